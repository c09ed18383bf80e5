/* The truth of meshes: watertight, and what marching cubes is worth against the trilinear surface (T40). */
#include "fields.h"
#include "lab/families.h"
#include "lab/mesh_truth.h"
#include "lab/random.h"
#include "lab/surface.h"
#include "render/mesh/marching_cubes.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static void rays_through_corners_and_edges_of_a_cube_hit_it(void **unused) {
    (void)unused;
    const double corners[24] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 0, 1, 1, 0, 1, 0, 1, 1, 1, 1, 1};
    const uint32_t faces[36] = {0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4,
                                2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5};
    lab_mesh *mesh;
    df_truth truth;
    assert_int_equal(lab_mesh_make(corners, 8, faces, 12, &mesh, NULL), DF_OK);
    for (int i = 0; i < 125; i++) { /* to a lattice of the surface's points: corners, edges, diagonals */
        const double target[3] = {i % 5 / 4.0, i / 5 % 5 / 4.0, i / 25 / 4.0};
        const bool on_surface = i % 5 % 4 == 0 || i / 5 % 5 % 4 == 0 || i / 25 % 4 == 0;
        const double origin[3] = {0.375, 0.5, 0.4375},
                     direction[3] = {target[0] - 0.375, target[1] - 0.5, target[2] - 0.4375};
        if (!on_surface) continue;
        lab_mesh_trace(mesh, origin, direction, &truth);
        assert_true(truth.hit && truth.back && fabs((double)truth.t - 1) < 1e-12);
        lab_mesh_trace(mesh, target, (double[]){-direction[0], -direction[1], -direction[2]}, &truth);
        lab_mesh_trace(mesh, (double[]){target[0] + direction[0], target[1] + direction[1], target[2] + direction[2]},
                       (double[]){-direction[0], -direction[1], -direction[2]}, &truth);
        assert_true(truth.hit && !truth.back && fabs((double)truth.t - 1) < 1e-12);
    }
    lab_mesh_free(mesh);
}

static void extract(const df_field *field, lab_mesh **mesh) {
    const df_mc_params params = {.skip_normals = true};
    df_mc_mesh triangles = {0};
    df_error err;
    if (df_mc_extract(field, "test", &params, &triangles, &err)) fail_msg("%s", err.text);
    if (lab_mesh_make(triangles.positions, triangles.vertex_count, triangles.triangles, triangles.triangle_count, mesh,
                      &err))
        fail_msg("%s", err.text);
    df_mc_mesh_free(&triangles);
}

static void nothing_escapes_from_an_extracted_mesh(void **unused) {
    (void)unused;
    const uint32_t count[3] = {40, 40, 40};
    const lab_surface surface = lab_surface_make(LAB_NOISE, 40, 2.5);
    df_field field = {0};
    lab_mesh *mesh;
    assert_int_equal(test_field_from_function(&field, DF_FIELD_DENSE, 8, count, surface.value, &surface, NULL), DF_OK);
    extract(&field, &mesh);
    for (uint64_t i = 0; i < 20000; i++) {
        double o[3], d[3];
        df_truth inside, truth;
        lab_family_ray(&field, LAB_INSIDE, LAB_SEED, i, o, d);
        df_truth_trace(&field, 0, o, d, &inside);
        lab_mesh_trace(mesh, o, d, &truth);
        if (inside.tangent || inside.t < 1) continue; /* the start may lie between the two surfaces */
        if (!truth.hit) fail_msg("ray %d escapes", (int)i);
    }
    lab_mesh_free(mesh);
    df_field_free(&field);
}

static int compare_doubles(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* T40: the distance of marching cubes from the trilinear surface falls with the radius only: for spheres of 3, 6, 12
 * and 24 voxels its median is 1.7e-2, 5.0e-3, 2.2e-3 and 1.1e-3 voxel and its largest 3.5e-2 to 4.6e-3, where the
 * default method has 1e-14. */
static void marching_cubes_is_off_by_what_its_facets_leave(void **unused) {
    (void)unused;
    const double radii[] = {3, 6, 12, 24};
    enum { RAYS = 20000 };
    double *off = malloc(RAYS * sizeof *off);
    for (int i = 0; i < 4; i++) {
        const uint32_t count[3] = {64, 64, 64};
        df_field field = {0};
        lab_mesh *mesh;
        uint64_t seed = 40;
        size_t hits = 0;
        assert_int_equal(test_field_sphere(&field, DF_FIELD_DENSE, 0, count, radii[i], NULL), DF_OK);
        extract(&field, &mesh);
        for (int r = 0; r < RAYS; r++) {
            double o[3], d[3];
            df_truth truth, facet;
            lab_random_direction(&seed, d);
            for (int a = 0; a < 3; a++) o[a] = 32 + radii[i] * lab_random(&seed, -0.55, 0.55) - 60 * d[a];
            df_truth_trace(&field, 0, o, d, &truth);
            lab_mesh_trace(mesh, o, d, &facet);
            if (truth.tangent || !truth.hit || !facet.hit) continue;
            off[hits++] = df_truth_residual(&field, 0, o, d, (double)facet.t);
        }
        qsort(off, hits, sizeof *off, compare_doubles);
        const double median = off[hits / 2] * radii[i], largest = off[hits - 1] * radii[i];
        if (hits < RAYS / 2 || median < 0.02 || median > 0.06 || largest < 0.09 || largest > 0.13) {
            fail_msg("radius %g: median %g, largest %g", radii[i], off[hits / 2], off[hits - 1]);
        }
        lab_mesh_free(mesh);
        df_field_free(&field);
    }
    free(off);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rays_through_corners_and_edges_of_a_cube_hit_it),
        cmocka_unit_test(nothing_escapes_from_an_extracted_mesh),
        cmocka_unit_test(marching_cubes_is_off_by_what_its_facets_leave),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
