/* Claims about marching cubes: render/mesh/marching_cubes.h. */
#include "common/memory.h"
#include "fields.h"
#include "mesh_check.h"
#include "mesh_judge.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <setjmp.h>
#include <stdarg.h>
#include <cmocka.h>

/* Hashed numbers: the same for a given seed and place. */
static uint64_t mix(uint64_t x) {
    x ^= x >> 33;
    x *= 0xff51afd7ed558ccdULL;
    x ^= x >> 33;
    x *= 0xc4ceb9fe1a85ec53ULL;
    return x ^ x >> 33;
}

typedef struct noise {
    uint64_t seed;
    uint32_t last; /* samples 0 and `last` are outside */
} noise;

static double noise_value(const double grid[3], const void *context) {
    const noise *n = context;
    uint64_t hash = n->seed * 0x9e3779b97f4a7c15ULL;
    for (int a = 0; a < 3; a++) {
        if (grid[a] == 0 || grid[a] == n->last) return 1;
        hash = mix(hash + (uint64_t)grid[a] + 1);
    }
    return (double)(hash >> 11) * 0x1p-52 - 1;
}

static void make_noise(df_field *field, df_field_kind kind, uint64_t seed, uint32_t samples) {
    uint32_t count = samples + 1; /* voxels: the samples and a layer outside */
    noise n = {seed, count};
    df_error err;
    assert_int_equal(
        test_field_from_function(field, kind, 8, (uint32_t[3]){count, count, count}, noise_value, &n, &err), DF_OK);
}

/* The eight samples in the middle of 4^3: context[0] at two opposite corners, context[1] at the others; 1e3 around. */
static double diagonal_cell(const double grid[3], const void *context) {
    const double *values = context;
    int upper = 0;
    for (int a = 0; a < 3; a++) {
        if (grid[a] == 0 || grid[a] == 3) return 1e3;
        upper += grid[a] == 2;
    }
    return values[upper != 0 && upper != 3];
}

static void extract(const df_field *field, df_mc_params params, df_mc_mesh *mesh) {
    df_error err = {0};
    if (df_mc_extract(field, "test", &params, mesh, &err) != DF_OK) fail_msg("%s", err.text);
}

static void assert_closed(const df_mc_mesh *mesh, const char *what) {
    mesh_check check = check_mesh(mesh);
    if (check.border_edges || check.crowded_edges || check.split_vertices || check.unused_vertices ||
        check.degenerate) {
        fail_msg("%s: %llu border, %llu crowded edges, %llu split, %llu unused vertices, %llu degenerate", what,
                 (unsigned long long)check.border_edges, (unsigned long long)check.crowded_edges,
                 (unsigned long long)check.split_vertices, (unsigned long long)check.unused_vertices,
                 (unsigned long long)check.degenerate);
    }
}

/* `full`: all that the bars ask for, for a slow test. */
static bool full;

static void random_fields_give_closed_manifolds(void **state) {
    (void)state;
    for (uint64_t seed = 0; seed < 1000; seed++) {
        df_field field;
        make_noise(&field, DF_FIELD_DENSE, seed, 16);
        for (int method = 0; method < 2; method++) {
            df_mc_mesh mesh;
            extract(&field, (df_mc_params){.method = (df_mc_method)method, .skip_normals = true}, &mesh);
            assert_closed(&mesh, method ? "classic" : "correct");
            if (method == DF_MC_CORRECT && (full || seed % 20 == 0)) /* by CGAL */
                assert_int_equal(judge_mesh(mesh.positions, mesh.vertex_count, mesh.triangles, mesh.triangle_count), 1);
            df_mc_mesh_free(&mesh);
        }
        df_field_free(&field);
    }
}

static void the_oracle_of_topology_knows_simple_solids(void **state) {
    (void)state;
    df_field field;
    df_error err;
    assert_int_equal(test_field_sphere(&field, DF_FIELD_DENSE, 0, (uint32_t[3]){16, 16, 16}, 5, &err), DF_OK);
    assert_int_equal(subdivided_euler(&field), 2);
    df_field_free(&field);
    /* A cell's corners: diagonal ones inside are two solids or, near enough to the surface, joined by a neck; the
     * opposite signs make a ball with or without a tunnel. */
    const struct {
        double corner, other;
        int64_t euler;
    } cells[] = {{-1, 4, 4}, {-4, 1, 2}, {1, -4, 2}, {4, -1, 0}};
    for (int i = 0; i < 4; i++) {
        double values[2] = {cells[i].corner, cells[i].other};
        assert_int_equal(
            test_field_from_function(&field, DF_FIELD_DENSE, 0, (uint32_t[3]){3, 3, 3}, diagonal_cell, values, &err),
            DF_OK);
        assert_int_equal(subdivided_euler(&field), cells[i].euler);
        df_field_free(&field);
    }
}

static void assert_euler(const df_field *field, const df_mc_mesh *mesh) {
    const int64_t euler = check_mesh(mesh).euler, expected = subdivided_euler(field);
    if (euler != expected)
        fail_msg("Euler characteristic %lld, by subdivision %lld", (long long)euler, (long long)expected);
}

static void euler_characteristic_is_that_of_the_trilinear_surface(void **state) {
    (void)state;
    for (uint64_t seed = 0; seed < (full ? 1000 : 60); seed++) {
        df_field field;
        df_mc_mesh mesh;
        make_noise(&field, DF_FIELD_DENSE, 5000 + seed, 16);
        extract(&field, (df_mc_params){.skip_normals = true}, &mesh);
        assert_euler(&field, &mesh);
        df_mc_mesh_free(&mesh);
        df_field_free(&field);
    }
}

/* An octree of 16^3 voxels, divided at random, over noise; hanging corners carry the coarser leaf's interpolated value.
 */
enum { ROOT = 16, LEVELS = 4, LATTICE = ROOT + 1 };
typedef struct random_tree {
    float values[LATTICE * LATTICE * LATTICE];
    uint64_t seed;
} random_tree;

static bool is_divided(const random_tree *tree, const uint32_t corner[3], uint32_t side) {
    uint64_t hash = mix(tree->seed + side);
    for (int a = 0; a < 3; a++) hash = mix(hash + corner[a] + 1);
    return side == ROOT || (side > 1 && hash % 100 < 55);
}

/* Interpolates within the leaves of one size; larger ones came before. */
static void impose(random_tree *tree, const uint32_t corner[3], uint32_t side, uint32_t leaf_side) {
    if (is_divided(tree, corner, side)) {
        for (uint32_t c = 0; c < 8 && side > leaf_side; c++) {
            uint32_t half = side / 2, child[3] = {corner[0] + (c & 1) * half, corner[1] + (c >> 1 & 1) * half,
                                                  corner[2] + (c >> 2) * half};
            impose(tree, child, half, leaf_side);
        }
        return;
    }
    if (side != leaf_side) return;
    float corners[8];
    for (uint32_t c = 0; c < 8; c++) {
        corners[c] =
            tree->values[corner[0] + (c & 1) * side +
                         LATTICE * (corner[1] + (c >> 1 & 1) * side + LATTICE * (corner[2] + (c >> 2) * side))];
    }
    for (uint32_t z = 0; z <= side; z++) {
        for (uint32_t y = 0; y <= side; y++) {
            for (uint32_t x = 0; x <= side; x++) {
                double local[3] = {(double)x / side, (double)y / side, (double)z / side};
                tree->values[corner[0] + x + LATTICE * (corner[1] + y + LATTICE * (corner[2] + z))] =
                    (float)df_trilinear(corners, local);
            }
        }
    }
}

static void make_random_tree(df_field *field, uint64_t seed) {
    enum { FAMILY_MAX = 1 + 8 + 64 + 512 };
    static random_tree tree;
    noise n = {seed, ROOT};
    tree.seed = seed;
    for (uint32_t i = 0; i < LATTICE * LATTICE * LATTICE; i++) {
        double grid[3] = {i % LATTICE, i / LATTICE % LATTICE, i / LATTICE / LATTICE};
        tree.values[i] = (float)noise_value(grid, &n);
    }
    for (uint32_t side = ROOT / 2; side > 1; side /= 2) impose(&tree, (uint32_t[3]){0}, ROOT, side);
    df_family *families = calloc(FAMILY_MAX, sizeof *families);
    float *samples = malloc((8 + FAMILY_MAX * DF_FAMILY_STORED_COUNT) * sizeof *samples);
    uint32_t(*corners)[4] = calloc(FAMILY_MAX, sizeof *corners), count = 1;
    corners[0][3] = ROOT;
    for (uint32_t f = 0; f < count; f++) {
        uint32_t half = corners[f][3] / 2;
        float family[27];
        for (uint32_t s = 0; s < 27; s++) {
            family[s] =
                tree.values[corners[f][0] + s % 3 * half +
                            LATTICE * (corners[f][1] + s / 3 % 3 * half + LATTICE * (corners[f][2] + s / 9 * half))];
        }
        df_family_store(family, f, samples);
        for (uint32_t c = 0; c < 8; c++) {
            uint32_t child[4] = {corners[f][0] + (c & 1) * half, corners[f][1] + (c >> 1 & 1) * half,
                                 corners[f][2] + (c >> 2) * half, half};
            if (!is_divided(&tree, child, half)) continue;
            families[f].states |= (uint32_t)DF_CHILD_FAMILY << 2 * c;
            memcpy(corners[count++], child, sizeof child);
        }
    }
    free(corners);
    *field = (df_field){.kind = DF_FIELD_ADF,
                        .sample_type = DF_SAMPLE_F32,
                        .voxel_count = {ROOT, ROOT, ROOT},
                        .voxel_size = {1, 1, 1},
                        .error_max = -1,
                        .error_rms = -1,
                        .samples = samples,
                        .families = families,
                        .family_count = count,
                        .level_count = LEVELS};
    df_field_own(field, families);
    df_field_own(field, samples);
    df_error err;
    if (df_field_finish(field, "random tree", &err) != DF_OK) fail_msg("%s", err.text);
}

static void levels_of_an_octree_meet_without_cracks(void **state) {
    (void)state;
    for (uint64_t seed = 0; seed < 200; seed++) {
        df_field field;
        df_mc_mesh mesh;
        make_random_tree(&field, seed);
        if (field.value_min >= 0) { /* coarse leaves on the border may have left nothing inside */
            df_field_free(&field);
            continue;
        }
        extract(&field, (df_mc_params){.skip_normals = seed % 2 == 0}, &mesh);
        assert_closed(&mesh, "octree");
        if (full || seed < 20) assert_euler(&field, &mesh);
        df_mc_mesh_free(&mesh);
        df_field_free(&field);
    }
}

static void assert_same_mesh(const df_mc_mesh *a, const df_mc_mesh *b) {
    assert_int_equal(a->vertex_count, b->vertex_count);
    assert_int_equal(a->triangle_count, b->triangle_count);
    assert_memory_equal(a->positions, b->positions, (size_t)a->vertex_count * 3 * sizeof *a->positions);
    assert_memory_equal(a->normals, b->normals, (size_t)a->vertex_count * 3 * sizeof *a->normals);
    assert_memory_equal(a->triangles, b->triangles, (size_t)a->triangle_count * 3 * sizeof *a->triangles);
}

static void bytes_are_the_same_for_any_thread_count(void **state) {
    (void)state;
    for (int kind = 0; kind < 4; kind++) {
        df_field field;
        df_mc_mesh mesh[3];
        df_error err;
        if (kind == 0) make_noise(&field, DF_FIELD_DENSE, 1, 30);
        if (kind == 1) make_random_tree(&field, 3);
        if (kind >= 2)
            assert_int_equal(
                test_field_sphere(&field, DF_FIELD_BRICKS, kind == 2 ? 8 : 4, (uint32_t[3]){61, 64, 67}, 24.3, &err),
                DF_OK);
        for (uint32_t i = 0; i < 3; i++) extract(&field, (df_mc_params){.thread_count = i == 2 ? 8 : i + 1}, &mesh[i]);
        assert_same_mesh(&mesh[0], &mesh[1]);
        assert_same_mesh(&mesh[0], &mesh[2]);
        for (int i = 0; i < 3; i++) df_mc_mesh_free(&mesh[i]);
        df_field_free(&field);
    }
}

/* Bricks number their vertices as the dense field's blocks do: only bricks without surface are missing. */
static void bricks_give_the_mesh_of_the_dense_field(void **state) {
    (void)state;
    df_field dense, bricks;
    df_mc_mesh a, b;
    df_error err;
    const uint32_t count[3] = {53, 48, 41};
    assert_int_equal(test_field_sphere(&dense, DF_FIELD_DENSE, 0, count, 19.7, &err), DF_OK);
    assert_int_equal(test_field_sphere(&bricks, DF_FIELD_BRICKS, 8, count, 19.7, &err), DF_OK);
    extract(&dense, (df_mc_params){0}, &a);
    extract(&bricks, (df_mc_params){0}, &b);
    assert_same_mesh(&a, &b);
    assert_closed(&a, "sphere");
    assert_int_equal(check_mesh(&a).euler, 2);
    df_mc_mesh_free(&a);
    df_mc_mesh_free(&b);
    df_field_free(&dense);
    df_field_free(&bricks);
}

/* Rounded samples, decoded block by block, and beyond a block for normals: the mesh is that of the values. */
static void quantised_fields_give_the_mesh_of_their_values(void **state) {
    (void)state;
    const df_sample_type types[] = {DF_SAMPLE_U16, DF_SAMPLE_U8};
    for (int i = 0; i < 4; i++) {
        df_field quantised, values;
        df_mc_mesh a, b;
        df_error err;
        const df_field_kind kind = i & 1 ? DF_FIELD_BRICKS : DF_FIELD_DENSE;
        const uint32_t count[3] = {29, 32, 27};
        assert_int_equal(test_field_sphere(&quantised, kind, 8, count, 9.3, &err), DF_OK);
        assert_int_equal(test_field_sphere(&values, kind, 8, count, 9.3, &err), DF_OK);
        assert_int_equal(test_field_quantise(&quantised, types[i >> 1], &err), DF_OK);
        float *decoded = (float *)values.samples;
        for (uint64_t s = 0; s < values.sample_count; s++) decoded[s] = df_field_decode(&quantised, s, -3);
        assert_int_equal(df_field_finish(&values, "values", &err), DF_OK);
        extract(&quantised, (df_mc_params){0}, &a);
        extract(&values, (df_mc_params){0}, &b);
        assert_same_mesh(&a, &b);
        assert_int_equal(check_mesh(&a).euler, 2);
        df_mc_mesh_free(&a);
        df_mc_mesh_free(&b);
        df_field_free(&quantised);
        df_field_free(&values);
    }
}

static double dense_value(const df_field *field, const double grid[3]) {
    uint32_t voxel[3];
    double local[3];
    float corners[8];
    for (int a = 0; a < 3; a++) {
        voxel[a] = (uint32_t)grid[a];
        if (voxel[a] == field->voxel_count[a]) voxel[a]--;
        local[a] = grid[a] - voxel[a];
    }
    df_field_corners(field, voxel, corners);
    return df_trilinear(corners, local);
}

static void vertices_lie_on_the_trilinear_surface(void **state) {
    (void)state;
    df_field field;
    df_mc_mesh mesh;
    make_noise(&field, DF_FIELD_DENSE, 77, 40);
    extract(&field, (df_mc_params){0}, &mesh);
    uint32_t on_edges = 0;
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        const double *p = mesh.positions + 3 * (size_t)v;
        int whole = 0, axis = 0;
        for (int a = 0; a < 3; a++) {
            whole += p[a] == floor(p[a]);
            if (p[a] != floor(p[a])) axis = a;
        }
        if (whole < 2) continue; /* within a voxel */
        /* Distance along the edge: |f| over the slope. */
        double low[3] = {p[0], p[1], p[2]}, high[3] = {p[0], p[1], p[2]};
        low[axis] = floor(p[axis]);
        high[axis] = low[axis] + 1;
        double slope = dense_value(&field, high) - dense_value(&field, low);
        assert_true(fabs(dense_value(&field, p)) <= 1e-6 * fabs(slope));
        on_edges++;
    }
    assert_true(on_edges > mesh.vertex_count / 2);
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        const float *n = mesh.normals + 3 * (size_t)v;
        assert_true(fabsf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] - 1) < 1e-5f);
    }
    df_mc_mesh_free(&mesh);
    df_field_free(&field);
}

static int compare_doubles(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Random points of the triangles, by area, against the trilinear surface: |f| over the gradient. */
static double median_sphere_error(df_field_kind kind, bool *outward) {
    enum { POINTS = 20000 };
    static double errors[POINTS];
    df_field field;
    df_mc_mesh mesh;
    df_error err;
    assert_int_equal(test_field_sphere(&field, kind, 8, (uint32_t[3]){64, 64, 64}, 24, &err), DF_OK);
    extract(&field, (df_mc_params){0}, &mesh);
    assert_closed(&mesh, "sphere");
    *outward = true;
    for (uint32_t i = 0; i < POINTS; i++) {
        uint64_t hash = mix(i + 1);
        const uint32_t *t = mesh.triangles + 3 * (size_t)(hash % mesh.triangle_count);
        double u = (double)(mix(hash) >> 11) * 0x1p-53, w = (double)(mix(hash + 1) >> 11) * 0x1p-53, p[3], out[3];
        double weight[3] = {1 - sqrt(u), sqrt(u) * (1 - w), sqrt(u) * w};
        for (int a = 0; a < 3; a++) {
            p[a] = 0;
            for (int k = 0; k < 3; k++) p[a] += weight[k] * mesh.positions[3 * (size_t)t[k] + (size_t)a];
            out[a] = p[a] - 32;
        }
        df_point_info info;
        df_field_query(&field, p, &info);
        const double *g = info.gradient;
        errors[i] = fabs(info.value) / sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
        double e[2][3];
        for (int a = 0; a < 3; a++) {
            e[0][a] = mesh.positions[3 * (size_t)t[1] + (size_t)a] - mesh.positions[3 * (size_t)t[0] + (size_t)a];
            e[1][a] = mesh.positions[3 * (size_t)t[2] + (size_t)a] - mesh.positions[3 * (size_t)t[0] + (size_t)a];
        }
        double facing = out[0] * (e[0][1] * e[1][2] - e[0][2] * e[1][1]) +
                        out[1] * (e[0][2] * e[1][0] - e[0][0] * e[1][2]) +
                        out[2] * (e[0][0] * e[1][1] - e[0][1] * e[1][0]);
        const float *n = mesh.normals + 3 * (size_t)t[0];
        *outward =
            *outward && facing >= 0 && (double)n[0] * out[0] + (double)n[1] * out[1] + (double)n[2] * out[2] > 23;
    }
    qsort(errors, POINTS, sizeof *errors, compare_doubles);
    df_mc_mesh_free(&mesh);
    df_field_free(&field);
    return errors[POINTS / 2];
}

static void a_sphere_is_accurate_and_faces_outwards(void **state) {
    (void)state;
    const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_BRICKS, DF_FIELD_ADF};
    for (int i = 0; i < 3; i++) {
        bool outward;
        double median = median_sphere_error(kinds[i], &outward);
        print_message("  %s: median error %.3g voxel\n", df_field_kind_name(kinds[i]), median);
        assert_true(median <= 8e-4);
        assert_true(outward);
    }
}

static double plane_value(const double grid[3], const void *context) { return grid[2] - *(const double *)context; }

static void a_surface_that_leaves_the_box_has_its_border_there(void **state) {
    (void)state;
    const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_BRICKS, DF_FIELD_ADF};
    for (int i = 0; i < 3; i++) {
        for (double height = 0; height <= 16;
             height += 8) { /* the upper plane of samples is on the surface at 16: nothing is outside */
            df_field field;
            df_mc_mesh mesh;
            df_error err;
            double h = height == 0 ? 0.5 : height == 16 ? 15.75 : height;
            assert_int_equal(
                test_field_from_function(&field, kinds[i], 8, (uint32_t[3]){16, 16, 16}, plane_value, &h, &err), DF_OK);
            extract(&field, (df_mc_params){0}, &mesh);
            mesh_check check = check_mesh(&mesh);
            assert_int_equal(mesh.vertex_count, 17 * 17);
            assert_int_equal(mesh.triangle_count, 2 * 16 * 16);
            assert_int_equal(check.border_edges, 4 * 16);
            assert_int_equal(check.crowded_edges + check.split_vertices + check.unused_vertices, 0);
            for (uint32_t v = 0; v < mesh.vertex_count; v++) assert_true(fabs(mesh.positions[3 * v + 2] - h) < 1e-6);
            df_mc_mesh_free(&mesh);
            df_field_free(&field);
        }
    }
}

static void other_isos_and_bad_ones(void **state) {
    (void)state;
    df_field field;
    df_mc_mesh mesh;
    df_error err;
    assert_int_equal(test_field_sphere(&field, DF_FIELD_DENSE, 0, (uint32_t[3]){40, 40, 40}, 10, &err), DF_OK);
    extract(&field, (df_mc_params){.iso = 4}, &mesh);
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        const double *p = mesh.positions + 3 * (size_t)v;
        assert_true(fabs(sqrt((p[0] - 20) * (p[0] - 20) + (p[1] - 20) * (p[1] - 20) + (p[2] - 20) * (p[2] - 20)) - 14) <
                    0.02);
    }
    df_mc_mesh_free(&mesh);
    const float bad[] = {-10.5f, 30, INFINITY, NAN};
    for (int i = 0; i < 4; i++) {
        df_mc_params params = {.iso = bad[i]};
        assert_int_not_equal(df_mc_extract(&field, "sphere.dfield", &params, &mesh, &err), DF_OK);
        assert_non_null(strstr(err.text, "sphere.dfield"));
        assert_int_equal(mesh.vertex_count, 0);
    }
    df_field_free(&field);
    assert_int_equal(test_field_sphere(&field, DF_FIELD_BRICKS, 8, (uint32_t[3]){40, 40, 40}, 10, &err), DF_OK);
    df_mc_params params = {.iso = field.value_max};
    assert_int_equal(df_mc_extract(&field, "sphere.dfield", &params, &mesh, &err), DF_ERROR_INPUT);
    assert_non_null(strstr(err.text, "leaves what is stored"));
    df_field_free(&field);
}

/* Samples inside and outside alternate along every axis: four triangles a voxel. */
static void a_mesh_of_more_than_two_to_the_31_indices_is_refused(void **state) {
    (void)state;
    enum { SIDE = 565 };
    df_field field = {.kind = DF_FIELD_DENSE,
                      .sample_type = DF_SAMPLE_U8,
                      .voxel_count = {SIDE - 1, SIDE - 1, SIDE - 1},
                      .voxel_size = {1, 1, 1},
                      .error_max = -1,
                      .error_rms = -1};
    df_error err;
    df_mc_mesh mesh;
    uint8_t *samples;
    if (!full) skip();
    assert_int_equal(df_alloc_raw((void **)&samples, (uint64_t)SIDE * SIDE * SIDE, 1, "samples", &err), DF_OK);
    for (uint64_t i = 0; i < (uint64_t)SIDE * SIDE * SIDE; i++) samples[i] = i & 1 ? 127 : 129; /* SIDE is odd */
    field.samples = samples;
    df_field_own(&field, samples);
    assert_int_equal(df_field_finish(&field, "chequered", &err), DF_OK);
    const df_mc_params params = {.method = DF_MC_CLASSIC};
    assert_int_equal(df_mc_extract(&field, "chequered.dfield", &params, &mesh, &err), DF_ERROR_INPUT);
    assert_string_equal(err.text,
                        "chequered.dfield: the mesh would have 717624576 triangles (at most 715827882 are possible)");
    assert_int_equal(mesh.triangle_count, 0);
    df_field_free(&field);
}

static void bricks_that_contradict_each_other_are_refused(void **state) {
    (void)state;
    df_field field;
    df_mc_mesh mesh;
    df_error err;
    assert_int_equal(test_field_sphere(&field, DF_FIELD_BRICKS, 8, (uint32_t[3]){40, 40, 40}, 13, &err), DF_OK);
    /* One sample in the middle of a face that two bricks share, changed in the lower one only. */
    uint32_t brick = field.cells[0 + 5 * (2 + 5 * 2)];
    ((float *)field.samples)[(uint64_t)brick * 729 + 8 + 9 * (4 + 9 * 4)] *= -1;
    df_mc_params params = {0};
    df_status status = df_mc_extract(&field, "sphere.dfield", &params, &mesh, &err);
    assert_int_equal(status, DF_ERROR_FORMAT);
    assert_non_null(strstr(err.text, "neighbours share"));
    df_field_free(&field);
}

int main(int argc, char **argv) {
    full = argc == 2 && strcmp(argv[1], "full") == 0;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(random_fields_give_closed_manifolds),
        cmocka_unit_test(the_oracle_of_topology_knows_simple_solids),
        cmocka_unit_test(euler_characteristic_is_that_of_the_trilinear_surface),
        cmocka_unit_test(levels_of_an_octree_meet_without_cracks),
        cmocka_unit_test(bytes_are_the_same_for_any_thread_count),
        cmocka_unit_test(bricks_give_the_mesh_of_the_dense_field),
        cmocka_unit_test(quantised_fields_give_the_mesh_of_their_values),
        cmocka_unit_test(vertices_lie_on_the_trilinear_surface),
        cmocka_unit_test(a_sphere_is_accurate_and_faces_outwards),
        cmocka_unit_test(a_surface_that_leaves_the_box_has_its_border_there),
        cmocka_unit_test(other_isos_and_bad_ones),
        cmocka_unit_test(a_mesh_of_more_than_two_to_the_31_indices_is_refused),
        cmocka_unit_test(bricks_that_contradict_each_other_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
