#include "render/scene.h"
#include "common/memory.h"
#include "common/progress.h"
#include "render/methods/gradient.h"
#include "render/methods/leaf.h"

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
    if (scene->field->kind == DF_FIELD_ADF) return "adf";
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
    if (field->kind == DF_FIELD_ADF) {
        df_adf_corners(field, block >> 3, block & 7, corner);
        for (int c = 0; c < 8; c++) corner[c] -= scene->iso;
        return;
    }
    if (field->kind == DF_FIELD_BRICKS) {
        uint32_t side = scene->k + 1, mask = scene->k - 1;
        row = side;
        slice = side * side;
        at = (uint64_t)block * df_brick_sample_count(scene->k) + (voxel[0] & mask) + row * (voxel[1] & mask) +
             slice * (voxel[2] & mask);
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

/* Where samples of a run start: of the whole dense field or of one brick. */
typedef struct sample_run {
    uint64_t first, row, slice;
    uint32_t block;
} sample_run;

static sample_run run_of_block(const df_scene *scene, uint32_t block) {
    const df_field *field = scene->field;
    if (field->kind == DF_FIELD_BRICKS) {
        uint32_t side = scene->k + 1;
        return (sample_run){(uint64_t)block * df_brick_sample_count(scene->k), side, side * side, block};
    }
    uint64_t row = (uint64_t)field->voxel_count[0] + 1;
    return (sample_run){0, row, row * ((uint64_t)field->voxel_count[1] + 1), 0};
}

/* Fills the 4 samples one step beyond the cell along `axis`, before it or after it, at strides of `step` floats. */
static void stencil_face(const df_scene *scene, const uint32_t voxel[3], uint32_t block, int axis, bool after,
                         float *stencil, size_t step) {
    const df_field *field = scene->field;
    const int u = (axis + 1) % 3, v = (axis + 2) % 3, stride[3] = {1, 4, 16};
    const int corner = DF_STENCIL(0, 0, 0), beyond = corner + (after ? 2 : -1) * stride[axis];
    const int64_t at = (int64_t)voxel[axis] + (after ? 2 : -1);
    bool exists = at >= 0 && at <= field->voxel_count[axis];
    if (exists && field->kind == DF_FIELD_BRICKS) {
        int64_t low = voxel[axis] & ~(scene->k - 1);
        if (at < low || at > low + scene->k) { /* in the next brick, when there is one */
            uint32_t cell[3] = {voxel[0], voxel[1], voxel[2]};
            cell[axis] = (uint32_t)(after ? at - 1 : at);
            block = df_scene_block(scene, cell[0], cell[1], cell[2]);
        }
    }
    const bool stored = exists && block < DF_CELL_INSIDE;
    const sample_run run = run_of_block(scene, stored ? block : 0);
    const uint32_t mask = field->kind == DF_FIELD_BRICKS ? scene->k - 1 : 0xFFFFFFFFu;
    const uint64_t strides[3] = {1, run.row, run.slice};
    /* after: the sample is the upper neighbour of at - 1, which lies in the same brick */
    const uint64_t along = after ? ((uint64_t)(at - 1) & mask) + 1 : (uint64_t)at & mask;
    const uint64_t first =
        run.first + along * strides[axis] + (voxel[u] & mask) * strides[u] + (voxel[v] & mask) * strides[v];
    for (int i = 0; i < 4; i++) {
        const int side = (i & 1) * stride[u] + (i >> 1) * stride[v];
        float *out = &stencil[(size_t)(beyond + side) * step];
        if (stored) {
            *out = decode(field, first + (i & 1) * strides[u] + (uint64_t)(i >> 1) * strides[v], block);
            continue;
        }
        uint32_t sample[3];
        sample[axis] = (uint32_t)at;
        sample[u] = voxel[u] + (i & 1);
        sample[v] = voxel[v] + (i >> 1);
        if (exists && df_field_sample(field, sample, out)) continue;
        float near = stencil[(size_t)(corner + side + (after ? stride[axis] : 0)) * step];
        float next = stencil[(size_t)(corner + side + (after ? 0 : stride[axis])) * step];
        *out = (near + near) - next;
    }
}

/* The sample at an offset from a voxel; false where it is not stored or outside the field. */
static bool field_sample(const df_field *field, const uint32_t voxel[3], const int offset[3], float *value) {
    uint32_t sample[3];
    for (int a = 0; a < 3; a++) {
        const int64_t at = (int64_t)voxel[a] + offset[a];
        if (at < 0 || at > field->voxel_count[a]) return false;
        sample[a] = (uint32_t)at;
    }
    return df_field_sample(field, sample, value);
}

void df_scene_stencil(const df_scene *scene, const uint32_t voxel[3], uint32_t block, int reach, float *stencil,
                      size_t step) {
    const sample_run run = run_of_block(scene, block);
    const uint32_t mask = scene->field->kind == DF_FIELD_BRICKS ? scene->k - 1 : 0xFFFFFFFFu;
    const uint64_t first = run.first + (voxel[0] & mask) + (voxel[1] & mask) * run.row + (voxel[2] & mask) * run.slice;
    for (int c = 0; c < 8; c++) {
        const uint64_t at = first + (c & 1) + (c & 2 ? run.row : 0) + (c & 4 ? run.slice : 0);
        stencil[(size_t)DF_STENCIL(c & 1, c >> 1 & 1, c >> 2) * step] = decode(scene->field, at, block);
    }
    for (int face = 0; reach >= DF_REACH_FACES && face < 6; face++)
        stencil_face(scene, voxel, block, face >> 1, face & 1, stencil, step);
    for (int outside = 2; reach == DF_REACH_ALL && outside <= 3; outside++) {
        for (int i = 0; i < 64; i++) {
            const int at[3] = {i % 4 - 1, i / 4 % 4 - 1, i / 16 - 1};
            if (df_stencil_outside(at) != outside) continue;
            if (!field_sample(scene->field, voxel, at, &stencil[(size_t)i * step]))
                stencil[(size_t)i * step] = df_stencil_extend(stencil, step, at);
        }
    }
}

void df_scene_leaf_stencil(const df_scene *scene, const uint32_t corner[3], uint32_t block, uint32_t size_log2,
                           int reach, float *stencil, size_t step) {
    df_leaf_stencil(scene->field, corner, block, size_log2, reach, stencil, step);
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
    df_status status =
        df_alloc((void **)&rows, (uint64_t)scene->row_words * count[1] * count[2], sizeof *rows, "surface mask", err);
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
    df_status status =
        df_alloc((void **)&masks, (uint64_t)field->brick_count * words, sizeof *masks, "surface masks", err);
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
            if (voxel[0] >= scene->voxel_count[0] || voxel[1] >= scene->voxel_count[1] ||
                voxel[2] >= scene->voxel_count[2])
                continue;
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
    if (scene->field->kind == DF_FIELD_ADF && (options->levels || options->coarse)) {
        return df_fail(err, DF_ERROR_USAGE, "--levels and --coarse are for dense fields: this one is an octree");
    }
    if (scene->field->kind != DF_FIELD_BRICKS) return DF_OK;
    if (options->levels == 1) return df_fail(err, DF_ERROR_USAGE, "--levels 1: a field of bricks has two levels");
    if (options->coarse && options->coarse != scene->field->brick_size) {
        return df_fail(err, DF_ERROR_USAGE, "--coarse %u: this field has bricks of %u voxels", options->coarse,
                       scene->field->brick_size);
    }
    return DF_OK;
}

df_status df_scene_prepare(const df_field *field, float iso, const df_scene_options *options, df_scene *scene,
                           df_error *err) {
    double start_ms = df_now_ms();
    memset(scene, 0, sizeof *scene);
    scene->field = field;
    scene->iso = iso;
    df_status status = check_options(scene, options, err);
    if (status != DF_OK) return status;
    for (int a = 0; a < 3; a++) scene->voxel_count[a] = field->voxel_count[a];
    if (field->kind == DF_FIELD_ADF) return DF_OK; /* traced as it is */
    bool bricks = field->kind == DF_FIELD_BRICKS;
    scene->levels = !bricks && options->levels == 1 ? 1 : 2;
    scene->k = bricks ? field->brick_size : options->coarse ? options->coarse : 8;
    scene->k_shift = scene->k == 8 ? 3 : 2;
    for (int a = 0; a < 3; a++) {
        scene->coarse_count[a] = (field->voxel_count[a] + scene->k - 1) / scene->k;
    }
    if (bricks) status = prepare_bricks(scene, err);
    else if (scene->levels == 1) status = prepare_uniform(scene, err);
    else status = prepare_two_level(scene, err);
    if (status != DF_OK) df_scene_free(scene);
    else scene->precompute_ms = df_now_ms() - start_ms;
    return status;
}
