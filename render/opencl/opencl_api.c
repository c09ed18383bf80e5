#include "render/opencl/opencl_api.h"

#include <dlfcn.h>
#include <pthread.h>
#include <stdbool.h>

/* Loaded once and never closed: drivers keep threads. */
static struct {
    pthread_once_t once;
    df_opencl_api api;
    df_status status;
    df_error error;
} library = {.once = PTHREAD_ONCE_INIT};

static df_status look_up(df_opencl_api *api, df_error *err) {
    void *handle = dlopen("libOpenCL.so.1", RTLD_NOW | RTLD_LOCAL);
    if (!handle) return df_fail(err, DF_ERROR_UNSUPPORTED, "no OpenCL on this machine: %s", dlerror());
#define DF_OPENCL_LOOK_UP(name)                       \
    *(void **)&api->name = dlsym(handle, "cl" #name); \
    if (!api->name) return df_fail(err, DF_ERROR_UNSUPPORTED, "the OpenCL library is too old: it has no cl%s", #name);
    DF_OPENCL_FUNCTIONS(DF_OPENCL_LOOK_UP)
#undef DF_OPENCL_LOOK_UP
    return DF_OK;
}

static void load(void) { library.status = look_up(&library.api, &library.error); }

df_status df_opencl_load(const df_opencl_api **api, df_error *err) {
    pthread_once(&library.once, load);
    *api = library.status == DF_OK ? &library.api : NULL;
    return library.status == DF_OK ? DF_OK : df_fail(err, library.status, "%s", library.error.text);
}

const char *df_opencl_error_name(cl_int code) {
    static const char *const low[] = {/* 0 to -19 */
                                      "CL_SUCCESS",
                                      "CL_DEVICE_NOT_FOUND",
                                      "CL_DEVICE_NOT_AVAILABLE",
                                      "CL_COMPILER_NOT_AVAILABLE",
                                      "CL_MEM_OBJECT_ALLOCATION_FAILURE",
                                      "CL_OUT_OF_RESOURCES",
                                      "CL_OUT_OF_HOST_MEMORY",
                                      "CL_PROFILING_INFO_NOT_AVAILABLE",
                                      "CL_MEM_COPY_OVERLAP",
                                      "CL_IMAGE_FORMAT_MISMATCH",
                                      "CL_IMAGE_FORMAT_NOT_SUPPORTED",
                                      "CL_BUILD_PROGRAM_FAILURE",
                                      "CL_MAP_FAILURE",
                                      "CL_MISALIGNED_SUB_BUFFER_OFFSET",
                                      "CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST",
                                      "CL_COMPILE_PROGRAM_FAILURE",
                                      "CL_LINKER_NOT_AVAILABLE",
                                      "CL_LINK_PROGRAM_FAILURE",
                                      "CL_DEVICE_PARTITION_FAILED",
                                      "CL_KERNEL_ARG_INFO_NOT_AVAILABLE"};
    static const char *const high[] = {/* -30 to -68 */
                                       "CL_INVALID_VALUE",
                                       "CL_INVALID_DEVICE_TYPE",
                                       "CL_INVALID_PLATFORM",
                                       "CL_INVALID_DEVICE",
                                       "CL_INVALID_CONTEXT",
                                       "CL_INVALID_QUEUE_PROPERTIES",
                                       "CL_INVALID_COMMAND_QUEUE",
                                       "CL_INVALID_HOST_PTR",
                                       "CL_INVALID_MEM_OBJECT",
                                       "CL_INVALID_IMAGE_FORMAT_DESCRIPTOR",
                                       "CL_INVALID_IMAGE_SIZE",
                                       "CL_INVALID_SAMPLER",
                                       "CL_INVALID_BINARY",
                                       "CL_INVALID_BUILD_OPTIONS",
                                       "CL_INVALID_PROGRAM",
                                       "CL_INVALID_PROGRAM_EXECUTABLE",
                                       "CL_INVALID_KERNEL_NAME",
                                       "CL_INVALID_KERNEL_DEFINITION",
                                       "CL_INVALID_KERNEL",
                                       "CL_INVALID_ARG_INDEX",
                                       "CL_INVALID_ARG_VALUE",
                                       "CL_INVALID_ARG_SIZE",
                                       "CL_INVALID_KERNEL_ARGS",
                                       "CL_INVALID_WORK_DIMENSION",
                                       "CL_INVALID_WORK_GROUP_SIZE",
                                       "CL_INVALID_WORK_ITEM_SIZE",
                                       "CL_INVALID_GLOBAL_OFFSET",
                                       "CL_INVALID_EVENT_WAIT_LIST",
                                       "CL_INVALID_EVENT",
                                       "CL_INVALID_OPERATION",
                                       "CL_INVALID_GL_OBJECT",
                                       "CL_INVALID_BUFFER_SIZE",
                                       "CL_INVALID_MIP_LEVEL",
                                       "CL_INVALID_GLOBAL_WORK_SIZE",
                                       "CL_INVALID_PROPERTY",
                                       "CL_INVALID_IMAGE_DESCRIPTOR",
                                       "CL_INVALID_COMPILER_OPTIONS",
                                       "CL_INVALID_LINKER_OPTIONS",
                                       "CL_INVALID_DEVICE_PARTITION_COUNT"};
    const cl_int low_count = sizeof low / sizeof low[0], high_count = sizeof high / sizeof high[0];
    if (code == -1001) return "CL_PLATFORM_NOT_FOUND_KHR";
    if (code <= 0 && code > -low_count) return low[-code];
    if (code <= -30 && code > -30 - high_count) return high[-30 - code];
    return "CL_?";
}

df_status df_opencl_check(cl_int code, const char *call, const char *device, df_error *err) {
    if (code == CL_SUCCESS) return DF_OK;
    const bool memory = code == CL_MEM_OBJECT_ALLOCATION_FAILURE || code == CL_OUT_OF_HOST_MEMORY;
    return df_fail(err, memory ? DF_ERROR_MEMORY : DF_ERROR_UNSUPPORTED, "%s: %s failed with %s (%d)%s", device, call,
                   df_opencl_error_name(code), code, memory ? ": the device has too little memory" : "");
}
