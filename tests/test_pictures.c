/*
 * Every tracer draws the same picture, bit for bit, with every instruction set: in fields full of trouble, from afar,
 * from close by, from inside the box and from inside the surface, straight along an axis, and with an eye on a grid
 * point. And a renderer that is set to another method draws what one that was opened for it draws.
 */
#include "fields.h"
#include "lab/octree.h"
#include "lab/surface.h"
#include "render/frame.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { WIDTH = 147, HEIGHT = 113, PIXELS = WIDTH * HEIGHT };

typedef struct view_case {
    const char *name;
    double eye[3], look_at[3], up[3]; /* in parts of the field's side */
    double fov;
} view_case;

static const view_case views[] = {
    {"afar", {2.1, 1.3, 1.7}, {0.5, 0.5, 0.5}, {0, 1, 0}, 0.7},
    {"very far", {2000.1, 1300, 1700}, {0.5, 0.5, 0.5}, {0, 1, 0}, 7e-4},
    {"along an axis", {0.5, 0.5, 3}, {0.5, 0.5, 0.5}, {0, 1, 0}, 0.6},
    {"along another", {-1, 0.5, 0.5}, {0.5, 0.5, 0.5}, {0, 0, 1}, 0.9},
    {"close by", {0.97, 0.8, 0.93}, {0.5, 0.5, 0.5}, {0, 1, 0}, 1.2},
    {"from the middle", {0.5, 0.5, 0.5}, {0.9, 0.6, 0.3}, {0, 1, 0}, 1.8},
    {"from a corner of the box", {0, 0, 0}, {1, 1, 1}, {0, 1, 0}, 1.0},
    {"from a face of the box", {1, 0.5, 0.25}, {0, 0.5, 0.5}, {0, 1, 0}, 1.4},
    {"a wide angle", {0.5, 0.52, 1.2}, {0.5, 0.5, 0.5}, {0, 1, 0}, 2.8},
};
static int octree_count = 6; /* the argument */
enum { VIEW_COUNT = sizeof views / sizeof views[0] };

typedef struct images {
    uint8_t rgb[3 * PIXELS];
    float depth[PIXELS], normals[3 * PIXELS];
} images;

static bool draw(const df_scene *scene, const df_frame_options *options, const df_view *view, images *out) {
    df_renderer *renderer;
    df_error err;
    const df_picture picture = {
        .width = WIDTH, .height = HEIGHT, .rgb = out->rgb, .depth = out->depth, .normals = out->normals};
    if (options->tracer->suits && !options->tracer->suits(scene, view)) return false;
    df_frame_options other = *options;
    static unsigned turn; /* every fourth renderer is opened for another method first */
    const bool set_later = ++turn % 4 == 0;
    if (set_later) {
        other.solve = options->solve == DF_SOLVE_ROBUST ? DF_SOLVE_MIDPOINT : DF_SOLVE_ROBUST;
        other.steps = 2;
        other.precision = DF_PRECISION_F32;
        other.gradient = DF_GRADIENT_ANALYTIC;
    }
    if (df_renderer_open(scene, &other, WIDTH, HEIGHT, &renderer, &err)) fail_msg("%s", err.text);
    if (set_later && df_renderer_frame(renderer, view, &picture, NULL, &err)) fail_msg("%s", err.text);
    if (set_later && df_renderer_set_method(renderer, options, &err)) fail_msg("%s", err.text);
    if (df_renderer_frame(renderer, view, &picture, NULL, &err)) fail_msg("%s", err.text);
    df_renderer_close(renderer);
    return true;
}

static int compare(const images *a, const images *b, const char *what) {
    int differ = 0, first = -1;
    for (int i = 0; i < PIXELS; i++) {
        bool same = memcmp(&a->depth[i], &b->depth[i], sizeof(float)) == 0 &&
                    memcmp(&a->normals[3 * i], &b->normals[3 * i], 3 * sizeof(float)) == 0 &&
                    memcmp(&a->rgb[3 * i], &b->rgb[3 * i], 3) == 0;
        if (!same && first < 0) first = i;
        differ += !same;
    }
    if (differ) {
        print_error("%s: %d pixels differ, the first is %d,%d at depth %.9g and %.9g\n", what, differ, first % WIDTH,
                    first / WIDTH, (double)a->depth[first], (double)b->depth[first]);
    }
    return differ;
}

/* All tracers and instruction sets against the scalar reference. */
static int check_view(const df_scene *scene, const char *field, const view_case *v, int solve) {
    static const char *const isas[] = {"scalar", "sse4.1", "avx2", "avx512"};
    static images reference, other;
    df_camera camera = {.fov_y = v->fov};
    df_view view;
    df_error err;
    int wrong = 0;
    for (int a = 0; a < 3; a++) {
        camera.eye[a] = v->eye[a] * scene->voxel_count[a];
        camera.look_at[a] = v->look_at[a] * scene->voxel_count[a];
        camera.up[a] = v->up[a];
    }
    if (df_view_make(&camera, scene->field, WIDTH, HEIGHT, &view, &err)) fail_msg("%s", err.text);
    df_frame_options options = {.tracer = scene->levels ? &df_tracer_dda : &df_tracer_adf,
                                .solve = solve,
                                .gradient = DF_GRADIENT_CORNER_CENTRAL,
                                .tile = 32,
                                .threads = 2};
    if (df_kernels_select("scalar", &options.kernels, &err)) fail_msg("%s", err.text);
    draw(scene, &options, &view, &reference);
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        for (int i = 0; i < 4; i++) {
            char what[200];
            if (df_kernels_select(isas[i], &options.kernels, &err)) continue; /* not of this machine */
            options.tracer = *tracer;
            if (!draw(scene, &options, &view, &other)) continue;
            snprintf(what, sizeof what, "%s, %s, %s, %s, %s", field, v->name, df_solve_names[solve], (*tracer)->name,
                     isas[i]);
            wrong += compare(&reference, &other, what) != 0;
        }
    }
    return wrong;
}

static void every_tracer_draws_the_same_picture(void **unused) {
    (void)unused;
    int wrong = 0;
    for (int shape = 0; shape < LAB_SHAPE_COUNT; shape++) {
        for (int kind = DF_FIELD_DENSE; kind <= DF_FIELD_BRICKS; kind++) {
            if (shape < LAB_BOX || shape == LAB_ROTATED_BOX || (kind == DF_FIELD_DENSE && shape != LAB_PAIRS)) continue;
            const uint32_t size = 37, count[3] = {size, size, size};
            const df_scene_options options = {0};
            const lab_surface surface = lab_surface_make((lab_shape)shape, size, 0);
            df_field field = {0};
            df_scene scene;
            df_error err;
            if (test_field_from_function(&field, (df_field_kind)kind, 8, count, surface.value, &surface, &err))
                fail_msg("%s", err.text);
            if (df_scene_prepare(&field, 0, &options, &scene, &err)) fail_msg("%s", err.text);
            for (int v = 0; v < VIEW_COUNT; v++) {
                wrong += check_view(&scene, surface.name, &views[v], DF_SOLVE_ROBUST);
                if (shape == LAB_PAIRS) wrong += check_view(&scene, surface.name, &views[v], DF_SOLVE_LINEAR);
            }
            df_scene_free(&scene);
            df_field_free(&field);
        }
    }
    assert_int_equal(wrong, 0);
}

/* Octrees whose leaves do not fit their neighbours, whole and cut off in the midst of solid, so that rays enter the
 * field inside. */
static void every_tracer_draws_the_same_octree(void **unused) {
    (void)unused;
    static const lab_shape shapes[] = {LAB_SPHERE, LAB_BOX, LAB_GYROID, LAB_NOISE, LAB_PAIRS};
    int wrong = 0;
    for (int i = 0; i < octree_count; i++) {
        const lab_surface surface = lab_surface_make(shapes[i % 5], 32, shapes[i % 5] == LAB_NOISE ? 5 : 0);
        const df_scene_options options = {0};
        const uint64_t seed = (uint64_t)i + 1;
        df_field field = {0};
        df_scene scene;
        df_error err;
        if (lab_octree_make(&surface, 5, 0.3 * (i % 3), seed, &field, &err)) fail_msg("%s", err.text);
        for (int cut = 0; cut < 2; cut++) {
            for (int a = 0; a < 3 && cut; a++) field.voxel_count[a] -= (uint32_t)(seed * 0x9E3779B9u >> 4 * a) % 17;
            if (df_scene_prepare(&field, 0, &options, &scene, &err)) fail_msg("%s", err.text);
            for (int v = 0; v < VIEW_COUNT; v++)
                wrong += check_view(&scene, surface.name, &views[v], i % 7 ? DF_SOLVE_ROBUST : DF_SOLVE_LINEAR);
            df_scene_free(&scene);
        }
        df_field_free(&field);
    }
    assert_int_equal(wrong, 0);
}

int main(int argc, char **argv) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_tracer_draws_the_same_picture),
                                       cmocka_unit_test(every_tracer_draws_the_same_octree)};
    if (argc > 1) octree_count = atoi(argv[1]);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
