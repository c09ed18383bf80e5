/* check_field FIELD MESH COUNT [any-sign]: compares COUNT random stored samples of a field, and where it stores none
 * the side, with brute force over the mesh as it is in its file. Values must agree within 1 ulp of a float or 1e-15 of
 * the largest coordinate; sides by winding number >= 1, or not at all for any-sign. Prints what it found; exit 0 when
 * all agree. */
#include "common/field_file.h"
#include "convert/mesh_read.h"
#include "oracle.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct tally {
    uint64_t stored, sides, wrong_values, wrong_signs;
    double worst_ulp;
} tally;

static void check_sample(const df_field *field, const df_mesh *mesh, const uint32_t at[3], double tolerance, bool sign,
                         tally *t) {
    float value;
    double grid[3] = {at[0], at[1], at[2]}, p[3];
    bool stored = df_field_sample(field, at, &value);
    df_field_grid_to_world(field, grid, p);
    double exact = stored || sign ? oracle_distance(mesh->positions, mesh->faces, mesh->face_count, p) : 0;
    if (stored) {
        double difference = fabs(fabs((double)value) - exact),
               ulp = fmax(exact * (double)FLT_EPSILON, (double)FLT_TRUE_MIN);
        t->stored++;
        if (difference > tolerance) t->worst_ulp = fmax(t->worst_ulp, difference / ulp);
        if (difference > fmax(tolerance, ulp)) {
            if (t->wrong_values++ == 0)
                printf("sample %u %u %u: %.9g, exact %.17g\n", at[0], at[1], at[2], (double)value, exact);
        }
    }
    if (!sign || exact <= tolerance) return;
    double winding = oracle_winding(mesh->positions, mesh->faces, mesh->face_count, p);
    t->sides++;
    if ((value < 0) != (winding > 0.5)) {
        if (t->wrong_signs++ == 0)
            printf("sample %u %u %u: %.9g, winding number %.6f\n", at[0], at[1], at[2], (double)value, winding);
    }
}

/* A random sample: half of them among those of a random brick. */
static void pick(const df_field *field, uint64_t *state, uint32_t at[3]) {
    bool in_brick = field->kind == DF_FIELD_BRICKS && oracle_random(state) < 0.75;
    uint32_t cell = in_brick ? field->brick_cells[(uint32_t)(oracle_random(state) * field->brick_count)] : 0;
    for (int a = 0; a < 3; a++) {
        uint32_t k = field->brick_size, count = field->voxel_count[a] + 1;
        at[a] = (uint32_t)(oracle_random(state) * (in_brick ? k + 1 : count));
        if (!in_brick) continue;
        at[a] += k * (cell % field->cell_count[a]);
        cell /= field->cell_count[a];
        if (at[a] >= count) at[a] = count - 1;
    }
}

int main(int argc, char **argv) {
    df_field field = {0};
    df_mesh mesh = {0};
    df_error err = {0};
    df_status status = argc < 4 ? df_fail(&err, DF_ERROR_USAGE, "FIELD MESH COUNT [any-sign]")
                                : df_field_read(argv[1], DF_READ_COPY, &field, &err);
    if (status == DF_OK && field.kind == DF_FIELD_ADF)
        status = df_fail(&err, DF_ERROR_USAGE, "%s: an octree's samples are no distances: see check_adf", argv[1]);
    if (status == DF_OK) status = df_mesh_read(argv[2], &mesh, &err);
    if (status != DF_OK) {
        fprintf(stderr, "check_field: %s\n", err.text);
        return 2;
    }
    bool sign = argc < 5;
    double largest = 0;
    for (size_t i = 0; i < (size_t)mesh.vertex_count * 3; i++) largest = fmax(largest, fabs(mesh.positions[i]));
    tally total = {0};
    int count = atoi(argv[3]);
#pragma omp parallel
    {
        tally mine = {0};
#pragma omp for schedule(dynamic, 16)
        for (int i = 0; i < count; i++) {
            uint64_t state = (uint64_t)i * 7919 + 1;
            uint32_t at[3];
            pick(&field, &state, at);
            check_sample(&field, &mesh, at, 1e-15 * largest, sign, &mine);
        }
#pragma omp critical
        {
            total.stored += mine.stored;
            total.sides += mine.sides;
            total.wrong_values += mine.wrong_values;
            total.wrong_signs += mine.wrong_signs;
            total.worst_ulp = fmax(total.worst_ulp, mine.worst_ulp);
        }
    }
    printf("%s: %llu values, %llu wrong, worst %.3f ulp; %llu sides, %llu wrong\n", argv[1],
           (unsigned long long)total.stored, (unsigned long long)total.wrong_values, total.worst_ulp,
           (unsigned long long)total.sides, (unsigned long long)total.wrong_signs);
    df_field_free(&field);
    df_mesh_free(&mesh);
    return total.wrong_values || total.wrong_signs;
}
