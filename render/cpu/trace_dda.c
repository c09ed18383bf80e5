/*
 * The scalar 3DDDA, ray by ray: the specification of what every tracer returns.
 */
#include "render/cpu/walk.h"
#include "render/methods/adf.h"
#include "render/methods/dda.h"
#include "render/methods/solve_methods.h"

static df_status dda_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                           df_error *err) {
    (void)err;
    const df_walk *walk = opaque;
    const df_scene *scene = walk->scene;
    const df_bounds *bounds = df_walk_bounds(walk, tile);
    const df_rays *rays = &tile->rays;
    df_candidate *candidates = walk->candidates[thread];
    const bool isolate = DF_SOLVE_ISOLATES(walk->options.solve);
    const double footprint = df_walk_footprint(walk, tile);
    uint32_t count = 0;
    for (uint32_t i = 0; i < rays->count; i++) {
        dda_ray ray;
        df_walk_ray(bounds, footprint, tile, i, &ray);
        if (!(ray.first <= ray.last)) continue;
        candidates[count].ray = i;
        count += scene->levels ? dda_walk_scene(scene, isolate, &ray, &candidates[count], counters)
                               : adf_walk_scene(scene, isolate, &ray, &candidates[count], counters);
    }
    df_walk_solve(walk, thread, tile, count, hits, counters);
    return DF_OK;
}

static bool dda_suits(const df_scene *scene, const df_view *view) {
    (void)view;
    return scene->levels != 0;
}

static bool adf_suits(const df_scene *scene, const df_view *view) {
    (void)view;
    return scene->levels == 0;
}

const df_tracer df_tracer_adf = {
    .name = "adf",
    .summary = "the leaves of an octree from front to back, one ray at a time",
    .prepare = df_walk_prepare,
    .release = df_walk_release,
    .suits = adf_suits,
    .trace = dda_trace,
};

static df_status adf_packet_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits,
                                  df_counters *counters, df_error *err) {
    (void)err;
    const df_walk *walk = opaque;
    const df_packet_job job = {.scene = walk->scene,
                               .tile = tile,
                               .isolate = DF_SOLVE_ISOLATES(walk->options.solve),
                               .footprint = df_walk_footprint(walk, tile)};
    const uint32_t count = walk->options.kernels->adf(&job, walk->candidates[thread], counters);
    df_walk_solve(walk, thread, tile, count, hits, counters);
    return DF_OK;
}

const df_tracer df_tracer_adf_packet = {
    .name = "adf-packet",
    .summary = "the leaves of an octree from front to back, SIMD packets of rays",
    .prepare = df_walk_prepare,
    .release = df_walk_release,
    .suits = adf_suits,
    .trace = adf_packet_trace,
};

const df_tracer df_tracer_dda = {
    .name = "dda",
    .summary = "scalar 3DDDA, one ray at a time: the reference",
    .takes_bounds = true,
    .prepare = df_walk_prepare,
    .release = df_walk_release,
    .bytes = df_walk_bytes,
    .begin_frame = df_walk_begin_frame,
    .touches = df_walk_touches,
    .suits = dda_suits,
    .trace = dda_trace,
};
