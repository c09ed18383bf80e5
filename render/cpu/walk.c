#include "render/cpu/walk.h"
#include "common/memory.h"
#include "common/progress.h"
#include "render/methods/dda.h"

#include <stdlib.h>

void df_walk_release(void *opaque) {
    df_walk *walk = opaque;
    if (!walk) return;
    for (uint32_t i = 0; walk->candidates && i < walk->options.threads; i++) free(walk->candidates[i]);
    free(walk->candidates);
    df_bounds_free(&walk->bounds);
    free(walk);
}

df_status df_walk_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    df_walk *walk;
    *out = NULL;
    df_status status = df_alloc((void **)&walk, 1, sizeof *walk, "tracer", err);
    if (status != DF_OK) return status;
    walk->scene = scene;
    walk->options = *options;
    status = df_alloc((void **)&walk->candidates, options->threads, sizeof *walk->candidates, "tracer", err);
    for (uint32_t i = 0; i < options->threads && status == DF_OK; i++) {
        status = df_alloc_raw((void **)&walk->candidates[i], (uint64_t)options->tile_width * options->tile_height + 1,
                              sizeof **walk->candidates, "candidates", err);
    }
    if (status == DF_OK && options->walk.bounds)
        status = df_bounds_prepare(scene, options->walk.bounds, &walk->bounds, err);
    if (status != DF_OK) df_walk_release(walk);
    else *out = walk;
    return status;
}

uint64_t df_walk_bytes(const void *opaque) { return df_bounds_bytes(&((const df_walk *)opaque)->bounds); }

df_status df_walk_begin_frame(void *opaque, const df_view *view, uint32_t first_row, uint32_t row_count,
                              df_error *err) {
    df_walk *walk = opaque;
    if (!walk->options.walk.bounds) return DF_OK;
    return df_bounds_project(&walk->bounds, view, first_row, row_count, walk->options.threads, err);
}

bool df_walk_touches(const void *opaque, const df_tile *tile) {
    const df_walk *walk = opaque;
    if (!walk->options.walk.bounds) return true;
    return df_bounds_touch(&walk->bounds, tile->x, tile->y, tile->width, tile->height);
}

const df_bounds *df_walk_bounds(const df_walk *walk, const df_tile *tile) {
    return walk->options.walk.bounds && tile->view ? &walk->bounds : NULL;
}

double df_walk_footprint(const df_walk *walk, const df_tile *tile) {
    double right = 0, down = 0;
    for (int a = 0; a < 3 && tile->view; a++) {
        right += tile->view->right[a] * tile->view->right[a];
        down += tile->view->down[a] * tile->view->down[a];
    }
    return walk->options.walk.lod * sqrt(fmin(right, down));
}

void df_walk_ray(const df_bounds *bounds, double footprint, const df_tile *tile, uint32_t i, dda_ray *ray) {
    const df_rays *rays = &tile->rays;
    for (int a = 0; a < 3; a++) {
        ray->origin[a] = rays->origin[a][rays->shared_origin ? 0 : i];
        ray->direction[a] = rays->direction[a][i];
        ray->inverse[a] = rays->inverse[a][i];
    }
    ray->first = 0;
    ray->last = INFINITY;
    ray->footprint = (float)footprint;
    ray->footprint_base = df_footprint_base(footprint, rays, i);
    if (bounds) {
        df_bounds_ray(bounds, tile->x + i % tile->width, tile->y + i / tile->width, rays->t_base ? rays->t_base[i] : 0,
                      &ray->first, &ray->last);
    }
}

void df_walk_solve(const df_walk *walk, uint32_t thread, const df_tile *tile, uint32_t count, df_hits *hits,
                   df_counters *counters) {
    const double start = df_now_ms();
    walk->options.kernels->solve(walk->scene, &walk->options, &tile->rays, walk->candidates[thread], count, hits);
    counters->solve_ms += df_now_ms() - start;
}
