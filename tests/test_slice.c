/* Claims about slices: what is inside is blue, outside orange, the surface black, in every structure. */
#include "common/slice.h"
#include "fields.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

static void every_structure_shows_the_same_sides(void **state) {
    (void)state;
    const uint32_t voxels[3] = {40, 32, 36};
    const double radius = 11;
    for (int kind = DF_FIELD_DENSE; kind <= DF_FIELD_ADF; kind++) {
        for (uint32_t axis = 0; axis < 3; axis++) {
            df_field field;
            df_error err = {0};
            df_slice slice = {.axis = axis, .position = 0.5, .longest = 320};
            uint8_t *rgb;
            uint32_t width, height, blue = 0, orange = 0, black = 0;
            double contour;
            assert_int_equal(test_field_sphere(&field, (df_field_kind)kind, 8, voxels, radius, &err), DF_OK);
            assert_int_equal(df_slice_draw(&field, &slice, &rgb, &width, &height, &contour, &err), DF_OK);
            uint32_t right = axis == 0 ? 1 : 0, up = axis == 2 ? 1 : 2;
            double scale = 320.0 / fmax(voxels[right], voxels[up]);
            assert_int_equal(width, lrint(ceil(voxels[right] * scale - 1e-6)));
            assert_int_equal(height, lrint(ceil(voxels[up] * scale - 1e-6)));
            for (uint32_t i = 0; i < width * height; i++) {
                double x = (i % width + 0.5) / scale - voxels[right] / 2.0,
                       y = (i / width + 0.5 - height + voxels[up] * scale / 2) / scale;
                double distance = sqrt(x * x + y * y) - radius;
                const uint8_t *pixel = rgb + 3 * (size_t)i;
                if (fabs(distance) * scale < 0.3) black += pixel[0] < 60 && pixel[2] < 60;
                if (distance < -0.5) blue += pixel[2] > pixel[0];
                if (distance > 0.5) orange += pixel[0] > pixel[2];
                if (distance < -0.5) assert_true(pixel[2] > pixel[0]);
                if (distance > 0.5) assert_true(pixel[0] > pixel[2]);
            }
            assert_true(black > 50 && blue > 1000 && orange > 1000);
            free(rgb);
            df_field_free(&field);
        }
    }
}

static void wrong_planes_are_refused(void **state) {
    (void)state;
    static const char *const wrong[] = {"", "z", "z=", "w=0.5", "z=1.5", "z=-0.1", "z=nan", "z:0.5", "z=0.5x"};
    df_slice slice = {0};
    df_error err = {0};
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_int_equal(df_slice_parse("--slice", wrong[i], &slice, &err), DF_ERROR_USAGE);
    }
    assert_int_equal(df_slice_parse("--slice", "y=0.25", &slice, &err), DF_OK);
    assert_int_equal(slice.axis, 1);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_structure_shows_the_same_sides),
        cmocka_unit_test(wrong_planes_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
