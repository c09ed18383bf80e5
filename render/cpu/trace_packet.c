/* The 3DDDA in SIMD packets and the coherent grid traversal: kernel_packet.c and kernel_cgt.c over tiles. */
#include "common/memory.h"
#include "render/cpu/kernels.h"
#include "render/methods/solve_methods.h"

#include <stdlib.h>

typedef struct packet_state {
    const df_scene *scene;
    df_trace_options options;
    df_candidate **candidates; /* by thread, one a ray of a tile */
} packet_state;

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

static void packet_release(void *opaque) {
    packet_state *state = opaque;
    if (!state) return;
    for (uint32_t i = 0; state->candidates && i < state->options.threads; i++) free(state->candidates[i]);
    free(state->candidates);
    free(state);
}

static df_status packet_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    packet_state *state;
    *out = NULL;
    if (!indices_fit(scene))
        return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer dda-packet: the field is too large for it; choose dda");
    df_status status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status != DF_OK) return status;
    state->scene = scene;
    state->options = *options;
    status = df_alloc((void **)&state->candidates, options->threads, sizeof *state->candidates, "tracer", err);
    for (uint32_t i = 0; i < options->threads && status == DF_OK; i++) {
        status = df_alloc_raw((void **)&state->candidates[i], (uint64_t)options->tile_width * options->tile_height,
                              sizeof **state->candidates, "candidates", err);
    }
    if (status != DF_OK) packet_release(state);
    else *out = state;
    return status;
}

static df_status packet_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                              df_error *err) {
    (void)err;
    const packet_state *state = opaque;
    const df_packet_job job = {state->scene, tile, DF_SOLVE_ISOLATES(state->options.solve), 0, false};
    const uint32_t count = state->options.kernels->packet(&job, state->candidates[thread], counters);
    state->options.kernels->solve(state->scene, &state->options, &tile->rays, state->candidates[thread], count, hits);
    return DF_OK;
}

const df_tracer df_tracer_packet = {
    .name = "dda-packet",
    .summary = "3DDDA over SIMD lanes",
    .prepare = packet_prepare,
    .release = packet_release,
    .suits = packet_suits,
    .trace = packet_trace,
};

static bool cgt_suits(const df_scene *scene, const df_view *view) {
    return scene->levels == 2 && view && !view->rebase;
}

static df_status cgt_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    *out = NULL;
    if (scene->levels != 2) return df_fail(err, DF_ERROR_USAGE, "--tracer cgt works on two levels");
    return packet_prepare(scene, options, out, err);
}

static df_status cgt_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                           df_error *err) {
    (void)err;
    const packet_state *state = opaque;
    const df_packet_job job = {state->scene, tile, DF_SOLVE_ISOLATES(state->options.solve),
                               state->options.packet ? state->options.packet : 8, !state->options.no_clip};
    const uint32_t count = state->options.kernels->cgt(&job, state->candidates[thread], counters);
    state->options.kernels->solve(state->scene, &state->options, &tile->rays, state->candidates[thread], count, hits);
    return DF_OK;
}

const df_tracer df_tracer_cgt = {
    .name = "cgt",
    .summary = "coherent grid traversal: squares of rays slice by slice; for pictures",
    .prepare = cgt_prepare,
    .release = packet_release,
    .suits = cgt_suits,
    .trace = cgt_trace,
};
