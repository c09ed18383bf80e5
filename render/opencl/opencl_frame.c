#include "render/opencl/opencl_frame.h"
#include "common/memory.h"
#include "common/octree_samples.h"
#include "common/progress.h"
#include "render/methods/shade.h"
#include "render/methods/solve_methods.h"
#include "render/opencl/grid.h"

#include <assert.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

const char *const df_opencl_tracer_names[] = {"dda", "cgt", "adf", NULL};

/* Floats of local memory that df_cgt_view wants for each work item: DF_CGT_VALUES of opencl/cgt.cl. */
#define CGT_VALUES 13

/* A buffer that grows. */
typedef struct frame_buffer {
    cl_mem memory;
    uint64_t size;
} frame_buffer;

enum { KERNEL_TRACE_VIEW, KERNEL_SHADE_VIEW, KERNEL_TRACE_RAYS, KERNEL_SOLVE_RAYS, KERNEL_COUNT_VIEW, KERNEL_COUNT };

enum { SCENE_SAMPLES, SCENE_EXPONENTS, SCENE_COARSE, SCENE_MASKS, SCENE_ARRAYS };
enum { SCENE_ARGUMENTS = 5 }; /* of every kernel: the grid and the arrays */

struct df_opencl_renderer {
    df_opencl device;
    const df_scene *scene;
    df_opencl_options options;
    size_t group[2], count_group[2], ray_group; /* work items of a group: in x and y, of arbitrary rays */
    cl_kernel kernels[KERNEL_COUNT];
    cl_mem arrays[SCENE_ARRAYS], shade_table;
    float *cells;     /* of an octree, which the device may use in place */
    cl_mem image;     /* of the samples; NULL: gradients read the buffer */
    df_bounds bounds; /* of the view's squares, when options ask for them */
    frame_buffer found, candidates, counts, rgb, depth, normals, rays, t, positions, intervals;
    cl_event events[8]; /* of the commands that are under way */
    uint32_t event_count;
    double build_ms, upload_ms;
};

/* ---- the field ---- */

typedef struct scene_array {
    const char *what;
    const void *data;
    uint64_t size;
} scene_array;

/* cells: of an octree; NULL where only sizes matter. */
static void scene_arrays(const df_scene *scene, const float *cells, scene_array arrays[SCENE_ARRAYS]) {
    const df_field *field = scene->field;
    const uint32_t *coarse = scene->coarse_count, *voxels = scene->voxel_count;
    const bool uniform = scene->levels == 1, octree = scene->levels == 0;
    memset(arrays, 0, SCENE_ARRAYS * sizeof *arrays);
    if (octree) {
        const uint32_t coded = field->family_count - field->exact_count;
        arrays[SCENE_SAMPLES] = (scene_array){"samples", field->samples, df_adf_sample_bytes(field)};
        arrays[SCENE_EXPONENTS] = (scene_array){"exponents", field->brick_exponents, coded};
        arrays[SCENE_COARSE] =
            (scene_array){"octree", field->families, (uint64_t)field->family_count * sizeof *field->families};
        arrays[SCENE_MASKS] = (scene_array){"cells of the octree", cells, (uint64_t)coded * 8 * sizeof(float)};
        return;
    }
    arrays[SCENE_SAMPLES] =
        (scene_array){"samples", field->samples, field->sample_count * df_sample_size(field->sample_type)};
    arrays[SCENE_EXPONENTS] =
        (scene_array){"exponents", field->brick_exponents, field->brick_exponents ? field->brick_count : 0};
    arrays[SCENE_COARSE] =
        (scene_array){"coarse cells", scene->coarse, uniform ? 0 : 4ull * coarse[0] * coarse[1] * coarse[2]};
    arrays[SCENE_MASKS] =
        uniform
            ? (scene_array){"surface mask", scene->rows, 8ull * scene->row_words * voxels[1] * voxels[2]}
            : (scene_array){"surface masks", scene->masks, 8ull * scene->block_count * df_brick_mask_words(scene->k)};
}

df_status df_opencl_fits(const df_scene *scene, uint64_t allocation_max, uint64_t memory_size, const char *name,
                         df_error *err) {
    static const df_sample_type types[] = {DF_SAMPLE_F32, DF_SAMPLE_U16, DF_SAMPLE_U8};
    const df_field *field = scene->field;
    scene_array arrays[SCENE_ARRAYS];
    uint64_t all = 0, largest = 0;
    char fitting[256] = "";
    scene_arrays(scene, NULL, arrays);
    for (int i = 0; i < SCENE_ARRAYS; i++) {
        all += arrays[i].size;
        if (arrays[i].size > largest) largest = arrays[i].size;
    }
    if (largest <= allocation_max && all <= memory_size) return DF_OK;
    const uint64_t brick_samples = (uint64_t)scene->block_count * df_brick_sample_count(scene->k);
    for (int bricks = 0; bricks < 2 && scene->levels > 0; bricks++) {
        if (bricks != (field->kind == DF_FIELD_BRICKS) && (!bricks || scene->levels == 1))
            continue; /* not known here */
        for (int t = 0; t < 3; t++) {
            uint64_t size = (bricks ? brick_samples : field->sample_count) * df_sample_size(types[t]);
            if (size > allocation_max || size + (all - arrays[SCENE_SAMPLES].size) > memory_size) continue;
            size_t used = strlen(fitting);
            snprintf(fitting + used, sizeof fitting - used, "%s%s %s (%" PRIu64 " bytes)", used ? ", " : "",
                     bricks ? "bricks of" : "dense", df_sample_type_name(types[t]), size);
        }
    }
    return df_fail(err, DF_ERROR_MEMORY,
                   "%s: the field has %" PRIu64 " bytes, the largest array %" PRIu64 "; the device takes %" PRIu64
                   " in one buffer and %" PRIu64 " in all; %s%s",
                   name, all, largest, allocation_max, memory_size,
                   fitting[0] ? "these would fit: " : "a lower resolution would fit", fitting);
}

static df_grid make_grid(const df_scene *scene) {
    df_grid grid = {.row_words = scene->row_words,
                    .step_exponent = scene->field->step_exponent,
                    .level_count = scene->field->level_count,
                    .exact_count = scene->field->exact_count,
                    .iso = scene->iso};
    memcpy(grid.voxel_count, scene->voxel_count, sizeof grid.voxel_count);
    memcpy(grid.coarse_count, scene->coarse_count, sizeof grid.coarse_count);
    return grid;
}

/* ---- arguments and launches ---- */

typedef struct kernel_argument {
    size_t size;
    const void *value;
} kernel_argument;
#define ARGUMENT(variable) \
    { sizeof(variable), &(variable) }

static df_status set_arguments(df_opencl_renderer *r, cl_kernel kernel, uint32_t first,
                               const kernel_argument *arguments, uint32_t count, df_error *err) {
    for (uint32_t i = 0; i < count; i++)
        DF_CL(&r->device, SetKernelArg, kernel, first + i, arguments[i].size, arguments[i].value);
    return DF_OK;
}

/* Queues a kernel; its event goes to r->events. */
static df_status launch(df_opencl_renderer *r, cl_kernel kernel, uint32_t dimensions, const size_t extent[2],
                        const size_t group[2], df_error *err) {
    size_t global[2];
    assert(r->event_count < sizeof r->events / sizeof r->events[0]);
    for (uint32_t d = 0; d < dimensions; d++) global[d] = (extent[d] + group[d] - 1) / group[d] * group[d];
    DF_CL(&r->device, EnqueueNDRangeKernel, r->device.queue, kernel, dimensions, NULL, global, group, 0, NULL,
          &r->events[r->event_count]);
    r->event_count++;
    return DF_OK;
}

static df_status read_back(df_opencl_renderer *r, cl_mem memory, void *data, uint64_t size, df_error *err) {
    assert(r->event_count < sizeof r->events / sizeof r->events[0]);
    DF_CL(&r->device, EnqueueReadBuffer, r->device.queue, memory, CL_FALSE, 0, size, data, 0, NULL,
          &r->events[r->event_count]);
    r->event_count++;
    return DF_OK;
}

/* Waits for what is under way, also after a failure: the host's memory is in use until then. */
static df_status finish(df_opencl_renderer *r, double ms[], df_error *err) {
    cl_int code = r->device.cl->Finish(r->device.queue);
    df_status status = df_opencl_check(code, "clFinish", r->device.info.name, err);
    for (uint32_t i = 0; i < r->event_count; i++) {
        if (status == DF_OK) status = df_opencl_event_ms(&r->device, r->events[i], &ms[i], err);
        else r->device.cl->ReleaseEvent(r->events[i]);
    }
    r->event_count = 0;
    return status;
}

static df_status grow(df_opencl_renderer *r, frame_buffer *buffer, uint64_t size, const char *what, df_error *err) {
    if (buffer->size >= size && buffer->memory) return DF_OK;
    if (buffer->memory) r->device.cl->ReleaseMemObject(buffer->memory);
    buffer->size = 0;
    df_status status = df_opencl_buffer(&r->device, CL_MEM_READ_WRITE, size, what, &buffer->memory, err);
    if (status == DF_OK) buffer->size = size;
    return status;
}

/* ---- opening ---- */

void df_opencl_renderer_close(df_opencl_renderer *r) {
    if (!r) return;
    const df_opencl_api *cl = r->device.cl;
    const frame_buffer *buffers[] = {&r->found,   &r->candidates, &r->counts, &r->rgb,       &r->depth,
                                     &r->normals, &r->rays,       &r->t,      &r->positions, &r->intervals};
    for (size_t i = 0; i < sizeof buffers / sizeof buffers[0]; i++) {
        if (buffers[i]->memory) cl->ReleaseMemObject(buffers[i]->memory);
    }
    for (int i = 0; i < SCENE_ARRAYS; i++) {
        if (r->arrays[i]) cl->ReleaseMemObject(r->arrays[i]);
    }
    if (r->shade_table) cl->ReleaseMemObject(r->shade_table);
    if (r->image) cl->ReleaseMemObject(r->image);
    for (int i = 0; i < KERNEL_COUNT; i++) {
        if (r->kernels[i]) cl->ReleaseKernel(r->kernels[i]);
    }
    df_bounds_free(&r->bounds);
    df_opencl_close(&r->device);
    free(r->cells);
    free(r);
}

/* A 3D image of the samples of a dense field. */
static df_status upload_image(df_opencl_renderer *r, df_error *err) {
    static const cl_channel_type channels[] = {
        [DF_SAMPLE_F32] = CL_FLOAT, [DF_SAMPLE_U16] = CL_UNSIGNED_INT16, [DF_SAMPLE_U8] = CL_UNSIGNED_INT8};
    const df_field *field = r->scene->field;
    const df_opencl_info *info = &r->device.info;
    const size_t start[3] = {0, 0, 0},
                 size[3] = {field->voxel_count[0] + 1, field->voxel_count[1] + 1, field->voxel_count[2] + 1};
    if (field->kind != DF_FIELD_DENSE)
        return df_fail(err, DF_ERROR_USAGE, "--gradient-image: a field of %s makes no image",
                       df_field_kind_name(field->kind));
    if (!info->images) return df_fail(err, DF_ERROR_UNSUPPORTED, "--gradient-image: %s has no images", info->name);
    if (size[0] > info->image3d_max[0] || size[1] > info->image3d_max[1] || size[2] > info->image3d_max[2]) {
        return df_fail(err, DF_ERROR_UNSUPPORTED,
                       "--gradient-image: %s: an image of %zux%zux%zu samples: at most %zux%zux%zu", info->name,
                       size[0], size[1], size[2], info->image3d_max[0], info->image3d_max[1], info->image3d_max[2]);
    }
    const cl_image_format format = {CL_R, channels[field->sample_type]};
    const cl_image_desc desc = {
        .image_type = CL_MEM_OBJECT_IMAGE3D, .image_width = size[0], .image_height = size[1], .image_depth = size[2]};
    cl_event event = NULL;
    cl_int code;
    double ms = 0;
    r->image = r->device.cl->CreateImage(r->device.context, CL_MEM_READ_ONLY, &format, &desc, NULL, &code);
    if (!r->image) return df_opencl_check(code, "clCreateImage", info->name, err);
    code = r->device.cl->EnqueueWriteImage(r->device.queue, r->image, CL_TRUE, start, size, 0, 0, field->samples, 0,
                                           NULL, &event);
    df_status status = df_opencl_blocking_ms(&r->device, code, "clEnqueueWriteImage", event, &ms, err);
    r->upload_ms += ms;
    return status;
}

/* The corners of the divided cells of the families of an octree that are not exact: a walk and a gradient look at many
 * leaves, and would decode each from an exact family down. *cells is malloc'ed; NULL where there are none. */
static df_status decode_cells(const df_field *field, float **cells, df_error *err) {
    const uint32_t first = field->exact_count;
    *cells = NULL;
    if (field->kind != DF_FIELD_ADF || field->family_count == first) return DF_OK;
    df_status status = df_alloc_raw((void **)cells, (uint64_t)field->family_count - first, 8 * sizeof(float),
                                    "cells of the octree", err);
    for (uint32_t family = first; family < field->family_count && status == DF_OK; family++) {
        const uint32_t parent = field->families[family].parent >> 3, child = field->families[family].parent & 7;
        float *cell = *cells + 8 * (size_t)(family - first);
        if (family == 0 || parent < first) df_octree_cell_corners(field, family, cell);
        else df_octree_child_corners(field, parent, child, *cells + 8 * (size_t)(parent - first), cell);
    }
    return status;
}

static df_status upload(df_opencl_renderer *r, df_error *err) {
    scene_array arrays[SCENE_ARRAYS];
    uint8_t *table;
    df_status status =
        df_opencl_fits(r->scene, r->device.info.allocation_max, r->device.info.memory_size, r->device.info.name, err);
    if (status == DF_OK) status = decode_cells(r->scene->field, &r->cells, err);
    scene_arrays(r->scene, r->cells, arrays);
    for (int i = 0; i < SCENE_ARRAYS && status == DF_OK; i++) {
        status = df_opencl_upload(&r->device, arrays[i].data, arrays[i].size, arrays[i].what, &r->arrays[i],
                                  &r->upload_ms, err);
    }
    if (status == DF_OK && r->options.images) status = upload_image(r, err);
    if (status == DF_OK) status = df_alloc((void **)&table, DF_SHADE_LEVELS, 1, "shade table", err);
    if (status != DF_OK) return status;
    df_shade_table(table);
    cl_int code;
    r->shade_table = r->device.cl->CreateBuffer(r->device.context, CL_MEM_READ_ONLY | CL_MEM_COPY_HOST_PTR,
                                                DF_SHADE_LEVELS, table, &code);
    free(table);
    return r->shade_table ? DF_OK : df_opencl_check(code, "clCreateBuffer", r->device.info.name, err);
}

/* Creates a kernel of the program, and lowers *most to the work items that it has room for in a group. */
static df_status create_kernel(df_opencl_renderer *r, const char *name, cl_kernel *kernel, size_t *most,
                               df_error *err) {
    const df_grid grid = make_grid(r->scene);
    const kernel_argument arguments[SCENE_ARGUMENTS] = {ARGUMENT(grid), ARGUMENT(r->arrays[0]), ARGUMENT(r->arrays[1]),
                                                        ARGUMENT(r->arrays[2]), ARGUMENT(r->arrays[3])};
    size_t of_kernel;
    df_status status = df_opencl_kernel(&r->device, name, kernel, err);
    if (status == DF_OK) status = set_arguments(r, *kernel, 0, arguments, SCENE_ARGUMENTS, err);
    if (status != DF_OK) return status;
    DF_CL(&r->device, GetKernelWorkGroupInfo, *kernel, r->device.info.id, CL_KERNEL_WORK_GROUP_SIZE, sizeof of_kernel,
          &of_kernel, NULL);
    if (of_kernel < *most) *most = of_kernel;
    return status;
}

/* Builds for the structure of the scene. part: what the build is to hold. */
static df_status build_part(df_opencl_renderer *r, const char *part, df_error *err) {
    char build[160];
    const df_scene *scene = r->scene;
    snprintf(build, sizeof build, "-DDF_KIND=%d -DDF_LEVELS=%u -DDF_K=%u -DDF_SAMPLE=%d%s", (int)scene->field->kind,
             scene->levels, scene->k, (int)scene->field->sample_type, part);
    df_status status = df_opencl_build(&r->device, build, r->options.log, err);
    r->build_ms += r->device.build_ms;
    return status;
}

/* The same with walks that do what the options say, and no more. */
static df_status build_walk(df_opencl_renderer *r, const char *part, df_error *err) {
    char build[80];
    snprintf(build, sizeof build, " -DDF_ISOLATE=%d -DDF_BOUNDS=%d%s", DF_SOLVE_ISOLATES(r->options.solve),
             r->options.bounds != 0, part);
    return build_part(r, build, err);
}

static void shrink_group(size_t group[2], size_t most) {
    while (group[0] * group[1] > most) group[group[1] > 1] /= 2;
}

/* The work group: as asked for, or what there is room for. */
static df_status choose_group(df_opencl_renderer *r, size_t most, df_error *err) {
    const uint32_t *wanted = r->options.group;
    if (wanted[0] && (uint64_t)wanted[0] * wanted[1] > most) {
        return df_fail(err, DF_ERROR_UNSUPPORTED, "%s: work groups of %ux%u: at most %zu work items fit",
                       r->device.info.name, wanted[0], wanted[1], most);
    }
    r->group[0] = wanted[0] ? wanted[0] : 8;
    r->group[1] = wanted[0] ? wanted[1] : 8;
    shrink_group(r->group, most);
    return DF_OK;
}

/* The kernel that finds the hits of a view. part: what it does besides. */
static df_status open_trace_kernel(df_opencl_renderer *r, const char *part, cl_kernel *kernel, size_t *most,
                                   df_error *err) {
    const bool packets = r->options.tracer == DF_OPENCL_CGT;
    char build[32];
    snprintf(build, sizeof build, "%s%s", packets ? " -DDF_CGT" : "", part);
    df_status status = build_walk(r, build, err);
    return status == DF_OK ? create_kernel(r, packets ? "df_cgt_view" : "df_trace_view", kernel, most, err) : status;
}

static df_status open_view_kernels(df_opencl_renderer *r, df_error *err) {
    cl_kernel *kernels = r->kernels;
    size_t most = r->device.info.group_max;
    df_status status = open_trace_kernel(r, "", &kernels[KERNEL_TRACE_VIEW], &most, err);
    if (status == DF_OK) status = build_part(r, r->image ? " -DDF_SHADE -DDF_IMAGES" : " -DDF_SHADE", err);
    if (status == DF_OK) status = create_kernel(r, "df_shade_view", &kernels[KERNEL_SHADE_VIEW], &most, err);
    return status == DF_OK ? choose_group(r, most, err) : status;
}

/* When counts are first asked for. */
static df_status open_count_kernel(df_opencl_renderer *r, df_error *err) {
    size_t most = r->device.info.group_max;
    if (r->kernels[KERNEL_COUNT_VIEW]) return DF_OK;
    df_status status = open_trace_kernel(r, " -DDF_COUNT", &r->kernels[KERNEL_COUNT_VIEW], &most, err);
    memcpy(r->count_group, r->group, sizeof r->count_group);
    shrink_group(r->count_group, most);
    return status;
}

/* When rays are first asked for: most pictures need none. */
static df_status open_ray_kernels(df_opencl_renderer *r, df_error *err) {
    cl_kernel *kernels = r->kernels;
    size_t most = r->group[0] * r->group[1];
    if (kernels[KERNEL_SOLVE_RAYS]) return DF_OK;
    df_status status = build_walk(r, " -DDF_RAYS", err);
    if (status == DF_OK) status = create_kernel(r, "df_trace_rays", &kernels[KERNEL_TRACE_RAYS], &most, err);
    if (status == DF_OK) status = create_kernel(r, "df_solve_rays", &kernels[KERNEL_SOLVE_RAYS], &most, err);
    r->ray_group = most;
    return status;
}

df_status df_opencl_renderer_open(const df_opencl_info *info, const df_scene *scene, const df_opencl_options *options,
                                  df_opencl_renderer **out, df_error *err) {
    df_opencl_renderer *r;
    *out = NULL;
    if ((scene->levels == 0) != (options->tracer == DF_OPENCL_ADF))
        return df_fail(err, DF_ERROR_USAGE, "--tracer %s cannot draw this field (%s): choose auto",
                       df_opencl_tracer_names[options->tracer], df_field_kind_name(scene->field->kind));
    df_status status = df_alloc((void **)&r, 1, sizeof *r, "renderer", err);
    if (status != DF_OK) return status;
    r->scene = scene;
    r->options = *options;
    if (r->options.steps == 0) r->options.steps = df_solve_steps(options->solve);
    status = df_opencl_open(info, &r->device, err);
    if (status == DF_OK && options->bounds) status = df_bounds_prepare(scene, options->bounds, &r->bounds, err);
    if (status == DF_OK) status = upload(r, err);
    if (status == DF_OK) status = open_view_kernels(r, err);
    if (status != DF_OK) df_opencl_renderer_close(r);
    else *out = r;
    return status;
}

void df_opencl_renderer_costs(const df_opencl_renderer *r, double *build_ms, double *upload_ms) {
    *build_ms = r->build_ms;
    *upload_ms = r->upload_ms;
}

/* ---- views ---- */

/* Projects the bounds of some rows of a view and sends them: least of all squares, then greatest. */
static df_status queue_bounds(df_opencl_renderer *r, const df_view *view, uint32_t first_row, uint32_t row_count,
                              df_error *err) {
    df_status status =
        df_bounds_project(&r->bounds, view, first_row, row_count, r->options.threads ? r->options.threads : 1, err);
    const uint64_t size = (uint64_t)r->bounds.columns * r->bounds.rows * sizeof(double);
    if (status == DF_OK) status = grow(r, &r->intervals, 2 * size, "bounds", err);
    if (status != DF_OK) return status;
    DF_CL(&r->device, EnqueueWriteBuffer, r->device.queue, r->intervals.memory, CL_FALSE, 0, size, r->bounds.least, 0,
          NULL, NULL);
    DF_CL(&r->device, EnqueueWriteBuffer, r->device.queue, r->intervals.memory, CL_FALSE, size, size,
          r->bounds.greatest, 0, NULL, NULL);
    return DF_OK;
}

/* counts: for the kernel that counts, else NULL. */
static df_status queue_trace(df_opencl_renderer *r, const df_view *view, uint32_t first_row, uint32_t row_count,
                             cl_mem counts, df_error *err) {
    const uint64_t pixels = (uint64_t)view->width * row_count;
    const size_t extent[2] = {view->width, row_count}, *group = counts ? r->count_group : r->group;
    df_status status = grow(r, &r->found, pixels, "hits", err);
    if (status == DF_OK) status = grow(r, &r->candidates, pixels * 16, "hits", err);
    const kernel_argument arguments[] = {
        {sizeof *view, view},      ARGUMENT(first_row),
        ARGUMENT(row_count),       ARGUMENT(r->intervals.memory),
        ARGUMENT(r->found.memory), ARGUMENT(r->candidates.memory),
        ARGUMENT(counts),          {sizeof(float) * CGT_VALUES * group[0] * group[1], NULL}};
    const bool packets = r->options.tracer == DF_OPENCL_CGT;
    const uint32_t argument_count =
        sizeof arguments / sizeof arguments[0] - !packets; /* the last is the packets' local memory */
    cl_kernel kernel = r->kernels[counts ? KERNEL_COUNT_VIEW : KERNEL_TRACE_VIEW];
    if (status == DF_OK) status = set_arguments(r, kernel, SCENE_ARGUMENTS, arguments, argument_count, err);
    return status == DF_OK ? launch(r, kernel, 2, extent, group, err) : status;
}

static df_status queue_shade(df_opencl_renderer *r, const df_view *view, uint32_t first_row, uint32_t row_count,
                             const df_picture *picture, df_error *err) {
    const uint64_t pixels = (uint64_t)view->width * row_count;
    const cl_int solve = r->options.solve, steps = r->options.steps, gradient = r->options.gradient;
    const size_t extent[2] = {view->width, row_count};
    const cl_mem none = NULL;
    df_status status = DF_OK;
    if (picture->rgb) status = grow(r, &r->rgb, pixels * 3, "picture", err);
    if (status == DF_OK && picture->depth) status = grow(r, &r->depth, pixels * 4, "depth", err);
    if (status == DF_OK && picture->normals) status = grow(r, &r->normals, pixels * 12, "normals", err);
    const kernel_argument arguments[] = {{sizeof *view, view},
                                         ARGUMENT(first_row),
                                         ARGUMENT(row_count),
                                         ARGUMENT(solve),
                                         ARGUMENT(steps),
                                         ARGUMENT(gradient),
                                         ARGUMENT(r->shade_table),
                                         ARGUMENT(r->found.memory),
                                         ARGUMENT(r->candidates.memory),
                                         {sizeof none, picture->rgb ? &r->rgb.memory : &none},
                                         {sizeof none, picture->depth ? &r->depth.memory : &none},
                                         {sizeof none, picture->normals ? &r->normals.memory : &none},
                                         ARGUMENT(r->image)};
    const uint32_t argument_count =
        sizeof arguments / sizeof arguments[0] - !r->image; /* the last is there with images only */
    cl_kernel kernel = r->kernels[KERNEL_SHADE_VIEW];
    if (status == DF_OK) status = set_arguments(r, kernel, SCENE_ARGUMENTS, arguments, argument_count, err);
    return status == DF_OK ? launch(r, kernel, 2, extent, r->group, err) : status;
}

df_status df_opencl_renderer_rows(df_opencl_renderer *r, const df_view *view, uint32_t first_row, uint32_t row_count,
                                  const df_picture *picture, df_opencl_times *times, df_error *err) {
    assert(picture->width == view->width && picture->height == view->height);
    assert(first_row <= view->height && row_count <= view->height - first_row);
    const uint64_t first = (uint64_t)view->width * first_row, pixels = (uint64_t)view->width * row_count;
    df_opencl_times spent = {.host_start_ms = df_now_ms()};
    double ms[8] = {0};
    df_status status = DF_OK;
    if (row_count > 0) {
        if (r->options.bounds) status = queue_bounds(r, view, first_row, row_count, err);
        const double projected = df_now_ms();
        if (status == DF_OK) status = queue_trace(r, view, first_row, row_count, NULL, err);
        if (status == DF_OK) status = queue_shade(r, view, first_row, row_count, picture, err);
        if (status == DF_OK && picture->rgb)
            status = read_back(r, r->rgb.memory, picture->rgb + 3 * first, pixels * 3, err);
        if (status == DF_OK && picture->depth)
            status = read_back(r, r->depth.memory, picture->depth + first, pixels * 4, err);
        if (status == DF_OK && picture->normals)
            status = read_back(r, r->normals.memory, picture->normals + 3 * first, pixels * 12, err);
        const uint32_t commands = r->event_count;
        df_status finished = finish(r, ms, status == DF_OK ? err : NULL);
        if (status == DF_OK) status = finished;
        spent.bounds_ms = projected - spent.host_start_ms;
        spent.trace_ms = ms[0];
        spent.shade_ms = ms[1];
        for (uint32_t i = 2; i < commands; i++) spent.download_ms += ms[i];
    }
    spent.host_end_ms = df_now_ms();
    if (times) *times = spent;
    return status;
}

df_status df_opencl_renderer_count(df_opencl_renderer *r, const df_view *view, uint64_t *hitting, df_counters *counters,
                                   df_error *err) {
    const uint32_t rows_at_once = view->height < 64 ? view->height : 64;
    const uint64_t most = (uint64_t)view->width * rows_at_once;
    uint32_t *counts;
    uint8_t *found;
    memset(counters, 0, sizeof *counters);
    *hitting = 0;
    df_status status = df_alloc_raw((void **)&counts, most * 3, sizeof *counts, "counts", err);
    if (status != DF_OK) return status;
    status = df_alloc_raw((void **)&found, most, 1, "counts", err);
    if (status == DF_OK) status = open_count_kernel(r, err);
    if (status == DF_OK) status = grow(r, &r->counts, most * 12, "counts", err);
    for (uint32_t y = 0; y < view->height && status == DF_OK; y += rows_at_once) {
        const uint32_t rows = view->height - y < rows_at_once ? view->height - y : rows_at_once;
        const uint64_t pixels = (uint64_t)view->width * rows;
        double ms[8];
        if (r->options.bounds) status = queue_bounds(r, view, y, rows, err);
        if (status == DF_OK) status = queue_trace(r, view, y, rows, r->counts.memory, err);
        if (status == DF_OK) status = read_back(r, r->counts.memory, counts, pixels * 12, err);
        if (status == DF_OK) status = read_back(r, r->found.memory, found, pixels, err);
        df_status finished = finish(r, ms, status == DF_OK ? err : NULL);
        if (status == DF_OK) status = finished;
        for (uint64_t i = 0; i < pixels && status == DF_OK; i++) {
            *hitting += found[i] != 0;
            counters->coarse_steps += counts[i];
            counters->fine_steps += counts[i + pixels];
            counters->cells_tested += counts[i + 2 * pixels];
        }
    }
    free(counts);
    free(found);
    return status;
}

/* ---- arbitrary rays ---- */

/* What comes back for a batch of rays. */
typedef struct ray_results {
    uint8_t *found;
    uint32_t *candidates;
    double *t;
    float *positions;
} ray_results;

static df_status alloc_results(uint32_t count, ray_results *results, df_error *err) {
    memset(results, 0, sizeof *results);
    df_status status = df_alloc_raw((void **)&results->found, count, 1, "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&results->candidates, count, 16, "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&results->t, count, sizeof(double), "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&results->positions, count, 12, "hits", err);
    return status;
}

static void free_results(ray_results *results) {
    free(results->found);
    free(results->candidates);
    free(results->t);
    free(results->positions);
}

/* Writes the arrays of the rays one after the other into r->rays. */
static df_status upload_rays(df_opencl_renderer *r, const df_rays *rays, df_error *err) {
    const uint64_t stride = rays->count;
    df_status status = grow(r, &r->rays, stride * 9 * sizeof(float), "rays", err);
    for (uint32_t i = 0; i < 9 && status == DF_OK; i++) {
        const float *data = i < 3 ? rays->origin[i] : i < 6 ? rays->direction[i - 3] : rays->inverse[i - 6];
        const uint64_t size = (i < 3 && rays->shared_origin ? 1 : stride) * sizeof(float);
        DF_CL(&r->device, EnqueueWriteBuffer, r->device.queue, r->rays.memory, CL_TRUE, i * stride * sizeof(float),
              size, data, 0, NULL, NULL);
    }
    return status;
}

static df_status queue_rays(df_opencl_renderer *r, const df_rays *rays, df_error *err) {
    const cl_uint count = rays->count, origin_step = !rays->shared_origin;
    const cl_int solve = r->options.solve, steps = r->options.steps;
    const cl_mem none = NULL;
    const size_t extent[2] = {count, 1}, group[2] = {r->ray_group, 1};
    df_status status = grow(r, &r->found, count, "hits", err);
    if (status == DF_OK) status = grow(r, &r->candidates, count * 16ull, "hits", err);
    if (status == DF_OK) status = grow(r, &r->t, count * 8ull, "hits", err);
    if (status == DF_OK) status = grow(r, &r->positions, count * 12ull, "hits", err);
    const kernel_argument trace[] = {ARGUMENT(r->rays.memory),
                                     ARGUMENT(count),
                                     ARGUMENT(origin_step),
                                     ARGUMENT(count),
                                     ARGUMENT(r->found.memory),
                                     ARGUMENT(r->candidates.memory),
                                     ARGUMENT(none)};
    const kernel_argument solves[] = {ARGUMENT(r->rays.memory),  ARGUMENT(count),
                                      ARGUMENT(origin_step),     ARGUMENT(count),
                                      ARGUMENT(solve),           ARGUMENT(steps),
                                      ARGUMENT(r->found.memory), ARGUMENT(r->candidates.memory),
                                      ARGUMENT(r->t.memory),     ARGUMENT(r->positions.memory)};
    cl_kernel *kernels = r->kernels;
    if (status == DF_OK)
        status =
            set_arguments(r, kernels[KERNEL_TRACE_RAYS], SCENE_ARGUMENTS, trace, sizeof trace / sizeof trace[0], err);
    if (status == DF_OK) status = launch(r, kernels[KERNEL_TRACE_RAYS], 1, extent, group, err);
    if (status == DF_OK)
        status = set_arguments(r, kernels[KERNEL_SOLVE_RAYS], SCENE_ARGUMENTS, solves, sizeof solves / sizeof solves[0],
                               err);
    return status == DF_OK ? launch(r, kernels[KERNEL_SOLVE_RAYS], 1, extent, group, err) : status;
}

static void append_hits(const df_rays *rays, const ray_results *results, df_hits *hits) {
    for (uint32_t i = 0; i < rays->count; i++) {
        if (!results->found[i]) continue;
        const uint32_t *candidate = results->candidates + 4ull * i, n = hits->count++;
        hits->ray[n] = i;
        hits->block[n] = candidate[2];
        hits->flags[n] =
            (uint8_t)((results->found[i] & DF_FOUND_BACK ? DF_HIT_BACK : 0) | candidate[3] << DF_HIT_SIZE_SHIFT);
        hits->cell[0][n] = (uint16_t)(candidate[0] & 0xFFFF);
        hits->cell[1][n] = (uint16_t)(candidate[0] >> 16);
        hits->cell[2][n] = (uint16_t)candidate[1];
        hits->t[n] = rays->t_base ? results->t[i] + rays->t_base[i] : results->t[i];
        for (int a = 0; a < 3; a++) hits->local[a][n] = results->positions[i + (size_t)rays->count * (size_t)a];
    }
}

df_status df_opencl_renderer_trace(df_opencl_renderer *r, const df_rays *rays, df_hits *hits, df_opencl_times *times,
                                   df_error *err) {
    assert(hits->count + rays->count <= hits->capacity);
    df_opencl_times spent = {.host_start_ms = df_now_ms()};
    double ms[8] = {0};
    ray_results results;
    df_status status = alloc_results(rays->count, &results, err);
    if (status == DF_OK && rays->count > 0) {
        status = open_ray_kernels(r, err);
        if (status == DF_OK) status = upload_rays(r, rays, err);
        if (status == DF_OK) status = queue_rays(r, rays, err);
        if (status == DF_OK) status = read_back(r, r->found.memory, results.found, rays->count, err);
        if (status == DF_OK) status = read_back(r, r->candidates.memory, results.candidates, rays->count * 16ull, err);
        if (status == DF_OK) status = read_back(r, r->t.memory, results.t, rays->count * 8ull, err);
        if (status == DF_OK) status = read_back(r, r->positions.memory, results.positions, rays->count * 12ull, err);
        df_status finished = finish(r, ms, status == DF_OK ? err : NULL);
        if (status == DF_OK) status = finished;
        if (status == DF_OK) append_hits(rays, &results, hits);
        spent.trace_ms = ms[0];
        spent.shade_ms = ms[1];
        for (int i = 2; i < 6; i++) spent.download_ms += ms[i];
    }
    free_results(&results);
    spent.host_end_ms = df_now_ms();
    if (times) *times = spent;
    return status;
}
