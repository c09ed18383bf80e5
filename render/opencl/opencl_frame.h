/*
 * Pictures and hits from one OpenCL device: walks, solves, gradients and shading are the texts of the CPU.
 *
 * The field is uploaded once, when a renderer is opened, and stays; views and methods go with every call. On a device
 * whose float division and square root are correctly rounded (df_opencl_info) the results are those of the CPU, bit for
 * bit, but for the closed-form solve, whose functions are the device's own.
 *
 * A renderer is used by one thread at a time.
 */
#ifndef DF_OPENCL_FRAME_H
#define DF_OPENCL_FRAME_H

#include "render/cpu/bounds.h"
#include "render/frame.h"
#include "render/opencl/opencl_device.h"

/* How first hits are found in views; arbitrary rays always walk alone. */
typedef enum df_opencl_tracer {
    DF_OPENCL_DDA = 0, /* each ray walks alone */
    DF_OPENCL_CGT,     /* a work group is a packet of rays that visits the grid slice by slice */
    DF_OPENCL_ADF,     /* the leaves of an octree, each ray alone: the only way for octrees, and for nothing else */
    DF_OPENCL_TRACER_COUNT
} df_opencl_tracer;
extern const char *const df_opencl_tracer_names[]; /* "dda", "cgt", "adf", NULL */

typedef struct df_opencl_options {
    df_opencl_tracer tracer;
    int solve, steps; /* as in df_frame_options */
    int gradient;
    int bounds; /* DF_BOUNDS_NONE, _BRICKS or _VOXELS: the CPU projects them, with so many threads, the device walks
                   between */
    uint32_t threads;
    bool images;       /* gradients read the samples of a dense field from a 3D image, not from a buffer */
    uint32_t group[2]; /* work items of a work group in x and y; 0: 8 x 8, or less where the device has no room */
    FILE *log;         /* where the log of a failed build goes; NULL: nowhere */
} df_opencl_options;

/* By the device's own clock. */
typedef struct df_opencl_times {
    double trace_ms, shade_ms, download_ms;
    double bounds_ms;                  /* of the pre-pass, by the host's clock */
    double host_start_ms, host_end_ms; /* df_now_ms before the first command and after the last */
} df_opencl_times;

typedef struct df_opencl_renderer df_opencl_renderer;

/* Opens the device, builds the kernels for the structure of the scene, which must outlive the renderer, and uploads it.
 * DF_ERROR_USAGE for a tracer that is not for the structure, DF_ERROR_MEMORY for a field that does not fit: the message
 * names what would. */
df_status df_opencl_renderer_open(const df_opencl_info *info, const df_scene *scene, const df_opencl_options *options,
                                  df_opencl_renderer **out, df_error *err);
void df_opencl_renderer_close(df_opencl_renderer *renderer);

/* What opening took. upload_ms is 0 where the device shares the host's memory. */
void df_opencl_renderer_costs(const df_opencl_renderer *renderer, double *build_ms, double *upload_ms);

/* Renders the rows first_row <= y < first_row + row_count of the view into the picture, which has the view's size.
 * times may be NULL. */
df_status df_opencl_renderer_rows(df_opencl_renderer *renderer, const df_view *view, uint32_t first_row,
                                  uint32_t row_count, const df_picture *picture, df_opencl_times *times, df_error *err);

/* Traces the view once more to count hits and steps: a figure for reports, outside all timing. */
df_status df_opencl_renderer_count(df_opencl_renderer *renderer, const df_view *view, uint64_t *hitting,
                                   df_counters *counters, df_error *err);

/* The hits of any rays, in the order of the rays: what the scalar tracer appends. hits must have room for one a ray. */
df_status df_opencl_renderer_trace(df_opencl_renderer *renderer, const df_rays *rays, df_hits *hits,
                                   df_opencl_times *times, df_error *err);

/* DF_OK where a field's arrays fit in a device with these limits (bytes: of one buffer and of all memory); otherwise
 * DF_ERROR_MEMORY with the sizes and what structure or sample type would fit. name: of the device. */
df_status df_opencl_fits(const df_scene *scene, uint64_t allocation_max, uint64_t memory_size, const char *name,
                         df_error *err);

#endif
