/*
 * The stability cases that live in one voxel. Each case is a field given by a formula, a ray, the true position of the
 * first crossing, and for each cell solve what must happen there: that it holds, to a bound, or that it fails in the
 * documented way. A method that stops failing fails the test too: that is news. The default method, robust, holds in
 * all. Each is claimed in double and in float: in float every method hits and misses as in double, and robust is up to
 * 1.4e-2 voxel off where crossings nearly coincide (T05, T07).
 *
 * Positions are in voxels along the ray, t * |direction|. The bounds of the methods that hold only roughly are those
 * measured, rounded up; "off" is the least error that the failure has.
 */
#include "fields.h"
#include "lab/random.h"
#include "lab/truth.h"
#include "render/methods/solve_methods.h"
#include "tracing.h"

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"

#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>
#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

#include <cmocka.h>

typedef enum outcome { HOLDS, MISSES, OFF } outcome;
typedef struct expectation {
    outcome outcome;
    double bound; /* HOLDS: largest error; OFF: smallest */
} expectation;

/* In the order of DF_SOLVE_...: midpoint, linear, repeated, marmitt, analytic, robust. */
typedef struct expectations {
    expectation of[DF_SOLVE_COUNT];
} expectations;

typedef struct cell_case {
    const char *id;
    double (*value)(double x, double y, double z, double parameter);
    double parameter, scale; /* scale: of the whole field; 0: 1 */
    double origin[3], direction[3];
    double t;                      /* of the first crossing; negative: a miss is right, for every method */
    expectations expected, single; /* in double, in float; the closed form has no float: N */
} cell_case;

static double two_planes(double x, double y, double z, double p) {
    (void)z;
    (void)p;
    return (x - .4) * (y - .6);
}
static double three_planes(double x, double y, double z, double p) {
    (void)p;
    return (x - .2) * (y - .5) * (z - .8);
}
static double three_planes_near(double x, double y, double z, double p) {
    (void)p;
    return (x - .1) * (y - .35) * (z - .4);
}
static double saddle(double x, double y, double z, double gap) {
    (void)z;
    return (x - .5) * (y - .5) - gap;
}
static double triple(double x, double y, double z, double gap) { return (x - .5) * (y - .5) * (z - .5) - gap; }
static double hyperbola(double x, double y, double z, double p) {
    (void)p;
    return x * y * z - 1e-3;
}
static double plane(double x, double y, double z, double p) {
    (void)p;
    return .3 * x + .5 * y + .7 * z - .6;
}
static double small_cubic(double x, double y, double z, double r) { return -.35 + .5 * x + .4 * x * y + r * x * y * z; }
static double small_quadratic(double x, double y, double z, double p) {
    (void)z;
    (void)p;
    return x + 1e-6 * x * y - .5;
}
static double nothing(double x, double y, double z, double p) {
    (void)x;
    (void)y;
    (void)z;
    (void)p;
    return 0;
}

#define H(bound) \
    { HOLDS, bound }
#define M \
    { MISSES, 0 }
#define O(bound) \
    { OFF, bound }

#define N \
    { MISSES, 0 }

#include "stability_cells.h"

static void fill(const cell_case *c, float corners[8]) {
    const double scale = c->scale != 0 ? c->scale : 1;
    for (int i = 0; i < 8; i++) corners[i] = (float)(scale * c->value(i & 1, i >> 1 & 1, i >> 2, c->parameter)) + 0.0f;
}

static void one_voxel(const float corners[8], df_field *field) {
    *field = (df_field){.kind = DF_FIELD_DENSE,
                        .sample_type = DF_SAMPLE_F32,
                        .voxel_count = {1, 1, 1},
                        .voxel_size = {1, 1, 1},
                        .samples = corners};
    if (df_field_finish(field, "one voxel", NULL) != DF_OK) fail_msg("not a field");
}

/* Traces one ray through a field with the reference tracer. */
static test_hit trace_one(const df_field *field, float iso, int solve, int precision, const double origin[3],
                          const double direction[3]) {
    const df_scene_options options = {.levels = 1};
    df_scene scene;
    df_rays rays;
    df_error err;
    test_hit hit;
    if (df_scene_prepare(field, iso, &options, &scene, &err)) fail_msg("%s", err.text);
    if (test_trace(&df_tracer_dda, &df_kernels_scalar, &scene, solve, 0, precision, origin, direction, 1, &rays, &hit,
                   &err))
        fail_msg("%s", err.text);
    double largest = fmax(fabs(direction[0]), fmax(fabs(direction[1]), fabs(direction[2])));
    hit.t /= largest; /* back into units of the caller's direction */
    df_rays_free(&rays);
    df_scene_free(&scene);
    return hit;
}

static double length3(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

static int check(const cell_case *c, int solve, int precision) {
    const expectation *e = precision == DF_PRECISION_F32 ? &c->single.of[solve] : &c->expected.of[solve];
    float corners[8];
    df_field field;
    fill(c, corners);
    one_voxel(corners, &field);
    const test_hit hit = trace_one(&field, 0, solve, precision, c->origin, c->direction);
    df_truth truth; /* of the corners as they were rounded to float; c->t is that of the formula */
    df_truth_trace(&field, 0, c->origin, c->direction, &truth);
    assert_int_equal(truth.hit, c->t >= 0);
    if (truth.hit) assert_true(fabs((double)truth.t - c->t) < 1e-3);
    const double error = fabs((double)((df_quad)hit.t - truth.t)) * length3(c->direction);
    df_field_free(&field);
    bool as_expected;
    if (c->t < 0 || e->outcome == MISSES) as_expected = !hit.hit;
    else if (e->outcome == HOLDS) as_expected = hit.hit && error <= e->bound;
    else as_expected = hit.hit && error >= e->bound;
    if (as_expected) return 0;
    print_error("%s with %s %s: %s", c->id, df_solve_names[solve], df_precision_names[precision],
                hit.hit ? "" : "a miss");
    if (hit.hit) print_error("%g voxels off", error);
    print_error(", expected %s %g\n",
                e->outcome == MISSES || c->t < 0 ? "a miss"
                : e->outcome == HOLDS            ? "at most"
                                                 : "at least",
                e->bound);
    return 1;
}

static void every_case_in_a_voxel_is_as_documented(void **state) {
    (void)state;
    int wrong = 0;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
            wrong += check(&cases[i], solve, DF_PRECISION_F64);
            if (solve != DF_SOLVE_ANALYTIC) wrong += check(&cases[i], solve, DF_PRECISION_F32);
        }
        assert_true(cases[i].t < 0 || cases[i].expected.of[DF_SOLVE_ROBUST].outcome == HOLDS);
        assert_true(cases[i].t < 0 || cases[i].single.of[DF_SOLVE_ROBUST].outcome == HOLDS);
    }
    assert_int_equal(wrong, 0);
}

/* T17: nothing is flushed to zero, down to fields of subnormal numbers; where a caller has the processor flush, those
 * are lost. */
static void a_subnormal_field_is_traced_unless_the_processor_flushes(void **state) {
    (void)state;
    const cell_case tiny = {"T17",
                            two_planes,
                            0,
                            1e-40,
                            {0, 0, 0.5},
                            {1, 1, 0},
                            .4,
                            {{M, M, M, O(0.03), H(1e-4), H(1e-4)}},
                            {{M, M, M, O(0.03), N, H(1e-4)}}};
    const cell_case small = {"T17",
                             two_planes,
                             0,
                             1e-20,
                             {0, 0, 0.5},
                             {1, 1, 0},
                             .4,
                             {{M, M, M, O(0.03), H(1e-9), H(1e-9)}},
                             {{M, M, M, O(0.03), N, H(1e-6)}}};
    int wrong = 0;
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        wrong += check(&tiny, solve, DF_PRECISION_F64) + check(&small, solve, DF_PRECISION_F64);
        if (solve == DF_SOLVE_ANALYTIC) continue;
        wrong += check(&tiny, solve, DF_PRECISION_F32) + check(&small, solve, DF_PRECISION_F32);
    }
    assert_int_equal(wrong, 0);
#if defined(__SSE2__)
    const unsigned int before = _mm_getcsr();
    float corners[8];
    df_field field;
    fill(&tiny, corners);
    one_voxel(corners, &field);
    _mm_setcsr(before | 0x8040); /* flush to zero, denormals are zero */
    const test_hit flushed = trace_one(&field, 0, DF_SOLVE_ROBUST, DF_PRECISION_F64, tiny.origin, tiny.direction);
    const int still_right = check(&small, DF_SOLVE_ROBUST, DF_PRECISION_F64);
    _mm_setcsr(before);
    df_field_free(&field);
    assert_false(flushed.hit);
    assert_int_equal(still_right, 0);
#endif
}

/* T20: the iso value is subtracted from the corners before anything is computed with them. */
static void a_large_iso_value_costs_no_accuracy(void **state) {
    (void)state;
    const double origin[3] = {.1, .9, .9}, direction[3] = {.3, -.5, -.6};
    for (int k = 3; k <= 6; k++) {
        float corners[8];
        df_field field;
        df_truth truth;
        const float iso = powf(10, (float)k);
        for (int i = 0; i < 8; i++) corners[i] = (float)((double)iso + plane(i & 1, i >> 1 & 1, i >> 2, 0) - .2);
        one_voxel(corners, &field);
        df_truth_trace(&field, iso, origin, direction, &truth);
        assert_true(truth.hit);
        const test_hit hit = trace_one(&field, iso, DF_SOLVE_ROBUST, DF_PRECISION_F64, origin, direction);
        assert_true(hit.hit);
        assert_true(fabs(hit.t - (double)truth.t) < 1e-6); /* the ray itself is rounded to float */
        df_field_free(&field);
    }
}

/* T26: the convex form is exact at both ends, whatever the values. */
static void interpolation_is_exact_at_both_ends(void **state) {
    (void)state;
    const float pairs[][2] = {{0x1p24f, -.3f}, {FLT_MAX, -.3f}, {100, -1e-6f}, {-1e-40f, 1e30f}};
    for (int i = 0; i < 4; i++) {
        assert_true(df_lerp_f32(pairs[i][0], pairs[i][1], 0) == pairs[i][0]);
        assert_true(df_lerp_f32(pairs[i][0], pairs[i][1], 1) == pairs[i][1]);
        assert_true(df_trilinear((float[]){pairs[i][0], pairs[i][1], 0, 0, 0, 0, 0, 0}, (double[]){1, 0, 0}) ==
                    (double)pairs[i][1]);
    }
}

/* T27: no arithmetic survives an infinite corner, so no field with one comes into being. */
static void a_corner_that_is_not_finite_is_refused(void **state) {
    (void)state;
    const float bad[] = {INFINITY, -INFINITY, NAN};
    for (int i = 0; i < 3; i++) {
        float corners[8] = {0, 1, 2, 3, bad[i], 1, 1, 1};
        df_field field = {.kind = DF_FIELD_DENSE,
                          .sample_type = DF_SAMPLE_F32,
                          .voxel_count = {1, 1, 1},
                          .voxel_size = {1, 1, 1},
                          .samples = corners};
        assert_int_equal(df_field_finish(&field, "bad", NULL), DF_ERROR_FORMAT);
        df_field_free(&field);
    }
}

/* T28: what a ray finds on the common face of two voxels is the same bits from both. */
static void both_voxels_of_a_face_see_the_same_value(void **state) {
    (void)state;
    uint64_t seed = 28;
    int compared = 0;
    for (int i = 0; i < 1000000; i++) {
        const int axis = i % 3, u = (axis + 1) % 3, v = (axis + 2) % 3;
        float corner[2][8], origin[3], direction[3], inverse[3], cell[2][3], bern[2][4];
        df_segment_f32 segment[2];
        double p[3] = {lab_random(&seed, 7, 9), lab_random(&seed, 7, 9), lab_random(&seed, 7, 9)};
        p[axis] = 8;
        for (int a = 0; a < 3; a++) {
            direction[a] = (float)lab_random(&seed, -1, 1);
            inverse[a] = 1.0f / direction[a];
            origin[a] = (float)(p[a] - 20 * (double)direction[a]);
            cell[0][a] = cell[1][a] = (float)floor(p[a]);
        }
        cell[direction[axis] > 0 ? 0 : 1][axis] = 7; /* the first voxel of the ray */
        cell[direction[axis] > 0 ? 1 : 0][axis] = 8;
        for (int c = 0; c < 8; c++) corner[0][c] = corner[1][c] = (float)lab_random(&seed, -1, 1);
        for (int c = 0; c < 4; c++) { /* the corners of the face */
            const int at = (c & 1) << u | (c >> 1) << v, upper = 1 << axis;
            const int first = cell[0][axis] < cell[1][axis] ? at | upper : at,
                      second = cell[0][axis] < cell[1][axis] ? at : at | upper;
            corner[1][second] = corner[0][first];
        }
        if (!df_cell_segment_f32(origin, direction, inverse, 0, cell[0], 1, &segment[0])) continue;
        if (!df_cell_segment_f32(origin, direction, inverse, 0, cell[1], 1, &segment[1])) continue;
        if (segment[0].t_out != segment[1].t_in) continue; /* the ray goes by another voxel */
        df_bernstein_f32(corner[0], segment[0].a, segment[0].b, bern[0]);
        df_bernstein_f32(corner[1], segment[1].a, segment[1].b, bern[1]);
        if (memcmp(&bern[0][3], &bern[1][0], sizeof(float)) != 0)
            fail_msg("face %d: %.9g and %.9g", i, (double)bern[0][3], (double)bern[1][0]);
        compared++;
    }
    assert_true(compared > 800000);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_case_in_a_voxel_is_as_documented),
        cmocka_unit_test(a_subnormal_field_is_traced_unless_the_processor_flushes),
        cmocka_unit_test(a_large_iso_value_costs_no_accuracy),
        cmocka_unit_test(interpolation_is_exact_at_both_ends),
        cmocka_unit_test(a_corner_that_is_not_finite_is_refused),
        cmocka_unit_test(both_voxels_of_a_face_see_the_same_value),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
