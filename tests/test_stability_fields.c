/*
 * The stability cases of rays through fields. Those of one voxel are in test_stability_cells.c; T33 in test_lab.c.
 * Elsewhere: T37 test_field_file.c and fuzz/ (headers that overflow), T40 and T41 test_mc_mesh.c (marching cubes), T43
 * test_render_shapes.c (normals of a stretched grid).
 */
#include "fields.h"
#include "lab/measure.h"
#include "lab/random.h"
#include "render/methods/gradient.h"
#include "render/methods/shade.h"
#include "render/methods/solve_methods.h"
#include "tracing.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* ---- help ---- */

typedef struct bundle {
    uint32_t count;
    double *origins, *directions;
    df_rays rays;
    test_hit *hits;
} bundle;

static void bundle_open(bundle *b, uint32_t count) {
    *b = (bundle){count,
                  calloc(3 * (size_t)count, sizeof(double)),
                  calloc(3 * (size_t)count, sizeof(double)),
                  {0},
                  calloc(count, sizeof *b->hits)};
    if (!b->origins || !b->directions || !b->hits) fail_msg("no memory");
}

static void bundle_close(bundle *b) {
    free(b->origins);
    free(b->directions);
    free(b->hits);
    df_rays_free(&b->rays);
}

static void set_ray(bundle *b, uint32_t i, const double origin[3], const double direction[3]) {
    memcpy(b->origins + 3 * (size_t)i, origin, 3 * sizeof *origin);
    memcpy(b->directions + 3 * (size_t)i, direction, 3 * sizeof *direction);
}

static void bundle_trace(bundle *b, const df_tracer *tracer, const df_field *field, int solve, int steps) {
    df_scene scene;
    df_error err;
    const df_scene_options options = {0};
    df_rays_free(&b->rays);
    if (df_scene_prepare(field, 0, &options, &scene, &err)) fail_msg("%s", err.text);
    if (test_trace(tracer, &df_kernels_scalar, &scene, solve, steps, DF_PRECISION_F64, b->origins, b->directions,
                   b->count, &b->rays, b->hits, &err))
        fail_msg("%s", err.text);
    df_scene_free(&scene);
}

/* The ray as the tracer has it. */
static void traced_ray(const bundle *b, uint32_t i, double origin[3], double direction[3]) {
    for (int a = 0; a < 3; a++) {
        origin[a] = (double)b->rays.origin[a][i];
        direction[a] = (double)b->rays.direction[a][i];
    }
}

static double length3(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

/* Voxels between a hit and the truth; INFINITY where one of them misses, 0 where both do or the ray is tangent. */
static double hit_error(const bundle *b, const df_field *field, uint32_t i) {
    double origin[3], direction[3];
    df_truth truth;
    traced_ray(b, i, origin, direction);
    df_truth_trace(field, 0, origin, direction, &truth);
    if (truth.tangent || (!truth.hit && !b->hits[i].hit)) return 0;
    if (!truth.hit || !b->hits[i].hit) return INFINITY;
    return fabs((double)((df_quad)(b->hits[i].t - b->rays.t_base[i]) - truth.t)) * length3(direction);
}

static void make(df_field *field, const uint32_t count[3], test_function function, const void *context) {
    df_error err;
    memset(field, 0, sizeof *field);
    if (test_field_from_function(field, DF_FIELD_DENSE, 0, count, function, context, &err)) fail_msg("%s", err.text);
}

static void make_shape(df_field *field, lab_shape shape, uint32_t size, double parameter) {
    const lab_surface surface = lab_surface_make(shape, size, parameter);
    make(field, (const uint32_t[3]){size, size, size}, surface.value, &surface);
}

typedef struct plane {
    double normal[3], offset;
} plane;

static double plane_value(const double p[3], const void *context) {
    const plane *s = context;
    return s->normal[0] * p[0] + s->normal[1] * p[1] + s->normal[2] * p[2] - s->offset;
}

static double centred_sphere(const double p[3], const void *context) {
    const double *s = context; /* middle and radius */
    return sqrt((p[0] - s[0]) * (p[0] - s[0]) + (p[1] - s[0]) * (p[1] - s[0]) + (p[2] - s[0]) * (p[2] - s[0])) - s[1];
}

/* ---- claims ---- */

static void t13_a_crossing_on_a_face_belongs_to_one_of_its_cells(void **unused) {
    (void)unused;
    const plane wall = {{-1, 0, 0}, -1};
    df_field field;
    bundle b;
    make(&field, (const uint32_t[3]){2, 2, 2}, plane_value, &wall);
    bundle_open(&b, 2);
    set_ray(&b, 0, (double[]){-1, 0.5, 0.5}, (double[]){1, 0, 0});
    set_ray(&b, 1, (double[]){3, 0.5, 0.5}, (double[]){-1, 0, 0});
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        const double slack = solve == DF_SOLVE_MIDPOINT ? 0.5 : 1e-9;
        bundle_trace(&b, &df_tracer_dda, &field, solve, 0);
        assert_true(b.hits[0].hit && b.hits[1].hit);
        assert_true(fabs(b.hits[0].t - 2) <= slack && fabs(b.hits[1].t - 2) <= slack);
    }
    bundle_close(&b);
    df_field_free(&field);
}

/* Product tests lose every axis ray on faces that are grid planes. */
static void t14_a_box_on_grid_planes_is_hit_by_every_solve(void **unused) {
    (void)unused;
    enum { RAYS = 4000 };
    df_field field;
    bundle b;
    uint64_t seed = 14;
    make_shape(&field, LAB_BOX, 64, 0); /* [16,48]^3 */
    bundle_open(&b, RAYS);
    for (uint32_t i = 0; i < RAYS; i++) {
        double o[3], d[3] = {0, 0, 0};
        const uint32_t axis = i % 3;
        for (uint32_t a = 0; a < 3; a++)
            o[a] = i % 2 ? 17 + lab_random_index(&seed, 30) : lab_random(&seed, 16.1, 47.9);
        d[axis] = lab_random_index(&seed, 2) ? 1 : -1;
        o[axis] = 32 - 40 * d[axis];
        set_ray(&b, i, o, d);
    }
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        bundle_trace(&b, &df_tracer_dda, &field, solve, 0);
        for (uint32_t i = 0; i < RAYS; i++) {
            if (!b.hits[i].hit) fail_msg("%s: ray %u goes through", df_solve_names[solve], i);
            assert_true(fabs(b.hits[i].t - 24) <= (solve == DF_SOLVE_MIDPOINT ? 0.500001 : 1e-5));
        }
    }
    bundle_close(&b);
    df_field_free(&field);
}

/* Powers of two change no bit; other scales change no hit. */
static void t18_scaling_a_field_changes_nothing(void **unused) {
    (void)unused;
    enum { RAYS = 2000 };
    const double factors[] = {0x1p-40, 0x1p40, 1e-20, 1e20};
    df_field field;
    bundle plain, scaled;
    make_shape(&field, LAB_PAIRS, 32, 0);
    float *original = malloc(field.sample_count * sizeof *original), *samples = (float *)field.samples;
    memcpy(original, samples, field.sample_count * sizeof *original);
    bundle_open(&plain, RAYS);
    bundle_open(&scaled, RAYS);
    test_random_rays(RAYS, 18, (const double[]){32, 32, 32}, plain.origins, plain.directions);
    test_random_rays(RAYS, 18, (const double[]){32, 32, 32}, scaled.origins, scaled.directions);
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        memcpy(samples, original, field.sample_count * sizeof *original);
        bundle_trace(&plain, &df_tracer_dda, &field, solve, 0);
        for (int f = 0; f < 4; f++) {
            for (uint64_t i = 0; i < field.sample_count; i++) samples[i] = (float)((double)original[i] * factors[f]);
            bundle_trace(&scaled, &df_tracer_dda, &field, solve, 0);
            for (uint32_t i = 0; i < RAYS; i++) {
                if (f < 2) assert_true(test_same_hit(&plain.hits[i], &scaled.hits[i]));
                else if (solve == DF_SOLVE_ROBUST) assert_true(hit_error(&scaled, &field, i) < 1e-5);
            }
        }
    }
    free(original);
    bundle_close(&plain);
    bundle_close(&scaled);
    df_field_free(&field);
}

/* Origins up to 1e6 voxels away: what is left is the rounding of the caller's own doubles. */
static void t19_a_far_origin_costs_nothing(void **unused) {
    (void)unused;
    const double sphere[2] = {32, 20}, distances[] = {1e2, 1e3, 1e4, 1e5, 1e6}, u[3] = {.36, .48, .8};
    df_field field;
    bundle b;
    uint64_t seed = 19;
    make(&field, (const uint32_t[3]){64, 64, 64}, centred_sphere, sphere);
    bundle_open(&b, 5 * 400);
    for (uint32_t i = 0; i < b.count; i++) {
        double o[3], d[3];
        for (int a = 0; a < 3; a++) {
            o[a] = 32 + lab_random(&seed, -8, 8) + distances[i / 400] * u[a];
            d[a] = -u[a];
        }
        set_ray(&b, i, o, d);
    }
    for (int solve = DF_SOLVE_LINEAR; solve < DF_SOLVE_COUNT; solve++) {
        bundle_trace(&b, &df_tracer_dda, &field, solve, 0);
        for (uint32_t i = 0; i < b.count; i++) {
            double p[3];
            assert_true(b.hits[i].hit);
            if (solve == DF_SOLVE_ROBUST && hit_error(&b, &field, i) > 1e-7)
                fail_msg("ray %u: %g", i, hit_error(&b, &field, i));
            for (int a = 0; a < 3; a++)
                p[a] = b.origins[3 * i + (uint32_t)a] + b.hits[i].t / 0.8 * b.directions[3 * i + (uint32_t)a];
            assert_true(fabs(centred_sphere(p, sphere)) < 0.03);
        }
    }
    bundle_close(&b);
    df_field_free(&field);
}

/* T21, T22: rays in the faces of the field's box, with components that are 0, -0 or next to nothing. */
static void t21_rays_in_the_faces_of_the_box_are_traced(void **unused) {
    (void)unused;
    const plane wall = {{0, 0, -1}, -0.5};
    const double nothings[] = {0, -0.0, 1e-39, -1e-39};
    df_field field;
    bundle b;
    make(&field, (const uint32_t[3]){1, 1, 1}, plane_value, &wall);
    bundle_open(&b, 24);
    for (uint32_t i = 0; i < 24; i++) {
        const double side = i / 4 % 2, other = i / 8 == 0 ? 0.5 : i / 8 == 1 ? 0 : 1;
        set_ray(&b, i, (double[]){side, other, -1}, (double[]){nothings[i % 4], nothings[i / 4 % 4], 1});
    }
    bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (uint32_t i = 0; i < 24; i++) {
        if (!b.hits[i].hit)
            fail_msg("the ray from %g %g along %g %g misses", b.origins[3 * i], b.origins[3 * i + 1],
                     b.directions[3 * i], b.directions[3 * i + 1]);
        assert_true(fabs(b.hits[i].t - 1.5) < 1e-6);
    }
    bundle_close(&b);
    df_field_free(&field);
}

/* Short boxes far away, rays that pass close to their edges: the box test must not lose them. */
static void t23_rays_near_the_edges_of_a_small_box_enter_it(void **unused) {
    (void)unused;
    const plane wall = {{0, 0, 1}, 1};
    df_field field;
    bundle b;
    uint64_t seed = 23;
    make(&field, (const uint32_t[3]){2, 2, 2}, plane_value, &wall);
    bundle_open(&b, 50000);
    for (uint32_t i = 0; i < b.count; i++) {
        double d[3], target[3] = {0, 0, 1}, o[3];
        const double reach = lab_random(&seed, 0.1, 2000);
        lab_random_direction(&seed, d);
        for (int a = 0; a < 2; a++) {
            const double inset = pow(10, lab_random(&seed, -4, 0));
            target[a] = lab_random_index(&seed, 2) ? inset : 2 - inset;
        }
        for (int a = 0; a < 3; a++) o[a] = target[a] - reach * d[a];
        set_ray(&b, i, o, d);
    }
    bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (uint32_t i = 0; i < b.count; i++) {
        if (!isfinite(hit_error(&b, &field, i))) fail_msg("ray %u is lost", i);
    }
    bundle_close(&b);
    df_field_free(&field);
}

static void t24_rays_that_are_none_are_refused(void **unused) {
    (void)unused;
    const double box[3] = {8, 8, 8}, sound[3] = {1, 2, 3};
    const double bad[][3] = {{0, 0, 0}, {NAN, 0, 1}, {INFINITY, 0, 1}, {0, -INFINITY, 0}};
    df_rays rays;
    double scale;
    assert_int_equal(df_rays_alloc(1, true, &rays, NULL), DF_OK);
    for (int i = 0; i < 4; i++) {
        assert_false(df_rays_set(&rays, 0, box, sound, bad[i], &scale));
        if (i) assert_false(df_rays_set(&rays, 0, box, bad[i], sound, &scale));
    }
    df_rays_free(&rays);
}

/* Accumulated steps drift by 0.4 voxel over 4096. */
static void t25_long_walks_do_not_drift(void **unused) {
    (void)unused;
    const plane wall = {{-0.9, 0.05, 0.03}, -0.9 * 4090.3};
    df_field field;
    bundle b;
    uint64_t seed = 25;
    make(&field, (const uint32_t[3]){4096, 5, 5}, plane_value, &wall);
    bundle_open(&b, 2000);
    for (uint32_t i = 0; i < b.count; i++) {
        double o[3] = {-1, 0, 0}, d[3] = {4096, 0, 0};
        for (int a = 1; a < 3; a++) {
            o[a] = lab_random(&seed, 0.1, 4.9);
            d[a] = lab_random(&seed, 0.1, 4.9) - o[a];
        }
        set_ray(&b, i, o, d);
    }
    bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (uint32_t i = 0; i < b.count; i++) {
        assert_true(b.hits[i].hit);
        assert_true(hit_error(&b, &field, i) < 1e-7);
    }
    bundle_close(&b);
    df_field_free(&field);
}

/* A ray in a surface may hit anywhere along it, or nowhere; but where it hits, there is surface. */
static void t30_hits_of_rays_in_the_surface_lie_on_it(void **unused) {
    (void)unused;
    const double heights[] = {0, 1e-8, 1e-7, 1e-6};
    const plane slab = {{2.0 / 7, 3.0 / 7, 6.0 / 7}, 32};
    df_field field;
    bundle b;
    uint64_t seed = 30;
    make(&field, (const uint32_t[3]){64, 64, 64}, plane_value, &slab);
    bundle_open(&b, 4000);
    for (uint32_t i = 0; i < b.count; i++) {
        double d[3], o[3], along = 0;
        lab_random_direction(&seed, d);
        for (int a = 0; a < 3; a++) along += d[a] * slab.normal[a];
        for (int a = 0; a < 3; a++) d[a] -= along * slab.normal[a];
        for (int a = 0; a < 3; a++) o[a] = slab.normal[a] * (32 + heights[i % 4]) + 12 * d[a];
        for (int a = 0; a < 3; a++) o[a] += a == 0 ? 20 * 3.0 / 7 : a == 1 ? -20 * 2.0 / 7 : 0; /* along the plane */
        set_ray(&b, i, o, d);
    }
    bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (uint32_t i = 0; i < b.count; i++) {
        double o[3], d[3];
        if (!b.hits[i].hit) continue;
        traced_ray(&b, i, o, d);
        assert_true(df_truth_residual(&field, 0, o, d, b.hits[i].t - b.rays.t_base[i]) < 1e-5);
    }
    bundle_close(&b);
    df_field_free(&field);
}

/* A hit's position, moved off the surface by what its rounding asks, does not hit at once again. */
static void t31_rays_that_leave_the_surface_do_not_hit_it_again(void **unused) {
    (void)unused;
    const double sphere[2] = {32, 20}, distances[] = {30, 1e2, 1e3, 1e4};
    df_field field;
    bundle b, out;
    uint64_t seed = 31;
    make(&field, (const uint32_t[3]){64, 64, 64}, centred_sphere, sphere);
    bundle_open(&b, 4000);
    bundle_open(&out, 4000);
    for (uint32_t i = 0; i < b.count; i++) {
        double o[3], d[3];
        lab_random_direction(&seed, d);
        for (int a = 0; a < 3; a++) o[a] = 32 + lab_random(&seed, -8, 8) - distances[i % 4] * d[a];
        set_ray(&b, i, o, d);
    }
    bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (uint32_t i = 0; i < b.count; i++) {
        double p[3], n[3], d[3];
        assert_true(b.hits[i].hit);
        for (int a = 0; a < 3; a++)
            p[a] = b.hits[i].cell[a] + (double)b.hits[i].local[a]; /* not o + t d: no distance in it */
        for (int a = 0; a < 3; a++) n[a] = (p[a] - 32) / 20;
        lab_random_direction(&seed, d);
        const double up = d[0] * n[0] + d[1] * n[1] + d[2] * n[2];
        for (int a = 0; a < 3; a++) {
            if (up < 0) d[a] = -d[a];
            d[a] += 0.1 * n[a];
            p[a] += 2e-5 * n[a];
        }
        set_ray(&out, i, p, d);
    }
    bundle_trace(&out, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (uint32_t i = 0; i < out.count; i++) {
        if (out.hits[i].hit) fail_msg("ray %u hits again after %g", i, out.hits[i].t);
    }
    bundle_close(&b);
    bundle_close(&out);
    df_field_free(&field);
}

/* Saddles and plateaus have no gradient; tiny and huge fields have one. A normal is always a unit vector. */
static void t32_normals_are_always_unit_vectors(void **unused) {
    (void)unused;
    const float toward_eye[3] = {0, 0.6f, 0.8f}, unit[3] = {1, 1, 1}, scales[] = {1, 1e-20f, 1e20f, 1e-40f, 1e36f};
    for (int field = 0; field < 3; field++) {
        for (int s = 0; s < 5; s++) {
            float stencil[64], gradient[3], normal[3];
            for (int i = 0; i < 64; i++) {
                const float x = (float)(i % 4) - 1.5f, y = (float)(i / 4 % 4) - 1.5f;
                stencil[i] = scales[s] * (field == 0 ? x * y : field == 1 ? 0 : x);
            }
            for (int method = 0; method < DF_GRADIENT_COUNT; method++) {
                df_gradient(method, stencil, (const float[]){0.5f, 0.5f, 0.5f}, unit, gradient);
                df_shade_normal(gradient, unit, toward_eye, normal);
                const float length = sqrtf(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
                if (!(fabsf(length - 1) < 1e-5f))
                    fail_msg("field %d * %g, %s: length %g", field, (double)scales[s], df_gradient_names[method],
                             (double)length);
                if (field == 2) assert_true(fabsf(normal[0]) > 0.999f);
            }
        }
    }
}

/* Flat faces make the cubic term rounding noise. Known: the closed form finds every hit, being kept in its bracket, but
 * some of them far off, in double too. */
static void t34_planar_faces_at_odd_angles_are_solved(void **unused) {
    (void)unused;
    df_field field;
    bundle b;
    make_shape(&field, LAB_ROTATED_BOX, 64, 0);
    bundle_open(&b, 6000);
    test_random_rays(b.count, 34, (const double[]){64, 64, 64}, b.origins, b.directions);
    for (int solve = DF_SOLVE_MARMITT; solve < DF_SOLVE_COUNT; solve++) {
        double worst = 0;
        bundle_trace(&b, &df_tracer_dda, &field, solve, 0);
        for (uint32_t i = 0; i < b.count; i++) worst = fmax(worst, hit_error(&b, &field, i));
        assert_true(isfinite(worst));
        if (solve == DF_SOLVE_ANALYTIC) assert_true(worst > 0.1);
        else if (!(worst < (solve == DF_SOLVE_ROBUST ? 1e-5 : 0.5))) fail_msg("%s: %g", df_solve_names[solve], worst);
    }
    bundle_close(&b);
    df_field_free(&field);
}

/* 8-bit and 16-bit samples: cubic terms of exactly 0 or a few steps. */
static void t35_quantised_samples_are_solved(void **unused) {
    (void)unused;
    enum { SIZE = 48 };
    const double sphere[2] = {24, 18};
    const size_t total = (SIZE + 1) * (SIZE + 1) * (SIZE + 1);
    for (int bits = 8; bits <= 16; bits += 8) {
        const int exponent = bits == 8 ? -5 : -13, zero = 1 << (bits - 1);
        df_field field = {.kind = DF_FIELD_DENSE,
                          .sample_type = bits == 8 ? DF_SAMPLE_U8 : DF_SAMPLE_U16,
                          .voxel_count = {SIZE, SIZE, SIZE},
                          .voxel_size = {1, 1, 1},
                          .step_exponent = exponent};
        uint8_t *bytes = malloc(total * 2);
        uint16_t *words = (uint16_t *)(void *)bytes;
        bundle b;
        for (size_t i = 0; i < total; i++) {
            const double p[3] = {(double)(i % (SIZE + 1)), (double)(i / (SIZE + 1) % (SIZE + 1)),
                                 (double)(i / (SIZE + 1) / (SIZE + 1))};
            const double steps = rint(ldexp(centred_sphere(p, sphere), -exponent));
            const int q = zero + (int)fmin(zero - 1, fmax(-zero, steps));
            if (bits == 8) bytes[i] = (uint8_t)q;
            else words[i] = (uint16_t)q;
        }
        df_field_own(&field, bytes);
        field.samples = bytes;
        assert_int_equal(df_field_finish(&field, "quantised", NULL), DF_OK);
        bundle_open(&b, 5000);
        test_random_rays(b.count, 35, (const double[]){SIZE, SIZE, SIZE}, b.origins, b.directions);
        for (int solve = DF_SOLVE_MARMITT; solve < DF_SOLVE_COUNT; solve++) {
            uint32_t lost = 0, off = 0;
            bundle_trace(&b, &df_tracer_dda, &field, solve, 0);
            for (uint32_t i = 0; i < b.count; i++) {
                const double error = hit_error(&b, &field, i);
                lost += !isfinite(error);
                off += error > (solve == DF_SOLVE_ROBUST ? 1e-5 : 0.5);
            }
            if (lost || off) fail_msg("%d bits, %s: %u lost, %u off", bits, df_solve_names[solve], lost, off);
        }
        bundle_close(&b);
        df_field_free(&field);
    }
}

/* A step count is a bound on work: few steps cost accuracy, never a hit. Known: five steps leave one hit in a hundred
 * by more than 1e-5 voxel. */
static void t36_few_steps_lose_accuracy_and_no_hits(void **unused) {
    (void)unused;
    df_field field;
    bundle b;
    double worst[3];
    const int steps[3] = {2, 5, 0};
    make_shape(&field, LAB_PAIRS, 40, 0);
    bundle_open(&b, 5000);
    test_random_rays(b.count, 36, (const double[]){40, 40, 40}, b.origins, b.directions);
    for (int s = 0; s < 3; s++) {
        bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, steps[s]);
        worst[s] = 0;
        for (uint32_t i = 0; i < b.count; i++) worst[s] = fmax(worst[s], hit_error(&b, &field, i));
    }
    if (!(worst[0] < 0.95 && worst[0] > worst[1] && worst[1] > worst[2] && worst[2] < 1e-7))
        fail_msg("%g %g %g", worst[0], worst[1], worst[2]);
    bundle_close(&b);
    df_field_free(&field);
}

static void t38_sample_counts_are_64_bit(void **unused) {
    (void)unused;
    assert_true(df_dense_sample_count((const uint32_t[3]){812, 812, 812}) * sizeof(float) > INT32_MAX);
    assert_true(df_dense_sample_count((const uint32_t[3]){1290, 1290, 1290}) == 1291ull * 1291 * 1291);
    assert_true(df_dense_sample_count((const uint32_t[3]){65536, 65536, 65536}) == 65537ull * 65537 * 65537);
}

/* A scan in world coordinates: a voxel of 1 mm, 1000 km from the origin. */
static void t39_a_world_offset_is_subtracted_in_double(void **unused) {
    (void)unused;
    const double offsets[] = {0, 1e3, 1e4, 1e5, 1e6}, sphere[2] = {32, 20};
    df_field field;
    df_rays rays;
    float reference = 0;
    make(&field, (const uint32_t[3]){64, 64, 64}, centred_sphere, sphere);
    for (int a = 0; a < 3; a++) field.voxel_size[a] = 1e-3;
    assert_int_equal(df_rays_alloc(64, true, &rays, NULL), DF_OK);
    for (int i = 0; i < 5; i++) {
        df_camera camera;
        df_view view;
        for (int a = 0; a < 3; a++) field.origin[a] = offsets[i];
        df_camera_orbit(&field, 30, 20, 1.6, &camera);
        camera.fov_y = 1;
        assert_int_equal(df_view_make(&camera, &field, 64, 64, &view, NULL), DF_OK);
        df_view_rays(&view, &df_kernels_scalar, 20, 31, 64, 1, &rays);
        if (i == 0) reference = rays.direction[0][20] / rays.direction[1][20];
        assert_true(fabsf(rays.direction[0][20] / rays.direction[1][20] / reference - 1) < 1e-4f);
        for (int a = 0; a < 3; a++) assert_true(fabs((double)rays.origin[a][0] - view.eye[a]) < 1e-5);
    }
    df_rays_free(&rays);
    df_field_free(&field);
}

/* A ray in the last grid plane of the field reads no sample behind it. */
static void t42_a_ray_in_the_upper_grid_plane_is_clamped(void **unused) {
    (void)unused;
    const plane wall = {{0, -1, 0}, -3.5};
    df_field field;
    bundle b;
    make(&field, (const uint32_t[3]){9, 9, 9}, plane_value, &wall);
    bundle_open(&b, 4);
    for (uint32_t i = 0; i < 4; i++)
        set_ray(&b, i, (double[]){i & 1 ? 9 : 4.5, -1, i & 2 ? 9 : 4.5}, (double[]){0, 1, 0});
    bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (uint32_t i = 0; i < 4; i++) assert_true(b.hits[i].hit && fabs(b.hits[i].t - 4.5) < 1e-6);
    bundle_close(&b);
    df_field_free(&field);
}

static void t44_a_ray_that_starts_inside_hits_where_it_leaves(void **unused) {
    (void)unused;
    const double sphere[2] = {32, 20};
    df_field field;
    bundle b;
    uint64_t seed = 44;
    make(&field, (const uint32_t[3]){64, 64, 64}, centred_sphere, sphere);
    bundle_open(&b, 3000);
    for (uint32_t i = 0; i < b.count; i++) {
        double o[3], d[3];
        lab_random_direction(&seed, d);
        for (int a = 0; a < 3; a++) o[a] = 32 + lab_random(&seed, -10, 10);
        set_ray(&b, i, o, d);
    }
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        bundle_trace(&b, &df_tracer_dda, &field, solve, 0);
        for (uint32_t i = 0; i < b.count; i++)
            assert_true(b.hits[i].hit && (b.hits[i].flags & DF_HIT_BACK) && b.hits[i].t > 0);
    }
    bundle_close(&b);
    df_field_free(&field);
}

static void t45_the_length_of_a_direction_does_not_matter(void **unused) {
    (void)unused;
    enum { RAYS = 3000 };
    const double lengths[] = {1, 0x1p-10, 0x1p10, 1e-3, 1e3, 1e-30, 1e30}, box[3] = {40, 40, 40};
    df_field field;
    bundle b;
    test_hit *reference = malloc(RAYS * sizeof *reference);
    make_shape(&field, LAB_GYROID, 40, 0);
    bundle_open(&b, RAYS);
    for (int l = 0; l < 7; l++) {
        test_random_rays(RAYS, 45, box, b.origins, b.directions);
        for (uint32_t i = 0; i < 3 * RAYS; i++) b.directions[i] *= lengths[l];
        bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
        if (l == 0) memcpy(reference, b.hits, RAYS * sizeof *reference);
        for (uint32_t i = 0; i < RAYS; i++) {
            if (l < 3) assert_true(test_same_hit(&reference[i], &b.hits[i]));
            else assert_true(hit_error(&b, &field, i) < 1e-5);
        }
    }
    free(reference);
    bundle_close(&b);
    df_field_free(&field);
}

static void t46_tiny_full_and_empty_fields_are_no_trouble(void **unused) {
    (void)unused;
    const uint32_t counts[][3] = {{1, 1, 1}, {2, 2, 2}, {1, 7, 2}};
    const plane fields[] = {{{0, 0, 0}, -1}, {{0, 0, 0}, 1}, {{1, 0, 0}, 0.5}};
    for (int i = 0; i < 9; i++) {
        df_field field;
        bundle b;
        make(&field, counts[i / 3], plane_value, &fields[i % 3]);
        bundle_open(&b, 2000);
        test_random_rays(b.count, 46, (const double[]){counts[i / 3][0], counts[i / 3][1], counts[i / 3][2]}, b.origins,
                         b.directions);
        for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
            bundle_trace(&b, &df_tracer_dda, &field, solve, 0);
            for (uint32_t r = 0; r < b.count; r++) {
                if (i % 3 < 2) assert_false(b.hits[r].hit);
                else if (solve == DF_SOLVE_ROBUST) assert_true(hit_error(&b, &field, r) < 1e-5);
            }
        }
        bundle_close(&b);
        df_field_free(&field);
    }
}

/* -0 is not less than 0: it is outside, as 0 is, in every tracer. */
static void t47_a_negative_zero_is_outside(void **unused) {
    (void)unused;
    enum { RAYS = 4000 };
    const double box[3] = {64, 64, 64};
    df_field field;
    bundle plus, minus;
    make_shape(&field, LAB_BOX, 64, 0);
    float *samples = (float *)field.samples;
    bundle_open(&plus, RAYS);
    bundle_open(&minus, RAYS);
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if ((*tracer)->whole_frame || *tracer == &df_tracer_splat) continue;         /* pictures only */
        if (*tracer == &df_tracer_adf || *tracer == &df_tracer_adf_packet) continue; /* octrees only */
        for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
            test_random_rays(RAYS, 47, box, plus.origins, plus.directions);
            test_random_rays(RAYS, 47, box, minus.origins, minus.directions);
            for (uint64_t i = 0; i < field.sample_count; i++) samples[i] = samples[i] == 0.0f ? 0.0f : samples[i];
            bundle_trace(&plus, *tracer, &field, solve, 0);
            for (uint64_t i = 0; i < field.sample_count; i++) samples[i] = samples[i] == 0.0f ? -0.0f : samples[i];
            bundle_trace(&minus, *tracer, &field, solve, 0);
            for (uint32_t i = 0; i < RAYS; i++) assert_true(test_same_hit(&plus.hits[i], &minus.hits[i]));
        }
    }
    bundle_close(&plus);
    bundle_close(&minus);
    df_field_free(&field);
}

/* Mirrors and permutes a point of [0, size]^3 or, with size 0, a direction. */
static void transform(int symmetry, double size, const double in[3], double out[3]) {
    static const int orders[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    for (int a = 0; a < 3; a++) {
        const double v = in[orders[symmetry / 8][a]];
        out[a] = symmetry >> a & 1 ? size - v : v;
    }
}

static void t48_the_48_symmetries_of_the_cube_give_the_same_hits(void **unused) {
    (void)unused;
    enum { SIZE = 24, RAYS = 1500 };
    df_field field, turned;
    bundle b, t;
    uint64_t seed = 48;
    make_shape(&field, LAB_PAIRS, SIZE, 0);
    make_shape(&turned, LAB_PAIRS, SIZE, 0);
    bundle_open(&b, RAYS);
    bundle_open(&t, RAYS);
    for (uint32_t i = 0; i < RAYS; i++) { /* multiples of 1/64: no transformation rounds */
        double o[3], d[3];
        for (int a = 0; a < 3; a++) {
            o[a] = (lab_random_index(&seed, 192) - 64.0) / 64 * SIZE;
            d[a] = lab_random_index(&seed, 64) / 64.0 * SIZE - o[a];
        }
        if (length3(d) == 0) d[0] = 1;
        set_ray(&b, i, o, d);
    }
    bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (int symmetry = 0; symmetry < 48; symmetry++) {
        for (uint32_t z = 0; z <= SIZE; z++) {
            for (uint32_t y = 0; y <= SIZE; y++) {
                for (uint32_t x = 0; x <= SIZE; x++) {
                    double to[3];
                    transform(symmetry, SIZE, (const double[]){x, y, z}, to);
                    const size_t n = SIZE + 1, at = (size_t)to[0] + n * ((size_t)to[1] + n * (size_t)to[2]);
                    ((float *)turned.samples)[at] = ((const float *)field.samples)[x + n * (y + n * z)];
                }
            }
        }
        for (uint32_t i = 0; i < RAYS; i++) {
            double o[3], d[3];
            transform(symmetry, SIZE, b.origins + 3 * (size_t)i, o);
            transform(symmetry, 0, b.directions + 3 * (size_t)i, d);
            set_ray(&t, i, o, d);
        }
        bundle_trace(&t, &df_tracer_dda, &turned, DF_SOLVE_ROBUST, 0);
        for (uint32_t i = 0; i < RAYS; i++) {
            if (b.hits[i].hit == t.hits[i].hit && fabs(b.hits[i].t - t.hits[i].t) <= 1e-9) continue;
            double o[3], d[3];
            df_truth truth; /* a tangent ray may fall on either side */
            traced_ray(&b, i, o, d);
            df_truth_trace(&field, 0, o, d, &truth);
            if (!truth.tangent)
                fail_msg("symmetry %d, ray %u: %d at %.17g, %d at %.17g", symmetry, i, b.hits[i].hit, b.hits[i].t,
                         t.hits[i].hit, t.hits[i].t);
        }
    }
    bundle_close(&b);
    bundle_close(&t);
    df_field_free(&field);
    df_field_free(&turned);
}

/* Where a ray crosses once, it crosses at the same place from the other end. */
static void t49_a_reversed_ray_hits_the_same_place(void **unused) {
    (void)unused;
    enum { RAYS = 4000 };
    const double sphere[2] = {32, 20};
    df_field field;
    bundle b, back;
    uint64_t seed = 49;
    make(&field, (const uint32_t[3]){64, 64, 64}, centred_sphere, sphere);
    bundle_open(&b, RAYS);
    bundle_open(&back, RAYS);
    for (uint32_t i = 0; i < RAYS; i++) {
        double o[3], d[3], end[3], u[3];
        lab_random_direction(&seed, u);
        for (int a = 0; a < 3; a++) {
            end[a] = (double)(float)(32 + lab_random(&seed, -5, 5));
            d[a] = (double)(float)(-28 * u[a]) / 28;
            o[a] = end[a] - 28 * d[a];
        }
        for (int a = 0; a < 3; a++) o[a] = (double)(float)o[a];
        for (int a = 0; a < 3; a++) d[a] = end[a] - o[a];
        set_ray(&b, i, o, d);
        for (int a = 0; a < 3; a++) d[a] = -d[a];
        set_ray(&back, i, end, d);
    }
    bundle_trace(&b, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    bundle_trace(&back, &df_tracer_dda, &field, DF_SOLVE_ROBUST, 0);
    for (uint32_t i = 0; i < RAYS; i++) {
        double largest = 0;
        assert_true(b.hits[i].hit && back.hits[i].hit && !b.hits[i].flags && back.hits[i].flags == DF_HIT_BACK);
        for (int a = 0; a < 3; a++) largest = fmax(largest, fabs(b.directions[3 * i + (uint32_t)a]));
        assert_true(fabs(b.hits[i].t + back.hits[i].t - largest) < 2e-5); /* directions are rounded to float */
    }
    bundle_close(&b);
    bundle_close(&back);
    df_field_free(&field);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(t13_a_crossing_on_a_face_belongs_to_one_of_its_cells),
        cmocka_unit_test(t14_a_box_on_grid_planes_is_hit_by_every_solve),
        cmocka_unit_test(t18_scaling_a_field_changes_nothing),
        cmocka_unit_test(t19_a_far_origin_costs_nothing),
        cmocka_unit_test(t21_rays_in_the_faces_of_the_box_are_traced),
        cmocka_unit_test(t23_rays_near_the_edges_of_a_small_box_enter_it),
        cmocka_unit_test(t24_rays_that_are_none_are_refused),
        cmocka_unit_test(t25_long_walks_do_not_drift),
        cmocka_unit_test(t30_hits_of_rays_in_the_surface_lie_on_it),
        cmocka_unit_test(t31_rays_that_leave_the_surface_do_not_hit_it_again),
        cmocka_unit_test(t32_normals_are_always_unit_vectors),
        cmocka_unit_test(t34_planar_faces_at_odd_angles_are_solved),
        cmocka_unit_test(t35_quantised_samples_are_solved),
        cmocka_unit_test(t36_few_steps_lose_accuracy_and_no_hits),
        cmocka_unit_test(t38_sample_counts_are_64_bit),
        cmocka_unit_test(t39_a_world_offset_is_subtracted_in_double),
        cmocka_unit_test(t42_a_ray_in_the_upper_grid_plane_is_clamped),
        cmocka_unit_test(t44_a_ray_that_starts_inside_hits_where_it_leaves),
        cmocka_unit_test(t45_the_length_of_a_direction_does_not_matter),
        cmocka_unit_test(t46_tiny_full_and_empty_fields_are_no_trouble),
        cmocka_unit_test(t47_a_negative_zero_is_outside),
        cmocka_unit_test(t48_the_48_symmetries_of_the_cube_give_the_same_hits),
        cmocka_unit_test(t49_a_reversed_ray_hits_the_same_place),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
