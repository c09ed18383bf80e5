/*
 * The scalar 3DDDA, ray by ray: the specification of what every tracer returns.
 */
#include "common/memory.h"
#include "render/cpu/kernels.h"
#include "render/methods/adf.h"
#include "render/methods/dda.h"
#include "render/methods/solve_methods.h"

#include <stdlib.h>

typedef struct dda_state {
    const df_scene *scene;
    df_trace_options options;
    df_candidate **candidates; /* by thread, one a ray of a tile */
} dda_state;

static df_status dda_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                           df_error *err) {
    (void)err;
    const dda_state *state = opaque;
    const df_rays *rays = &tile->rays;
    df_candidate *candidates = state->candidates[thread];
    const bool isolate = DF_SOLVE_ISOLATES(state->options.solve);
    uint32_t count = 0;
    for (uint32_t i = 0; i < rays->count; i++) {
        dda_ray ray;
        for (int a = 0; a < 3; a++) {
            ray.origin[a] = rays->origin[a][rays->shared_origin ? 0 : i];
            ray.direction[a] = rays->direction[a][i];
            ray.inverse[a] = rays->inverse[a][i];
        }
        candidates[count].ray = i;
        count += state->scene->levels ? dda_walk_scene(state->scene, isolate, &ray, &candidates[count], counters)
                                      : adf_walk_scene(state->scene, isolate, &ray, &candidates[count], counters);
    }
    state->options.kernels->solve(state->scene, &state->options, rays, candidates, count, hits);
    return DF_OK;
}

static void dda_release(void *opaque) {
    dda_state *state = opaque;
    if (!state) return;
    if (state->candidates) {
        for (uint32_t i = 0; i < state->options.threads; i++) free(state->candidates[i]);
    }
    free(state->candidates);
    free(state);
}

static df_status dda_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    dda_state *state;
    *out = NULL;
    df_status status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status != DF_OK) return status;
    state->scene = scene;
    state->options = *options;
    status = df_alloc((void **)&state->candidates, options->threads, sizeof *state->candidates, "tracer", err);
    for (uint32_t i = 0; i < options->threads && status == DF_OK; i++) {
        /* one more than there are rays: the walk fills the next entry before it knows */
        status = df_alloc_raw((void **)&state->candidates[i], (uint64_t)options->tile_width * options->tile_height + 1,
                              sizeof **state->candidates, "candidates", err);
    }
    if (status != DF_OK) {
        dda_release(state);
        return status;
    }
    *out = state;
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
    .prepare = dda_prepare,
    .release = dda_release,
    .suits = adf_suits,
    .trace = dda_trace,
};

const df_tracer df_tracer_dda = {
    .name = "dda",
    .summary = "scalar 3DDDA, one ray at a time: the reference",
    .prepare = dda_prepare,
    .release = dda_release,
    .suits = dda_suits,
    .trace = dda_trace,
};
