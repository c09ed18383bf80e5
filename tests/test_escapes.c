/*
 * Watertight on every structure, by every tracer: rays from inside closed fields, and pictures. `df-lab escape` is the
 * same with more rays.
 */
#include "fields.h"
#include "lab/octree.h"
#include "lab/opencl_tracer.h"
#include "lab/view_escapes.h"
#include "render/methods/solve_methods.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { VOXELS = 32, STRUCTURE_COUNT = 4, PIXELS = 512 * 512 };
static const char *const structure_names[] = {"dense", "bricks", "octree", "octree with junctions"};

typedef struct fixture {
    df_field field;
    df_scene scene;
} fixture;

static void open_fixture(fixture *f, lab_shape shape, int structure) {
    static const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_BRICKS, DF_FIELD_ADF};
    const lab_surface surface = lab_surface_make(shape, VOXELS, 0);
    const uint32_t count[3] = {VOXELS, VOXELS, VOXELS};
    const df_scene_options options = {0};
    df_error err;
    df_status status =
        structure == 3 ? lab_octree_make(&surface, 5, 0.3, LAB_SEED, &f->field, &err)
                       : test_field_from_function(&f->field, kinds[structure], 8, count, surface.value, &surface, &err);
    if (status == DF_OK) status = df_scene_prepare(&f->field, 0, &options, &f->scene, &err);
    if (status != DF_OK) fail_msg("%s", err.text);
}

static void close_fixture(fixture *f) {
    df_scene_free(&f->scene);
    df_field_free(&f->field);
}

static bool suits_a_view(const df_tracer *tracer, const df_scene *scene) {
    df_camera camera;
    df_view view;
    df_camera_orbit(scene->field, 0, 0, 2, &camera);
    camera.fov_y = 1;
    return df_view_make(&camera, scene->field, 8, 8, &view, NULL) == DF_OK &&
           (!tracer->suits || tracer->suits(scene, &view));
}

static void no_picture_of_a_closed_field_has_a_hole(void **unused) {
    (void)unused;
    int pictures = 0;
    for (int n = 0; n < STRUCTURE_COUNT; n++) {
        fixture f;
        open_fixture(&f, n % 2 ? LAB_PAIRS : LAB_GYROID, n);
        for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
            lab_escapes escapes;
            df_error err;
            if (!suits_a_view(*tracer, &f.scene)) continue;
            if (lab_count_view_escapes(*tracer, &f.scene, LAB_SEED, 2 * PIXELS, &escapes, &err))
                fail_msg("%s", err.text);
            if (escapes.count)
                fail_msg("%s, %s: %d holes, the first without a hit is pixel %d", structure_names[n], (*tracer)->name,
                         (int)escapes.count, (int)escapes.kept[0].ray);
            assert_true(escapes.rays > PIXELS); /* all of the first, from inside, and some of the second */
            pictures++;
        }
        close_fixture(&f);
    }
    assert_int_equal(pictures, 14);
}

/* A tracer of views that loses one hit of a thousand. */
static df_status lose_hits(void *state, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                           df_error *err) {
    df_status status = df_tracer_dda.trace(state, thread, tile, hits, counters, err);
    if (hits->count > 1000) hits->count--;
    return status;
}

static bool suits_views(const df_scene *scene, const df_view *view) { return scene->levels != 0 && view; }

static void a_hole_in_a_picture_is_found(void **unused) {
    (void)unused;
    fixture f;
    df_tracer lossy = df_tracer_dda;
    lab_escapes escapes;
    df_error err;
    lossy.trace = lose_hits;
    lossy.suits = suits_views;
    open_fixture(&f, LAB_GYROID, 1);
    if (lab_count_view_escapes(&lossy, &f.scene, LAB_SEED, 2 * PIXELS, &escapes, &err)) fail_msg("%s", err.text);
    assert_true(escapes.count >= PIXELS / (64 * 64)); /* one in each tile of the first */
    assert_true(escapes.kept_count == LAB_FAILURES_KEPT && !escapes.kept[0].tangent);
    assert_true(escapes.kept[0].ray < escapes.kept[1].ray && escapes.kept[0].true_hit > 0);
    close_fixture(&f);
}

static void nothing_escapes_on_an_opencl_device(void **unused) {
    (void)unused;
    for (int n = 0; n < STRUCTURE_COUNT; n++) {
        fixture f;
        lab_escapes escapes;
        df_error err;
        open_fixture(&f, n % 2 ? LAB_PAIRS : LAB_GYROID, n);
        const lab_run run = {.tracer = &lab_tracer_opencl,
                             .scene = &f.scene,
                             .solve = DF_SOLVE_ROBUST,
                             .family = LAB_INSIDE,
                             .seed = LAB_SEED,
                             .count = 10000};
        const df_status status = lab_count_escapes(&run, &escapes, &err);
        close_fixture(&f);
        if (status == DF_ERROR_UNSUPPORTED) skip();
        if (status != DF_OK) fail_msg("%s", err.text);
        assert_int_equal(escapes.rays, 10000);
        if (escapes.count)
            fail_msg("%s: %d rays escape, the first without a hit is %d", structure_names[n], (int)escapes.count,
                     (int)escapes.kept[0].ray);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(no_picture_of_a_closed_field_has_a_hole),
        cmocka_unit_test(a_hole_in_a_picture_is_found),
        cmocka_unit_test(nothing_escapes_on_an_opencl_device),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
