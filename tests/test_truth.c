/* The truth in quad precision against arbitrary precision, and against what is known by hand. */
#include "lab/random.h"
#include "lab/truth.h"

#include <mpfr.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

#include <cmocka.h>

#include "fields.h"

#define CUBIC_COUNT 100000
#define BITS 1000       /* all sums and products below are then exact; only the roots of the derivative are rounded */
#define ERROR_MAX 1e-28 /* voxels */
#define VALUE_MAX 1e-29
#define ZERO_BITS \
    600 /* an extremum is a touch below this part of the largest corner: far above its rounding, squared */

/* What MPFR says of a ray in a voxel: its polynomial in t and the points between which it is monotone. */
typedef struct exact {
    mpfr_t c[4], stop[4], zero, work[4];
    int stop_count;
} exact;

static void exact_init(exact *x) {
    for (int i = 0; i < 4; i++) mpfr_inits2(BITS, x->c[i], x->stop[i], x->work[i], (mpfr_ptr)NULL);
    mpfr_init2(x->zero, BITS);
}

static void exact_clear(exact *x) {
    for (int i = 0; i < 4; i++) mpfr_clears(x->c[i], x->stop[i], x->work[i], (mpfr_ptr)NULL);
    mpfr_clear(x->zero);
}

static void exact_value(exact *x, mpfr_t out, mpfr_t t) {
    mpfr_set(out, x->c[3], MPFR_RNDN);
    for (int i = 2; i >= 0; i--) mpfr_fma(out, out, t, x->c[i], MPFR_RNDN);
}

static bool exact_inside(exact *x, mpfr_t t) {
    mpfr_t value;
    mpfr_init2(value, BITS);
    exact_value(x, value, t);
    mpfr_add(value, value, x->zero, MPFR_RNDN);
    bool inside = mpfr_sgn(value) < 0;
    mpfr_clear(value);
    return inside;
}

/* The polynomial: the sum over corners of value * (three factors, each linear in t). */
static void exact_polynomial(exact *x, const float corners[8], const double origin[3], const double direction[3]) {
    mpfr_t low, high;
    mpfr_inits2(BITS, low, high, (mpfr_ptr)NULL);
    mpfr_set_ui(x->zero, 0, MPFR_RNDN);
    for (int i = 0; i < 4; i++) mpfr_set_ui(x->c[i], 0, MPFR_RNDN);
    for (int corner = 0; corner < 8; corner++) {
        mpfr_set_flt(x->work[0], corners[corner], MPFR_RNDN);
        for (int i = 1; i < 4; i++) mpfr_set_ui(x->work[i], 0, MPFR_RNDN);
        for (int a = 0; a < 3; a++) {
            bool upper = corner >> a & 1; /* (o + t d) or (1 - o) - t d */
            mpfr_set_d(low, origin[a], MPFR_RNDN);
            mpfr_set_d(high, upper ? direction[a] : -direction[a], MPFR_RNDN);
            if (!upper) mpfr_ui_sub(low, 1, low, MPFR_RNDN);
            for (int i = a + 1; i >= 0; i--) {
                mpfr_mul(x->work[i], x->work[i], low, MPFR_RNDN);
                if (i > 0) mpfr_fma(x->work[i], x->work[i - 1], high, x->work[i], MPFR_RNDN);
            }
        }
        for (int i = 0; i < 4; i++) mpfr_add(x->c[i], x->c[i], x->work[i], MPFR_RNDN);
        mpfr_set_flt(low, corners[corner], MPFR_RNDN);
        mpfr_abs(low, low, MPFR_RNDN);
        mpfr_max(x->zero, x->zero, low, MPFR_RNDN);
    }
    mpfr_div_2ui(x->zero, x->zero, ZERO_BITS, MPFR_RNDN);
    mpfr_clears(low, high, (mpfr_ptr)NULL);
}

/* Clips to the unit box; false where nothing is left. */
static bool exact_clip(const double origin[3], const double direction[3], mpfr_t t_in, mpfr_t t_out) {
    mpfr_t low, high;
    bool meets = true;
    mpfr_inits2(BITS, low, high, (mpfr_ptr)NULL);
    mpfr_set_ui(t_in, 0, MPFR_RNDN);
    mpfr_set_inf(t_out, 1);
    for (int a = 0; a < 3; a++) {
        if (direction[a] == 0) {
            meets = meets && origin[a] >= 0 && origin[a] <= 1;
            continue;
        }
        mpfr_set_d(low, direction[a] > 0 ? 0 : 1, MPFR_RNDN);
        mpfr_ui_sub(high, 1, low, MPFR_RNDN);
        mpfr_sub_d(low, low, origin[a], MPFR_RNDN);
        mpfr_sub_d(high, high, origin[a], MPFR_RNDN);
        mpfr_div_d(low, low, direction[a], MPFR_RNDN);
        mpfr_div_d(high, high, direction[a], MPFR_RNDN);
        mpfr_max(t_in, t_in, low, MPFR_RNDN);
        mpfr_min(t_out, t_out, high, MPFR_RNDN);
    }
    mpfr_clears(low, high, (mpfr_ptr)NULL);
    return meets && mpfr_less_p(t_in, t_out);
}

/* Adds the derivative's roots between the first stop and t_out, in order, then t_out. */
static void exact_stops(exact *x, mpfr_t t_out) {
    mpfr_t a, b, disc, root[2];
    mpfr_inits2(BITS, a, b, disc, root[0], root[1], (mpfr_ptr)NULL);
    x->stop_count = 1;
    mpfr_mul_ui(a, x->c[3], 3, MPFR_RNDN);
    mpfr_sqr(disc, x->c[2], MPFR_RNDN);
    mpfr_mul(b, a, x->c[1], MPFR_RNDN);
    mpfr_sub(disc, disc, b, MPFR_RNDN);
    if (mpfr_sgn(disc) > 0) {
        mpfr_sqrt(disc, disc, MPFR_RNDN);
        if (mpfr_sgn(x->c[2]) < 0) mpfr_neg(disc, disc, MPFR_RNDN);
        mpfr_add(b, x->c[2], disc, MPFR_RNDN);
        mpfr_neg(b, b, MPFR_RNDN);
        mpfr_div(root[0], x->c[1], b, MPFR_RNDN); /* b is not 0: the root of disc was added away from 0 */
        mpfr_div(root[1], b, a, MPFR_RNDN);       /* infinite for a quadratic: outside */
        if (mpfr_greater_p(root[0], root[1])) mpfr_swap(root[0], root[1]);
        for (int i = 0; i < 2; i++) {
            if (mpfr_greater_p(root[i], x->stop[0]) && mpfr_less_p(root[i], t_out))
                mpfr_set(x->stop[x->stop_count++], root[i], MPFR_RNDN);
        }
    }
    mpfr_set(x->stop[x->stop_count++], t_out, MPFR_RNDN);
    mpfr_clears(a, b, disc, root[0], root[1], (mpfr_ptr)NULL);
}

/* True when t is a crossing of the monotone part [low, high] to within `error`; or, where several roots fall together
 * and no rounded polynomial has its root there, when the value at t is below `value_max` of the largest corner. */
static bool exact_confirms(exact *x, mpfr_t low, mpfr_t high, df_quad t, double error, double value_max) {
    mpfr_t at, before, after, value;
    mpfr_inits2(BITS, at, before, after, value, (mpfr_ptr)NULL);
    const double head = (double)t;
    const double tail = (double)(t - (df_quad)head), rest = (double)(t - (df_quad)head - (df_quad)tail);
    mpfr_set_d(at, head, MPFR_RNDN);
    mpfr_add_d(at, at, tail, MPFR_RNDN);
    mpfr_add_d(at, at, rest, MPFR_RNDN);
    mpfr_sub_d(before, at, error, MPFR_RNDN);
    mpfr_add_d(after, at, error, MPFR_RNDN);
    mpfr_max(before, before, low, MPFR_RNDN);
    mpfr_min(after, after, high, MPFR_RNDN);
    bool fits = mpfr_lessequal_p(before, after) && exact_inside(x, before) != exact_inside(x, after);
    exact_value(x, value, at);
    mpfr_div(value, value, x->zero, MPFR_RNDN);
    mpfr_div_2ui(value, value, ZERO_BITS, MPFR_RNDN);
    fits = fits || fabs(mpfr_get_d(value, MPFR_RNDN)) < value_max;
    mpfr_clears(at, before, after, value, (mpfr_ptr)NULL);
    return fits;
}

typedef struct tally {
    uint64_t hits, backs, tangents, class_differences, position_differences;
} tally;

static void compare(exact *x, const float corners[8], const double origin[3], const double direction[3], tally *sum) {
    df_truth truth;
    mpfr_t t_out;
    mpfr_init2(t_out, BITS);
    df_truth_trace_voxel(corners, origin, direction, &truth);
    bool hit = false, back = false;
    int last = 0;
    if (exact_clip(origin, direction, x->stop[0], t_out)) {
        exact_polynomial(x, corners, origin, direction);
        exact_stops(x, t_out);
        back = exact_inside(x, x->stop[0]);
        for (last = 1; last < x->stop_count && !hit; last++) hit = exact_inside(x, x->stop[last]) != back;
    }
    sum->hits += hit;
    sum->backs += hit && back;
    sum->tangents += truth.tangent;
    sum->class_differences += hit != truth.hit || (hit && back != truth.back);
    if (hit && truth.hit && !truth.tangent) {
        double length = sqrt(direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2]);
        sum->position_differences +=
            !exact_confirms(x, x->stop[last - 2], x->stop[last - 1], truth.t, ERROR_MAX / length, VALUE_MAX);
    }
    mpfr_clear(t_out);
}

/* A multiple of 1/16 in [0,1]: products of a few of them are exact in float. */
static double dyadic(uint64_t *seed) { return lab_random_index(seed, 17) / 16.0; }

static void make_corners(uint64_t *seed, uint32_t family, float corners[8]) {
    const double a = dyadic(seed), b = dyadic(seed), c = dyadic(seed),
                 gap = ldexp(lab_random_index(seed, 3) - 1.0, -(int)lab_random_index(seed, 40));
    const double scale = pow(10, lab_random_index(seed, 41) - 20.0);
    for (int i = 0; i < 8; i++) {
        const double x = i & 1, y = i >> 1 & 1, z = i >> 2, r = lab_random(seed, -1, 1);
        switch (family) {
        case 0: corners[i] = (float)r; break;
        case 1: corners[i] = (float)(lab_random_index(seed, 3) - 1.0); break;        /* exact zeros and plateaus */
        case 2: corners[i] = (float)((x - a) * (y - b) - gap); break;                /* nearly or exactly touching */
        case 3: corners[i] = (float)((x - a) * (y - b) * (z - c) - gap); break;      /* three roots */
        case 4: corners[i] = (float)(a * x + b * y + c * z - 0.5 + 1e-7 * r); break; /* almost a plane */
        case 5: corners[i] = (float)(scale * (x - a) * (y - b) * (z - c) + 1e-3 * scale * r); break;
        case 6: corners[i] = (float)((lab_random_index(seed, 9) - 4.0) / 64); break; /* 8-bit samples */
        default: corners[i] = (float)(1e6 + 1e-1 * r) - 1e6f; break;
        }
    }
}

static void make_ray(uint64_t *seed, uint32_t family, double origin[3], double direction[3]) {
    double target[3];
    for (int a = 0; a < 3; a++) {
        origin[a] = family & 1 ? dyadic(seed) : lab_random(seed, -0.5, 1.5);
        target[a] = family & 1 ? dyadic(seed) : lab_random(seed, 0, 1);
        direction[a] = target[a] - origin[a];
        if (family & 2) direction[a] = lab_random_index(seed, 3) - 1.0; /* axes and diagonals */
        if (family & 4) origin[a] -= 1000 * direction[a];
    }
    if (direction[0] == 0 && direction[1] == 0 && direction[2] == 0) direction[lab_random_index(seed, 3)] = 1;
}

static void truth_agrees_with_arbitrary_precision(void **state) {
    (void)state;
    tally sum = {0};
#pragma omp parallel
    {
        exact x;
        tally mine = {0};
        exact_init(&x);
#pragma omp for
        for (uint32_t i = 0; i < CUBIC_COUNT; i++) {
            uint64_t seed = 20261122 + 1000003ull * i;
            float corners[8];
            double origin[3], direction[3];
            make_corners(&seed, i % 8, corners);
            make_ray(&seed, i / 8 % 8, origin, direction);
            compare(&x, corners, origin, direction, &mine);
        }
#pragma omp critical
        {
            sum.hits += mine.hits;
            sum.backs += mine.backs;
            sum.tangents += mine.tangents;
            sum.class_differences += mine.class_differences;
            sum.position_differences += mine.position_differences;
        }
        exact_clear(&x);
    }
    print_message("%d cubics: %d hits, %d of them from inside, %d in the tangent band; %d classes differ, %d positions "
                  "by more than %g\n",
                  CUBIC_COUNT, (int)sum.hits, (int)sum.backs, (int)sum.tangents, (int)sum.class_differences,
                  (int)sum.position_differences, ERROR_MAX);
    assert_true(sum.hits > CUBIC_COUNT / 4 && sum.backs > CUBIC_COUNT / 16);
    assert_int_equal(sum.class_differences, 0);
    assert_int_equal(sum.position_differences, 0);
}

/* (x - a)(y - b) - gap in a voxel */
static void saddle(double a, double b, double gap, float corners[8]) {
    for (int i = 0; i < 8; i++) corners[i] = (float)(((i & 1) - a) * ((i >> 1 & 1) - b) - gap);
}

static void a_touch_is_a_miss_and_tangent(void **state) {
    (void)state;
    float corners[8];
    df_truth truth;
    saddle(0.5, 0.5, 0, corners);
    df_truth_trace_voxel(corners, (double[]){0, 0, 0.5}, (double[]){1, 1, 0}, &truth);
    assert_false(truth.hit);
    assert_true(truth.tangent);
}

static void a_pair_of_crossings_is_found_down_to_the_last_bit_of_a_float(void **state) {
    (void)state;
    for (int k = 4; k <= 25; k++) {
        float corners[8];
        df_truth truth;
        saddle(0.5, 0.5, ldexp(1, -k), corners);
        df_truth_trace_voxel(corners, (double[]){0, 0, 0.5}, (double[]){1, 1, 0}, &truth);
        assert_true(truth.hit);
        assert_false(truth.back);
        assert_false(truth.tangent);
        assert_true(fabs((double)truth.t - (0.5 - ldexp(sqrt(k % 2 ? 0.5 : 1), -k / 2))) < 1e-15);
    }
}

static void a_plateau_is_a_miss(void **state) {
    (void)state;
    const float corners[8] = {0};
    df_truth truth;
    df_truth_trace_voxel(corners, (double[]){-1, 0.25, 0.5}, (double[]){1, 0.1, 0}, &truth);
    assert_false(truth.hit);
    assert_true(truth.tangent);
}

static double plane_at_one(const double grid[3], const void *context) {
    (void)context;
    return 1 - grid[0];
}

static void a_crossing_on_a_face_is_found_from_both_sides(void **state) {
    (void)state;
    df_field field = {0};
    df_truth truth;
    const uint32_t voxels[3] = {2, 2, 2};
    assert_int_equal(test_field_from_function(&field, DF_FIELD_DENSE, 0, voxels, plane_at_one, NULL, NULL), DF_OK);
    df_truth_trace(&field, 0, (double[]){-1, 0.5, 0.5}, (double[]){1, 0, 0}, &truth);
    assert_true(truth.hit && !truth.back && !truth.tangent && truth.t == 2);
    df_truth_trace(&field, 0, (double[]){3, 0.5, 0.5}, (double[]){-1, 0, 0}, &truth);
    assert_true(truth.hit && truth.back && !truth.tangent && truth.t == 2);
    df_field_free(&field);
}

/* Every structure holds the same surface where the surface is. */
static void structures_agree(void **state) {
    (void)state;
    df_field fields[4] = {{0}};
    const uint32_t voxels[3] = {32, 32, 32};
    assert_int_equal(test_field_sphere(&fields[0], DF_FIELD_DENSE, 0, voxels, 10, NULL), DF_OK);
    assert_int_equal(test_field_sphere(&fields[1], DF_FIELD_BRICKS, 4, voxels, 10, NULL), DF_OK);
    assert_int_equal(test_field_sphere(&fields[2], DF_FIELD_BRICKS, 8, voxels, 10, NULL), DF_OK);
    assert_int_equal(test_field_sphere(&fields[3], DF_FIELD_ADF, 0, voxels, 10, NULL), DF_OK);
    uint64_t seed = 5;
    int hits = 0;
    for (int i = 0; i < 2000; i++) {
        double origin[3], direction[3];
        df_truth truth[4];
        lab_random_direction(&seed, direction);
        for (int a = 0; a < 3; a++) origin[a] = 16 - 40 * direction[a] + lab_random(&seed, -11, 11);
        for (int f = 0; f < 4; f++) df_truth_trace(&fields[f], 0, origin, direction, &truth[f]);
        if (truth[0].tangent) continue;
        hits += truth[0].hit;
        for (int f = 1; f < 4; f++) {
            assert_int_equal(truth[f].hit, truth[0].hit);
            if (!truth[0].hit) continue;
            assert_true(fabs((double)(truth[f].t - truth[0].t)) < 1e-28);
            assert_true(df_truth_residual(&fields[f], 0, origin, direction, (double)truth[f].t) < 1e-14);
        }
    }
    assert_true(hits > 500);
    for (int f = 0; f < 4; f++) df_field_free(&fields[f]);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(truth_agrees_with_arbitrary_precision),
        cmocka_unit_test(a_touch_is_a_miss_and_tangent),
        cmocka_unit_test(a_pair_of_crossings_is_found_down_to_the_last_bit_of_a_float),
        cmocka_unit_test(a_plateau_is_a_miss),
        cmocka_unit_test(a_crossing_on_a_face_is_found_from_both_sides),
        cmocka_unit_test(structures_agree),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
