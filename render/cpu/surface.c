#include "render/cpu/surface.h"
#include "common/memory.h"
#include "render/cpu/fetch.h"
#include "render/cpu/surface_box.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

void df_surface_free(df_surface *surface) {
    free(surface->first);
    free(surface->voxels);
    free(surface->corners);
    free(surface->corner[0]);
    free(surface->leaves);
    free(surface->block_log2);
    free(surface->stencils.samples);
    free(surface->stencils.first);
    free(surface->stencils.outer);
    memset(surface, 0, sizeof *surface);
}

uint64_t df_surface_bytes(const df_surface *surface) {
    const uint64_t record = 8 * df_sample_size(surface->sample_type) + sizeof *surface->voxels +
                            (surface->leaves ? sizeof *surface->leaves : 0);
    const uint64_t block = sizeof *surface->first + 3 * sizeof *surface->corner[0] +
                           (surface->block_log2 ? sizeof *surface->block_log2 : 0);
    return surface->record_count * record + surface->block_count * block + surface->stencil_bytes;
}

df_status df_surface_alloc_blocks(df_surface *surface, df_error *err) {
    const uint64_t blocks = surface->block_count;
    df_status status = df_alloc((void **)&surface->first, blocks + 1, sizeof *surface->first, "surface records", err);
    if (status == DF_OK)
        status = df_alloc((void **)&surface->corner[0], blocks * 3 + DF_RAY_PADDING, sizeof *surface->corner[0],
                          "surface records", err);
    for (int a = 1; a < 3 && status == DF_OK; a++) surface->corner[a] = surface->corner[a - 1] + blocks;
    return status;
}

df_status df_surface_alloc_records(df_surface *surface, uint64_t count, df_error *err) {
    if (count > INT32_MAX / 8) {
        return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer splat: more than %d surface voxels; choose another",
                       INT32_MAX / 8);
    }
    surface->record_count = (uint32_t)count;
    df_status status =
        df_alloc((void **)&surface->voxels, count + DF_RAY_PADDING, sizeof *surface->voxels, "surface records", err);
    if (status == DF_OK)
        status = df_alloc(&surface->corners, count * 8, df_sample_size(surface->sample_type), "surface records", err);
    return status;
}

uint32_t df_surface_box(const float corner[8], float margin) { return (uint32_t)df_surface_box_bits(corner, margin); }

float df_surface_margin(const df_scene *scene) {
    const uint32_t *count = scene->voxel_count;
    const uint32_t longest =
        count[0] > count[1] ? (count[0] > count[2] ? count[0] : count[2]) : (count[1] > count[2] ? count[1] : count[2]);
    return 1.0f / 64 + (float)longest * 0x1p-20f;
}

/* ---- voxels ---- */

static void copy_corners(const df_scene *scene, const df_surface *surface, const uint32_t voxel[3], uint32_t block,
                         uint32_t record) {
    const df_field *field = scene->field;
    const df_fetch f = df_fetch_corner(scene, voxel, block);
    const size_t size = df_sample_size(field->sample_type);
    for (uint32_t i = 0; i < 4; i++) { /* rows of two */
        const size_t from = f.corner + (i & 1 ? f.row : 0) + (i & 2 ? f.slice : 0);
        memcpy((uint8_t *)surface->corners + (8 * (size_t)record + 2 * i) * size,
               (const uint8_t *)field->samples + from * size, 2 * size);
    }
}

static void fill_records(const df_scene *scene, const df_surface *surface, uint32_t block) {
    const uint32_t words = df_brick_mask_words(scene->k), k_mask = scene->k - 1;
    uint32_t record = surface->first[block], low[3];
    low[0] = scene->block_cells[block] % scene->coarse_count[0] * scene->k;
    low[1] = scene->block_cells[block] / scene->coarse_count[0] % scene->coarse_count[1] * scene->k;
    low[2] = scene->block_cells[block] / scene->coarse_count[0] / scene->coarse_count[1] * scene->k;
    for (int a = 0; a < 3; a++) surface->corner[a][block] = low[a];
    for (uint32_t w = 0; w < words; w++) {
        for (uint64_t mask = scene->masks[(uint64_t)block * words + w]; mask; mask &= mask - 1, record++) {
            const uint32_t bit = 64 * w + (uint32_t)__builtin_ctzll(mask);
            const uint32_t voxel[3] = {low[0] + (bit & k_mask), low[1] + (bit >> scene->k_shift & k_mask),
                                       low[2] + (bit >> 2 * scene->k_shift)};
            surface->voxels[record] = bit;
            copy_corners(scene, surface, voxel, block, record);
        }
    }
    assert(record == surface->first[block + 1]);
}

df_status df_surface_make(const df_scene *scene, const df_kernels *kernels, uint32_t threads, df_surface *surface,
                          df_error *err) {
    if (scene->levels == 0) return df_surface_make_octree(scene, threads, surface, err);
    const uint32_t words = df_brick_mask_words(scene->k);
    const float margin = df_surface_margin(scene);
    uint64_t count = 0;
    surface->k_shift = scene->k_shift;
    surface->block_count = scene->block_count;
    surface->sample_type = scene->field->sample_type;
    df_status status = df_surface_alloc_blocks(surface, err);
    for (uint32_t block = 0; block < scene->block_count && status == DF_OK && count <= UINT32_MAX / 2; block++) {
        surface->first[block] = (uint32_t)count;
        for (uint32_t w = 0; w < words; w++)
            count += (uint64_t)__builtin_popcountll(scene->masks[(uint64_t)block * words + w]);
    }
    if (status == DF_OK) status = df_surface_alloc_records(surface, count, err);
    if (status != DF_OK) return status;
    surface->first[scene->block_count] = (uint32_t)count;
#pragma omp parallel for schedule(dynamic, 64) num_threads(threads)
    for (uint32_t block = 0; block < scene->block_count; block++) {
        fill_records(scene, surface, block);
        kernels->surface_boxes(scene, surface, block, margin);
    }
    return DF_OK;
}
