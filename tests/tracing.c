#include "tracing.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

double test_uniform(test_random *random) {
    uint64_t z = random->state += 0x9E3779B97F4A7C15u; /* splitmix64 */
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

void test_random_rays(uint32_t count, uint64_t seed, const double box[3], double *origins, double *directions) {
    test_random random = {seed};
    double longest = fmax(box[0], fmax(box[1], box[2]));
    for (uint32_t i = 0; i < count; i++) {
        double *o = origins + 3 * (size_t)i, *d = directions + 3 * (size_t)i, reach = i % 4 == 0 ? 0.5 : 2;
        for (int a = 0; a < 3; a++) {
            double target = test_uniform(&random) * box[a];
            o[a] = box[a] / 2 + (2 * test_uniform(&random) - 1) * reach * longest;
            if (i % 3 == 0 && test_uniform(&random) < 0.5) {
                o[a] = floor(o[a]);
                d[a] = test_uniform(&random) < 0.5 ? 0 : floor(target) - o[a];
            } else {
                d[a] = target - o[a];
            }
        }
        if (d[0] == 0 && d[1] == 0 && d[2] == 0) d[i % 3] = 1;
    }
}

df_status test_trace(const df_tracer *tracer, const df_kernels *kernels, const df_scene *scene, int solve, int steps,
                     int precision, const double *origins, const double *directions, uint32_t count, df_rays *rays,
                     test_hit *hits, df_error *err) {
    const double box[3] = {scene->voxel_count[0], scene->voxel_count[1], scene->voxel_count[2]};
    const df_trace_options options = {.kernels = kernels,
                                      .solve = solve,
                                      .steps = steps,
                                      .precision = precision,
                                      .threads = 1,
                                      .tile_width = count,
                                      .tile_height = 1};
    df_hits list = {0};
    df_counters counters = {0};
    void *state = NULL;
    df_status status = df_rays_alloc(count, true, rays, err);
    if (status == DF_OK) status = df_hits_alloc(count, &list, err);
    if (status == DF_OK) status = tracer->prepare(scene, &options, &state, err);
    if (status != DF_OK) goto done;
    rays->count = count;
    for (uint32_t i = 0; i < count; i++) {
        double scale;
        if (!df_rays_set(rays, i, box, origins + 3 * (size_t)i, directions + 3 * (size_t)i, &scale)) abort();
    }
    df_rays_pad(rays);
    df_tile tile = {.width = count, .height = 1, .rays = *rays};
    status = tracer->trace(state, 0, &tile, &list, &counters, err);
    memset(hits, 0, count * sizeof *hits);
    for (uint32_t i = 0; i < list.count && status == DF_OK; i++) {
        test_hit *hit = &hits[list.ray[i]];
        hit->hit = true;
        hit->flags = list.flags[i];
        hit->t = list.t[i];
        for (int a = 0; a < 3; a++) {
            hit->cell[a] = list.cell[a][i];
            hit->local[a] = list.local[a][i];
        }
    }
done:
    if (state) tracer->release(state);
    df_hits_free(&list);
    if (status != DF_OK) df_rays_free(rays);
    return status;
}

bool test_same_hit(const test_hit *a, const test_hit *b) {
    return a->hit == b->hit && a->flags == b->flags && memcmp(a->cell, b->cell, sizeof a->cell) == 0 &&
           memcmp(a->local, b->local, sizeof a->local) == 0 && memcmp(&a->t, &b->t, sizeof a->t) == 0;
}
