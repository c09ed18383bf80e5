/* check_adf FIELD COUNT: takes random points on shared faces, edges and corners of an octree's leaves and evaluates
 * them from every leaf that touches them: all must agree within 1e-6 of the field's diagonal, the leaves by a search of
 * their own. Exit 0 when they do. */
#include "common/field_file.h"
#include "oracle.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

/* The value at a grid point from the leaf in one of the eight octants around it. */
static double value_from(const df_field *f, const double p[3], int octant) {
    uint32_t family = 0;
    double low[3] = {0, 0, 0}, side = ldexp(1, (int)f->level_count);
    for (;;) {
        uint32_t child = 0, before = 0;
        side /= 2;
        for (int a = 0; a < 3; a++) {
            double middle = low[a] + side;
            if (p[a] > middle || (p[a] == middle && (octant >> a & 1))) {
                child |= 1u << a;
                low[a] = middle;
            }
        }
        uint32_t states = f->families[family].states;
        if ((states >> 2 * child & 3) != DF_CHILD_FAMILY) {
            float corners[8];
            double local[3];
            df_adf_corners(f, family, child, corners);
            for (int a = 0; a < 3; a++) local[a] = (p[a] - low[a]) / side;
            return df_trilinear(corners, local);
        }
        for (uint32_t c = 0; c < child; c++) before += (states >> 2 * c & 3) == DF_CHILD_FAMILY;
        family = f->families[family].first_child + before;
    }
}

int main(int argc, char **argv) {
    df_field field = {0};
    df_error err = {0};
    if (argc < 3 || df_field_read(argv[1], DF_READ_COPY, &field, &err) != DF_OK || field.kind != DF_FIELD_ADF) {
        fprintf(stderr, "check_adf: %s\n", err.text[0] ? err.text : "an octree, and a count");
        return 2;
    }
    double diagonal = 0, worst = 0, root = ldexp(1, (int)field.level_count);
    for (int a = 0; a < 3; a++) diagonal += pow(field.voxel_count[a] * field.voxel_size[a], 2);
    long count = atol(argv[2]), wrong = 0;
#pragma omp parallel for reduction(max : worst) reduction(+ : wrong)
    for (long i = 0; i < count; i++) {
        uint64_t state = (uint64_t)i * 104729 + 5;
        double p[3], low = INFINITY, high = -INFINITY;
        int fixed = 1 + (int)(oracle_random(&state) * 7); /* axes on which the point lies on a plane between cells */
        int level = (int)(oracle_random(&state) * field.level_count);
        for (int a = 0; a < 3; a++) {
            p[a] = oracle_random(&state) * root;
            if (fixed >> a & 1) p[a] = ldexp(floor(ldexp(p[a], -level)), level);
        }
        for (int octant = 0; octant < 8; octant++) {
            int inside = 1;
            for (int a = 0; a < 3; a++) inside = inside && (octant >> a & 1 ? p[a] < root : p[a] > 0);
            if (!inside) continue;
            double v = value_from(&field, p, octant);
            low = fmin(low, v);
            high = fmax(high, v);
        }
        if (high - low > worst) worst = high - low;
        if (high - low > 1e-6 * sqrt(diagonal)) {
            if (wrong++ == 0) printf("at %g %g %g: %.9g to %.9g\n", p[0], p[1], p[2], low, high);
        }
    }
    printf("%s: %ld points, %ld tears, worst %.3g of the diagonal\n", argv[1], count, wrong, worst / sqrt(diagonal));
    df_field_free(&field);
    return wrong != 0;
}
