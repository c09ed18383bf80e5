# The tests of the renderer.
df_test(test_render_shapes LABELS stability LIBS distfield-render SOURCES fields.c tracing.c)
df_test(test_render_tracers LABELS kernels LIBS distfield-render SOURCES fields.c)
df_test(test_gradients LABELS kernels LIBS distfield-render SOURCES fields.c)
add_executable(make_field make_field.c fields.c)
target_link_libraries(make_field PRIVATE distfield-common df_flags)
df_script_test(test_render_cli LABELS unit)
