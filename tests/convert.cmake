# The converter.
df_script_test(test_convert_bad_input LABELS unit)
add_executable(check_field check_field.c oracle.c)
target_link_libraries(check_field PRIVATE distfield-convert)
set_target_properties(check_field PROPERTIES LINKER_LANGUAGE CXX)
df_script_test(test_convert_oracle LABELS unit)
df_test(test_convert_readers LABELS unit LIBS distfield-convert)
set_target_properties(test_convert_readers PROPERTIES LINKER_LANGUAGE CXX)
target_compile_options(test_convert_readers PRIVATE -Wno-format-nonliteral)
