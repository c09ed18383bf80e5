/*
 * OpenCL devices: finding, listing and opening them, building kernels and moving bytes. Kernels live in render/opencl.
 *
 * An opened device has one queue that works in order; it is used by one thread at a time. Different devices, or one
 * device opened twice, may be used by different threads.
 */
#ifndef DF_OPENCL_DEVICE_H
#define DF_OPENCL_DEVICE_H

#include "render/opencl/opencl_api.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

typedef struct df_opencl_info {
    cl_platform_id platform;
    cl_device_id id;
    cl_device_type type;
    char name[128], platform_name[96], version[96], driver[64];
    uint32_t compute_units;
    uint64_t memory_size, allocation_max; /* bytes: all, and of one buffer */
    size_t group_max;                     /* work items in a work group */
    size_t image3d_max[3];                /* 0 without images */
    bool images, fp64;
    bool shared_memory;     /* with the host: buffers use the host's bytes in place */
    bool correctly_rounded; /* float division and square root are IEEE: pictures are equal to the CPU's, bit for bit */
    bool compiler;
} df_opencl_info;

/* All devices of all platforms, in the library's order: --device opencl:N counts through them. *list is malloc'ed. A
 * library without platforms or devices gives a count of 0; DF_ERROR_UNSUPPORTED where there is no library, or where
 * platforms fail to give their devices. */
df_status df_opencl_find(df_opencl_info **list, uint32_t *count, df_error *err);

/* One line for --list-devices, without a newline. */
void df_opencl_print(FILE *stream, uint32_t number, const df_opencl_info *info);

#define DF_OPENCL_ANY 0xFFFFFFFFu /* the first GPU, else the first accelerator, else the first CPU */

/* The number of a device that can be used; DF_ERROR_UNSUPPORTED, naming what is missing, where there is none of that
 * number. gpu_only: DF_OPENCL_ANY means a GPU or an accelerator. */
df_status df_opencl_choose(const df_opencl_info *list, uint32_t count, uint32_t wanted, bool gpu_only, uint32_t *number,
                           df_error *err);

typedef struct df_opencl {
    const df_opencl_api *cl;
    df_opencl_info info;
    cl_context context;
    cl_command_queue queue;
    cl_program program;
    double build_ms;
} df_opencl;

/* Opens a device; release with df_opencl_close, which accepts what failed to open. */
df_status df_opencl_open(const df_opencl_info *info, df_opencl *device, df_error *err);
void df_opencl_close(df_opencl *device);

/* Builds the kernels with these options besides the fixed ones ("-DDF_K=8"). Where that fails the message holds the
 * first error of the build log, and the whole log goes to `log` unless that is NULL. */
df_status df_opencl_build(df_opencl *device, const char *options, FILE *log, df_error *err);
df_status df_opencl_build_source(df_opencl *device, const char *source, const char *options, FILE *log, df_error *err);

/* return from the function unless the call succeeded: DF_CL(device, Finish, device->queue) */
#define DF_CL(device, call, ...)                                                                                \
    do {                                                                                                        \
        cl_int df_cl_code = (device)->cl->call(__VA_ARGS__);                                                    \
        if (df_cl_code != CL_SUCCESS) return df_opencl_check(df_cl_code, "cl" #call, (device)->info.name, err); \
    } while (0)

df_status df_opencl_kernel(df_opencl *device, const char *name, cl_kernel *kernel, df_error *err);

/* A buffer of `size` bytes (at least 1 is allocated). DF_ERROR_MEMORY, with the sizes, where it is larger than the
 * device's largest allocation. */
df_status df_opencl_buffer(df_opencl *device, cl_mem_flags flags, uint64_t size, const char *what, cl_mem *buffer,
                           df_error *err);

/* A read-only buffer with the bytes at `data`, which must stay where they are while it lives: shared where memory is.
 * NULL for size 0. *ms grows by the time of the transfer. */
df_status df_opencl_upload(df_opencl *device, const void *data, uint64_t size, const char *what, cl_mem *buffer,
                           double *ms, df_error *err);

/* The time of a finished command, which is released. */
df_status df_opencl_event_ms(df_opencl *device, cl_event event, double *ms, df_error *err);

/* The same of a blocking command that has returned `code`: its event, NULL or not, is released in any case. */
df_status df_opencl_blocking_ms(df_opencl *device, cl_int code, const char *call, cl_event event, double *ms,
                                df_error *err);

/* The text of all kernels, made from render/opencl and the headers they share with the CPU. */
extern const char df_opencl_source[];

#endif
