/*
 * What df-render says about a picture: one JSON object, or the same as text.
 *
 * Times of phases are summed over threads, but phase_begin_ms. phase_solve_ms is the part of phase_trace_ms that solves
 * the accepted cells. floor_ns_per_ray is what a frame costs whose hit cells are known: rays, solve and shade; 0 for
 * tracers that do not tell the solve apart.
 */
#ifndef DF_REPORT_H
#define DF_REPORT_H

#include "render/devices.h"
#include "render/settings.h"

#include <jansson.h>

typedef struct df_report {
    const char *field_path;
    const df_scene *scene;
    const df_settings *settings;
    const df_devices *devices;
    df_frame_stats stats;
    const df_tracer *tracer;
    const df_kernels *kernels;
    uint32_t threads, tile;
    double load_ms, precompute_ms;
    double extract_ms; /* the part of precompute_ms that made a mesh */
    uint64_t precompute_bytes;
} df_report;

/* NULL when memory is short. The names are those of measure: tools rely on them. */
json_t *df_report_json(const df_report *report);

void df_report_print(const json_t *json);

#endif
