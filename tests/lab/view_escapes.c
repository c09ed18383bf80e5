#include "view_escapes.h"
#include "render/frame.h"
#include "render/methods/solve_methods.h"
#include "view_ray.h"
#include "view_truth.h"

#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

enum { SIZE = 512, PIXELS = SIZE * SIZE };

typedef struct pictures {
    df_renderer *renderer, *walk; /* the tracer, and each ray alone */
    float *drawn, *walked;        /* depths */
    df_rays rays;
} pictures;

static df_status pictures_open(pictures *p, const df_tracer *tracer, const df_scene *scene, df_error *err) {
    df_frame_options options = {
        .tracer = tracer, .solve = DF_SOLVE_ROBUST, .tile = 64, .threads = (uint32_t)omp_get_max_threads()};
    *p = (pictures){.drawn = malloc(PIXELS * sizeof(float)), .walked = malloc(PIXELS * sizeof(float))};
    df_status status = p->drawn && p->walked ? DF_OK : df_fail(err, DF_ERROR_MEMORY, "no memory for pictures");
    if (status == DF_OK) status = df_kernels_select("auto", &options.kernels, err);
    if (status == DF_OK) status = df_renderer_open(scene, &options, SIZE, SIZE, &p->renderer, err);
    options.tracer = scene->levels ? &df_tracer_dda : &df_tracer_adf;
    if (status == DF_OK) status = df_renderer_open(scene, &options, SIZE, SIZE, &p->walk, err);
    return status == DF_OK ? df_rays_alloc(PIXELS, true, &p->rays, err) : status;
}

static void pictures_close(pictures *p) {
    df_renderer_close(p->renderer);
    df_renderer_close(p->walk);
    df_rays_free(&p->rays);
    free(p->drawn);
    free(p->walked);
}

/* The pixels of one picture, numbered from `first`. */
static void judge_picture(const pictures *p, const df_scene *scene, bool inside, uint64_t first, lab_escapes *escapes) {
    for (uint32_t i = 0; i < PIXELS; i++) {
        const bool must = inside || isfinite(p->walked[i]);
        escapes->rays += must;
        if (!must || isfinite(p->drawn[i])) continue;
        lab_escape escape = {.ray = first + i};
        lab_view_ray(&p->rays, i, escape.origin, escape.direction);
        lab_escapes_judge(escapes, scene, escape);
    }
}

df_status lab_count_view_escapes(const df_tracer *tracer, const df_scene *scene, uint64_t seed, uint64_t rays,
                                 lab_escapes *escapes, df_error *err) {
    pictures p;
    df_status status = pictures_open(&p, tracer, scene, err);
    const df_picture drawn = {.width = SIZE, .height = SIZE, .depth = p.drawn},
                     walked = {.width = SIZE, .height = SIZE, .depth = p.walked};
    memset(escapes, 0, sizeof *escapes);
    for (uint64_t n = 0; n * PIXELS < rays && status == DF_OK; n++) {
        const bool inside = n % 2 == 0;
        df_camera camera;
        df_view view;
        if (!lab_random_camera(scene->field, seed, n, &camera)) continue;
        status = df_view_make(&camera, scene->field, SIZE, SIZE, &view, err);
        if (status != DF_OK || !tracer->suits(scene, &view)) continue;
        status = df_renderer_frame(p.renderer, &view, &drawn, NULL, err);
        if (status == DF_OK) status = df_renderer_frame(p.walk, &view, &walked, NULL, err);
        if (status != DF_OK) break;
        df_view_rays(&view, &df_kernels_scalar, 0, 0, SIZE, SIZE, &p.rays);
        judge_picture(&p, scene, inside, n * PIXELS, escapes);
    }
    lab_escapes_sort(escapes);
    pictures_close(&p);
    return status;
}
