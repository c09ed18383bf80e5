/* What splatting projects: the box of a record holds the cell's surface, and all instruction sets make the same boxes.
 */
#include "fields.h"
#include "render/cpu/surface.h"
#include "tracing.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static void random_point(test_random *random, double p[3]) {
    for (int a = 0; a < 3; a++) {
        p[a] = test_uniform(random);
        if (test_uniform(random) < 0.2) p[a] = p[a] < 0.5 ? 0 : 1;
    }
}

/* Roots between random points of cells with random corners, zeros and equal ones among them. */
static void boxes_hold_the_surface(void **unused) {
    enum { CELLS = 20000, PAIRS = 20 };
    const double margin = 1.0 / 64;
    test_random random = {5};
    uint32_t roots = 0, thin = 0;
    (void)unused;
    for (int n = 0; n < CELLS; n++) {
        float corner[8];
        for (int c = 0; c < 8; c++) {
            corner[c] = (float)((2 * test_uniform(&random) - 1) * (n % 3 == 0 ? 1 : 1e-3));
            if (n % 5 == 0) corner[c] = rintf(corner[c] * 3);
            if (n % 3 == 1) corner[c] += (float)(c & 1) - 0.5f; /* nearly a plane */
        }
        const uint32_t box = df_surface_box(corner, (float)margin);
        double low[3], high[3], volume = 1;
        for (int a = 0; a < 3; a++) {
            low[a] = (box >> (DF_SURFACE_LOW + 3 * a) & 7) / 8.0;
            high[a] = ((box >> (DF_SURFACE_HIGH + 3 * a) & 7) + 1) / 8.0;
            volume *= high[a] - low[a];
        }
        thin += volume < 0.5;
        for (int pair = 0; pair < PAIRS; pair++) {
            double p[3], q[3];
            random_point(&random, p);
            random_point(&random, q);
            if (df_trilinear(corner, p) * df_trilinear(corner, q) > 0) continue;
            for (int i = 0; i < 50; i++) {
                double middle[3];
                for (int a = 0; a < 3; a++) middle[a] = (p[a] + q[a]) / 2;
                memcpy(df_trilinear(corner, middle) * df_trilinear(corner, q) > 0 ? q : p, middle, sizeof middle);
            }
            roots++;
            for (int a = 0; a < 3; a++) {
                if (p[a] < low[a] || p[a] > high[a])
                    fail_msg("cell %d: surface at %g along %d, the box is %g to %g", n, p[a], a, low[a], high[a]);
            }
        }
    }
    assert_true(roots > CELLS && thin > CELLS / 8);
}

static double wave(const double grid[3], const void *context) {
    (void)context;
    return sin(grid[0] / 3) * cos(grid[1] / 3) + sin(grid[1] / 3) * cos(grid[2] / 3) +
           sin(grid[2] / 3) * cos(grid[0] / 3);
}

static void instruction_sets_make_the_same_boxes(void **unused) {
    static const char *const isas[] = {"scalar", "sse4.1", "avx2", "avx512"};
    static const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_BRICKS};
    const uint32_t count[3] = {45, 38, 29};
    (void)unused;
    for (int n = 0; n < 12; n++) { /* structures, sample types, iso values */
        df_field field = {0};
        df_scene scene = {0};
        df_error err;
        const df_scene_options options = {.levels = 2};
        if (test_field_from_function(&field, kinds[n & 1], 8, count, wave, NULL, &err)) fail_msg("%s", err.text);
        if (n / 4 && test_field_quantise(&field, n / 4 == 1 ? DF_SAMPLE_U16 : DF_SAMPLE_U8, &err))
            fail_msg("%s", err.text);
        if (df_scene_prepare(&field, n & 2 ? 0.25f : 0, &options, &scene, &err)) fail_msg("%s", err.text);
        for (int i = 0; i < 4; i++) {
            const df_kernels *kernels;
            df_surface surface = {0};
            if (df_kernels_select(isas[i], &kernels, &err) == DF_ERROR_UNSUPPORTED) continue;
            if (df_surface_make(&scene, kernels, 2, &surface, &err)) fail_msg("%s", err.text);
            assert_true(surface.record_count > 1000);
            for (uint32_t block = 0; block < surface.block_count; block++) {
                for (uint32_t r = surface.first[block]; r < surface.first[block + 1]; r++) {
                    uint32_t voxel[3];
                    float corner[8];
                    for (int a = 0; a < 3; a++)
                        voxel[a] = surface.corner[a][block] + (surface.voxels[r] >> a * (int)surface.k_shift & 7);
                    df_scene_corners(&scene, voxel, block, corner);
                    assert_int_equal(surface.voxels[r] >> DF_SURFACE_LOW,
                                     df_surface_box(corner, df_surface_margin(&scene)) >> DF_SURFACE_LOW);
                }
            }
            df_surface_free(&surface);
        }
        df_scene_free(&scene);
        df_field_free(&field);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(boxes_hold_the_surface),
                                       cmocka_unit_test(instruction_sets_make_the_same_boxes)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
