#include "render/opencl/opencl_device.h"
#include "common/memory.h"
#include "common/progress.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

/* ---- finding ---- */

static void text_of(const df_opencl_api *cl, cl_device_id id, cl_device_info what, char *text, size_t size) {
    if (cl->GetDeviceInfo(id, what, size, text, NULL) != CL_SUCCESS) snprintf(text, size, "?");
    text[size - 1] = 0;
}

static uint64_t number_of(const df_opencl_api *cl, cl_device_id id, cl_device_info what) {
    uint64_t value = 0; /* every number asked for has 4 or 8 bytes, little endian */
    return cl->GetDeviceInfo(id, what, sizeof value, &value, NULL) == CL_SUCCESS ? value : 0;
}

static void describe(const df_opencl_api *cl, cl_platform_id platform, cl_device_id id, df_opencl_info *info) {
    memset(info, 0, sizeof *info);
    info->platform = platform;
    info->id = id;
    info->type = number_of(cl, id, CL_DEVICE_TYPE);
    text_of(cl, id, CL_DEVICE_NAME, info->name, sizeof info->name);
    text_of(cl, id, CL_DEVICE_OPENCL_C_VERSION, info->version, sizeof info->version);
    text_of(cl, id, CL_DRIVER_VERSION, info->driver, sizeof info->driver);
    if (cl->GetPlatformInfo(platform, CL_PLATFORM_NAME, sizeof info->platform_name, info->platform_name, NULL) !=
        CL_SUCCESS) {
        snprintf(info->platform_name, sizeof info->platform_name, "?");
    }
    info->compute_units = (uint32_t)number_of(cl, id, CL_DEVICE_MAX_COMPUTE_UNITS);
    info->memory_size = number_of(cl, id, CL_DEVICE_GLOBAL_MEM_SIZE);
    info->allocation_max = number_of(cl, id, CL_DEVICE_MAX_MEM_ALLOC_SIZE);
    info->group_max = number_of(cl, id, CL_DEVICE_MAX_WORK_GROUP_SIZE);
    info->images = number_of(cl, id, CL_DEVICE_IMAGE_SUPPORT);
    if (info->images) {
        info->image3d_max[0] = number_of(cl, id, CL_DEVICE_IMAGE3D_MAX_WIDTH);
        info->image3d_max[1] = number_of(cl, id, CL_DEVICE_IMAGE3D_MAX_HEIGHT);
        info->image3d_max[2] = number_of(cl, id, CL_DEVICE_IMAGE3D_MAX_DEPTH);
    }
    info->fp64 = number_of(cl, id, CL_DEVICE_DOUBLE_FP_CONFIG) != 0;
    info->shared_memory = number_of(cl, id, CL_DEVICE_HOST_UNIFIED_MEMORY);
    info->correctly_rounded = number_of(cl, id, CL_DEVICE_SINGLE_FP_CONFIG) & CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT;
    info->compiler = number_of(cl, id, CL_DEVICE_COMPILER_AVAILABLE) && number_of(cl, id, CL_DEVICE_AVAILABLE);
}

df_status df_opencl_find(df_opencl_info **list, uint32_t *count, df_error *err) {
    enum { PLATFORM_MAX = 16, DEVICE_MAX = 64 };
    const df_opencl_api *cl;
    cl_platform_id platforms[PLATFORM_MAX];
    cl_uint platform_count = 0;
    *list = NULL;
    *count = 0;
    df_status status = df_opencl_load(&cl, err);
    if (status != DF_OK) return status;
    if (cl->GetPlatformIDs(PLATFORM_MAX, platforms, &platform_count) != CL_SUCCESS) platform_count = 0;
    if (platform_count > PLATFORM_MAX) platform_count = PLATFORM_MAX;
    cl_int failure = CL_SUCCESS;
    for (cl_uint p = 0; p < platform_count; p++) {
        cl_device_id ids[DEVICE_MAX];
        cl_uint found = 0;
        const cl_int code = cl->GetDeviceIDs(platforms[p], CL_DEVICE_TYPE_ALL, DEVICE_MAX, ids, &found);
        if (code != CL_SUCCESS) {
            failure = code;
            continue;
        }
        if (found > DEVICE_MAX) found = DEVICE_MAX;
        df_opencl_info *grown = realloc(*list, (*count + found) * sizeof **list);
        if (!grown) {
            free(*list);
            *list = NULL;
            return df_fail(err, DF_ERROR_MEMORY, "out of memory");
        }
        *list = grown;
        for (cl_uint d = 0; d < found; d++) describe(cl, platforms[p], ids[d], &(*list)[(*count)++]);
    }
    if (*count == 0 && failure != CL_SUCCESS) {
        return df_fail(err, DF_ERROR_UNSUPPORTED,
                       "OpenCL has a platform but no device: clGetDeviceIDs failed with %s (%d). Drivers that keep "
                       "kernels in a cache "
                       "may need a home folder that they can write",
                       df_opencl_error_name(failure), failure);
    }
    return DF_OK;
}

static const char *type_name(cl_device_type type) {
    if (type & CL_DEVICE_TYPE_GPU) return "GPU";
    if (type & CL_DEVICE_TYPE_ACCELERATOR) return "accelerator";
    return type & CL_DEVICE_TYPE_CPU ? "CPU" : "other";
}

/* What a device lacks that the kernels need; NULL: nothing. */
static const char *missing(const df_opencl_info *info) {
    if (!info->compiler) return "it has no compiler";
    if (!info->fp64) return "it has no double precision (cl_khr_fp64), in which hits are solved";
    return NULL;
}

void df_opencl_print(FILE *stream, uint32_t number, const df_opencl_info *info) {
    const double gib = 1024.0 * 1024 * 1024;
    const char *lack = missing(info);
    fprintf(stream,
            "opencl:%u  %s (%s, %u compute units, %.1f GiB, at most %.1f GiB at once, %s, %s, %s; %s, driver %s)",
            number, info->name, type_name(info->type), info->compute_units, (double)info->memory_size / gib,
            (double)info->allocation_max / gib, info->images ? "images" : "no images",
            info->correctly_rounded ? "correctly rounded" : "not correctly rounded", info->version, info->platform_name,
            info->driver);
    if (lack) fprintf(stream, ": cannot be used, %s", lack);
}

df_status df_opencl_choose(const df_opencl_info *list, uint32_t count, uint32_t wanted, bool gpu_only, uint32_t *number,
                           df_error *err) {
    static const cl_device_type order[] = {CL_DEVICE_TYPE_GPU, CL_DEVICE_TYPE_ACCELERATOR, CL_DEVICE_TYPE_CPU};
    if (count == 0) return df_fail(err, DF_ERROR_UNSUPPORTED, "OpenCL has no device on this machine");
    if (wanted != DF_OPENCL_ANY) {
        if (wanted >= count) {
            return df_fail(err, DF_ERROR_UNSUPPORTED,
                           "--device opencl:%u: there are %u devices, numbered from 0 (--list-devices)", wanted, count);
        }
        const char *lack = missing(&list[wanted]);
        if (lack) return df_fail(err, DF_ERROR_UNSUPPORTED, "%s cannot be used: %s", list[wanted].name, lack);
        *number = wanted;
        return DF_OK;
    }
    for (int o = 0; o < (gpu_only ? 2 : 3); o++) {
        for (uint32_t i = 0; i < count; i++) {
            if (!(list[i].type & order[o]) || missing(&list[i])) continue;
            *number = i;
            return DF_OK;
        }
    }
    if (gpu_only) return df_fail(err, DF_ERROR_UNSUPPORTED, "OpenCL has no GPU on this machine");
    const char *lack = missing(&list[0]);
    return df_fail(err, DF_ERROR_UNSUPPORTED, "no OpenCL device can be used: %s: %s", list[0].name,
                   lack ? lack : "it is of no known kind");
}

/* ---- opening and building ---- */

void df_opencl_close(df_opencl *device) {
    if (!device->cl) return;
    if (device->program) device->cl->ReleaseProgram(device->program);
    if (device->queue) device->cl->ReleaseCommandQueue(device->queue);
    if (device->context) device->cl->ReleaseContext(device->context);
    memset(device, 0, sizeof *device);
}

df_status df_opencl_open(const df_opencl_info *info, df_opencl *device, df_error *err) {
    cl_int code;
    memset(device, 0, sizeof *device);
    df_status status = df_opencl_load(&device->cl, err);
    if (status != DF_OK) return status;
    device->info = *info;
    const cl_context_properties properties[] = {CL_CONTEXT_PLATFORM, (cl_context_properties)info->platform, 0};
    device->context = device->cl->CreateContext(properties, 1, &info->id, NULL, NULL, &code);
    if (!device->context) return df_opencl_check(code, "clCreateContext", info->name, err);
    device->queue = device->cl->CreateCommandQueue(device->context, info->id, CL_QUEUE_PROFILING_ENABLE, &code);
    if (!device->queue) return df_opencl_check(code, "clCreateCommandQueue", info->name, err);
    return DF_OK;
}

/* The log of a failed build, which the caller frees; NULL where there is none. */
static char *build_log(const df_opencl *device) {
    const df_opencl_api *cl = device->cl;
    size_t size = 0;
    cl->GetProgramBuildInfo(device->program, device->info.id, CL_PROGRAM_BUILD_LOG, 0, NULL, &size);
    char *text = size > 0 ? calloc(size + 1, 1) : NULL;
    if (!text ||
        cl->GetProgramBuildInfo(device->program, device->info.id, CL_PROGRAM_BUILD_LOG, size, text, NULL) == CL_SUCCESS)
        return text;
    free(text);
    return NULL;
}

/* The message of a failed build: the first line of the log that holds an error, and the log itself. */
static df_status report_build(df_opencl *device, cl_int code, FILE *log, df_error *err) {
    char *text = build_log(device);
    if (!text) return df_opencl_check(code, "clBuildProgram", device->info.name, err);
    if (log) fprintf(log, "%s\n", text);
    char *first = strstr(text, "error");
    const char *hint =
        first ? "" : ". OpenCL drivers that keep kernels in a cache may need a folder that they can write";
    if (!first) first = text;
    while (first > text && first[-1] != '\n') first--;
    df_status status = df_fail(err, DF_ERROR_UNSUPPORTED, "%s: the kernels do not build (%s): %.*s%s",
                               device->info.name, df_opencl_error_name(code), (int)strcspn(first, "\n"), first, hint);
    free(text);
    return status;
}

/* Makes the program of a source and builds it; *code: how the build went. */
static df_status try_build(df_opencl *device, const char *source, const char *options, cl_int *code, df_error *err) {
    if (device->program) device->cl->ReleaseProgram(device->program);
    device->program = device->cl->CreateProgramWithSource(device->context, 1, &source, NULL, code);
    if (!device->program) return df_opencl_check(*code, "clCreateProgramWithSource", device->info.name, err);
    *code = device->cl->BuildProgram(device->program, 1, &device->info.id, options, NULL, NULL);
    return DF_OK;
}

/* Whether the compiler found an error in the text, as far as the log tells. */
static bool text_is_wrong(const df_opencl *device) {
    char *text = build_log(device);
    const bool wrong = text && strstr(text, "error");
    free(text);
    return wrong;
}

/* PoCL, and others that keep kernels in files, may stumble over a process that fills the cache at the same time: what
 * fails without an error in the text is built again, a little later. */
#define BUILD_TRIES 4
#define BUILD_PAUSE_MS 50
df_status df_opencl_build_source(df_opencl *device, const char *source, const char *options, FILE *log, df_error *err) {
    char all[512];
    cl_int code;
    const double start = df_now_ms();
    snprintf(all, sizeof all, "-cl-std=CL1.2 -DDF_OPENCL %s %s",
             device->info.correctly_rounded ? "-cl-fp32-correctly-rounded-divide-sqrt" : "", options);
    df_status status = try_build(device, source, all, &code, err);
    for (long i = 1; status == DF_OK && code != CL_SUCCESS && i < BUILD_TRIES && !text_is_wrong(device); i++) {
        nanosleep(&(struct timespec){.tv_nsec = (BUILD_PAUSE_MS << i) * 1000000L}, NULL);
        status = try_build(device, source, all, &code, err);
    }
    if (status != DF_OK) return status;
    device->build_ms = df_now_ms() - start;
    return code == CL_SUCCESS ? DF_OK : report_build(device, code, log, err);
}

df_status df_opencl_build(df_opencl *device, const char *options, FILE *log, df_error *err) {
    return df_opencl_build_source(device, df_opencl_source, options, log, err);
}

df_status df_opencl_kernel(df_opencl *device, const char *name, cl_kernel *kernel, df_error *err) {
    cl_int code;
    *kernel = device->cl->CreateKernel(device->program, name, &code);
    return *kernel ? DF_OK : df_opencl_check(code, "clCreateKernel", device->info.name, err);
}

/* ---- memory ---- */

static df_status create_buffer(df_opencl *device, cl_mem_flags flags, uint64_t size, void *data, const char *what,
                               cl_mem *buffer, df_error *err) {
    cl_int code;
    *buffer = NULL;
    if (size > device->info.allocation_max) {
        return df_fail(err, DF_ERROR_MEMORY, "%s: %s of %llu bytes: a buffer may have %llu at most on this device",
                       device->info.name, what, (unsigned long long)size,
                       (unsigned long long)device->info.allocation_max);
    }
    *buffer = device->cl->CreateBuffer(device->context, flags, size ? size : 1, data, &code);
    if (*buffer) return DF_OK;
    return df_fail(err, DF_ERROR_MEMORY, "%s: %s of %llu bytes: clCreateBuffer failed with %s (%d)", device->info.name,
                   what, (unsigned long long)size, df_opencl_error_name(code), code);
}

df_status df_opencl_buffer(df_opencl *device, cl_mem_flags flags, uint64_t size, const char *what, cl_mem *buffer,
                           df_error *err) {
    return create_buffer(device, flags, size, NULL, what, buffer, err);
}

df_status df_opencl_upload(df_opencl *device, const void *data, uint64_t size, const char *what, cl_mem *buffer,
                           double *ms, df_error *err) {
    cl_event event = NULL;
    double part = 0;
    *buffer = NULL;
    if (size == 0) return DF_OK;
    /* Read only, so the host's bytes are never written although the interface takes a plain pointer. */
    if (device->info.shared_memory) {
        return create_buffer(device, CL_MEM_READ_ONLY | CL_MEM_USE_HOST_PTR, size, (void *)data, what, buffer, err);
    }
    df_status status = create_buffer(device, CL_MEM_READ_ONLY, size, NULL, what, buffer, err);
    if (status != DF_OK) return status;
    const cl_int code = device->cl->EnqueueWriteBuffer(device->queue, *buffer, CL_TRUE, 0, size, data, 0, NULL, &event);
    status = df_opencl_blocking_ms(device, code, "clEnqueueWriteBuffer", event, &part, err);
    *ms += part;
    return status;
}

df_status df_opencl_event_ms(df_opencl *device, cl_event event, double *ms, df_error *err) {
    cl_ulong start = 0, end = 0;
    cl_int code = device->cl->GetEventProfilingInfo(event, CL_PROFILING_COMMAND_START, sizeof start, &start, NULL);
    if (code == CL_SUCCESS)
        code = device->cl->GetEventProfilingInfo(event, CL_PROFILING_COMMAND_END, sizeof end, &end, NULL);
    device->cl->ReleaseEvent(event);
    *ms = (double)(end - start) * 1e-6;
    return df_opencl_check(code, "clGetEventProfilingInfo", device->info.name, err);
}

df_status df_opencl_blocking_ms(df_opencl *device, cl_int code, const char *call, cl_event event, double *ms,
                                df_error *err) {
    if (code == CL_SUCCESS) return df_opencl_event_ms(device, event, ms, err);
    if (event) device->cl->ReleaseEvent(event);
    return df_opencl_check(code, call, device->info.name, err);
}
