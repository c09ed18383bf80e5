# The OpenCL tracers, on PoCL where there is nothing else; skipped with the reason where there is no device.
df_test(test_opencl LABELS opencl LIBS distfield-render SOURCES fields.c tracing.c)
if(NOT DF_SANITIZE)
    set_tests_properties(test_opencl PROPERTIES TIMEOUT 900) # builds some hundred kernels
endif()
df_script_test(test_opencl_cli LABELS opencl)
df_script_test(test_kernels LABELS opencl)

# A library before the real one, for which that name stands until test_opencl_cli puts a link in its place.
file(WRITE ${CMAKE_CURRENT_BINARY_DIR}/real_opencl.c "int df_real_opencl;\n")
add_library(df_real_opencl SHARED ${CMAKE_CURRENT_BINARY_DIR}/real_opencl.c)
add_library(fail_opencl SHARED fail_opencl.c)
target_compile_definitions(fail_opencl PRIVATE _GNU_SOURCE)
target_include_directories(fail_opencl PRIVATE ${OPENCL_INCLUDE_DIR})
target_link_libraries(fail_opencl PRIVATE df_real_opencl dl)
target_link_options(fail_opencl PRIVATE -Wl,--no-as-needed)
set_target_properties(fail_opencl PROPERTIES SKIP_BUILD_RPATH ON)
