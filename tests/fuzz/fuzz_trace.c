/* Any samples and any rays: every tracer ends, stays in the box, and finds the hits of the scalar walk, on any
 * instruction set. The first bytes choose structure, instruction set and size, the next the rays' seed and the scale;
 * the rest are the samples, over and over. */
#include "../fields.h"
#include "../tracing.h"
#include "fuzz.h"
#include "render/methods/solve_methods.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { RAYS = 16, SIDE_MAX = 6, HEADER = 8 };

typedef struct bytes {
    const uint8_t *data;
    size_t size;
    uint32_t side;
    double scale;
} bytes;

static double sample(const double grid[3], const void *context) {
    const bytes *b = context;
    const size_t at = (size_t)grid[0] + (size_t)b->side * ((size_t)grid[1] + (size_t)b->side * (size_t)grid[2]);
    return (double)(int8_t)b->data[at % b->size] * b->scale;
}

static void check(const df_scene *scene, const df_kernels *kernels, uint64_t seed) {
    double box[3], origins[3 * RAYS], directions[3 * RAYS];
    test_hit expected[RAYS], hits[RAYS];
    bool is_first = true;
    df_error err = {0};
    for (int a = 0; a < 3; a++) box[a] = scene->voxel_count[a];
    test_random_rays(RAYS, seed, box, origins, directions);
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        df_rays rays = {0};
        if ((*tracer)->suits && !(*tracer)->suits(scene, NULL)) continue;
        test_hit *out = is_first ? expected : hits;
        const df_kernels *used = is_first ? &df_kernels_scalar : kernels;
        is_first = false;
        if (test_trace(*tracer, used, scene, DF_SOLVE_ROBUST, 0, DF_PRECISION_F64, origins, directions, RAYS, &rays,
                       out, &err) != DF_OK)
            abort();
        for (int i = 0; i < RAYS; i++) {
            if (out[i].hit && !isfinite(out[i].t)) abort();
            if (!test_same_hit(&out[i], &expected[i])) abort();
            for (int a = 0; a < 3 && out[i].hit; a++) {
                if (out[i].cell[a] >= scene->voxel_count[a]) abort();
            }
        }
        df_rays_free(&rays);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_BRICKS, DF_FIELD_ADF};
    static const char *const isas[] = {"scalar", "sse4.1", "avx2", "avx512"};
    if (size <= HEADER) return 0;
    const df_field_kind kind = kinds[data[0] % 3];
    const uint32_t brick = data[1] & 1 ? 8 : 4,
                   count[3] = {1 + data[2] % SIDE_MAX, 1 + data[3] % SIDE_MAX, 1 + data[4] % SIDE_MAX};
    const bytes values = {data + HEADER, size - HEADER, SIDE_MAX + 1, ldexp(1, (int8_t)data[5])};
    const df_kernels *kernels;
    df_field field = {0};
    df_scene scene = {0};
    df_error err = {0};
    const df_scene_options options = {.levels = kind == DF_FIELD_DENSE && data[1] & 2 ? 1 : 0};
    df_status status = test_field_from_function(&field, kind, brick, count, sample, &values, &err);
    if (status == DF_OK) status = df_scene_prepare(&field, (float)(int8_t)data[7], &options, &scene, &err);
    if (df_kernels_select(isas[data[1] >> 2 & 3], &kernels, NULL) != DF_OK) kernels = &df_kernels_scalar;
    if (status == DF_OK) check(&scene, kernels, data[6]);
    else if (!err.text[0]) abort();
    df_scene_free(&scene);
    df_field_free(&field);
    return 0;
}
