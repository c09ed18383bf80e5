#include "render/scene.h"
#include "common/memory.h"
#include "common/progress.h"
#include "render/gradient.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void df_scene_free(df_scene *scene) {
    for (size_t i = 0; i < sizeof scene->owned / sizeof scene->owned[0]; i++) free(scene->owned[i]);
    memset(scene, 0, sizeof *scene);
}

const char *df_scene_structure_name(const df_scene *scene) {
    if (scene->field->kind == DF_FIELD_BRICKS) return scene->k == 8 ? "bricks k=8" : "bricks k=4";
    if (scene->levels == 1) return "dense";
    return scene->k == 8 ? "dense 2-level k=8" : "dense 2-level k=4";
}

static float decode(const df_field *field, uint64_t index, uint32_t block) {
    if (field->sample_type == DF_SAMPLE_F32) return ((const float *)field->samples)[index];
    return df_field_decode(field, index, field->brick_exponents ? field->brick_exponents[block] : field->step_exponent);
}

void df_scene_corners(const df_scene *scene, const uint32_t voxel[3], uint32_t block, float corner[8]) {
    const df_field *field = scene->field;
    uint64_t at, row, slice;
    if (field->kind == DF_FIELD_BRICKS) {
        uint32_t side = scene->k + 1, mask = scene->k - 1;
        row = side;
        slice = side * side;
        at = (uint64_t)block * df_brick_sample_count(scene->k) + (voxel[0] & mask) + row * (voxel[1] & mask) + slice * (voxel[2] & mask);
    } else {
        row = (uint64_t)field->voxel_count[0] + 1;
        slice = row * ((uint64_t)field->voxel_count[1] + 1);
        at = voxel[0] + row * voxel[1] + slice * voxel[2];
    }
    for (int c = 0; c < 8; c++) {
        corner[c] = decode(field, at + (c & 1) + (c & 2 ? row : 0) + (c & 4 ? slice : 0), block) - scene->iso;
    }
}

/* ---- the stencil of a voxel ---- */

/* A sample that may lie in another brick than the voxel's own, or outside the field. Returns false when it is not stored. */
static bool sample_anywhere(const df_field *field, const int64_t at[3], float *value) {
    uint32_t sample[3];
    for (int a = 0; a < 3; a++) {
        if (at[a] < 0 || at[a] > field->voxel_count[a]) return false;
        sample[a] = (uint32_t)at[a];
    }
    return df_field_sample(field, sample, value);
}

/* Fills the samples beyond the cell along `axis`: 4 before and 4 after. */
static void stencil_axis(const df_scene *scene, const uint32_t voxel[3], int axis, float stencil[64]) {
    const int stride[3] = {1, 4, 16}, u = (axis + 1) % 3, v = (axis + 2) % 3;
    for (int side = 0; side < 2; side++) {
        for (int corner = 0; corner < 4; corner++) {
            int64_t at[3] = {voxel[0], voxel[1], voxel[2]};
            at[axis] += side ? 2 : -1;
            at[u] += corner & 1;
            at[v] += corner >> 1;
            int base = DF_STENCIL(0, 0, 0) + (corner & 1) * stride[u] + (corner >> 1) * stride[v];
            int beyond = base + (side ? 2 : -1) * stride[axis];
            if (!sample_anywhere(scene->field, at, &stencil[beyond])) {
                float near = stencil[base + (side ? 1 : 0) * stride[axis]], next = stencil[base + (side ? 0 : 1) * stride[axis]];
                stencil[beyond] = (near + near) - next;
            }
        }
    }
}

/* True where all of a voxel's stencil lies in one run of samples: *at is the lower corner's index. */
static bool stencil_is_local(const df_scene *scene, const uint32_t voxel[3], uint32_t block, uint64_t *at, uint64_t *row,
                             uint64_t *slice) {
    const df_field *field = scene->field;
    bool local = true;
    if (field->kind == DF_FIELD_BRICKS) {
        uint32_t mask = scene->k - 1, side = scene->k + 1;
        for (int a = 0; a < 3; a++) {
            uint32_t within = voxel[a] & mask;
            local = local && within >= 1 && within + 2 <= scene->k && voxel[a] + 2 <= scene->voxel_count[a];
        }
        *row = side;
        *slice = side * side;
        *at = (uint64_t)block * df_brick_sample_count(scene->k) + (voxel[0] & mask) + *row * (voxel[1] & mask) + *slice * (voxel[2] & mask);
    } else {
        for (int a = 0; a < 3; a++) local = local && voxel[a] >= 1 && voxel[a] + 2 <= scene->voxel_count[a];
        *row = (uint64_t)field->voxel_count[0] + 1;
        *slice = *row * ((uint64_t)field->voxel_count[1] + 1);
        *at = voxel[0] + *row * voxel[1] + *slice * voxel[2];
    }
    return local;
}

void df_scene_stencil(const df_scene *scene, const uint32_t voxel[3], uint32_t block, bool beyond, float stencil[64]) {
    uint64_t at, row, slice;
    bool whole = stencil_is_local(scene, voxel, block, &at, &row, &slice) && beyond;
    for (int z = whole ? -1 : 0; z < (whole ? 3 : 2); z++) {
        for (int y = whole ? -1 : 0; y < (whole ? 3 : 2); y++) {
            for (int x = whole ? -1 : 0; x < (whole ? 3 : 2); x++) {
                uint64_t index = at + (uint64_t)(int64_t)x + row * (uint64_t)(int64_t)y + slice * (uint64_t)(int64_t)z;
                stencil[DF_STENCIL(x, y, z)] = decode(scene->field, index, block);
            }
        }
    }
    if (whole || !beyond) return;
    for (int axis = 0; axis < 3; axis++) stencil_axis(scene, voxel, axis, stencil);
}

/* ---- masks ---- */

/* Bits of one row of voxels: bit x - x0 is set where voxel (x,y,z) straddles iso, for x0 <= x < x1, x1 - x0 <= 64. */
static uint64_t dense_row_bits(const df_scene *scene, uint32_t x0, uint32_t x1, uint32_t y, uint32_t z) {
    const df_field *field = scene->field;
    uint64_t row = (uint64_t)field->voxel_count[0] + 1, slice = row * ((uint64_t)field->voxel_count[1] + 1);
    uint64_t first = row * y + slice * z, bits = 0;
    bool all_before = false, any_before = false;
    for (uint32_t x = x0; x <= x1; x++) { /* per column of 4 samples: any and all inside */
        int inside = 0;
        for (int c = 0; c < 4; c++) {
            inside += decode(field, first + x + (c & 1 ? row : 0) + (c & 2 ? slice : 0), 0) < scene->iso;
        }
        bool any = inside > 0, all = inside == 4;
        if (x > x0) bits |= (uint64_t)((any || any_before) && !(all && all_before)) << (x - x0 - 1);
        any_before = any;
        all_before = all;
    }
    return bits;
}

static df_status prepare_uniform(df_scene *scene, df_error *err) {
    const uint32_t *count = scene->voxel_count;
    uint64_t *rows;
    scene->row_words = (count[0] + 63) / 64;
    df_status status = df_alloc((void **)&rows, (uint64_t)scene->row_words * count[1] * count[2], sizeof *rows, "surface mask", err);
    if (status != DF_OK) return status;
    scene->owned[0] = rows;
    scene->rows = rows;
    scene->precompute_bytes = (uint64_t)scene->row_words * count[1] * count[2] * sizeof *rows;
#pragma omp parallel for
    for (uint32_t z = 0; z < count[2]; z++) {
        for (uint32_t y = 0; y < count[1]; y++) {
            uint64_t *row = rows + scene->row_words * (y + (uint64_t)count[1] * z);
            for (uint32_t w = 0; w < scene->row_words; w++) {
                uint32_t x0 = w * 64, x1 = count[0] - x0 < 64 ? count[0] : x0 + 64;
                row[w] = dense_row_bits(scene, x0, x1, y, z);
            }
        }
    }
    return DF_OK;
}

/* The mask of one coarse cell of a dense field; returns whether any bit is set. */
static bool dense_block(const df_scene *scene, const uint32_t cell[3], uint64_t *mask) {
    uint32_t k = scene->k, low[3], high[3];
    uint64_t any = 0;
    for (int a = 0; a < 3; a++) {
        low[a] = cell[a] * k;
        high[a] = low[a] + k < scene->voxel_count[a] ? low[a] + k : scene->voxel_count[a];
    }
    memset(mask, 0, df_brick_mask_words(k) * sizeof *mask);
    for (uint32_t z = low[2]; z < high[2]; z++) {
        for (uint32_t y = low[1]; y < high[1]; y++) {
            uint64_t bits = dense_row_bits(scene, low[0], high[0], y, z);
            uint32_t bit = k * (y - low[1] + k * (z - low[2]));
            mask[bit / 64] |= bits << (bit % 64);
            any |= bits;
        }
    }
    return any != 0;
}

static void cell_of(const df_scene *scene, uint64_t index, uint32_t cell[3]) {
    cell[0] = (uint32_t)(index % scene->coarse_count[0]);
    cell[1] = (uint32_t)(index / scene->coarse_count[0] % scene->coarse_count[1]);
    cell[2] = (uint32_t)(index / scene->coarse_count[0] / scene->coarse_count[1]);
}

/* Coarse cells and masks over a dense field: which cells hold the surface, then their masks. */
static df_status prepare_two_level(df_scene *scene, df_error *err) {
    uint64_t total = 1, blocks = 0;
    uint32_t *coarse, *block_cells, words = df_brick_mask_words(scene->k);
    uint64_t *masks;
    for (int a = 0; a < 3; a++) total *= scene->coarse_count[a];
    df_status status = df_alloc((void **)&coarse, total, sizeof *coarse, "coarse cells", err);
    if (status != DF_OK) return status;
    scene->owned[0] = coarse;
    scene->coarse = coarse;
#pragma omp parallel for
    for (uint64_t i = 0; i < total; i++) {
        uint32_t cell[3], voxel[3];
        uint64_t mask[8];
        float corner[8];
        cell_of(scene, i, cell);
        for (int a = 0; a < 3; a++) voxel[a] = cell[a] * scene->k;
        df_scene_corners(scene, voxel, 0, corner);
        coarse[i] = dense_block(scene, cell, mask) ? 0 : corner[0] < 0 ? DF_CELL_INSIDE : DF_CELL_OUTSIDE;
    }
    for (uint64_t i = 0; i < total; i++) {
        if (coarse[i] == 0) coarse[i] = (uint32_t)blocks++;
    }
    scene->block_count = (uint32_t)blocks;
    status = df_alloc((void **)&masks, blocks * words, sizeof *masks, "surface masks", err);
    if (status != DF_OK) return status;
    scene->owned[1] = masks;
    scene->masks = masks;
    status = df_alloc((void **)&block_cells, blocks, sizeof *block_cells, "surface cells", err);
    if (status != DF_OK) return status;
    scene->owned[2] = block_cells;
    scene->block_cells = block_cells;
#pragma omp parallel for
    for (uint64_t i = 0; i < total; i++) {
        uint32_t cell[3];
        if (coarse[i] >= DF_CELL_INSIDE) continue;
        cell_of(scene, i, cell);
        dense_block(scene, cell, masks + (uint64_t)coarse[i] * words);
        block_cells[coarse[i]] = (uint32_t)i;
    }
    scene->precompute_bytes = total * sizeof *coarse + blocks * (words * sizeof *masks + sizeof *block_cells);
    return DF_OK;
}

/* Masks of bricks at an iso value other than 0. */
static df_status prepare_brick_masks(df_scene *scene, df_error *err) {
    const df_field *field = scene->field;
    uint32_t k = scene->k, words = df_brick_mask_words(k);
    uint64_t *masks;
    df_status status = df_alloc((void **)&masks, (uint64_t)field->brick_count * words, sizeof *masks, "surface masks", err);
    if (status != DF_OK) return status;
    scene->owned[1] = masks;
    scene->masks = masks;
    scene->precompute_bytes = (uint64_t)field->brick_count * words * sizeof *masks;
#pragma omp parallel for
    for (uint32_t b = 0; b < field->brick_count; b++) {
        uint32_t cell[3];
        cell_of(scene, field->brick_cells[b], cell);
        for (uint32_t bit = 0; bit < k * k * k; bit++) {
            uint32_t voxel[3] = {cell[0] * k + bit % k, cell[1] * k + bit / k % k, cell[2] * k + bit / k / k};
            float corner[8];
            if (voxel[0] >= scene->voxel_count[0] || voxel[1] >= scene->voxel_count[1] || voxel[2] >= scene->voxel_count[2]) continue;
            df_scene_corners(scene, voxel, b, corner);
            if (df_corners_straddle(corner, 0)) masks[(uint64_t)b * words + bit / 64] |= 1ull << (bit % 64);
        }
    }
    return DF_OK;
}

static df_status prepare_bricks(df_scene *scene, df_error *err) {
    const df_field *field = scene->field;
    scene->coarse = field->cells;
    scene->block_count = field->brick_count;
    scene->block_cells = field->brick_cells;
    scene->masks = field->brick_masks;
    if (scene->iso == 0) return DF_OK;
    float low, high;
    df_field_iso_range(field, &low, &high);
    if (!(scene->iso > low && scene->iso <= high)) {
        return df_fail(err, DF_ERROR_USAGE, "--iso %g: this field stores its surface for values above %g up to %g only",
                       (double)scene->iso, (double)low, (double)high);
    }
    return prepare_brick_masks(scene, err);
}

static df_status check_options(const df_scene *scene, const df_scene_options *options, df_error *err) {
    if (scene->field->kind != DF_FIELD_BRICKS) return DF_OK;
    if (options->levels == 1) return df_fail(err, DF_ERROR_USAGE, "--levels 1: a field of bricks has two levels");
    if (options->coarse && options->coarse != scene->field->brick_size) {
        return df_fail(err, DF_ERROR_USAGE, "--coarse %u: this field has bricks of %u voxels", options->coarse, scene->field->brick_size);
    }
    return DF_OK;
}

df_status df_scene_prepare(const df_field *field, float iso, const df_scene_options *options, df_scene *scene, df_error *err) {
    double start_ms = df_now_ms();
    memset(scene, 0, sizeof *scene);
    scene->field = field;
    scene->iso = iso;
    if (field->kind == DF_FIELD_ADF) return df_fail(err, DF_ERROR_UNSUPPORTED, "this version cannot trace octrees yet");
    df_status status = check_options(scene, options, err);
    if (status != DF_OK) return status;
    bool bricks = field->kind == DF_FIELD_BRICKS;
    scene->levels = !bricks && options->levels == 1 ? 1 : 2;
    scene->k = bricks ? field->brick_size : options->coarse ? options->coarse : 8;
    scene->k_shift = scene->k == 8 ? 3 : 2;
    for (int a = 0; a < 3; a++) {
        scene->voxel_count[a] = field->voxel_count[a];
        scene->coarse_count[a] = (field->voxel_count[a] + scene->k - 1) / scene->k;
    }
    if (bricks) status = prepare_bricks(scene, err);
    else if (scene->levels == 1) status = prepare_uniform(scene, err);
    else status = prepare_two_level(scene, err);
    if (status != DF_OK) df_scene_free(scene);
    else scene->precompute_ms = df_now_ms() - start_ms;
    return status;
}
