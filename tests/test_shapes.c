/* Distances to analytic shapes: no two points may differ by more than what lies between them. */
#include "convert/shape.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <cmocka.h>

static double random_between(uint64_t *state, double low, double high) {
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return low + (high - low) * (double)(*state >> 11) / 9007199254740992.0;
}

static void distances_are_1_lipschitz(void **unused) {
    (void)unused;
    static const char *const names[] = {"shape:sphere",      "shape:torus",  "shape:box",
                                        "shape:rotated-box", "shape:gyroid", "shape:shell"};
    uint64_t state = 1;
    for (size_t n = 0; n < sizeof names / sizeof *names; n++) {
        df_shape shape;
        df_error err;
        assert_int_equal(df_shape_parse(names[n], &shape, &err), DF_OK);
        for (int i = 0; i < 50000; i++) {
            double p[3], q[3], apart = 0;
            for (int a = 0; a < 3; a++) {
                p[a] = random_between(&state, -1.2, 1.2);
                q[a] = p[a] + random_between(&state, -2e-4, 2e-4);
                apart += (q[a] - p[a]) * (q[a] - p[a]);
            }
            const double change = fabs(df_shape_distance(&shape, p) - df_shape_distance(&shape, q));
            if (change > sqrt(apart) + 1e-9)
                fail_msg("%s: %g apart, %g in distance, at %.17g %.17g %.17g", names[n], sqrt(apart), change, p[0],
                         p[1], p[2]);
        }
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(distances_are_1_lipschitz)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
