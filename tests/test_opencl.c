/* OpenCL against the scalar tracers. With --full: every tracer, structure, sample type, solve and gradient with every
 * other; otherwise every pair of them. */
#include "common/memory.h"
#include "fields.h"
#include "render/devices.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"
#include "render/opencl/opencl_frame.h"
#include "tracing.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static df_opencl_info *devices;
static uint32_t device_count, device;
static bool full;

/* Bumps of about a voxel and thin walls: cells with several crossings, flat cells and every kind of neighbour. */
static double lumps(const double p[3], const void *context) {
    const double n = *(const double *)context, x = p[0] - n / 2, y = p[1] - n / 2, z = p[2] - n / 2;
    const double wave = 0.8 * sin(1.7 * p[0]) * sin(1.3 * p[1]) * sin(1.9 * p[2]);
    return fabs(sqrt(x * x + y * y + 1.2 * z * z) - 0.33 * n) - 0.9 + wave;
}

/* Rewrites f32 samples as u16 or u8, with one step for all. */
static void quantise(df_field *field, df_sample_type type) {
    const float *samples = field->samples;
    float largest = fmaxf(fabsf(field->value_min), fabsf(field->value_max));
    const int half = type == DF_SAMPLE_U16 ? 32768 : 128;
    int exponent = 0;
    while (df_power_of_two(exponent) * (float)(half - 1) > largest) exponent--;
    exponent++;
    void *quantised = calloc(field->sample_count, df_sample_size(type));
    assert_non_null(quantised);
    for (uint64_t i = 0; i < field->sample_count; i++) {
        int q = (int)lrintf(samples[i] / df_power_of_two(exponent)) + half;
        if (type == DF_SAMPLE_U16) ((uint16_t *)quantised)[i] = (uint16_t)q;
        else ((uint8_t *)quantised)[i] = (uint8_t)q;
    }
    df_field_own(field, quantised);
    field->samples = quantised;
    field->sample_type = type;
    if (field->kind == DF_FIELD_BRICKS) {
        int8_t *exponents = malloc(field->brick_count);
        assert_non_null(exponents);
        memset(exponents, exponent, field->brick_count);
        df_field_own(field, exponents);
        field->brick_exponents = exponents;
    } else {
        field->step_exponent = exponent;
    }
}

/* Codes all but the first families of an octree as residuals. */
static void quantise_octree(df_field *field, df_sample_type type) {
    const int exponent = type == DF_SAMPLE_U16 ? -12 : -5, half = type == DF_SAMPLE_U16 ? 32768 : 128;
    const uint32_t exact = 9 < field->family_count ? 9 : field->family_count, coded = field->family_count - exact;
    const size_t floats = 8 + exact * DF_FAMILY_STORED_COUNT;
    float(*wanted)[DF_FAMILY_SAMPLE_COUNT] = malloc(field->family_count * sizeof *wanted), cell[8];
    uint8_t *samples = calloc(floats + coded * DF_FAMILY_STORED_COUNT, sizeof(float));
    int8_t *exponents = malloc(coded);
    df_error err;
    assert_true(wanted && samples && exponents);
    for (uint32_t f = 0; f < field->family_count; f++) {
        df_adf_cell_corners(field, f, cell);
        df_adf_samples(field, f, cell, wanted[f]);
    }
    memcpy(samples, field->samples, floats * sizeof(float));
    memset(exponents, exponent, coded);
    df_field_own(field, samples);
    df_field_own(field, exponents);
    field->samples = samples;
    field->brick_exponents = exponents;
    field->sample_type = type;
    field->exact_count = exact;
    for (uint32_t f = exact; f < field->family_count; f++) {
        df_adf_cell_corners(field, f, cell);
        for (uint32_t s = 0; s < DF_FAMILY_SAMPLE_COUNT; s++) {
            const int slot = df_family_slot(s);
            if (slot < 0) continue;
            const size_t at = (size_t)(f - exact) * DF_FAMILY_STORED_COUNT + (size_t)slot;
            long q = lrintf((wanted[f][s] - df_family_predict(cell, s)) / df_power_of_two(exponent)) + half;
            q = q < 1 ? 1 : q > 2 * half - 1 ? 2 * half - 1 : q;
            if (type == DF_SAMPLE_U16) ((uint16_t *)(samples + floats * sizeof(float)))[at] = (uint16_t)q;
            else samples[floats * sizeof(float) + at] = (uint8_t)q;
        }
    }
    free(wanted);
    assert_int_equal(df_field_finish(field, "octree", &err), DF_OK);
}

/* A structure that a field can be walked in. */
typedef struct structure {
    df_field_kind kind;
    uint32_t brick_size;
    df_scene_options scene;
} structure;
static const structure structures[] = {
    {DF_FIELD_DENSE, 0, {1, 0}},  {DF_FIELD_DENSE, 0, {2, 8}},  {DF_FIELD_DENSE, 0, {2, 4}},
    {DF_FIELD_BRICKS, 8, {0, 0}}, {DF_FIELD_BRICKS, 4, {0, 0}}, {DF_FIELD_ADF, 0, {0, 0}},
};
enum { STRUCTURE_COUNT = sizeof structures / sizeof structures[0] };

static void make_scene(const structure *form, df_sample_type type, float iso, df_field *field, df_scene *scene) {
    const uint32_t count[3] = {37, 30, 41};
    const double n = 32;
    df_error err;
    memset(field, 0, sizeof *field);
    assert_int_equal(test_field_from_function(field, form->kind, form->brick_size, count, lumps, &n, &err), DF_OK);
    if (type != DF_SAMPLE_F32 && form->kind == DF_FIELD_ADF) quantise_octree(field, type);
    else if (type != DF_SAMPLE_F32) quantise(field, type);
    assert_int_equal(df_scene_prepare(field, iso, &form->scene, scene, &err), DF_OK);
}

static void alloc_picture(const df_view *view, df_picture *picture) {
    const uint64_t pixels = (uint64_t)view->width * view->height;
    df_error err;
    picture->width = view->width;
    picture->height = view->height;
    assert_int_equal(df_alloc((void **)&picture->rgb, pixels, 3, "rgb", &err), DF_OK);
    assert_int_equal(df_alloc((void **)&picture->depth, pixels, 4, "depth", &err), DF_OK);
    assert_int_equal(df_alloc((void **)&picture->normals, pixels, 12, "normals", &err), DF_OK);
}

static void free_picture(df_picture *picture) {
    free(picture->rgb);
    free(picture->depth);
    free(picture->normals);
}

static void assert_same_picture(const df_picture *a, const df_picture *b) {
    const size_t pixels = (size_t)a->width * a->height;
    assert_memory_equal(a->rgb, b->rgb, pixels * 3);
    assert_memory_equal(a->depth, b->depth, pixels * 4);
    assert_memory_equal(a->normals, b->normals, pixels * 12);
}

static void make_view(const df_field *field, double azimuth, double elevation, double distance, uint32_t width,
                      uint32_t height, df_view *view) {
    df_camera camera = {.fov_y = 1};
    df_error err;
    df_camera_orbit(field, azimuth, elevation, distance, &camera);
    assert_int_equal(df_view_make(&camera, field, width, height, view, &err), DF_OK);
}

static const df_tracer *scalar_tracer(const df_scene *scene) { return scene->levels ? &df_tracer_dda : &df_tracer_adf; }

static df_opencl_tracer plain_tracer(const df_scene *scene) { return scene->levels ? DF_OPENCL_DDA : DF_OPENCL_ADF; }

static void scalar_picture(const df_scene *scene, int solve, int gradient, const df_view *view, df_picture *picture,
                           df_frame_stats *stats) {
    const df_frame_options options = {
        .tracer = scalar_tracer(scene), .solve = solve, .gradient = gradient, .tile = 64, .threads = 2};
    df_renderer *renderer;
    df_error err;
    assert_int_equal(df_renderer_open(scene, &options, view->width, view->height, &renderer, &err), DF_OK);
    assert_int_equal(df_renderer_frame(renderer, view, picture, stats, &err), DF_OK);
    df_renderer_close(renderer);
}

static df_opencl_renderer *open_renderer(const df_scene *scene, df_opencl_tracer tracer, int solve, int gradient) {
    const df_opencl_options options = {.tracer = tracer, .solve = solve, .gradient = gradient, .log = stderr};
    df_opencl_renderer *renderer;
    df_error err;
    df_status status = df_opencl_renderer_open(&devices[device], scene, &options, &renderer, &err);
    if (status != DF_OK) fail_msg("%s", err.text);
    return renderer;
}

static void compare(const df_picture *expected, const df_picture *got, int solve) {
    if (solve != DF_SOLVE_ANALYTIC && devices[device].correctly_rounded) {
        assert_same_picture(expected, got);
        return;
    }
    for (size_t i = 0; i < (size_t)got->width * got->height; i++) {
        assert_int_equal(isinf(expected->depth[i]), isinf(got->depth[i]));
        if (!isinf(got->depth[i]))
            assert_true(fabsf(expected->depth[i] - got->depth[i]) <= 1e-5f + expected->depth[i] * 0x1p-22f);
    }
}

/* The scalar picture and the device's are the same bytes, by its plain tracer and by packets; for the closed form,
 * whose functions are the device's own, within 1e-5. */
static void compare_pictures(const df_scene *scene, int solve, int gradient, const df_view *view, bool packets) {
    df_picture expected = {0}, got = {0};
    df_error err;
    alloc_picture(view, &expected);
    alloc_picture(view, &got);
    scalar_picture(scene, solve, gradient, view, &expected, NULL);
    for (int way = 0; way < (packets && scene->levels ? 2 : 1); way++) {
        df_opencl_renderer *renderer = open_renderer(scene, way ? DF_OPENCL_CGT : plain_tracer(scene), solve, gradient);
        memset(got.rgb, 1, 3u * view->width * view->height);
        assert_int_equal(df_opencl_renderer_rows(renderer, view, 0, view->height, &got, NULL, &err), DF_OK);
        compare(&expected, &got, solve);
        df_opencl_renderer_close(renderer);
    }
    free_picture(&expected);
    free_picture(&got);
}

/* What a comparison combines, and the pairs of them that were seen. */
enum { BY_STRUCTURE, BY_TYPE, BY_SOLVE, BY_GRADIENT, BY_TRACER, KIND_COUNT };
static bool seen[KIND_COUNT][KIND_COUNT][8][8];

static void note_pairs(const int choice[KIND_COUNT]) {
    for (int a = 0; a < KIND_COUNT; a++) {
        for (int b = 0; b < KIND_COUNT; b++) seen[a][b][choice[a]][choice[b]] = true;
    }
}

/* One field, all the combinations that are wanted of it. */
static void compare_structure(int s, df_sample_type type) {
    df_field field;
    df_scene scene;
    df_view view;
    make_scene(&structures[s], type, 0, &field, &scene);
    make_view(&field, 30 * s, 20, 1.3, 93, 71, &view);
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        for (int gradient = 0; gradient < DF_GRADIENT_COUNT; gradient++) {
            const bool wanted =
                (solve + gradient) % STRUCTURE_COUNT == s && (solve / 2 + gradient) % 3 == (int)type - DF_SAMPLE_F32;
            const bool packets = full || (s + (int)type) % 2 == 0; /* kernels take seconds to build */
            if (!full && !wanted) continue;
            compare_pictures(&scene, solve, gradient, &view, packets);
            note_pairs((const int[]){s, (int)type - DF_SAMPLE_F32, solve, gradient, 0});
            if (packets && scene.levels) note_pairs((const int[]){s, (int)type - DF_SAMPLE_F32, solve, gradient, 1});
        }
    }
    df_scene_free(&scene);
    df_field_free(&field);
}

static void pictures_are_those_of_the_scalar_tracer(void **state) {
    (void)state;
    const int counts[KIND_COUNT] = {STRUCTURE_COUNT, 3, DF_SOLVE_COUNT, DF_GRADIENT_COUNT, 2};
    for (int s = 0; s < STRUCTURE_COUNT; s++) {
        for (df_sample_type type = DF_SAMPLE_F32; type <= DF_SAMPLE_U8; type++) compare_structure(s, type);
    }
    for (int a = 0; a < KIND_COUNT; a++) {
        for (int b = 0; b < KIND_COUNT; b++) {
            for (int i = 0; i < counts[a]; i++) {
                for (int j = 0; j < counts[b] && a != b; j++) {
                    const bool octree_of_packets = (a == BY_STRUCTURE && b == BY_TRACER && i == 5 && j == 1) ||
                                                   (b == BY_STRUCTURE && a == BY_TRACER && j == 5 && i == 1);
                    if (!octree_of_packets && !seen[a][b][i][j])
                        fail_msg("kind %d choice %d was never seen with kind %d choice %d", a, i, b, j);
                }
            }
        }
    }
}

static void cameras_inside_far_away_and_along_the_axes_see_the_same(void **state) {
    (void)state;
    const double orbits[][3] = {{30, 20, 0.1}, {30, 20, 500}, {0, 0, 2}, {90, 0, 2}, {10, 90, 3}, {200, -40, 0.45}};
    const int forms[] = {1, 3, 5};
    for (size_t f = 0; f < sizeof forms / sizeof forms[0]; f++) {
        df_field field;
        df_scene scene;
        make_scene(&structures[forms[f]], DF_SAMPLE_F32, 0, &field, &scene);
        for (size_t i = 0; i < sizeof orbits / sizeof orbits[0]; i++) {
            df_view view;
            make_view(&field, orbits[i][0], orbits[i][1], orbits[i][2], 64, 48, &view);
            compare_pictures(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CORNER_CENTRAL, &view, true);
        }
        df_scene_free(&scene);
        df_field_free(&field);
    }
}

static void gradients_from_images_are_those_from_buffers(void **state) {
    (void)state;
    for (df_sample_type type = DF_SAMPLE_F32; type <= DF_SAMPLE_U8; type++) {
        df_field field;
        df_scene scene;
        df_view view;
        df_picture expected = {0}, got = {0};
        df_opencl_renderer *renderer;
        df_error err;
        make_scene(&structures[1], type, 0, &field, &scene);
        make_view(&field, 30, 20, 1.1, 80, 60, &view);
        alloc_picture(&view, &expected);
        alloc_picture(&view, &got);
        for (int gradient = type == DF_SAMPLE_F32 || full ? 0 : DF_GRADIENT_COUNT - 1; gradient < DF_GRADIENT_COUNT;
             gradient++) {
            const df_opencl_options options = {
                .solve = DF_SOLVE_ROBUST, .gradient = gradient, .images = true, .log = stderr};
            df_status status = df_opencl_renderer_open(&devices[device], &scene, &options, &renderer, &err);
            if (status == DF_ERROR_UNSUPPORTED && strstr(err.text, "images")) {
                printf("no images: %s\n", err.text);
                break;
            }
            if (status != DF_OK) fail_msg("%s", err.text);
            scalar_picture(&scene, DF_SOLVE_ROBUST, gradient, &view, &expected, NULL);
            assert_int_equal(df_opencl_renderer_rows(renderer, &view, 0, view.height, &got, NULL, &err), DF_OK);
            if (devices[device].correctly_rounded) assert_same_picture(&expected, &got);
            df_opencl_renderer_close(renderer);
        }
        free_picture(&expected);
        free_picture(&got);
        df_scene_free(&scene);
        df_field_free(&field);
    }
}

static void images_are_refused_where_there_are_none(void **state) {
    (void)state;
    df_opencl_info info = devices[device];
    const df_opencl_options options = {.solve = DF_SOLVE_ROBUST, .images = true};
    df_opencl_renderer *renderer;
    df_field field;
    df_scene scene;
    df_error err;
    make_scene(&structures[1], DF_SAMPLE_F32, 0, &field, &scene);
    info.images = true;
    info.image3d_max[0] = info.image3d_max[1] = info.image3d_max[2] = 38;
    assert_int_equal(df_opencl_renderer_open(&info, &scene, &options, &renderer, &err), DF_ERROR_UNSUPPORTED);
    assert_non_null(strstr(err.text, "at most 38x38x38"));
    info.images = false;
    assert_int_equal(df_opencl_renderer_open(&info, &scene, &options, &renderer, &err), DF_ERROR_UNSUPPORTED);
    df_scene_free(&scene);
    df_field_free(&field);
    make_scene(&structures[3], DF_SAMPLE_F32, 0, &field, &scene);
    assert_int_equal(df_opencl_renderer_open(&devices[device], &scene, &options, &renderer, &err), DF_ERROR_USAGE);
    df_scene_free(&scene);
    df_field_free(&field);
}

static void iso_and_voxel_shapes_go_to_the_device(void **state) {
    (void)state;
    df_field field;
    df_scene scene;
    df_view view;
    df_error err;
    make_scene(&structures[1], DF_SAMPLE_F32, 0, &field, &scene);
    df_scene_free(&scene);
    field.voxel_size[0] = 0.5;
    field.voxel_size[2] = 4;
    assert_int_equal(df_scene_prepare(&field, 0.25f, &structures[1].scene, &scene, &err), DF_OK);
    make_view(&field, 50, 30, 1.2, 100, 60, &view);
    compare_pictures(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL, &view, true);
    df_scene_free(&scene);
    df_field_free(&field);
}

static void strips_of_rows_make_the_picture_and_counts_are_equal(void **state) {
    (void)state;
    df_field field;
    df_scene scene;
    df_view view;
    df_picture expected = {0}, got = {0};
    df_frame_stats stats;
    df_counters counters;
    df_opencl_times times;
    uint64_t hitting;
    df_error err;
    make_scene(&structures[3], DF_SAMPLE_F32, 0, &field, &scene);
    make_view(&field, 30, 20, 1.3, 101, 83, &view);
    alloc_picture(&view, &expected);
    alloc_picture(&view, &got);
    scalar_picture(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL, &view, &expected, &stats);
    df_opencl_renderer *renderer = open_renderer(&scene, DF_OPENCL_DDA, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL);
    const uint32_t cuts[] = {0, 0, 1, 9, 50, 83, 83};
    for (size_t i = 0; i + 1 < sizeof cuts / sizeof cuts[0]; i++) {
        assert_int_equal(df_opencl_renderer_rows(renderer, &view, cuts[i], cuts[i + 1] - cuts[i], &got, &times, &err),
                         DF_OK);
        assert_true(cuts[i] == cuts[i + 1] ||
                    (times.trace_ms > 0 && times.shade_ms > 0 && times.host_end_ms > times.host_start_ms));
    }
    assert_same_picture(&expected, &got);
    assert_int_equal(df_opencl_renderer_count(renderer, &view, &hitting, &counters, &err), DF_OK);
    assert_int_equal(hitting, stats.rays_hitting);
    assert_int_equal(counters.coarse_steps, stats.counters.coarse_steps);
    assert_int_equal(counters.fine_steps, stats.counters.fine_steps);
    assert_int_equal(counters.cells_tested, stats.counters.cells_tested);
    df_opencl_renderer_close(renderer);
    free_picture(&expected);
    free_picture(&got);
    df_scene_free(&scene);
    df_field_free(&field);
}

static void bounds_change_no_hit_and_save_steps(void **state) {
    (void)state;
    const double orbits[][3] = {{30, 20, 1.3}, {30, 20, 500}, {200, -40, 0.45}};
    const int forms[] = {0, 2, 3};
    for (int way = 0; way < 12; way++) {
        const int bounds = way & 1 ? DF_BOUNDS_VOXELS : DF_BOUNDS_BRICKS;
        const df_opencl_options options = {.tracer = way & 2 ? DF_OPENCL_CGT : DF_OPENCL_DDA,
                                           .solve = DF_SOLVE_ROBUST,
                                           .gradient = DF_GRADIENT_CENTRAL,
                                           .bounds = bounds,
                                           .threads = 2,
                                           .log = stderr};
        df_field field;
        df_scene scene;
        df_opencl_renderer *renderer;
        df_error err;
        make_scene(&structures[forms[way / 4]], DF_SAMPLE_F32, 0, &field, &scene);
        df_status status = df_opencl_renderer_open(&devices[device], &scene, &options, &renderer, &err);
        if (status != DF_OK) fail_msg("%s", err.text);
        for (int i = 0; i < 3; i++) {
            df_view view;
            df_picture expected = {0}, got = {0};
            df_frame_stats whole;
            df_counters counters;
            uint64_t hitting;
            make_view(&field, orbits[i][0], orbits[i][1], orbits[i][2], 93, 71, &view);
            alloc_picture(&view, &expected);
            alloc_picture(&view, &got);
            scalar_picture(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL, &view, &expected, &whole);
            assert_int_equal(df_opencl_renderer_rows(renderer, &view, 0, 13, &got, NULL, &err), DF_OK);
            assert_int_equal(df_opencl_renderer_rows(renderer, &view, 13, view.height - 13, &got, NULL, &err), DF_OK);
            compare(&expected, &got, DF_SOLVE_ROBUST);
            assert_int_equal(df_opencl_renderer_count(renderer, &view, &hitting, &counters, &err), DF_OK);
            assert_int_equal(hitting, whole.rays_hitting);
            if (options.tracer == DF_OPENCL_DDA && i == 0)
                assert_true(counters.coarse_steps + counters.fine_steps <
                            (whole.counters.coarse_steps + whole.counters.fine_steps) * 9 / 10);
            free_picture(&expected);
            free_picture(&got);
        }
        df_opencl_renderer_close(renderer);
        df_scene_free(&scene);
        df_field_free(&field);
    }
}

static void arbitrary_rays_hit_what_the_scalar_tracer_hits(void **state) {
    (void)state;
    enum { COUNT = 20001 };
    double *origins = malloc(COUNT * 3 * sizeof *origins), *directions = malloc(COUNT * 3 * sizeof *directions);
    test_hit *expected = malloc(COUNT * sizeof *expected);
    assert_true(origins && directions && expected);
    for (int s = 0; s < STRUCTURE_COUNT; s++) {
        df_field field;
        df_scene scene;
        df_rays rays;
        df_hits hits;
        df_error err;
        make_scene(&structures[s], DF_SAMPLE_F32, 0, &field, &scene);
        const double box[3] = {scene.voxel_count[0], scene.voxel_count[1], scene.voxel_count[2]};
        test_random_rays(COUNT, 77 + (uint64_t)s, box, origins, directions);
        assert_int_equal(test_trace(scalar_tracer(&scene), &df_kernels_scalar, &scene, DF_SOLVE_ROBUST, 0,
                                    DF_PRECISION_F64, origins, directions, COUNT, &rays, expected, &err),
                         DF_OK);
        df_opencl_renderer *renderer =
            open_renderer(&scene, plain_tracer(&scene), DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL);
        assert_int_equal(df_hits_alloc(COUNT, &hits, &err), DF_OK);
        assert_int_equal(df_opencl_renderer_trace(renderer, &rays, &hits, NULL, &err), DF_OK);
        uint32_t h = 0;
        for (uint32_t i = 0; i < COUNT; i++) {
            test_hit got = {0};
            if (h < hits.count && hits.ray[h] == i) {
                got.hit = true;
                got.flags = hits.flags[h];
                got.t = hits.t[h];
                for (int a = 0; a < 3; a++) {
                    got.cell[a] = hits.cell[a][h];
                    got.local[a] = hits.local[a][h];
                }
                h++;
            }
            assert_true(test_same_hit(&expected[i], &got));
        }
        assert_int_equal(h, hits.count);
        assert_true(h > COUNT / 20);
        df_opencl_renderer_close(renderer);
        df_hits_free(&hits);
        df_rays_free(&rays);
        df_scene_free(&scene);
        df_field_free(&field);
    }
    free(origins);
    free(directions);
    free(expected);
}

static void a_field_that_is_too_large_is_refused_with_what_would_fit(void **state) {
    (void)state;
    df_field field;
    df_scene scene;
    df_error err;
    make_scene(&structures[1], DF_SAMPLE_F32, 0, &field, &scene);
    const uint64_t samples = field.sample_count;
    assert_int_equal(df_opencl_fits(&scene, samples * 4, 1 << 30, "a device", &err), DF_OK);
    assert_int_equal(df_opencl_fits(&scene, samples * 4 - 1, 1 << 30, "a device", &err), DF_ERROR_MEMORY);
    assert_non_null(strstr(err.text, "a device"));
    assert_non_null(strstr(err.text, "dense u16"));
    assert_non_null(strstr(err.text, "bricks of u8"));
    assert_null(strstr(err.text, "dense f32"));
    assert_int_equal(df_opencl_fits(&scene, samples * 4, samples * 4, "a device", &err), DF_ERROR_MEMORY);
    assert_int_equal(df_opencl_fits(&scene, 10, 10, "a device", &err), DF_ERROR_MEMORY);
    assert_non_null(strstr(err.text, "lower resolution"));
    df_scene_free(&scene);
    df_field_free(&field);
}

static void a_kernel_that_does_not_build_names_its_file_and_line(void **state) {
    (void)state;
    df_opencl opened;
    df_error err;
    char *log = NULL;
    size_t log_size;
    FILE *stream = open_memstream(&log, &log_size);
    assert_int_equal(df_opencl_open(&devices[device], &opened, &err), DF_OK);
    assert_int_equal(df_opencl_build_source(&opened,
                                            "#line 41 \"render/opencl/wrong.cl\"\n__kernel void f() { nothing(; }\n",
                                            "", stream, &err),
                     DF_ERROR_UNSUPPORTED);
    fclose(stream);
    assert_non_null(strstr(err.text, "wrong.cl:41"));
    assert_non_null(strstr(err.text, "CL_BUILD_PROGRAM_FAILURE"));
    assert_non_null(strstr(log, "wrong.cl:41"));
    free(log);
    df_opencl_close(&opened);
}

static void work_groups_of_any_shape_make_the_same_picture_or_are_refused(void **state) {
    (void)state;
    const uint32_t groups[][2] = {{1, 1}, {64, 1}, {3, 5}, {1u << 16, 1u << 10}};
    df_field field;
    df_scene scene;
    df_view view;
    df_picture expected = {0}, got = {0};
    df_error err;
    make_scene(&structures[3], DF_SAMPLE_F32, 0, &field, &scene);
    make_view(&field, 30, 20, 1.3, 50, 40, &view);
    alloc_picture(&view, &expected);
    alloc_picture(&view, &got);
    scalar_picture(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL, &view, &expected, NULL);
    for (int i = 0; i < 8; i++) {
        const df_opencl_options options = {.tracer = i < 4 ? DF_OPENCL_DDA : DF_OPENCL_CGT,
                                           .solve = DF_SOLVE_ROBUST,
                                           .gradient = DF_GRADIENT_CENTRAL,
                                           .group = {groups[i % 4][0], groups[i % 4][1]},
                                           .log = stderr};
        df_opencl_renderer *renderer;
        df_status status = df_opencl_renderer_open(&devices[device], &scene, &options, &renderer, &err);
        assert_int_equal(status, i % 4 < 3 ? DF_OK : DF_ERROR_UNSUPPORTED);
        if (status != DF_OK) continue;
        assert_int_equal(df_opencl_renderer_rows(renderer, &view, 0, view.height, &got, NULL, &err), DF_OK);
        if (devices[device].correctly_rounded) assert_same_picture(&expected, &got);
        df_opencl_renderer_close(renderer);
    }
    free_picture(&expected);
    free_picture(&got);
    df_scene_free(&scene);
    df_field_free(&field);
}

/* ---- calls that fail ---- */

static cl_int fail_launch(cl_command_queue queue, cl_kernel kernel, cl_uint dimensions, const size_t *offset,
                          const size_t *global, const size_t *local, cl_uint wait_count, const cl_event *wait,
                          cl_event *event) {
    (void)queue, (void)kernel, (void)dimensions, (void)offset, (void)global, (void)local, (void)wait_count, (void)wait,
        (void)event;
    return CL_OUT_OF_RESOURCES;
}
static cl_int (*real_finish)(cl_command_queue);
static cl_int fail_finish(cl_command_queue queue) {
    real_finish(queue); /* a device that is lost writes no more */
    return CL_DEVICE_NOT_AVAILABLE;
}
static cl_int fail_read(cl_command_queue queue, cl_mem memory, cl_bool blocking, size_t offset, size_t size, void *data,
                        cl_uint wait_count, const cl_event *wait, cl_event *event) {
    (void)queue, (void)memory, (void)blocking, (void)offset, (void)size, (void)data, (void)wait_count, (void)wait,
        (void)event;
    return CL_OUT_OF_HOST_MEMORY;
}
static cl_mem fail_buffer(cl_context context, cl_mem_flags flags, size_t size, void *data, cl_int *code) {
    (void)context, (void)flags, (void)size, (void)data;
    *code = CL_MEM_OBJECT_ALLOCATION_FAILURE;
    return NULL;
}
static cl_context fail_context(const cl_context_properties *properties, cl_uint count, const cl_device_id *ids,
                               void(CL_CALLBACK *notify)(const char *, const void *, size_t, void *), void *data,
                               cl_int *code) {
    (void)properties, (void)count, (void)ids, (void)notify, (void)data;
    *code = CL_DEVICE_NOT_AVAILABLE;
    return NULL;
}

static cl_int fail_build(cl_program program, cl_uint count, const cl_device_id *ids, const char *options,
                         void(CL_CALLBACK *notify)(cl_program, void *), void *data) {
    (void)program, (void)count, (void)ids, (void)options, (void)notify, (void)data;
    return CL_BUILD_PROGRAM_FAILURE;
}
/* A transfer that fails although it has made an event, and times that cannot be had. */
static int events_made, events_released;
static cl_int (*real_write_image)(cl_command_queue, cl_mem, cl_bool, const size_t *, const size_t *, size_t, size_t,
                                  const void *, cl_uint, const cl_event *, cl_event *);
static cl_int write_image_result;
static cl_int write_image_and_fail(cl_command_queue queue, cl_mem image, cl_bool blocking, const size_t *origin,
                                   const size_t *region, size_t row, size_t slice, const void *data, cl_uint wait_count,
                                   const cl_event *wait, cl_event *event) {
    if (real_write_image(queue, image, blocking, origin, region, row, slice, data, wait_count, wait, event) !=
        CL_SUCCESS)
        return CL_INVALID_VALUE;
    events_made++;
    return write_image_result;
}
static cl_int (*real_release_event)(cl_event);
static cl_int count_release(cl_event event) {
    events_released++;
    return real_release_event(event);
}
static cl_int fail_profiling(cl_event event, cl_profiling_info what, size_t size, void *value, size_t *used) {
    (void)event, (void)what, (void)size, (void)value, (void)used;
    return CL_PROFILING_INFO_NOT_AVAILABLE;
}
static cl_int no_platforms(cl_uint room, cl_platform_id *platforms, cl_uint *count) {
    (void)room, (void)platforms;
    *count = 0;
    return -1001; /* CL_PLATFORM_NOT_FOUND_KHR */
}
static cl_int no_devices(cl_platform_id platform, cl_device_type type, cl_uint room, cl_device_id *ids,
                         cl_uint *count) {
    (void)platform, (void)type, (void)room, (void)ids, (void)count;
    return CL_DEVICE_NOT_FOUND;
}
static cl_int (*device_info)(cl_device_id, cl_device_info, size_t, void *, size_t *);
static cl_int info_of_a_gpu(cl_device_id id, cl_device_info what, size_t size, void *value, size_t *used) {
    const cl_int code = device_info(id, what, size, value, used);
    if (what == CL_DEVICE_TYPE && value) *(cl_device_type *)value = CL_DEVICE_TYPE_GPU;
    return code;
}

static void machines_without_platforms_or_devices_are_told_apart(void **state) {
    (void)state;
    const df_opencl_api *loaded;
    df_opencl_info *list;
    uint32_t count, number;
    df_error err;
    assert_int_equal(df_opencl_load(&loaded, &err), DF_OK);
    df_opencl_api *api = (df_opencl_api *)(uintptr_t)loaded; /* the table is ours to bend here */
    const df_opencl_api whole = *api;
    api->GetPlatformIDs = no_platforms;
    assert_int_equal(df_opencl_find(&list, &count, &err), DF_OK);
    assert_int_equal(count, 0);
    assert_int_equal(df_opencl_choose(list, count, DF_OPENCL_ANY, false, &number, &err), DF_ERROR_UNSUPPORTED);
    assert_non_null(strstr(err.text, "no device"));
    *api = whole;
    api->GetDeviceIDs = no_devices;
    assert_int_equal(df_opencl_find(&list, &count, &err), DF_ERROR_UNSUPPORTED);
    assert_non_null(strstr(err.text, "CL_DEVICE_NOT_FOUND"));
    *api = whole;
}

static void calls_that_fail_end_in_one_line_that_names_them(void **state) {
    (void)state;
    const df_opencl_api *loaded;
    df_field field;
    df_scene scene;
    df_view view;
    df_picture picture = {0};
    df_error err;
    assert_int_equal(df_opencl_load(&loaded, &err), DF_OK);
    df_opencl_api *api = (df_opencl_api *)(uintptr_t)loaded; /* the table is ours to bend here */
    const df_opencl_api whole = *api;
    const df_opencl_options options = {.solve = DF_SOLVE_ROBUST, .gradient = DF_GRADIENT_CENTRAL};
    make_scene(&structures[3], DF_SAMPLE_F32, 0, &field, &scene);
    make_view(&field, 30, 20, 1.3, 50, 40, &view);
    alloc_picture(&view, &picture);
    df_opencl_renderer *renderer = open_renderer(&scene, DF_OPENCL_DDA, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL), *other;

    api->EnqueueNDRangeKernel = fail_launch;
    assert_int_equal(df_opencl_renderer_rows(renderer, &view, 0, view.height, &picture, NULL, &err),
                     DF_ERROR_UNSUPPORTED);
    assert_non_null(strstr(err.text, "clEnqueueNDRangeKernel failed with CL_OUT_OF_RESOURCES"));
    *api = whole;
    real_finish = whole.Finish;
    api->Finish = fail_finish;
    assert_int_equal(df_opencl_renderer_rows(renderer, &view, 0, view.height, &picture, NULL, &err),
                     DF_ERROR_UNSUPPORTED);
    assert_non_null(strstr(err.text, "clFinish failed with CL_DEVICE_NOT_AVAILABLE"));
    *api = whole;
    api->EnqueueReadBuffer = fail_read;
    assert_int_equal(df_opencl_renderer_rows(renderer, &view, 0, view.height, &picture, NULL, &err), DF_ERROR_MEMORY);
    *api = whole;
    assert_int_equal(df_opencl_renderer_rows(renderer, &view, 0, view.height, &picture, NULL, &err),
                     DF_OK); /* and works again */
    api->CreateBuffer = fail_buffer;
    assert_int_equal(df_opencl_renderer_open(&devices[device], &scene, &options, &other, &err), DF_ERROR_MEMORY);
    assert_non_null(strstr(err.text, "CL_MEM_OBJECT_ALLOCATION_FAILURE"));
    assert_null(other);
    *api = whole;
    api->BuildProgram = fail_build;
    assert_int_equal(df_opencl_renderer_open(&devices[device], &scene, &options, &other, &err), DF_ERROR_UNSUPPORTED);
    assert_non_null(strstr(err.text, "CL_BUILD_PROGRAM_FAILURE"));
    assert_null(other);
    *api = whole;
    api->CreateContext = fail_context;
    assert_int_equal(df_opencl_renderer_open(&devices[device], &scene, &options, &other, &err), DF_ERROR_UNSUPPORTED);
    assert_null(other);
    *api = whole;
    df_opencl_renderer_close(renderer);
    free_picture(&picture);
    df_scene_free(&scene);
    df_field_free(&field);
}

static void the_event_of_an_image_is_released_whatever_fails(void **state) {
    (void)state;
    const df_opencl_api *loaded;
    df_field field;
    df_scene scene;
    df_error err;
    df_opencl_renderer *renderer;
    if (!devices[device].images) skip();
    assert_int_equal(df_opencl_load(&loaded, &err), DF_OK);
    df_opencl_api *api = (df_opencl_api *)(uintptr_t)loaded;
    const df_opencl_api whole = *api;
    const df_opencl_options options = {.solve = DF_SOLVE_ROBUST, .gradient = DF_GRADIENT_CENTRAL, .images = true};
    make_scene(&structures[0], DF_SAMPLE_F32, 0, &field, &scene);
    real_write_image = whole.EnqueueWriteImage;
    real_release_event = whole.ReleaseEvent;
    for (int fault = 0; fault < 2; fault++) {
        events_made = events_released = 0;
        write_image_result = fault == 0 ? CL_OUT_OF_RESOURCES : CL_SUCCESS;
        api->EnqueueWriteImage = write_image_and_fail;
        api->ReleaseEvent = count_release;
        if (fault == 1) api->GetEventProfilingInfo = fail_profiling;
        assert_int_equal(df_opencl_renderer_open(&devices[device], &scene, &options, &renderer, &err),
                         DF_ERROR_UNSUPPORTED);
        *api = whole;
        assert_non_null(strstr(err.text, fault == 0 ? "clEnqueueWriteImage failed with CL_OUT_OF_RESOURCES"
                                                    : "clGetEventProfilingInfo failed with"));
        assert_null(renderer);
        assert_true(events_made > 0);
        assert_true(events_released >= events_made); /* those of buffers, where memory is not shared, count too */
    }
    df_scene_free(&scene);
    df_field_free(&field);
}

/* ---- several devices ---- */

static df_devices *open_devices(const char *names, const df_scene *scene, const df_view *view, FILE *messages) {
    const df_frame_options frame = {
        .tracer = &df_tracer_dda, .solve = DF_SOLVE_ROBUST, .gradient = DF_GRADIENT_CENTRAL, .tile = 16, .threads = 1};
    df_devices_options options = {.messages = messages, .program = "test"};
    df_devices *opened;
    df_error err;
    assert_int_equal(df_devices_parse(names, &options.choice, &err), DF_OK);
    df_status status = df_devices_open(&options, scene, &frame, view->width, view->height, &opened, &err);
    if (status != DF_OK) fail_msg("%s", err.text);
    return opened;
}

static void device_lists_are_parsed(void **state) {
    (void)state;
    df_device_choice choice;
    df_error err;
    assert_int_equal(df_devices_parse("both", &choice, &err), DF_OK);
    assert_int_equal(choice.count, 2);
    assert_int_equal(df_devices_parse("opencl:3,cpu,opencl:1", &choice, &err), DF_OK);
    assert_int_equal(choice.count, 3);
    assert_int_equal(choice.numbers[0], 3);
    assert_int_equal(choice.numbers[1], DF_DEVICE_CPU);
    assert_int_equal(df_devices_parse("auto", &choice, &err), DF_OK);
    assert_true(choice.automatic);
    const char *const wrong[] = {
        "",        "gpu",      "cpu,cpu",
        "opencl:", "opencl:x", "opencl:-1",
        "cpu,",    "both,cpu", "opencl,opencl,opencl,opencl,opencl,opencl,opencl,opencl,opencl"};
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_int_equal(df_devices_parse(wrong[i], &choice, &err), DF_ERROR_USAGE);
    }
}

static void devices_share_a_picture_and_the_rows_follow_their_speeds(void **state) {
    (void)state;
    const char *const names[] = {"both", "opencl,opencl", "cpu,opencl,opencl", "cpu"};
    df_field field;
    df_scene scene;
    df_view view;
    df_picture expected = {0}, got = {0};
    df_error err;
    make_scene(&structures[3], DF_SAMPLE_F32, 0, &field, &scene);
    make_view(&field, 30, 20, 1.3, 120, 101, &view);
    alloc_picture(&view, &expected);
    alloc_picture(&view, &got);
    scalar_picture(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL, &view, &expected, NULL);
    for (size_t n = 0; n < sizeof names / sizeof names[0]; n++) {
        df_devices *opened = open_devices(names[n], &scene, &view, NULL);
        for (int frame = 0; frame < 6; frame++) {
            df_device_report reports[DF_DEVICE_MAX];
            df_frame_stats stats;
            uint32_t rows = 0;
            memset(got.rgb, 1, 3u * view.width * view.height);
            assert_int_equal(df_devices_frame(opened, &view, &got, &stats, &err), DF_OK);
            if (devices[device].correctly_rounded) assert_same_picture(&expected, &got);
            const uint32_t parts = df_devices_report(opened, reports);
            for (uint32_t i = 0; i < parts; i++) {
                rows += reports[i].rows;
                assert_true(reports[i].rows > 0);
            }
            assert_int_equal(rows, view.height);
            assert_int_equal(stats.rays_cast, view.width * view.height);
        }
        df_devices_close(opened);
    }
    view.height = 3; /* fewer rows than groups of rows */
    expected.height = got.height = 3;
    df_devices *opened = open_devices("both", &scene, &view, NULL);
    assert_int_equal(df_devices_frame(opened, &view, &got, NULL, &err), DF_OK);
    if (devices[device].correctly_rounded) assert_same_picture(&expected, &got);
    df_devices_close(opened);
    free_picture(&expected);
    free_picture(&got);
    df_scene_free(&scene);
    df_field_free(&field);
}

static void devices_take_frames_in_turn(void **state) {
    (void)state;
    enum { COUNT = 9 };
    df_field field;
    df_scene scene;
    df_view views[COUNT];
    df_picture expected = {0}, got[3] = {{0}};
    df_frame_stats stats;
    uint32_t makers[COUNT];
    df_error err;
    make_scene(&structures[3], DF_SAMPLE_F32, 0, &field, &scene);
    for (int i = 0; i < COUNT; i++) make_view(&field, 40 * i, 20, 1.3, 60, 41, &views[i]);
    alloc_picture(&views[0], &expected);
    for (int i = 0; i < 3; i++) alloc_picture(&views[0], &got[i]);
    df_devices *opened = open_devices("cpu,opencl,opencl", &scene, &views[0], NULL);
    assert_int_equal(df_devices_parts(opened), 3);
    memset(makers, 9, sizeof makers);
    assert_int_equal(df_devices_frames(opened, views, COUNT, got, makers, &stats, &err), DF_OK);
    assert_int_equal(stats.rays_cast, COUNT * 60 * 41);
    for (int last[3] = {-1, -1, -1}, i = 0; i < COUNT; i++) {
        assert_true(makers[i] < 3);
        last[makers[i]] = i;
        for (int part = 0; part < 3 && i == COUNT - 1; part++) {
            if (last[part] < 0) continue;
            scalar_picture(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL, &views[last[part]], &expected, NULL);
            compare(&expected, &got[part], DF_SOLVE_ROBUST);
        }
    }
    df_devices_close(opened);
    free_picture(&expected);
    for (int i = 0; i < 3; i++) free_picture(&got[i]);
    df_scene_free(&scene);
    df_field_free(&field);
}

static void rows_settle_where_all_parts_take_the_same_time(void **state) {
    (void)state;
    const double ms_a_row[] = {1.0, 3.0}; /* the second part is three times slower */
    double shares[] = {0.5, 0.5};
    uint32_t rows[2] = {0};
    for (int frame = 0; frame < 8; frame++) {
        double ms[2];
        df_devices_divide(shares, 2, 1024, rows);
        assert_int_equal(rows[0] + rows[1], 1024);
        for (int i = 0; i < 2; i++) ms[i] = rows[i] * ms_a_row[i];
        df_devices_learn(rows, ms, 2, shares);
    }
    assert_in_range(rows[0], 760, 776);
    df_devices_divide((const double[]){0, 1}, 2, 64, rows); /* every part keeps a group */
    assert_int_equal(rows[0], 8);
    df_devices_divide((const double[]){1, 0}, 2, 64, rows);
    assert_int_equal(rows[1], 8);
    df_devices_divide((const double[]){0.5, 0.5}, 2, 5, rows);
    assert_int_equal(rows[0] + rows[1], 5);
}

static void auto_falls_back_to_the_cpu_and_says_so_once(void **state) {
    (void)state;
    char *messages = NULL;
    size_t size;
    FILE *stream = open_memstream(&messages, &size);
    const df_opencl_api *loaded;
    df_field field;
    df_scene scene;
    df_view view;
    df_picture expected = {0}, got = {0};
    df_error err;
    assert_int_equal(df_opencl_load(&loaded, &err), DF_OK);
    df_opencl_api *api = (df_opencl_api *)(uintptr_t)loaded;
    const df_opencl_api whole = *api;
    make_scene(&structures[3], DF_SAMPLE_F32, 0, &field, &scene);
    make_view(&field, 30, 20, 1.3, 60, 40, &view);
    alloc_picture(&view, &expected);
    alloc_picture(&view, &got);
    scalar_picture(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL, &view, &expected, NULL);
    df_devices *opened = open_devices("auto", &scene, &view, stream); /* without a GPU it falls back here, */
    api->EnqueueNDRangeKernel = fail_launch;                          /* with one when it is lost */
    for (int frame = 0; frame < 2; frame++) {
        assert_int_equal(df_devices_frame(opened, &view, &got, NULL, &err), DF_OK);
        assert_same_picture(&expected, &got);
    }
    *api = whole;
    df_devices_close(opened);
    fclose(stream);
    const char *first = strstr(messages, "the CPU takes over\n");
    assert_non_null(first);
    assert_null(strstr(first + 1, "the CPU takes over"));
    free(messages);
    free_picture(&expected);
    free_picture(&got);
    df_scene_free(&scene);
    df_field_free(&field);
}

static void a_gpu_that_is_lost_in_mid_run_leaves_the_picture_to_the_cpu(void **state) {
    (void)state;
    char *messages = NULL;
    size_t size;
    FILE *stream = open_memstream(&messages, &size);
    const df_opencl_api *loaded;
    df_field field;
    df_scene scene;
    df_view view;
    df_picture expected = {0}, got = {0};
    df_device_report reports[DF_DEVICE_MAX];
    df_error err;
    assert_int_equal(df_opencl_load(&loaded, &err), DF_OK);
    df_opencl_api *api = (df_opencl_api *)(uintptr_t)loaded;
    const df_opencl_api whole = *api;
    make_scene(&structures[3], DF_SAMPLE_F32, 0, &field, &scene);
    make_view(&field, 30, 20, 1.3, 60, 40, &view);
    alloc_picture(&view, &expected);
    alloc_picture(&view, &got);
    scalar_picture(&scene, DF_SOLVE_ROBUST, DF_GRADIENT_CENTRAL, &view, &expected, NULL);
    device_info = whole.GetDeviceInfo;
    real_finish = whole.Finish;
    api->GetDeviceInfo = info_of_a_gpu;
    df_devices *opened = open_devices("auto", &scene, &view, stream);
    for (int frame = 0; frame < 4; frame++) { /* two by the device, which is lost in the third */
        if (frame == 2) api->Finish = fail_finish;
        memset(got.rgb, 1, 3u * view.width * view.height);
        assert_int_equal(df_devices_frame(opened, &view, &got, NULL, &err), DF_OK);
        assert_int_equal(df_devices_report(opened, reports), 1);
        assert_true((strncmp(reports[0].name, "opencl", 6) == 0) == (frame < 2));
        if (frame >= 2 || devices[device].correctly_rounded) assert_same_picture(&expected, &got);
    }
    *api = whole;
    df_devices_close(opened);
    fclose(stream);
    assert_non_null(strstr(messages, "clFinish failed with CL_DEVICE_NOT_AVAILABLE"));
    const char *first = strstr(messages, "the CPU takes over\n");
    assert_true(first && !strstr(first + 1, "the CPU takes over"));
    free(messages);
    free_picture(&expected);
    free_picture(&got);
    df_scene_free(&scene);
    df_field_free(&field);
}

static void devices_are_chosen_by_number_or_kind(void **state) {
    (void)state;
    const df_opencl_info list[] = {
        {.type = CL_DEVICE_TYPE_CPU, .name = "cpu", .fp64 = true, .compiler = true},
        {.type = CL_DEVICE_TYPE_GPU, .name = "old gpu", .fp64 = false, .compiler = true},
        {.type = CL_DEVICE_TYPE_GPU, .name = "gpu", .fp64 = true, .compiler = true},
    };
    uint32_t number;
    df_error err;
    assert_int_equal(df_opencl_choose(list, 3, DF_OPENCL_ANY, false, &number, &err), DF_OK);
    assert_int_equal(number, 2);
    assert_int_equal(df_opencl_choose(list, 1, DF_OPENCL_ANY, false, &number, &err), DF_OK);
    assert_int_equal(number, 0);
    assert_int_equal(df_opencl_choose(list, 1, DF_OPENCL_ANY, true, &number, &err), DF_ERROR_UNSUPPORTED);
    assert_int_equal(df_opencl_choose(list, 3, 1, false, &number, &err), DF_ERROR_UNSUPPORTED);
    assert_non_null(strstr(err.text, "double precision"));
    assert_int_equal(df_opencl_choose(list, 3, 3, false, &number, &err), DF_ERROR_UNSUPPORTED);
    assert_int_equal(df_opencl_choose(NULL, 0, DF_OPENCL_ANY, false, &number, &err), DF_ERROR_UNSUPPORTED);
}

int main(int argc, char **argv) {
    df_error err = {0};
    full = argc > 1 && strcmp(argv[1], "--full") == 0;
    if (df_opencl_find(&devices, &device_count, &err) != DF_OK ||
        df_opencl_choose(devices, device_count, DF_OPENCL_ANY, false, &device, &err) != DF_OK) {
        printf("skipped: %s\n", err.text);
        return 77;
    }
    df_opencl_print(stdout, device, &devices[device]);
    printf("\n");
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(devices_are_chosen_by_number_or_kind),
        cmocka_unit_test(a_kernel_that_does_not_build_names_its_file_and_line),
        cmocka_unit_test(a_field_that_is_too_large_is_refused_with_what_would_fit),
        cmocka_unit_test(strips_of_rows_make_the_picture_and_counts_are_equal),
        cmocka_unit_test(pictures_are_those_of_the_scalar_tracer),
        cmocka_unit_test(cameras_inside_far_away_and_along_the_axes_see_the_same),
        cmocka_unit_test(gradients_from_images_are_those_from_buffers),
        cmocka_unit_test(images_are_refused_where_there_are_none),
        cmocka_unit_test(iso_and_voxel_shapes_go_to_the_device),
        cmocka_unit_test(bounds_change_no_hit_and_save_steps),
        cmocka_unit_test(arbitrary_rays_hit_what_the_scalar_tracer_hits),
        cmocka_unit_test(work_groups_of_any_shape_make_the_same_picture_or_are_refused),
        cmocka_unit_test(calls_that_fail_end_in_one_line_that_names_them),
        cmocka_unit_test(the_event_of_an_image_is_released_whatever_fails),
        cmocka_unit_test(machines_without_platforms_or_devices_are_told_apart),
        cmocka_unit_test(a_gpu_that_is_lost_in_mid_run_leaves_the_picture_to_the_cpu),
        cmocka_unit_test(device_lists_are_parsed),
        cmocka_unit_test(rows_settle_where_all_parts_take_the_same_time),
        cmocka_unit_test(devices_share_a_picture_and_the_rows_follow_their_speeds),
        cmocka_unit_test(devices_take_frames_in_turn),
        cmocka_unit_test(auto_falls_back_to_the_cpu_and_says_so_once),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    free(devices);
    return failed;
}
