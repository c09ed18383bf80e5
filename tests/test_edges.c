/*
 * Fields at the ends of what is allowed: one voxel, stretched boxes, and (with the argument "large", slow) more than
 * 2^31 samples. All tracers that suit draw the scalar walk's picture, bit for bit.
 */
#include "fields.h"
#include "render/frame.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

enum { W = 70, H = 50 };
typedef struct picture {
    uint8_t rgb[3 * W * H];
    float depth[W * H], normals[3 * W * H];
} picture;
static picture reference, other;

static void draw(const df_scene *scene, const df_view *view, const df_frame_options *options, picture *p) {
    df_renderer *renderer;
    df_error err;
    memset(p, 0, sizeof *p);
    if (df_renderer_open(scene, options, W, H, &renderer, &err)) fail_msg("%s", err.text);
    const df_picture out = {.width = W, .height = H, .rgb = p->rgb, .depth = p->depth, .normals = p->normals};
    if (df_renderer_frame(renderer, view, &out, NULL, &err)) fail_msg("%s", err.text);
    df_renderer_close(renderer);
}

/* Draws with every tracer, instruction set and bounds; `reference` keeps the scalar walk's picture. Returns its hits.
 */
static uint32_t draw_all(const df_field *field, uint32_t levels, const df_camera *camera, const char *name) {
    static const char *const isas[] = {"scalar", "sse4.1", "avx2", "avx512"};
    const df_scene_options scene_options = {.levels = levels};
    df_scene scene;
    df_view view;
    df_error err;
    uint32_t hits = 0;
    if (df_scene_prepare(field, 0, &scene_options, &scene, &err)) fail_msg("%s", err.text);
    if (df_view_make(camera, field, W, H, &view, &err)) fail_msg("%s", err.text);
    df_frame_options options = {.tracer = scene.levels ? &df_tracer_dda : &df_tracer_adf,
                                .solve = DF_SOLVE_ROBUST,
                                .gradient = DF_GRADIENT_CORNER_CENTRAL,
                                .tile = 32,
                                .threads = 2};
    draw(&scene, &view, &options, &reference);
    for (int i = 0; i < W * H; i++) hits += isfinite(reference.depth[i]);
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if ((*tracer)->suits && !(*tracer)->suits(&scene, &view)) continue;
        options.tracer = *tracer;
        for (int n = 0; n < 12; n++) {
            options.walk.bounds = n / 4;
            if (df_kernels_select(isas[n % 4], &options.kernels, &err) || (n >= 4 && !(*tracer)->takes_bounds))
                continue;
            draw(&scene, &view, &options, &other);
            if (memcmp(&reference, &other, sizeof other))
                fail_msg("%s: %s, %s, bounds %s", name, (*tracer)->name, isas[n % 4],
                         df_bounds_names[options.walk.bounds]);
        }
    }
    df_scene_free(&scene);
    return hits;
}

static double slope(const double p[3], const void *context) {
    const double *s = context; /* the middle */
    return 0.3 * (p[0] - s[0]) + 0.9 * (p[1] - s[1]) - 0.2 * (p[2] - s[2]);
}

static double ellipsoid(const double p[3], const void *context) {
    const double *s = context; /* the middle */
    double sum = 0;
    for (int a = 0; a < 3; a++) sum += (p[a] - s[a]) * (p[a] - s[a]) / (0.6 * s[a] * s[a]);
    return sqrt(sum) - 1;
}

static void a_field_of_one_voxel_is_drawn(void **unused) {
    (void)unused;
    static const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_DENSE, DF_FIELD_BRICKS, DF_FIELD_ADF};
    const double middle[3] = {0.5, 0.4, 0.5};
    for (int i = 0; i < 4; i++) {
        df_field field = {0};
        df_camera camera;
        df_error err;
        if (test_field_from_function(&field, kinds[i], 4, (const uint32_t[3]){1, 1, 1}, slope, middle, &err))
            fail_msg("%s", err.text);
        for (int view = 0; view < 4; view++) {
            df_camera_orbit(&field, 100 * view, 40, 0.4 + view, &camera);
            camera.fov_y = 1;
            assert_true(draw_all(&field, i == 1, &camera, "one voxel") > 10);
        }
        df_field_free(&field);
    }
}

/* Counts that no brick divides, and voxels that are 30 times as long as wide. */
static void stretched_fields_are_drawn(void **unused) {
    (void)unused;
    static const uint32_t counts[][3] = {{37, 5, 90}, {3, 120, 17}, {64, 2, 9}};
    static const double sizes[][3] = {{1, 2.5, 0.3}, {3, 0.1, 1}, {0.2, 6, 1e-3}};
    for (int i = 0; i < 3; i++) {
        const double middle[3] = {counts[i][0] / 2.0, counts[i][1] / 2.0, counts[i][2] / 2.0};
        for (int bricks = 0; bricks < 2; bricks++) {
            df_field field = {0};
            df_camera camera;
            df_error err;
            uint32_t hits = 0;
            if (test_field_from_function(&field, bricks ? DF_FIELD_BRICKS : DF_FIELD_DENSE, 8, counts[i], ellipsoid,
                                         middle, &err))
                fail_msg("%s", err.text);
            for (int a = 0; a < 3; a++) field.voxel_size[a] = sizes[i][a];
            for (int view = 0; view < 3; view++) {
                df_camera_orbit(&field, 50 + 80 * view, 35 - 30 * view, 0.8 + 0.4 * view, &camera);
                camera.fov_y = 1;
                hits += draw_all(&field, 0, &camera, "stretched");
            }
            assert_true(hits > 20);
            df_field_free(&field);
        }
    }
}

/* A gentle slope in the last layer of 1290^3 voxels: all its samples lie beyond 2^31. */
static void more_samples_than_31_bits_count(void **unused) {
    (void)unused;
    enum { N = 1290, SIDE = N + 1 };
    const uint64_t total = (uint64_t)SIDE * SIDE * SIDE, layer = (uint64_t)SIDE * SIDE;
    df_field field = {.kind = DF_FIELD_DENSE, .sample_type = DF_SAMPLE_U8, .step_exponent = -6};
    df_camera camera;
    df_error err;
    uint8_t *codes = calloc(total, 1); /* all 2 voxels inside */
    if (!codes) fail_msg("no memory");
    assert_true(total > INT32_MAX);
    for (uint64_t z = N - 3; z <= N; z++) {
        for (uint64_t i = 0; i < layer; i++) {
            const double f = (double)z - (N - 0.5) + 0.0005 * ((double)(i % SIDE) - 645);
            codes[z * layer + i] = (uint8_t)(128 + fmax(-128, fmin(127, rint(f * 64))));
        }
    }
    field.samples = codes;
    df_field_own(&field, codes);
    for (int a = 0; a < 3; a++) {
        field.voxel_count[a] = N;
        field.voxel_size[a] = 1;
    }
    if (df_field_finish(&field, "large", &err)) fail_msg("%s", err.text);
    memset(&camera, 0, sizeof camera);
    memcpy(camera.eye, (const double[3]){645, 645, 1900}, sizeof camera.eye);
    memcpy(camera.look_at, (const double[3]){645, 645, 0}, sizeof camera.look_at);
    camera.up[1] = 1;
    camera.fov_y = 0.8;
    assert_int_equal(draw_all(&field, 0, &camera, "large"), W * H);
    for (int i = 0; i < W * H; i++) {
        const double forward = 0.5 * H / tan(0.4), x = i % W + 0.5 - 0.5 * W, y = i / W + 0.5 - 0.5 * H;
        const double away = (double)reference.depth[i] * forward / sqrt(forward * forward + x * x + y * y);
        if (fabs(away - (1900 - (N - 0.5))) > 0.35) fail_msg("pixel %d lies %g before the eye", i, away);
    }
    df_field_free(&field);
}

int main(int argc, char **argv) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_field_of_one_voxel_is_drawn),
                                       cmocka_unit_test(stretched_fields_are_drawn)};
    const struct CMUnitTest large[] = {cmocka_unit_test(more_samples_than_31_bits_count)};
    if (argc < 2 || strcmp(argv[1], "large") != 0) return cmocka_run_group_tests(tests, NULL, NULL);
    const double free_bytes = (double)sysconf(_SC_AVPHYS_PAGES) * (double)sysconf(_SC_PAGESIZE);
    if (free_bytes < 4e9) {
        printf("skipped: %.1f GB of memory are free, 4 are needed\n", free_bytes / 1e9);
        return 77;
    }
    return cmocka_run_group_tests(large, NULL, NULL);
}
