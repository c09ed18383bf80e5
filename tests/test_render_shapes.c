/* Analytic shapes through the tracers: what is hit, what is missed, and that structures agree to the bit. */
#include "fields.h"
#include "render/frame.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"
#include "tracing.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define RAYS 60000u

/* A field in several structures: dense uniform, dense with two levels, bricks, a full octree. */
typedef struct variant {
    df_field_kind kind;
    uint32_t k, levels;
} variant;
static const variant variants[] = {{DF_FIELD_DENSE, 8, 1},  {DF_FIELD_DENSE, 8, 2},  {DF_FIELD_DENSE, 4, 2},
                                   {DF_FIELD_BRICKS, 8, 2}, {DF_FIELD_BRICKS, 4, 2}, {DF_FIELD_ADF, 0, 0}};
enum { VARIANT_COUNT = sizeof variants / sizeof variants[0] };

typedef struct fixture {
    df_field field;
    df_scene scene;
} fixture;

static void open_variant(fixture *f, const variant *v, const uint32_t count[3], test_function function,
                         const void *context, float iso) {
    df_error err;
    memset(f, 0, sizeof *f);
    if (test_field_from_function(&f->field, v->kind, v->k, count, function, context, &err)) fail_msg("%s", err.text);
    const df_scene_options options = {v->levels, v->k};
    if (df_scene_prepare(&f->field, iso, &options, &f->scene, &err)) fail_msg("%s", err.text);
}

/* The reference for a structure. */
static const df_tracer *tracer_of(const variant *v) {
    return v->kind == DF_FIELD_ADF ? &df_tracer_adf : &df_tracer_dda;
}

static void close_variant(fixture *f) {
    df_scene_free(&f->scene);
    df_field_free(&f->field);
}

typedef struct ray_set {
    double *origins, *directions;
    df_rays rays;
    test_hit *hits;
} ray_set;

static void trace(fixture *f, const df_tracer *tracer, int solve, uint32_t count, uint64_t seed, ray_set *set) {
    df_error err;
    const double box[3] = {f->scene.voxel_count[0], f->scene.voxel_count[1], f->scene.voxel_count[2]};
    set->origins = malloc(3 * sizeof(double) * count);
    set->directions = malloc(3 * sizeof(double) * count);
    set->hits = malloc(sizeof *set->hits * count);
    test_random_rays(count, seed, box, set->origins, set->directions);
    if (test_trace(tracer, &df_kernels_scalar, &f->scene, solve, 0, DF_PRECISION_F64, set->origins, set->directions,
                   count, &set->rays, set->hits, &err))
        fail_msg("%s", err.text);
}

static void free_set(ray_set *set) {
    free(set->origins);
    free(set->directions);
    free(set->hits);
    df_rays_free(&set->rays);
}

/* ---- functions ---- */

typedef struct sphere {
    double centre[3], radius;
} sphere;

static double sphere_distance(const double p[3], const void *context) {
    const sphere *s = context;
    double x = p[0] - s->centre[0], y = p[1] - s->centre[1], z = p[2] - s->centre[2];
    return sqrt(x * x + y * y + z * z) - s->radius;
}

static double torus_distance(const double p[3], const void *context) {
    const sphere *s = context; /* the ring's radius; the tube is a third */
    double x = p[0] - s->centre[0], y = p[1] - s->centre[1], z = p[2] - s->centre[2],
           q = sqrt(x * x + z * z) - s->radius;
    return sqrt(q * q + y * y) - s->radius / 3;
}

/* The box [16,48]^3 and its exact distance: its faces are grid planes. */
static double box_distance(const double p[3], const void *context) {
    (void)context;
    double outside = 0, inside = -1e9;
    for (int a = 0; a < 3; a++) {
        double q = fabs(p[a] - 32) - 16;
        outside += fmax(q, 0) * fmax(q, 0);
        inside = fmax(inside, q);
    }
    return sqrt(outside) + fmin(inside, 0);
}

static double slope(const double p[3], const void *context) {
    (void)context;
    return 0.36 * p[0] + 0.48 * p[1] + 0.8 * p[2] - 20.25;
}

/* ---- claims ---- */

static void position_of(const ray_set *set, uint32_t i, double t, double p[3]) {
    for (int a = 0; a < 3; a++) {
        p[a] = (double)set->rays.origin[a][i] + (t - set->rays.t_base[i]) * (double)set->rays.direction[a][i];
    }
}

/* The nearest that the ray, from its start on, comes to a point. */
static double approach(const ray_set *set, uint32_t i, const double centre[3]) {
    double dd = 0, cd = 0, p[3], sum = 0;
    for (int a = 0; a < 3; a++) {
        double d = (double)set->rays.direction[a][i];
        dd += d * d;
        cd += d * (centre[a] - (double)set->rays.origin[a][i]);
    }
    position_of(set, i, fmax(0, cd / dd) + set->rays.t_base[i], p);
    for (int a = 0; a < 3; a++) sum += (p[a] - centre[a]) * (p[a] - centre[a]);
    return sqrt(sum);
}

static void every_hit_lies_on_the_sphere_and_none_is_missed(void **unused) {
    (void)unused;
    const uint32_t count[3] = {61, 64, 59};
    const sphere s = {{30.3, 31.9, 29.6}, 24};
    for (int v = 0; v < VARIANT_COUNT; v++) {
        fixture f;
        ray_set set;
        uint32_t hits = 0;
        open_variant(&f, &variants[v], count, sphere_distance, &s, 0);
        trace(&f, tracer_of(&variants[v]), DF_SOLVE_ROBUST, RAYS, 1, &set);
        for (uint32_t i = 0; i < RAYS; i++) {
            double p[3], nearest = approach(&set, i, s.centre);
            if (set.hits[i].hit) {
                position_of(&set, i, set.hits[i].t, p);
                if (fabs(sphere_distance(p, &s)) > 0.02)
                    fail_msg("ray %u hits %g voxels off", i, sphere_distance(p, &s));
                if (nearest > s.radius + 0.02)
                    fail_msg("ray %u hits though it passes %g outside", i, nearest - s.radius);
                hits++;
            } else if (nearest < s.radius - 0.02) {
                fail_msg("ray %u misses though it passes %g inside", i, s.radius - nearest);
            }
        }
        assert_true(hits > RAYS / 4);
        free_set(&set);
        close_variant(&f);
    }
}

static void rays_that_start_inside_hit_back_faces(void **unused) {
    (void)unused;
    const uint32_t count[3] = {64, 64, 64};
    const sphere s = {{32, 32, 32}, 24};
    fixture f;
    ray_set set;
    open_variant(&f, &variants[3], count, sphere_distance, &s, 0);
    trace(&f, &df_tracer_dda, DF_SOLVE_ROBUST, RAYS, 2, &set);
    for (uint32_t i = 0; i < RAYS; i++) {
        double start = sphere_distance(
            (double[3]){(double)set.rays.origin[0][i], (double)set.rays.origin[1][i], (double)set.rays.origin[2][i]},
            &s);
        if (fabs(start) < 0.02) continue;
        if (start < 0) assert_true(set.hits[i].hit);
        if (set.hits[i].hit) assert_int_equal(set.hits[i].flags & DF_HIT_BACK, start < 0 ? DF_HIT_BACK : 0);
    }
    free_set(&set);
    close_variant(&f);
}

static void structures_agree_to_the_bit(void **unused) {
    (void)unused;
    const uint32_t count[3] = {53, 40, 60};
    const sphere s = {{26, 20.5, 30}, 13};
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        ray_set reference;
        for (int v = 0; v < VARIANT_COUNT; v++) {
            fixture f;
            ray_set set;
            open_variant(&f, &variants[v], count, torus_distance, &s, 0);
            trace(&f, tracer_of(&variants[v]), solve, RAYS / 4, 3, &set);
            if (v == 0) {
                reference = set;
            } else {
                for (uint32_t i = 0; i < RAYS / 4; i++) {
                    if (!test_same_hit(&set.hits[i], &reference.hits[i]))
                        fail_msg("solve %d, variant %d, ray %u", solve, v, i);
                }
                free_set(&set);
            }
            close_variant(&f);
        }
        free_set(&reference);
    }
}

static void a_field_scaled_by_a_power_of_two_gives_the_same_bits(void **unused) {
    (void)unused;
    const uint32_t count[3] = {64, 64, 64};
    const sphere s = {{32.2, 31.7, 32}, 15};
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        fixture f;
        ray_set plain, scaled;
        open_variant(&f, &variants[1], count, torus_distance, &s, 0);
        trace(&f, &df_tracer_dda, solve, RAYS / 8, 4, &plain);
        float *samples = (float *)f.field.samples;
        for (uint64_t i = 0; i < f.field.sample_count; i++) samples[i] *= 0x1p-40f;
        trace(&f, &df_tracer_dda, solve, RAYS / 8, 4, &scaled);
        for (uint32_t i = 0; i < RAYS / 8; i++) assert_true(test_same_hit(&plain.hits[i], &scaled.hits[i]));
        free_set(&plain);
        free_set(&scaled);
        close_variant(&f);
    }
}

/* Rays along axes, diagonals and edges against a box whose faces are grid planes: product tests miss all of them. */
static void a_box_on_grid_planes_is_watertight(void **unused) {
    (void)unused;
    enum { N = 4000 };
    const uint32_t count[3] = {64, 64, 64};
    const double *box = (const double[3]){64, 64, 64};
    double *origins = malloc(3 * N * sizeof(double)), *directions = malloc(3 * N * sizeof(double));
    test_hit *hits = malloc(N * sizeof *hits);
    test_random random = {5};
    for (uint32_t i = 0; i < N; i++) {
        int kind = i % 3, axis = (int)(i / 3 % 3);
        for (int a = 0; a < 3; a++) {
            double inner = 17 + floor(30 * test_uniform(&random)), sign = test_uniform(&random) < 0.5 ? -1 : 1;
            if (kind == 1) inner = 17 + 30 * test_uniform(&random);
            bool along = kind == 2 ? a != axis : a == axis; /* kind 2: diagonals in a plane, through cell edges */
            directions[3 * i + a] = along ? sign : 0;
            origins[3 * i + a] = kind == 2 && along ? 32 - 40 * sign : along ? box[a] / 2 - 40 * sign : inner;
        }
    }
    for (int v = 0; v < VARIANT_COUNT; v++) {
        fixture f;
        df_rays rays;
        df_error err;
        open_variant(&f, &variants[v], count, box_distance, NULL, 0);
        if (test_trace(tracer_of(&variants[v]), &df_kernels_scalar, &f.scene, DF_SOLVE_ROBUST, 0, DF_PRECISION_F64,
                       origins, directions, N, &rays, hits, &err))
            fail_msg("%s", err.text);
        for (uint32_t i = 0; i < N; i++) {
            if (!hits[i].hit) fail_msg("ray %u slips through the box (variant %d)", i, v);
            if (fabs(hits[i].t - 24) > 1e-6) fail_msg("ray %u hits at %.9g, not 24", i, hits[i].t);
        }
        df_rays_free(&rays);
        close_variant(&f);
    }
    free(origins);
    free(directions);
    free(hits);
}

static void a_plane_is_hit_exactly_and_its_normal_is_exact(void **unused) {
    (void)unused;
    const uint32_t count[3] = {32, 32, 32};
    fixture f;
    ray_set set;
    open_variant(&f, &variants[3], count, slope, NULL, 0);
    trace(&f, &df_tracer_dda, DF_SOLVE_ROBUST, RAYS / 4, 6, &set);
    uint32_t hits = 0;
    for (uint32_t i = 0; i < RAYS / 4; i++) {
        double p[3], along = 0;
        if (!set.hits[i].hit) continue;
        for (int a = 0; a < 3; a++) along += (double)set.rays.direction[a][i] * (double[]){0.36, 0.48, 0.8}[a];
        if (fabs(along) < 0.01) continue;
        position_of(&set, i, set.hits[i].t, p);
        if (fabs(slope(p, NULL)) > 3e-6) fail_msg("ray %u is %g off the plane", i, slope(p, NULL));
        hits++;
        const uint32_t voxel[3] = {set.hits[i].cell[0], set.hits[i].cell[1], set.hits[i].cell[2]};
        float stencil[64], gradient[3];
        df_scene_stencil(&f.scene, voxel, df_scene_block(&f.scene, voxel[0], voxel[1], voxel[2]), DF_REACH_ALL, stencil,
                         1);
        for (int method = 0; method < DF_GRADIENT_COUNT; method++) {
            df_gradient(method, stencil, set.hits[i].local, (const float[]){1, 1, 1}, gradient);
            for (int a = 0; a < 3; a++) assert_true(fabs((double)gradient[a] - (double[]){0.36, 0.48, 0.8}[a]) < 1e-5);
        }
    }
    assert_true(hits > 1000);
    free_set(&set);
    close_variant(&f);
}

static void a_far_eye_sees_the_same_as_a_near_one(void **unused) {
    (void)unused;
    const uint32_t count[3] = {64, 64, 64}, n = 20000;
    const sphere s = {{32, 32, 32}, 24};
    double *origins = malloc(3 * n * sizeof(double)), *directions = malloc(3 * n * sizeof(double));
    test_hit *hits = malloc(n * sizeof *hits);
    test_random random = {7};
    fixture f;
    df_rays rays;
    df_error err;
    for (uint32_t i = 0; i < n; i++) {
        double *o = origins + 3 * (size_t)i, *d = directions + 3 * (size_t)i, offset[3];
        for (int a = 0; a < 3; a++) d[a] = test_uniform(&random) - 0.5;
        for (int a = 0; a < 3; a++) offset[a] = 40 * (test_uniform(&random) - 0.5);
        for (int a = 0; a < 3; a++) o[a] = 32 + offset[a] - 1e6 * d[a];
    }
    open_variant(&f, &variants[3], count, sphere_distance, &s, 0);
    if (test_trace(&df_tracer_dda, &df_kernels_scalar, &f.scene, DF_SOLVE_ROBUST, 0, DF_PRECISION_F64, origins,
                   directions, n, &rays, hits, &err))
        fail_msg("%s", err.text);
    for (uint32_t i = 0; i < n; i++) {
        double dd = 0, od = 0, oo = 0, p[3], largest = 0;
        for (int a = 0; a < 3; a++) largest = fmax(largest, fabs(directions[3 * i + a]));
        for (int a = 0; a < 3; a++) {
            double o = origins[3 * i + a] - 32, d = directions[3 * i + a];
            dd += d * d;
            od += o * d;
            oo += o * o;
        }
        double nearest = sqrt(fmax(0, oo - od * od / dd));
        if (nearest < 23.97) assert_true(hits[i].hit);
        if (nearest > 24.03) assert_false(hits[i].hit);
        if (!hits[i].hit) continue;
        for (int a = 0; a < 3; a++) p[a] = origins[3 * i + a] + hits[i].t / largest * directions[3 * i + a];
        assert_true(fabs(sphere_distance(p, &s)) < 0.03);
    }
    df_rays_free(&rays);
    close_variant(&f);
    free(origins);
    free(directions);
    free(hits);
}

static void bad_rays_are_refused(void **unused) {
    (void)unused;
    df_rays rays;
    df_error err;
    double scale;
    const double box[3] = {8, 8, 8}, sound[3] = {1, 2, 3},
                 bad[4][3] = {{0, 0, 0}, {NAN, 0, 1}, {INFINITY, 0, 0}, {0, -INFINITY, 1}};
    assert_int_equal(df_rays_alloc(1, true, &rays, &err), DF_OK);
    for (int i = 0; i < 4; i++) {
        assert_false(df_rays_set(&rays, 0, box, sound, bad[i], &scale));
        if (i > 0) assert_false(df_rays_set(&rays, 0, box, bad[i], sound, &scale));
    }
    df_rays_free(&rays);
}

/* ---- pictures ---- */

static void render(const fixture *f, uint32_t width, uint32_t height, uint32_t tile, uint32_t threads, uint8_t *rgb,
                   float *depth, float *normals) {
    df_camera camera;
    df_view view;
    df_error err;
    df_renderer *renderer;
    df_camera_orbit(&f->field, 40, 25, 1.6, &camera);
    camera.fov_y = 1;
    if (df_view_make(&camera, &f->field, width, height, &view, &err)) fail_msg("%s", err.text);
    const df_frame_options options = {
        .tracer = &df_tracer_dda,
        .solve = DF_SOLVE_ROBUST,
        .gradient = DF_GRADIENT_CORNER_CENTRAL,
        .tile = tile,
        .threads = threads,
    };
    if (df_renderer_open(&f->scene, &options, width, height, &renderer, &err)) fail_msg("%s", err.text);
    const df_picture picture = {.width = width, .height = height, .rgb = rgb, .depth = depth, .normals = normals};
    if (df_renderer_frame(renderer, &view, &picture, NULL, &err)) fail_msg("%s", err.text);
    df_renderer_close(renderer);
}

static void pictures_do_not_depend_on_threads_and_tiles(void **unused) {
    (void)unused;
    const uint32_t count[3] = {48, 48, 48}, width = 131, height = 77, pixels = width * height;
    const sphere s = {{24, 24, 24}, 13};
    fixture f;
    uint8_t *rgb[2] = {malloc(3 * pixels), malloc(3 * pixels)};
    float *depth[2] = {malloc(pixels * sizeof(float)), malloc(pixels * sizeof(float))};
    float *normals[2] = {malloc(3 * pixels * sizeof(float)), malloc(3 * pixels * sizeof(float))};
    const uint32_t tiles[] = {1, 7, 16, 33, 64, 500}, threads[] = {1, 2, 3, 8};
    open_variant(&f, &variants[3], count, torus_distance, &s, 0);
    render(&f, width, height, 64, 1, rgb[0], depth[0], normals[0]);
    for (int i = 0; i < 6; i++) {
        render(&f, width, height, tiles[i], threads[i % 4], rgb[1], depth[1], normals[1]);
        assert_memory_equal(rgb[0], rgb[1], 3 * pixels);
        assert_memory_equal(depth[0], depth[1], pixels * sizeof(float));
        assert_memory_equal(normals[0], normals[1], 3 * pixels * sizeof(float));
    }
    for (int i = 0; i < 2; i++) {
        free(rgb[i]);
        free(depth[i]);
        free(normals[i]);
    }
    close_variant(&f);
}

static void normals_of_a_stretched_grid_are_those_of_the_world(void **unused) {
    (void)unused;
    const uint32_t count[3] = {32, 32, 32}, width = 64, height = 64;
    fixture f;
    float *normals = malloc(3 * sizeof(float) * width * height);
    uint32_t seen = 0;
    open_variant(&f, &variants[3], count, slope, NULL, 0);
    f.field.voxel_size[0] = 1;
    f.field.voxel_size[1] = 2;
    f.field.voxel_size[2] = 4;
    render(&f, width, height, 32, 1, NULL, NULL, normals);
    const double g[3] = {0.36, 0.48 / 2, 0.8 / 4}, length = sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
    for (uint32_t i = 0; i < width * height; i++) {
        if (normals[3 * i] == 0.0f && normals[3 * i + 1] == 0.0f && normals[3 * i + 2] == 0.0f) continue;
        for (int a = 0; a < 3; a++) assert_true(fabs((double)normals[3 * i + (uint32_t)a] - g[a] / length) < 1e-5);
        seen++;
    }
    assert_true(seen > 100);
    free(normals);
    close_variant(&f);
}

static void small_and_empty_fields_are_no_trouble(void **unused) {
    (void)unused;
    const double radii[] = {0.4, -1, 100};
    const uint32_t counts[][3] = {{1, 1, 1}, {2, 2, 2}, {1, 9, 3}};
    for (int i = 0; i < 9; i++) {
        const uint32_t *count = counts[i / 3];
        const sphere s = {{count[0] / 2.0 + 0.3, count[1] / 2.0, count[2] / 2.0 - 0.1}, radii[i % 3]};
        for (int v = 0; v < VARIANT_COUNT; v++) {
            fixture f;
            ray_set set;
            open_variant(&f, &variants[v], count, sphere_distance, &s, 0);
            trace(&f, tracer_of(&variants[v]), DF_SOLVE_ROBUST, 2000, 8, &set);
            free_set(&set);
            close_variant(&f);
        }
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_hit_lies_on_the_sphere_and_none_is_missed),
        cmocka_unit_test(rays_that_start_inside_hit_back_faces),
        cmocka_unit_test(structures_agree_to_the_bit),
        cmocka_unit_test(a_field_scaled_by_a_power_of_two_gives_the_same_bits),
        cmocka_unit_test(a_box_on_grid_planes_is_watertight),
        cmocka_unit_test(a_plane_is_hit_exactly_and_its_normal_is_exact),
        cmocka_unit_test(a_far_eye_sees_the_same_as_a_near_one),
        cmocka_unit_test(bad_rays_are_refused),
        cmocka_unit_test(pictures_do_not_depend_on_threads_and_tiles),
        cmocka_unit_test(normals_of_a_stretched_grid_are_those_of_the_world),
        cmocka_unit_test(small_and_empty_fields_are_no_trouble),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
