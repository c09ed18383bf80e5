# Pictures from OpenCL devices. The library is loaded at run time; building needs only its headers.
find_path(OPENCL_INCLUDE_DIR CL/cl.h REQUIRED)

# The kernels as one text in the program.
file(GLOB opencl_texts CONFIGURE_DEPENDS *.h kernels/*)
set(opencl_source ${PROJECT_BINARY_DIR}/generated/opencl_source)
find_program(PYTHON3 python3 REQUIRED)
add_custom_command(
    OUTPUT ${opencl_source}.c ${opencl_source}.cl
    COMMAND ${PYTHON3} ${CMAKE_CURRENT_SOURCE_DIR}/kernels/embed.py ${PROJECT_SOURCE_DIR} render/kernels/trace.cl df_opencl_source
            ${opencl_source}.cl ${opencl_source}.c
    DEPENDS ${opencl_texts}
    VERBATIM)

target_sources(distfield-render PRIVATE devices.c opencl_api.c opencl_device.c opencl_frame.c ${opencl_source}.c)
target_include_directories(distfield-render PUBLIC $<BUILD_INTERFACE:${OPENCL_INCLUDE_DIR}>)
target_link_libraries(distfield-render PUBLIC ${CMAKE_DL_LIBS})
