/* Samples of 16 and 8 bits: signs stay, zeros stay, and what several bricks hold decodes alike. */
#include "common/field_file.h"
#include "convert/quantise.h"
#include "fields.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>
#include <cmocka.h>

static const uint32_t SIZE[3] = {37, 29, 33};

/* A wavy surface with exact zeros on a plane of samples, and values near zero on both sides. */
static double wave(const double grid[3], const void *context) {
    (void)context;
    if (grid[0] == 16) return 0;
    double d = (grid[0] - 16) * (1 + 0.3 * sin(grid[1] * 0.7) * cos(grid[2] * 0.5));
    return fmod(grid[1], 5) == 0 ? d * 1e-7 : d;
}

static float decoded(const df_field *f, uint64_t i) {
    uint32_t block = df_brick_sample_count(f->kind == DF_FIELD_BRICKS ? f->brick_size : 8);
    return df_field_decode(f, i, f->brick_exponents ? f->brick_exponents[i / block] : f->step_exponent);
}

/* A plane, in units of which a voxel has *context. */
static double tilted(const double grid[3], const void *context) {
    return *(const double *)context * (0.36 * (grid[0] - 18.1) + 0.48 * (grid[1] - 14.3) + 0.8 * (grid[2] - 16.7));
}

static void check_signs(df_field_kind kind, df_sample_type type) {
    df_field exact, field;
    df_error err;
    assert_int_equal(test_field_from_function(&exact, kind, 8, SIZE, wave, NULL, &err), DF_OK);
    assert_int_equal(df_quantise(&exact, type, &field, &err), DF_OK);
    assert_int_equal(field.sample_type, type);
    assert_true(field.sample_count == exact.sample_count);
    for (uint64_t i = 0; i < field.sample_count; i++) {
        float was = decoded(&exact, i), is = decoded(&field, i);
        assert_int_equal(was < 0, is < 0);
        if (was == 0) assert_true(is == 0 && !signbit(is));
        if (kind == DF_FIELD_BRICKS) was = fmaxf(-4, fminf(4, was));
        assert_true(fabs((double)was - (double)is) <=
                    (type == DF_SAMPLE_U16 ? 2e-3 : 0.6)); /* voxels; the largest value is about 30 */
    }
    assert_true(df_field_surface_voxel_count(&field) == df_field_surface_voxel_count(&exact));
    df_field_free(&field);
    df_field_free(&exact);
}

static void signs_and_zeros_are_kept(void **state) {
    (void)state;
    for (int type = DF_SAMPLE_U16; type <= DF_SAMPLE_U8; type++) {
        check_signs(DF_FIELD_DENSE, (df_sample_type)type);
        check_signs(DF_FIELD_BRICKS, (df_sample_type)type);
    }
}

/* Each sample, from every voxel whose brick holds it. */
static void bricks_do_not_tear(void **state) {
    (void)state;
    for (int type = DF_SAMPLE_U16; type <= DF_SAMPLE_U8; type++) {
        df_field exact, field;
        df_error err;
        uint64_t shared = 0;
        assert_int_equal(test_field_from_function(&exact, DF_FIELD_BRICKS, 4, SIZE, wave, NULL, &err), DF_OK);
        assert_int_equal(df_quantise(&exact, (df_sample_type)type, &field, &err), DF_OK);
        for (uint32_t n = 0; n < (SIZE[0] + 1) * (SIZE[1] + 1) * (SIZE[2] + 1); n++) {
            uint32_t at[3] = {n % (SIZE[0] + 1), n / (SIZE[0] + 1) % (SIZE[1] + 1), n / (SIZE[0] + 1) / (SIZE[1] + 1)};
            float first = NAN;
            for (uint32_t c = 0; c < 8; c++) {
                uint32_t voxel[3];
                float corners[8];
                bool exists = true;
                for (int a = 0; a < 3; a++) {
                    voxel[a] = at[a] - (c >> a & 1);
                    exists = exists && voxel[a] < SIZE[a];
                }
                if (!exists || !df_field_corners(&field, voxel, corners)) continue;
                if (!isnan(first)) assert_true(first == corners[c]);
                shared += !isnan(first) && at[0] % 4 == 0;
                first = corners[c];
            }
        }
        assert_true(shared > 1000);
        df_field_free(&field);
        df_field_free(&exact);
    }
}

/* A plane, which leaves of all sizes interpolate exactly: so what differs is the rounding. */
static double plane(const double grid[3], const void *context) {
    (void)context;
    return 0.48 * (grid[0] - 15.3) + 0.6 * (grid[1] - 15.1) + 0.64 * (grid[2] - 16.2);
}

static void octrees_keep_their_surface(void **state) {
    (void)state;
    for (int type = DF_SAMPLE_U16; type <= DF_SAMPLE_U8; type++) {
        df_field exact, field;
        df_error err;
        const uint32_t size[3] = {32, 32, 32};
        assert_int_equal(test_field_from_function(&exact, DF_FIELD_ADF, 0, size, plane, NULL, &err), DF_OK);
        assert_int_equal(df_quantise(&exact, (df_sample_type)type, &field, &err), DF_OK);
        assert_int_equal(field.family_count, exact.family_count);
        assert_true(df_field_surface_voxel_count(&field) == df_field_surface_voxel_count(&exact));
        double largest = 0;
        for (uint32_t n = 0; n < 4000; n++) {
            double p[3] = {fmod(n * 0.754877666, 1) * 32, fmod(n * 0.569840291, 1) * 32, 0};
            p[2] = 16.2 - (0.48 * (p[0] - 15.3) + 0.6 * (p[1] - 15.1)) / 0.64;
            if (!(p[2] > 0 && p[2] < 32)) continue;
            df_point_info is;
            df_field_query(&field, p, &is);
            largest = fmax(largest, fabs(is.value));
        }
        /* leaves at the surface share corners with leaves up to four times as large, whose values stay below 16: half a
         * step of those */
        assert_true(largest > 0 && largest <= (type == DF_SAMPLE_U16 ? 2.5e-4 : 0.065));
        df_field_free(&field);
        df_field_free(&exact);
    }
}

/* The NumPy reader, which shares no code with ours, decodes the same samples of all families. */
static void numpy_decodes_the_same_octree(void **state) {
    (void)state;
    char path[] = "/tmp/df_test_quantise_XXXXXX", command[1024];
    df_field exact, field;
    df_error err;
    const uint32_t size[3] = {150, 150, 150};
    assert_int_equal(test_field_sphere(&exact, DF_FIELD_ADF, 0, size, 60.3, &err), DF_OK);
    assert_int_equal(df_quantise(&exact, DF_SAMPLE_U8, &field, &err), DF_OK);
    assert_in_range(field.exact_count, 1, field.family_count - 1);
    close(mkstemp(path));
    assert_int_equal(df_field_write(&field, path, &err), DF_OK);
    snprintf(command, sizeof command,
             "cd %s/pipelines && /usr/bin/python3 -B -c \"import read_dfield as r, sys; "
             "sys.stdout.buffer.write(r.read('%s')['samples'].tobytes())\"",
             DF_SOURCE_FOLDER, path);
    FILE *pipe = popen(command, "r");
    assert_non_null(pipe);
    for (uint32_t f = 0; f < field.family_count; f++) {
        float cell[8], is[27], read[27];
        df_adf_cell_corners(&field, f, cell);
        df_adf_samples(&field, f, cell, is);
        assert_int_equal(fread(read, sizeof(float), 27, pipe), 27);
        assert_memory_equal(read, is, sizeof is);
    }
    assert_int_equal(pclose(pipe), 0);
    unlink(path);
    df_field_free(&field);
    df_field_free(&exact);
}

/* The rounding, with and without regard to what neighbours need: within the bound on what 16 bits may add. */
static void u16_bricks_add_at_most_a_4000th_of_a_voxel(void **state) {
    (void)state;
    for (int i = 0; i < 40; i++) {
        df_field exact, field;
        df_error err;
        double scale = 1 + i / 40.0; /* steps are powers of two: over this range all relations to a voxel come up */
        assert_int_equal(test_field_from_function(&exact, DF_FIELD_BRICKS, 8, SIZE, tilted, &scale, &err), DF_OK);
        for (int a = 0; a < 3; a++) exact.voxel_size[a] = scale;
        assert_int_equal(df_quantise(&exact, DF_SAMPLE_U16, &field, &err), DF_OK);
        for (uint64_t n = 0; n < field.sample_count; n++) {
            float was = decoded(&exact, n), is = decoded(&field, n);
            if (fabsf(was) <= 3.4642f * (float)scale) assert_true(fabs((double)was - (double)is) <= 2.5e-4 * scale);
        }
        df_field_free(&field);
        df_field_free(&exact);
    }
}

/* The NumPy reader unpacks the samples of bricks of various steps. */
static void numpy_unpacks_the_same_bricks(void **state) {
    (void)state;
    char path[] = "/tmp/df_test_quantise_XXXXXX", command[1024];
    close(mkstemp(path));
    snprintf(command, sizeof command,
             "cd %s/pipelines && /usr/bin/python3 -B -c \"import read_dfield as r, sys; "
             "sys.stdout.buffer.write(r.read('%s')['samples'].tobytes())\"",
             DF_SOURCE_FOLDER, path);
    for (int type = DF_SAMPLE_U16; type <= DF_SAMPLE_U8; type++) {
        df_field exact, field;
        df_error err;
        assert_int_equal(test_field_from_function(&exact, DF_FIELD_BRICKS, 4, SIZE, wave, NULL, &err), DF_OK);
        assert_int_equal(df_quantise(&exact, (df_sample_type)type, &field, &err), DF_OK);
        int least = 127, most = -127;
        for (uint32_t b = 0; b < field.brick_count; b++) {
            least = field.brick_exponents[b] < least ? field.brick_exponents[b] : least;
            most = field.brick_exponents[b] > most ? field.brick_exponents[b] : most;
        }
        assert_true(least < most);
        assert_int_equal(df_field_write(&field, path, &err), DF_OK);
        FILE *pipe = popen(command, "r");
        assert_non_null(pipe);
        for (uint64_t i = 0; i < field.sample_count; i++) {
            float read, is = decoded(&field, i);
            assert_int_equal(fread(&read, sizeof read, 1, pipe), 1);
            assert_memory_equal(&read, &is, sizeof is);
        }
        assert_int_equal(pclose(pipe), 0);
        df_field_free(&field);
        df_field_free(&exact);
    }
    unlink(path);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(signs_and_zeros_are_kept),
        cmocka_unit_test(bricks_do_not_tear),
        cmocka_unit_test(u16_bricks_add_at_most_a_4000th_of_a_voxel),
        cmocka_unit_test(numpy_unpacks_the_same_bricks),
        cmocka_unit_test(octrees_keep_their_surface),
        cmocka_unit_test(numpy_decodes_the_same_octree),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
