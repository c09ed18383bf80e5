/* Buffers of rays through a tracer, for tests. */
#ifndef DF_TESTS_TRACING_H
#define DF_TESTS_TRACING_H

#include "render/cpu/kernels.h"

/* A hit or a miss by ray, so that results can be compared ray by ray. */
typedef struct test_hit {
    bool hit;
    uint8_t flags;
    uint16_t cell[3];
    float local[3];
    double t;
} test_hit;

/* Small random numbers that are the same everywhere. */
typedef struct test_random {
    uint64_t state;
} test_random;
double test_uniform(test_random *random); /* [0,1) */

/* `count` rays in grid space that aim at points of the box from random places outside and inside of it; every third one
 * starts on and runs along whole coordinates in some of the axes. */
void test_random_rays(uint32_t count, uint64_t seed, const double box[3], double *origins, double *directions);

/* Traces rays (3 doubles each) as the tracer takes them, rounded to float; `rays` keeps them for truths. Free with
 * df_rays_free. */
df_status test_trace(const df_tracer *tracer, const df_kernels *kernels, const df_scene *scene, int solve, int steps,
                     int precision, const double *origins, const double *directions, uint32_t count, df_rays *rays,
                     test_hit *hits, df_error *err);

/* True when two results are the same bits. */
bool test_same_hit(const test_hit *a, const test_hit *b);

#endif
