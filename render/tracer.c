#include "render/tracer.h"
#include "common/memory.h"
#include "render/methods/solve_methods.h"

#include <stdlib.h>
#include <string.h>

const df_tracer *const df_tracers[] = {
    &df_tracer_splat, &df_tracer_packet, &df_tracer_cgt, &df_tracer_dda, &df_tracer_adf_packet, &df_tracer_adf, NULL};
const df_tracer *const df_mc_tracers[] = {
#ifdef DF_HAVE_EMBREE
    &df_tracer_mc_embree,
#endif
#ifdef DF_HAVE_EGL
    &df_tracer_mc_raster,
#endif
    NULL};
const char *const df_solve_names[] = {"midpoint", "linear", "repeated", "marmitt", "analytic", "robust", NULL};
const char *const df_precision_names[] = {"f64", "f32", NULL};
const char *const df_gradient_names[] = {"analytic",       "central", "forward", "backward", "corner-central",
                                         "corner-forward", "c0",      "crease",  NULL};
const char *const df_bounds_names[] = {"none", "bricks", "voxels", "gl", NULL};
const char *const df_filter_names[] = {"trilinear", "catmull-rom", "b-spline", NULL};

const df_tracer *df_tracer_find(const char *name) {
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if (strcmp((*tracer)->name, name) == 0) return *tracer;
    }
    for (const df_tracer *const *tracer = df_mc_tracers; *tracer; tracer++) {
        if (strcmp((*tracer)->name, name) == 0) return *tracer;
    }
    return NULL;
}

/* The pixels of a picture by which splat has won back the time in which it prepares a block of voxels, or a family of
 * an octree: measured with the bunny, the dragon and the armadillo from 128 to 512, by AVX2 and AVX-512, with one
 * thread and two. */
enum { PIXELS_A_BLOCK = 100, PIXELS_A_FAMILY = 10 };

static const df_tracer *fastest(const df_scene *scene, const df_view *view, const df_walk_options *walk,
                                bool prepared) {
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if (walk && walk->bounds && scene->levels && !(*tracer)->takes_bounds) continue;
        if (walk && walk->lod > 0 && scene->levels == 0 && *tracer == &df_tracer_splat) continue;
        if (!prepared && *tracer == &df_tracer_splat) continue;
        if (!(*tracer)->suits || (*tracer)->suits(scene, view)) return *tracer;
    }
    return &df_tracer_dda;
}

const df_tracer *df_tracer_choose(const df_scene *scene, const df_view *view, const df_walk_options *walk) {
    return fastest(scene, view, walk, true);
}

const df_tracer *df_tracer_choose_once(const df_scene *scene, const df_view *view, const df_walk_options *walk,
                                       uint64_t *repays) {
    const df_tracer *tracer = fastest(scene, view, walk, true);
    *repays = 0;
    if (tracer != &df_tracer_splat) return tracer;
    *repays = scene->levels == 0 ? (uint64_t)PIXELS_A_FAMILY * scene->field->family_count
                                 : (uint64_t)PIXELS_A_BLOCK * scene->block_count;
    return (uint64_t)view->width * view->height < *repays ? fastest(scene, view, walk, false) : tracer;
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
    const uint64_t room = (uint64_t)capacity + DF_RAY_PADDING;
    df_status status = df_alloc_raw((void **)&hits->ray, room, sizeof *hits->ray, "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&hits->block, room, sizeof *hits->block, "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&hits->flags, room, sizeof *hits->flags, "hits", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&hits->t, room, sizeof *hits->t, "hits", err);
    for (int a = 0; a < 3; a++) {
        if (status == DF_OK) status = df_alloc_raw((void **)&hits->cell[a], room, sizeof *hits->cell[a], "hits", err);
        if (status == DF_OK) status = df_alloc_raw((void **)&hits->local[a], room, sizeof *hits->local[a], "hits", err);
        if (status == DF_OK)
            status = df_alloc_raw((void **)&hits->direction[a], room, sizeof *hits->direction[a], "hits", err);
        if (status == DF_OK)
            status = df_alloc_raw((void **)&hits->normal[a], room, sizeof *hits->normal[a], "hits", err);
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
        free(hits->direction[a]);
        free(hits->normal[a]);
    }
    memset(hits, 0, sizeof *hits);
}
