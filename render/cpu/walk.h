/*
 * What all tracers that walk through cells hold for a scene: a list of accepted cells for each thread, which the solve
 * turns into hits, and the intervals of a view's rays.
 */
#ifndef DF_WALK_H
#define DF_WALK_H

#include "render/cpu/bounds.h"
#include "render/cpu/kernels.h"

typedef struct df_walk {
    const df_scene *scene; /* borrowed */
    df_trace_options options;
    df_candidate *
        *candidates;  /* by thread: one a ray of a tile, and one more, as a walk fills an entry before it knows */
    df_bounds bounds; /* options.walk.bounds */
} df_walk;

/* As df_tracer has them; *out is a df_walk. */
df_status df_walk_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err);
void df_walk_release(void *walk);
uint64_t df_walk_bytes(const void *walk);
df_status df_walk_begin_frame(void *walk, const df_view *view, uint32_t first_row, uint32_t row_count, df_error *err);
bool df_walk_touches(const void *walk, const df_tile *tile);

/* The intervals of a tile's rays; NULL: they have none. */
const df_bounds *df_walk_bounds(const df_walk *walk, const df_tile *tile);

/* A ray of a tile as the scalar walks take it (methods/dda.h). bounds: of df_walk_bounds; first > last where it cannot
 * hit. footprint: of df_walk_footprint. */
struct dda_ray;
void df_walk_ray(const df_bounds *bounds, double footprint, const df_tile *tile, uint32_t i, struct dda_ray *ray);

/* Voxels that options.walk.lod pixels of a tile's view cover at t = 1; 0: no matter how small, cells are divided. */
double df_walk_footprint(const df_walk *walk, const df_tile *tile);

/* Solves the first `count` candidates of a thread and appends them to hits. */
void df_walk_solve(const df_walk *walk, uint32_t thread, const df_tile *tile, uint32_t count, df_hits *hits,
                   df_counters *counters);

#endif
