/* Gradients: continuity, edges, and that structures do not matter. */
#include "fields.h"
#include "render/frame.h"
#include "render/methods/filter.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIDE = 24 };
static const uint32_t counts[3] = {SIDE, SIDE, SIDE};
static const float unit[3] = {1, 1, 1};

/* Bumps in all directions, nowhere near a distance. */
static double bumps(const double p[3], const void *context) {
    (void)context;
    return sin(1.3 * p[0]) + cos(0.9 * p[1] + 0.4 * p[0]) * sin(1.1 * p[2]) + 0.1 * (p[0] - SIDE / 2);
}

/* A box turned about two axes; its exact distance. */
static void turn(const double p[3], double q[3]) {
    const double c = cos(0.5), s = sin(0.5), x = p[0] - 12.1, y = p[1] - 11.8, z = p[2] - 12.3;
    const double u = c * x - s * y, v = s * x + c * y;
    q[0] = c * u + s * z;
    q[1] = v;
    q[2] = c * z - s * u;
}

static double turned_box(const double p[3], const void *context) {
    (void)context;
    double q[3], outside = 0, inside = -1e9;
    turn(p, q);
    for (int a = 0; a < 3; a++) {
        const double beyond = fabs(q[a]) - 6.5;
        outside += fmax(beyond, 0) * fmax(beyond, 0);
        inside = fmax(inside, beyond);
    }
    return sqrt(outside) + fmin(inside, 0);
}

static void open_scene(df_field *field, df_scene *scene, df_field_kind kind, uint32_t k, test_function function) {
    const df_scene_options options = {0};
    df_error err;
    memset(field, 0, sizeof *field);
    if (test_field_from_function(field, kind, k, counts, function, NULL, &err)) fail_msg("%s", err.text);
    if (df_scene_prepare(field, 0, &options, scene, &err)) fail_msg("%s", err.text);
}

static void close_scene(df_field *field, df_scene *scene) {
    df_scene_free(scene);
    df_field_free(field);
}

/* The gradient at a point, seen from a voxel that holds it. */
static void gradient_at(const df_scene *scene, int method, const uint32_t voxel[3], const float local[3],
                        float gradient[3]) {
    float stencil[64];
    df_scene_stencil(scene, voxel, 0, DF_REACH_ALL, stencil, 1);
    df_gradient(method, stencil, local, unit, gradient);
}

static void c0_does_not_jump_between_voxels(void **unused) {
    (void)unused;
    df_field field;
    df_scene scene;
    float analytic_jump = 0;
    open_scene(&field, &scene, DF_FIELD_DENSE, 0, bumps);
    for (uint32_t i = 0; i < 3000; i++) {
        const uint32_t axis = i % 3;
        uint32_t voxel[3] = {1 + i * 7 % (SIDE - 3), 1 + i * 11 % (SIDE - 3), 1 + i * 13 % (SIDE - 3)};
        float local[3] = {(float)(i * 17 % 101) / 100, (float)(i * 29 % 101) / 100, (float)(i * 37 % 101) / 100};
        for (int method = DF_GRADIENT_ANALYTIC; method <= DF_GRADIENT_C0; method += DF_GRADIENT_C0) {
            float before[3], after[3];
            local[axis] = 1;
            gradient_at(&scene, method, voxel, local, before);
            local[axis] = 0;
            voxel[axis]++;
            gradient_at(&scene, method, voxel, local, after);
            voxel[axis]--;
            for (int a = 0; a < 3; a++) {
                const float jump = fabsf(before[a] - after[a]);
                if (method == DF_GRADIENT_ANALYTIC) analytic_jump = fmaxf(analytic_jump, jump);
                else if (jump > 2e-6f) fail_msg("a jump of %g", (double)jump);
            }
        }
        /* also where the cells that are blended change, half way through a voxel */
        float before[3], after[3];
        local[axis] = 0.5f;
        gradient_at(&scene, DF_GRADIENT_C0, voxel, local, after);
        local[axis] = nextafterf(0.5f, 0);
        gradient_at(&scene, DF_GRADIENT_C0, voxel, local, before);
        for (int a = 0; a < 3; a++) assert_true(fabsf(before[a] - after[a]) < 2e-6f);
    }
    assert_true(analytic_jump > 0.1f);
    close_scene(&field, &scene);
}

/* All methods are exact where the field is linear; c0 and crease also at the ends of the field. */
static double slope(const double p[3], const void *context) {
    (void)context;
    return 0.36 * p[0] + 0.48 * p[1] + 0.8 * p[2] - 17.25;
}

static void linear_fields_have_one_gradient(void **unused) {
    (void)unused;
    df_field field;
    df_scene scene;
    open_scene(&field, &scene, DF_FIELD_DENSE, 0, slope);
    for (uint32_t i = 0; i < 27; i++) {
        const uint32_t at[3] = {0, SIDE / 2, SIDE - 1}, voxel[3] = {at[i % 3], at[i / 3 % 3], at[i / 9]};
        for (int method = 0; method < DF_GRADIENT_COUNT; method++) {
            float gradient[3];
            gradient_at(&scene, method, voxel, (const float[]){0.2f, 0.5f, 0.9f}, gradient);
            for (int a = 0; a < 3; a++)
                assert_true(fabs((double)gradient[a] - (const double[]){0.36, 0.48, 0.8}[a]) < 2e-5);
        }
    }
    close_scene(&field, &scene);
}

/* Mean angle between a method's gradient and the nearest face's normal, over the hits of a box near its edges. */
static double box_error(const df_scene *scene, int method) {
    double sum = 0;
    uint32_t count = 0;
    for (uint32_t i = 0; i < SIDE * SIDE * SIDE; i++) {
        const uint32_t voxel[3] = {i % SIDE, i / SIDE % SIDE, i / SIDE / SIDE};
        float corner[8], gradient[3], ahead[3];
        double q[3], cosine = 0, length = 0;
        df_scene_corners(scene, voxel, 0, corner);
        if (!df_corners_straddle(corner, 0)) continue;
        const double p[3] = {voxel[0] + 0.5, voxel[1] + 0.5, voxel[2] + 0.5};
        turn(p, q);
        const double x = fabs(q[0]), y = fabs(q[1]), z = fabs(q[2]);
        const int face = x > y && x > z ? 0 : y > z ? 1 : 2;
        const double second = face == 0 ? fmax(y, z) : face == 1 ? fmax(x, z) : fmax(x, y);
        if (second > 6.2 || second < 4) continue; /* on one face, within 2.5 voxels of an edge */
        gradient_at(scene, method, voxel, (const float[]){0.5f, 0.5f, 0.5f}, gradient);
        for (int a = 0; a < 3; a++) { /* the face's normal by differences of |q| */
            double moved[3] = {p[0], p[1], p[2]}, r[3];
            moved[a] += 1e-4;
            turn(moved, r);
            ahead[a] = (float)((fabs(r[face]) - fabs(q[face])) / 1e-4);
            cosine += (double)gradient[a] * (double)ahead[a];
            length += (double)gradient[a] * (double)gradient[a];
        }
        sum += acos(fmin(1, cosine / sqrt(length)));
        count++;
    }
    assert_true(count > 100);
    return sum / count * 180 / M_PI;
}

/* The 8 samples of a stencil whose lower corner is at `low`, interpolated at p, in double and term by term. */
static double interpolated(const float stencil[64], const int low[3], const float p[3]) {
    double sum = 0;
    for (int c = 0; c < 8; c++) {
        double weight = 1;
        for (int a = 0; a < 3; a++) weight *= c >> a & 1 ? (double)p[a] : 1 - (double)p[a];
        sum += weight * (double)stencil[DF_STENCIL(low[0] + (c & 1), low[1] + (c >> 1 & 1), low[2] + (c >> 2))];
    }
    return sum;
}

/* Central, forward and backward: differences of values a voxel apart, along each axis its own. */
static void differences_are_those_of_interpolated_values(void **unused) {
    (void)unused;
    static const struct {
        int method, before, after;
    } cases[] = {{DF_GRADIENT_CENTRAL, 1, 1}, {DF_GRADIENT_FORWARD, 0, 1}, {DF_GRADIENT_BACKWARD, 1, 0}};
    uint32_t state = 1;
    for (int n = 0; n < 300; n++) {
        float stencil[64], p[3], gradient[3];
        for (int i = 0; i < 64; i++)
            stencil[i] = (float)((state = state * 1664525 + 1013904223) >> 8) / 16777216 - 0.5f;
        for (int a = 0; a < 3; a++) p[a] = (float)((state = state * 1664525 + 1013904223) >> 8) / 16777216;
        for (int m = 0; m < 3; m++) {
            df_gradient(cases[m].method, stencil, p, (const float[]){1, 1, 1}, gradient);
            for (int a = 0; a < 3; a++) {
                int low[3] = {0, 0, 0}, high[3] = {0, 0, 0};
                low[a] = -cases[m].before;
                high[a] = cases[m].after;
                const double exact = (interpolated(stencil, high, p) - interpolated(stencil, low, p)) /
                                     (cases[m].before + cases[m].after);
                if (fabs((double)gradient[a] - exact) > 1e-6)
                    fail_msg("method %d, axis %d: %g instead of %g", cases[m].method, a, (double)gradient[a], exact);
            }
        }
    }
}

static void crease_is_nearer_to_the_faces_of_a_box(void **unused) {
    (void)unused;
    df_field field;
    df_scene scene;
    open_scene(&field, &scene, DF_FIELD_DENSE, 0, turned_box);
    const double central = box_error(&scene, DF_GRADIENT_CORNER_CENTRAL),
                 crease = box_error(&scene, DF_GRADIENT_CREASE);
    printf("mean angle near edges: corner-central %.2f, crease %.2f degrees\n", central, crease);
    assert_true(crease < 0.7 * central);
    close_scene(&field, &scene);
}

/* Normals of every method in bricks are those in the dense field, bit for bit. */
static void bricks_have_the_gradients_of_the_dense_field(void **unused) {
    (void)unused;
    enum { W = 80, H = 60 };
    static const struct {
        df_field_kind kind;
        uint32_t k;
    } kinds[] = {{DF_FIELD_DENSE, 0}, {DF_FIELD_BRICKS, 8}, {DF_FIELD_BRICKS, 4}};
    for (int method = 0; method < DF_GRADIENT_COUNT; method++) {
        float normals[3][3 * W * H];
        for (int i = 0; i < 3; i++) {
            df_field field;
            df_scene scene;
            df_camera camera;
            df_view view;
            df_renderer *renderer;
            df_error err;
            open_scene(&field, &scene, kinds[i].kind, kinds[i].k, turned_box);
            df_camera_orbit(&field, 25, 35, 1.2, &camera);
            camera.fov_y = 1;
            df_frame_options options = {
                .tracer = &df_tracer_dda, .solve = DF_SOLVE_ROBUST, .gradient = method, .tile = 64, .threads = 1};
            if (df_kernels_select("auto", &options.kernels, &err)) fail_msg("%s", err.text);
            if (df_view_make(&camera, &field, W, H, &view, &err)) fail_msg("%s", err.text);
            if (df_renderer_open(&scene, &options, W, H, &renderer, &err)) fail_msg("%s", err.text);
            const df_picture picture = {.width = W, .height = H, .normals = normals[i]};
            if (df_renderer_frame(renderer, &view, &picture, NULL, &err)) fail_msg("%s", err.text);
            df_renderer_close(renderer);
            close_scene(&field, &scene);
            if (memcmp(normals[0], normals[i], sizeof normals[0]))
                fail_msg("%s, bricks of %u", df_gradient_names[method], kinds[i].k);
        }
    }
}

/* Catmull-Rom reproduces quadratics, the B-spline linear functions; both with their gradients. */
static void filters_are_exact_on_their_polynomials(void **unused) {
    (void)unused;
    for (int filter = DF_FILTER_CATMULL_ROM; filter < DF_FILTER_COUNT; filter++) {
        const double bend = filter == DF_FILTER_CATMULL_ROM ? 0.3 : 0;
        float stencil[64];
        for (int i = 0; i < 64; i++) {
            const double x = i % 4 - 1, y = i / 4 % 4 - 1, z = i / 16 - 1;
            stencil[i] = (float)(0.5 * x - 2 * y + z + bend * (x * x + 2 * y * z));
        }
        for (int n = 0; n < 125; n++) {
            const double p[3] = {n % 5 / 4.0, n / 5 % 5 / 4.0, n / 25 / 4.0};
            double gradient[3];
            const double value = df_filter_value(filter, stencil, p, gradient);
            const double exact[3] = {0.5 + 2 * bend * p[0], -2 + 2 * bend * p[2], 1 + 2 * bend * p[1]};
            assert_true(fabs(value - (0.5 * p[0] - 2 * p[1] + p[2] + bend * (p[0] * p[0] + 2 * p[1] * p[2]))) < 1e-6);
            for (int a = 0; a < 3; a++) assert_true(fabs(gradient[a] - exact[a]) < 1e-5);
        }
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(c0_does_not_jump_between_voxels),
        cmocka_unit_test(linear_fields_have_one_gradient),
        cmocka_unit_test(differences_are_those_of_interpolated_values),
        cmocka_unit_test(crease_is_nearer_to_the_faces_of_a_box),
        cmocka_unit_test(filters_are_exact_on_their_polynomials),
        cmocka_unit_test(bricks_have_the_gradients_of_the_dense_field),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
