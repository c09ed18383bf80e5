/*
 * An OpenCL library that fails on demand: a test puts it before the real one as libOpenCL.so.1, by LD_LIBRARY_PATH,
 * with the real one beside it as libdf_real_opencl.so, where all calls end that are not here.
 *
 * DF_CL_FAULTS names the faults, separated by commas; NAME:N is only at the N-th call, counted from 1:
 *   gpu         devices say that they are GPUs (for --device auto)
 *   no-images   devices say that they have no images
 *   build       the first line of dda.h in the kernels' text is an error
 *   cache       clBuildProgram fails without a word of why
 *   buffer      clCreateBuffer fails
 *   launch      clEnqueueNDRangeKernel fails
 *   lost        clFinish says that the device is gone
 * Each writes its name to descriptor DF_FAIL_FD when it occurs, so that a test knows that it did.
 */
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>

#include <dlfcn.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { FAULT_GPU, FAULT_NO_IMAGES, FAULT_BUILD, FAULT_CACHE, FAULT_BUFFER, FAULT_LAUNCH, FAULT_LOST, FAULT_COUNT };
static const char *const names[FAULT_COUNT] = {"gpu", "no-images", "build", "cache", "buffer", "launch", "lost"};
static atomic_long calls[FAULT_COUNT];

/* A function of the real library. */
static void *real(const char *name) {
    void *library = dlopen("libdf_real_opencl.so", RTLD_NOW | RTLD_LOCAL);
    void *function = library ? dlsym(library, name) : NULL;
    if (function) return function;
    (void)fprintf(stderr, "fail_opencl: no real %s\n", name);
    abort();
}
#define REAL(name) ((__typeof__(name) *)real(#name))

/* Whether this call is to fail. */
static int occurs(int fault) {
    const char *wanted = getenv("DF_CL_FAULTS"), *fd = getenv("DF_FAIL_FD");
    const size_t length = strlen(names[fault]);
    const long call = atomic_fetch_add(&calls[fault], 1) + 1;
    for (; wanted && *wanted; wanted += strcspn(wanted, ","), wanted += *wanted == ',') {
        if (strncmp(wanted, names[fault], length) != 0 || !strchr(",:", wanted[length])) continue;
        if (wanted[length] == ':' && atol(wanted + length + 1) != call) continue;
        if (fd && (write(atoi(fd), names[fault], length) < 0 || write(atoi(fd), "\n", 1) < 0)) abort();
        return 1;
    }
    return 0;
}

cl_int clGetDeviceInfo(cl_device_id device, cl_device_info what, size_t size, void *value, size_t *used) {
    const cl_int code = REAL(clGetDeviceInfo)(device, what, size, value, used);
    if (code == CL_SUCCESS && value && what == CL_DEVICE_TYPE && occurs(FAULT_GPU))
        *(cl_device_type *)value = CL_DEVICE_TYPE_GPU;
    if (code == CL_SUCCESS && value && what == CL_DEVICE_IMAGE_SUPPORT && occurs(FAULT_NO_IMAGES))
        *(cl_bool *)value = CL_FALSE;
    return code;
}

cl_program clCreateProgramWithSource(cl_context context, cl_uint count, const char **texts, const size_t *lengths,
                                     cl_int *code) {
    static const char place[] = "#line 1 \"render/methods/dda.h\"\n", mistake[] = "this is no declaration; ";
    const char *found = count == 1 && !lengths ? strstr(texts[0], place) : NULL;
    if (!found || !occurs(FAULT_BUILD)) return REAL(clCreateProgramWithSource)(context, count, texts, lengths, code);
    const size_t before = (size_t)(found - texts[0]) + sizeof place - 1;
    char *text = malloc(strlen(texts[0]) + sizeof mistake);
    if (!text) abort();
    memcpy(text, texts[0], before);
    memcpy(text + before, mistake, sizeof mistake - 1);
    strcpy(text + before + sizeof mistake - 1, texts[0] + before); // NOLINT(clang-analyzer-security.insecureAPI.strcpy)
    const char *const given = text;
    cl_program program = REAL(clCreateProgramWithSource)(context, 1, (const char **)(size_t)&given, NULL, code);
    free(text);
    return program;
}

cl_int clBuildProgram(cl_program program, cl_uint count, const cl_device_id *devices, const char *options,
                      void(CL_CALLBACK *notify)(cl_program, void *), void *data) {
    if (occurs(FAULT_CACHE)) return CL_BUILD_PROGRAM_FAILURE;
    return REAL(clBuildProgram)(program, count, devices, options, notify, data);
}

cl_mem clCreateBuffer(cl_context context, cl_mem_flags flags, size_t size, void *data, cl_int *code) {
    if (!occurs(FAULT_BUFFER)) return REAL(clCreateBuffer)(context, flags, size, data, code);
    if (code) *code = CL_MEM_OBJECT_ALLOCATION_FAILURE;
    return NULL;
}

cl_int clEnqueueNDRangeKernel(cl_command_queue queue, cl_kernel kernel, cl_uint dimensions, const size_t *offset,
                              const size_t *global, const size_t *local, cl_uint wait_count, const cl_event *wait,
                              cl_event *event) {
    if (occurs(FAULT_LAUNCH)) return CL_OUT_OF_RESOURCES;
    return REAL(clEnqueueNDRangeKernel)(queue, kernel, dimensions, offset, global, local, wait_count, wait, event);
}

cl_int clFinish(cl_command_queue queue) {
    const cl_int code = REAL(clFinish)(queue); /* a device that is lost writes no more */
    return occurs(FAULT_LOST) ? CL_DEVICE_NOT_AVAILABLE : code;
}
