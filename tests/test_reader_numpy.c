/* The NumPy reader, which shares no code with ours, finds the same samples. */
#include "common/field_file.h"
#include "fields.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static void numpy_reader_agrees(df_field_kind kind) {
    char path[] = "/tmp/df_test_numpy_XXXXXX", command[512], line[256];
    df_field field;
    df_error err = {0};
    const uint32_t voxels[3] = {10, 8, 13};
    assert_int_equal(test_field_sphere(&field, kind, 4, voxels, 3.3, &err), DF_OK);
    close(mkstemp(path));
    assert_int_equal(df_field_write(&field, path, &err), DF_OK);
    static const uint32_t points[][3] = {{0, 0, 0}, {10, 8, 13}, {5, 4, 6}, {4, 4, 4}, {8, 4, 8}, {3, 7, 9}, {5, 1, 6}};
    for (size_t i = 0; i < sizeof points / sizeof points[0]; i++) {
        float expected;
        df_field_sample(&field, points[i], &expected);
        snprintf(command, sizeof command, "%s/pipelines/read_dfield.py %s %u %u %u", DF_SOURCE_FOLDER, path,
                 points[i][0], points[i][1], points[i][2]);
        FILE *pipe = popen(command, "r");
        assert_non_null(pipe);
        assert_non_null(fgets(line, sizeof line, pipe));
        assert_int_equal(pclose(pipe), 0);
        float got = strtof(line, NULL);
        assert_memory_equal(&got, &expected, sizeof got);
    }
    unlink(path);
    df_field_free(&field);
}

static void numpy_reader_agrees_on_dense(void **state) {
    (void)state;
    numpy_reader_agrees(DF_FIELD_DENSE);
}

static void numpy_reader_agrees_on_bricks(void **state) {
    (void)state;
    numpy_reader_agrees(DF_FIELD_BRICKS);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numpy_reader_agrees_on_dense),
        cmocka_unit_test(numpy_reader_agrees_on_bricks),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
