#include "render/tracer.h"
#include "common/memory.h"
#include "render/hit.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

const df_tracer *const df_tracers[] = {&df_tracer_dda, NULL};
const char *const df_solve_names[] = {"midpoint", "linear", "repeated", "marmitt", "analytic", "robust", NULL};
const char *const df_gradient_names[] = {"analytic", "central", "forward", "backward", "corner-central", "corner-forward", NULL};

const df_tracer *df_tracer_find(const char *name) {
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if (strcmp((*tracer)->name, name) == 0) return *tracer;
    }
    return NULL;
}

int df_solve_steps(int solve) {
    switch (solve) {
    case DF_SOLVE_REPEATED:
    case DF_SOLVE_MARMITT: return 3;
    case DF_SOLVE_ROBUST: return 16;
    default: return 0;
    }
}

df_status df_hits_alloc(uint32_t capacity, df_hits *hits, df_error *err) {
    memset(hits, 0, sizeof *hits);
    hits->capacity = capacity;
    df_status status = df_alloc_raw((void **)&hits->ray, capacity, sizeof *hits->ray, "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&hits->block, capacity, sizeof *hits->block, "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&hits->flags, capacity, sizeof *hits->flags, "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&hits->t, capacity, sizeof *hits->t, "hits", err);
    for (int a = 0; a < 3; a++) {
        if (status == DF_OK) status = df_alloc_raw((void **)&hits->cell[a], capacity, sizeof *hits->cell[a], "hits", err);
        if (status == DF_OK) status = df_alloc_raw((void **)&hits->local[a], capacity, sizeof *hits->local[a], "hits", err);
    }
    if (status != DF_OK) df_hits_free(hits);
    return status;
}

void df_hits_free(df_hits *hits) {
    free(hits->ray);
    free(hits->block);
    free(hits->flags);
    free(hits->t);
    for (int a = 0; a < 3; a++) {
        free(hits->cell[a]);
        free(hits->local[a]);
    }
    memset(hits, 0, sizeof *hits);
}

void df_candidates_solve(const df_scene *scene, const df_trace_options *options, const df_rays *rays,
                         const df_candidate *candidates, uint32_t count, df_hits *hits) {
    assert(hits->count + count <= hits->capacity);
    const int steps = options->steps ? options->steps : df_solve_steps(options->solve);
    for (uint32_t i = 0; i < count; i++) {
        const df_candidate *c = &candidates[i];
        const uint32_t voxel[3] = {c->cell[0], c->cell[1], c->cell[2]};
        const int inside = (c->flags & DF_HIT_BACK) != 0;
        float origin[3], direction[3], stored[8], local[3];
        for (int a = 0; a < 3; a++) {
            origin[a] = rays->origin[a][rays->shared_origin ? 0 : c->ray];
            direction[a] = rays->direction[a][c->ray];
        }
        df_scene_corners(scene, voxel, c->block, stored);
        double t = df_hit_solve(options->solve, steps, origin, direction, voxel, stored, inside, local);
        uint32_t n = hits->count++;
        hits->ray[n] = c->ray;
        hits->block[n] = c->block;
        hits->flags[n] = c->flags;
        hits->t[n] = rays->t_base ? t + rays->t_base[c->ray] : t;
        for (int a = 0; a < 3; a++) {
            hits->cell[a][n] = c->cell[a];
            hits->local[a][n] = local[a];
        }
    }
}
