#include "opencl_tracer.h"
#include "common/memory.h"
#include "render/opencl/opencl_frame.h"

#include <stdlib.h>

typedef struct device_state {
    df_opencl_renderer *renderer;
} device_state;

static void device_release(void *opaque) {
    device_state *state = opaque;
    if (!state) return;
    df_opencl_renderer_close(state->renderer);
    free(state);
}

static df_status device_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    const df_opencl_options device_options = {.tracer = scene->levels == 0 ? DF_OPENCL_ADF : DF_OPENCL_DDA,
                                              .solve = options->solve,
                                              .steps = options->steps,
                                              .threads = options->threads};
    df_opencl_info *list = NULL;
    uint32_t count, number;
    device_state *state = NULL;
    *out = NULL;
    df_status status = df_opencl_find(&list, &count, err);
    if (status == DF_OK) status = df_opencl_choose(list, count, DF_OPENCL_ANY, false, &number, err);
    if (status == DF_OK) status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status == DF_OK) status = df_opencl_renderer_open(&list[number], scene, &device_options, &state->renderer, err);
    free(list);
    if (status == DF_OK) *out = state;
    else device_release(state);
    return status;
}

static df_status device_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                              df_error *err) {
    (void)thread;
    (void)counters;
    device_state *state = opaque;
    df_status status;
#pragma omp critical(lab_opencl)
    status = df_opencl_renderer_trace(state->renderer, &tile->rays, hits, NULL, err);
    return status;
}

const df_tracer lab_tracer_opencl = {
    .name = "opencl",
    .summary = "an OpenCL device",
    .prepare = device_prepare,
    .release = device_release,
    .trace = device_trace,
};
