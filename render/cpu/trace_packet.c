/* The 3DDDA in SIMD packets and the coherent grid traversal: kernel_packet.c and kernel_cgt.c over tiles. */
#include "render/cpu/walk.h"
#include "render/methods/dda.h"
#include "render/methods/solve_methods.h"

/* The gathers of packets take signed 32-bit indices. */
static bool indices_fit(const df_scene *scene) {
    if (scene->levels == 0) return false;
    if (scene->levels == 1) {
        return (uint64_t)scene->row_words * 64 * scene->voxel_count[1] * scene->voxel_count[2] <= INT32_MAX;
    }
    const uint64_t cells = (uint64_t)scene->coarse_count[0] * scene->coarse_count[1] * scene->coarse_count[2];
    return cells <= INT32_MAX && (uint64_t)scene->block_count * 2 * df_brick_mask_words(scene->k) <= INT32_MAX;
}

static bool packet_suits(const df_scene *scene, const df_view *view) {
    (void)view;
    return indices_fit(scene);
}

static df_status packet_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    *out = NULL;
    if (scene->levels == 0)
        return df_fail(err, DF_ERROR_USAGE, "--tracer dda-packet does not walk octrees: choose adf");
    if (!indices_fit(scene))
        return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer dda-packet: the field is too large for it; choose dda");
    return df_walk_prepare(scene, options, out, err);
}

/* What is left of a packet: dda.c's walk from there on. */
static bool walk_alone(const df_packet_job *job, uint32_t ray, float first, df_candidate *candidate,
                       df_counters *counters) {
    dda_ray alone;
    df_walk_ray(job->bounds, 0, job->tile, ray, &alone);
    if (first > alone.first) alone.first = first;
    return dda_walk_scene(job->scene, job->isolate, &alone, candidate, counters);
}

static df_status packet_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                              df_error *err) {
    (void)err;
    const df_walk *walk = opaque;
    const df_packet_job job = {.scene = walk->scene,
                               .tile = tile,
                               .bounds = df_walk_bounds(walk, tile),
                               .isolate = DF_SOLVE_ISOLATES(walk->options.solve),
                               .split = walk->options.walk.split,
                               .alone = walk_alone};
    const uint32_t count = walk->options.kernels->packet(&job, walk->candidates[thread], counters);
    df_walk_solve(walk, thread, tile, count, hits, counters);
    return DF_OK;
}

const df_tracer df_tracer_packet = {
    .name = "dda-packet",
    .summary = "3DDDA over SIMD lanes",
    .takes_bounds = true,
    .prepare = packet_prepare,
    .release = df_walk_release,
    .bytes = df_walk_bytes,
    .begin_frame = df_walk_begin_frame,
    .touches = df_walk_touches,
    .suits = packet_suits,
    .trace = packet_trace,
};

static bool cgt_suits(const df_scene *scene, const df_view *view) {
    return scene->levels == 2 && indices_fit(scene) && view && !view->rebase;
}

static df_status cgt_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    *out = NULL;
    if (scene->levels != 2) return df_fail(err, DF_ERROR_USAGE, "--tracer cgt works on two levels");
    return packet_prepare(scene, options, out, err);
}

static df_status cgt_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                           df_error *err) {
    (void)err;
    const df_walk *walk = opaque;
    const df_packet_job job = {.scene = walk->scene,
                               .tile = tile,
                               .bounds = df_walk_bounds(walk, tile),
                               .isolate = DF_SOLVE_ISOLATES(walk->options.solve),
                               .packet = walk->options.walk.packet ? walk->options.walk.packet : 8,
                               .clip = !walk->options.walk.no_clip};
    const uint32_t count = walk->options.kernels->cgt(&job, walk->candidates[thread], counters);
    df_walk_solve(walk, thread, tile, count, hits, counters);
    return DF_OK;
}

const df_tracer df_tracer_cgt = {
    .name = "cgt",
    .summary = "coherent grid traversal: squares of rays slice by slice; for pictures",
    .takes_bounds = true,
    .prepare = cgt_prepare,
    .release = df_walk_release,
    .bytes = df_walk_bytes,
    .begin_frame = df_walk_begin_frame,
    .touches = df_walk_touches,
    .suits = cgt_suits,
    .trace = cgt_trace,
};
