/*
 * The OpenCL library, loaded when it is first asked for: programs start and work where there is none. Entry points are
 * those of OpenCL 1.2 and members of one table, so that a test can put its own in their place.
 */
#ifndef DF_OPENCL_API_H
#define DF_OPENCL_API_H

#include "common/status.h"

#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>

#define DF_OPENCL_FUNCTIONS(X)                                                                                 \
    X(GetPlatformIDs)                                                                                          \
    X(GetPlatformInfo)                                                                                         \
    X(GetDeviceIDs)                                                                                            \
    X(GetDeviceInfo)                                                                                           \
    X(CreateContext)                                                                                           \
    X(ReleaseContext) X(CreateCommandQueue) X(ReleaseCommandQueue) X(CreateProgramWithSource) X(BuildProgram)  \
        X(GetProgramBuildInfo) X(ReleaseProgram) X(CreateKernel) X(ReleaseKernel) X(SetKernelArg)              \
            X(GetKernelWorkGroupInfo) X(CreateBuffer) X(CreateImage) X(ReleaseMemObject) X(EnqueueWriteBuffer) \
                X(EnqueueReadBuffer) X(EnqueueWriteImage) X(EnqueueNDRangeKernel) X(Flush) X(Finish)           \
                    X(GetEventProfilingInfo) X(ReleaseEvent)

typedef struct df_opencl_api {
#define DF_OPENCL_MEMBER(name) __typeof__(cl##name) *name; // NOLINT(bugprone-macro-parentheses)
    DF_OPENCL_FUNCTIONS(DF_OPENCL_MEMBER)
#undef DF_OPENCL_MEMBER
} df_opencl_api;

/* Sets *api to the table, which stays valid until the program ends. DF_ERROR_UNSUPPORTED where there is no OpenCL
 * library. Safe to call from several threads. */
df_status df_opencl_load(const df_opencl_api **api, df_error *err);

/* "CL_OUT_OF_RESOURCES" for -5; "CL_?" for a code that OpenCL 1.2 does not know. */
const char *df_opencl_error_name(cl_int code);

/* The status of a call's result; the message names the call, the symbolic error and the device. */
df_status df_opencl_check(cl_int code, const char *call, const char *device, df_error *err);

#endif
