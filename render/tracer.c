#include "render/tracer.h"
#include "common/memory.h"
#include "render/cubic.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "render/lane_f64.h"

#include "render/cell.h"
#include "render/solve.h"

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

/* The closed form is no text of lanes: isolation as always, then the root inside the bracket. */
static double solve_analytic(const double bernstein[4], int inside) {
    double bern[4] = {bernstein[0], bernstein[1], bernstein[2], bernstein[3]}, extremum;
    df_cubic_scale_f64(bern);
    df_bracket_f64 part = df_isolate_f64(bern, inside, &extremum);
    if (part.found) return df_cubic_first_root(bern, part.low, part.high);
    return df_solve_f64(DF_SOLVE_MARMITT, 0, bernstein, inside, 0);
}

/* Illinois steps end where the position moves less than this, in parts of the segment. */
#define SOLVE_TOLERANCE 1e-12

void df_candidates_solve(const df_scene *scene, const df_trace_options *options, const df_rays *rays,
                         const df_candidate *candidates, uint32_t count, df_hits *hits) {
    assert(hits->count + count <= hits->capacity);
    const int steps = options->steps ? options->steps : df_solve_steps(options->solve);
    for (uint32_t i = 0; i < count; i++) {
        const df_candidate *c = &candidates[i];
        const uint32_t voxel[3] = {c->cell[0], c->cell[1], c->cell[2]};
        const int inside = (c->flags & DF_HIT_BACK) != 0;
        double origin[3], direction[3], inverse[3], cell[3], corner[8], bern[4];
        float stored[8];
        for (int a = 0; a < 3; a++) {
            origin[a] = (double)rays->origin[a][rays->shared_origin ? 0 : c->ray];
            direction[a] = (double)rays->direction[a][c->ray];
            inverse[a] = 1 / direction[a];
            cell[a] = voxel[a];
        }
        df_scene_corners(scene, voxel, c->block, stored);
        for (int k = 0; k < 8; k++) corner[k] = (double)stored[k];
        df_segment_f64 segment;
        df_cell_segment_f64(origin, direction, inverse, 0, cell, 1, &segment);
        df_bernstein_f64(corner, segment.a, segment.b, bern);
        double s = options->solve == DF_SOLVE_ANALYTIC ? solve_analytic(bern, inside)
                                                       : df_solve_f64(options->solve, steps, bern, inside, SOLVE_TOLERANCE);
        uint32_t n = hits->count++;
        hits->ray[n] = c->ray;
        hits->block[n] = c->block;
        hits->flags[n] = c->flags;
        hits->t[n] = df_lerp_f64(segment.t_in, ld_max(segment.t_in, segment.t_out), s);
        if (rays->t_base) hits->t[n] += rays->t_base[c->ray];
        for (int a = 0; a < 3; a++) {
            hits->cell[a][n] = c->cell[a];
            hits->local[a][n] = (float)df_lerp_f64(segment.a[a], segment.b[a], s);
        }
    }
}
