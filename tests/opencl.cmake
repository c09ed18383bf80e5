# The OpenCL tracers, on PoCL where there is nothing else; skipped with the reason where there is no device.
df_test(test_opencl LABELS opencl LIBS distfield-render SOURCES fields.c tracing.c)
df_script_test(test_opencl_cli LABELS opencl)
df_script_test(test_kernels LABELS opencl)
