/*
 * What all tracers that walk through cells hold for a scene, one ray or one packet at a time: a list of accepted cells
 * for each thread, which the solve turns into hits.
 */
#ifndef DF_WALK_H
#define DF_WALK_H

#include "render/cpu/kernels.h"

typedef struct df_walk {
    const df_scene *scene; /* borrowed */
    df_trace_options options;
    df_candidate *
        *candidates; /* by thread: one a ray of a tile, and one more, as a walk fills an entry before it knows */
} df_walk;

/* As df_tracer's prepare and release; *out is a df_walk. */
df_status df_walk_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err);
void df_walk_release(void *walk);

/* Solves the first `count` candidates of a thread and appends them to hits. */
void df_walk_solve(const df_walk *walk, uint32_t thread, const df_tile *tile, uint32_t count, df_hits *hits);

#endif
