/* make_field KIND VOXELS FILE: a torus as dense, bricks4, bricks8 or adf, for tests of the programs. */
#include "common/field_file.h"
#include "fields.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static double torus(const double p[3], const void *context) {
    const double n = *(const double *)context, x = p[0] - n / 2, y = p[1] - n / 2, z = p[2] - n / 2;
    const double q = sqrt(x * x + z * z) - 0.3 * n;
    return sqrt(q * q + y * y) - 0.13 * n;
}

int main(int argc, char **argv) {
    df_field field = {0};
    df_error err = {0};
    if (argc != 4) return 2;
    const double n = atof(argv[2]);
    const uint32_t count[3] = {(uint32_t)n, (uint32_t)n, (uint32_t)n};
    df_field_kind kind = strcmp(argv[1], "dense") == 0 ? DF_FIELD_DENSE
                         : strcmp(argv[1], "adf") == 0 ? DF_FIELD_ADF
                                                       : DF_FIELD_BRICKS;
    df_status status =
        test_field_from_function(&field, kind, strcmp(argv[1], "bricks4") == 0 ? 4 : 8, count, torus, &n, &err);
    if (status == DF_OK) status = df_field_write(&field, argv[3], &err);
    if (status != DF_OK) fprintf(stderr, "make_field: %s\n", err.text);
    df_field_free(&field);
    return df_exit_code(status);
}
