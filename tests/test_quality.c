/* --quality auto: what it chooses, and that what it chooses is enough. */
#include "fields.h"
#include "lab/surface.h"
#include "render/frame.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"
#include "render/quality.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIZE = 200 };

static void open_field(lab_shape shape, uint32_t size, df_field *field) {
    const uint32_t count[3] = {size, size, size};
    const lab_surface surface = lab_surface_make(shape, size, 0);
    df_error err;
    memset(field, 0, sizeof *field);
    if (test_field_from_function(field, DF_FIELD_BRICKS, 8, count, surface.value, &surface, &err))
        fail_msg("%s", err.text);
    field->error_rms = -1;
}

static df_quality choose(const df_field *field, double distance, uint32_t height) {
    df_camera camera;
    df_quality quality;
    df_camera_orbit(field, 30, 20, distance, &camera);
    camera.fov_y = 1;
    df_quality_choose(field, &camera, height, true, &quality);
    return quality;
}

static void three_distances_lead_to_three_choices(void **unused) {
    (void)unused;
    df_field field;
    open_field(LAB_SPHERE, 64, &field);
    const df_quality near = choose(&field, 0.9, 1024), middle = choose(&field, 8, 1024), far = choose(&field, 60, 1024);
    assert_true(near.steps > middle.steps && middle.steps >= far.steps && far.steps >= 6);
    assert_int_equal(middle.gradient, DF_GRADIENT_CORNER_CENTRAL);
    assert_int_equal(near.gradient, DF_GRADIENT_CORNER_CENTRAL);
    assert_int_equal(far.gradient, DF_GRADIENT_ANALYTIC);
    df_field_free(&field);
}

static void an_eye_in_the_box_gets_everything_unless_the_field_is_coarse(void **unused) {
    (void)unused;
    df_field field;
    open_field(LAB_SPHERE, 64, &field);
    assert_int_equal(choose(&field, 0.2, 1024).steps, df_solve_steps(DF_SOLVE_ROBUST));
    field.error_rms = 0.5;
    assert_int_equal(choose(&field, 0.2, 1024).steps, 6);
    df_field_free(&field);
}

/* Float where its error hides under the floors: from afar, and close by where the field itself is coarse; less of it in
 * a larger field, whose coordinates round more; none on devices that have no float solve. */
static void single_precision_is_taken_where_it_cannot_be_seen(void **unused) {
    (void)unused;
    df_field field;
    df_camera camera;
    df_quality quality;
    open_field(LAB_SPHERE, 64, &field);
    assert_int_equal(choose(&field, 0.2, 1024).precision, DF_PRECISION_F64);
    assert_int_equal(choose(&field, 3, 1024).precision, DF_PRECISION_F32);
    assert_int_equal(choose(&field, 60, 1024).precision, DF_PRECISION_F32);
    df_camera_orbit(&field, 30, 20, 60, &camera);
    camera.fov_y = 1;
    df_quality_choose(&field, &camera, 1024, false, &quality);
    assert_int_equal(quality.precision, DF_PRECISION_F64);
    assert_int_equal(quality.steps, choose(&field, 60, 1024).steps);
    field.error_rms = 0.05;
    assert_int_equal(choose(&field, 0.2, 1024).precision, DF_PRECISION_F32);
    field.voxel_count[0] = 1024; /* only its size is looked at */
    assert_int_equal(choose(&field, 0.2, 1024).precision, DF_PRECISION_F64);
    field.voxel_count[0] = 64;
    df_field_free(&field);
}

static void draw(const df_scene *scene, const df_view *view, const df_quality *quality, float *depth) {
    df_error err;
    df_renderer *renderer;
    const df_picture picture = {.width = SIZE, .height = SIZE, .depth = depth};
    df_frame_options options = {.tracer = &df_tracer_dda,
                                .solve = quality->solve,
                                .steps = quality->steps,
                                .precision = quality->precision,
                                .gradient = quality->gradient,
                                .tile = 64,
                                .threads = 1};
    if (df_kernels_select("auto", &options.kernels, &err)) fail_msg("%s", err.text);
    if (df_renderer_open(scene, &options, SIZE, SIZE, &renderer, &err)) fail_msg("%s", err.text);
    if (df_renderer_frame(renderer, view, &picture, NULL, &err)) fail_msg("%s", err.text);
    df_renderer_close(renderer);
}

/* No pixel is lost or won, and 99 of 100 depths stay within the bound; also in fields that the table of errors was not
 * made of. */
static void the_choice_keeps_its_promise(void **unused) {
    (void)unused;
    const df_quality full = {.solve = DF_SOLVE_ROBUST, .gradient = DF_GRADIENT_CORNER_CENTRAL};
    const double distances[] = {0.9, 1.6, 5, 20};
    for (int shape = 0; shape < LAB_SHAPE_COUNT; shape++) {
        df_field field;
        df_scene scene;
        df_error err;
        const df_scene_options scene_options = {0};
        float *depth[2] = {malloc(SIZE * SIZE * sizeof(float)), malloc(SIZE * SIZE * sizeof(float))};
        open_field((lab_shape)shape, 45, &field);
        if (df_scene_prepare(&field, 0, &scene_options, &scene, &err)) fail_msg("%s", err.text);
        for (int i = 0; i < 4; i++) {
            df_camera camera;
            df_view view;
            df_quality quality;
            int hits = 0, over = 0;
            df_camera_orbit(&field, 55, 15, distances[i], &camera);
            camera.fov_y = 1;
            df_quality_choose(&field, &camera, SIZE, true, &quality);
            if (df_view_make(&camera, &field, SIZE, SIZE, &view, &err)) fail_msg("%s", err.text);
            draw(&scene, &view, &full, depth[0]);
            draw(&scene, &view, &quality, depth[1]);
            for (int p = 0; p < SIZE * SIZE; p++) {
                assert_int_equal(isfinite(depth[0][p]), isfinite(depth[1][p]));
                if (!isfinite(depth[0][p])) continue;
                hits++;
                over += fabs((double)depth[0][p] - (double)depth[1][p]) > quality.bound;
            }
            if (over * 100 > hits)
                fail_msg("%s at %g: %d of %d depths are off by more than %g", lab_shape_names[shape], distances[i],
                         over, hits, quality.bound);
        }
        df_scene_free(&scene);
        df_field_free(&field);
        free(depth[0]);
        free(depth[1]);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(three_distances_lead_to_three_choices),
        cmocka_unit_test(an_eye_in_the_box_gets_everything_unless_the_field_is_coarse),
        cmocka_unit_test(single_precision_is_taken_where_it_cannot_be_seen),
        cmocka_unit_test(the_choice_keeps_its_promise),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
