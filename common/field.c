#include "common/field.h"
#include "common/memory.h"
#include "common/octree_samples.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

enum { PARALLEL_SAMPLES = 100000 }; /* below that, threads cost more than they gain */

void df_field_free(df_field *field) {
    for (uint32_t i = 0; i < field->block_count; i++) free(field->blocks[i]);
    if (field->mapping) munmap(field->mapping, field->mapping_size);
    memset(field, 0, sizeof *field);
}

void df_field_own(df_field *field, void *block) {
    assert(field->block_count < sizeof field->blocks / sizeof field->blocks[0]);
    field->blocks[field->block_count++] = block;
}

const char *df_field_kind_name(df_field_kind kind) {
    switch (kind) {
    case DF_FIELD_DENSE: return "dense";
    case DF_FIELD_BRICKS: return "bricks";
    case DF_FIELD_ADF: return "adf";
    }
    return "?";
}

const char *df_sample_type_name(df_sample_type type) {
    switch (type) {
    case DF_SAMPLE_F32: return "f32";
    case DF_SAMPLE_U16: return "u16";
    case DF_SAMPLE_U8: return "u8";
    }
    return "?";
}

const char *df_verdict_name(df_verdict verdict) {
    switch (verdict) {
    case DF_VERDICT_UNKNOWN: return "unknown";
    case DF_VERDICT_CERTAIN: return "certain";
    case DF_VERDICT_REPAIRED: return "repaired";
    case DF_VERDICT_UNCERTAIN: return "uncertain";
    }
    return "?";
}

float df_field_decode(const df_field *field, uint64_t index, int exponent) {
    assert(index < field->sample_count);
    switch (field->sample_type) {
    case DF_SAMPLE_F32: return ((const float *)field->samples)[index];
    case DF_SAMPLE_U16:
        return (float)((int)((const uint16_t *)field->samples)[index] - 32768) * df_power_of_two(exponent);
    case DF_SAMPLE_U8: return (float)((int)((const uint8_t *)field->samples)[index] - 128) * df_power_of_two(exponent);
    }
    return 0;
}

bool df_corners_straddle(const float corners[8], float iso) {
    int inside = 0;
    for (int c = 0; c < 8; c++) inside += corners[c] < iso;
    return inside > 0 && inside < 8;
}

static int brick_exponent(const df_field *field, uint32_t brick) {
    return field->brick_exponents ? field->brick_exponents[brick] : 0;
}

static uint64_t dense_index(const df_field *field, uint32_t i, uint32_t j, uint32_t k) {
    uint64_t row = (uint64_t)field->voxel_count[0] + 1, slice = row * ((uint64_t)field->voxel_count[1] + 1);
    return i + row * j + slice * k;
}

static uint64_t cell_index(const df_field *field, const uint32_t cell[3]) {
    return cell[0] + (uint64_t)field->cell_count[0] * (cell[1] + (uint64_t)field->cell_count[1] * cell[2]);
}

bool df_field_corners(const df_field *field, const uint32_t voxel[3], float corners[8]) {
    assert(voxel[0] < field->voxel_count[0] && voxel[1] < field->voxel_count[1] && voxel[2] < field->voxel_count[2]);
    if (field->kind == DF_FIELD_DENSE) {
        for (int c = 0; c < 8; c++) {
            uint64_t index = dense_index(field, voxel[0] + (c & 1), voxel[1] + (c >> 1 & 1), voxel[2] + (c >> 2));
            corners[c] = df_field_decode(field, index, field->step_exponent);
        }
        return true;
    }
    uint32_t k = field->brick_size, side = k + 1, cell[3], local[3];
    for (int a = 0; a < 3; a++) {
        cell[a] = voxel[a] / k;
        local[a] = voxel[a] % k;
    }
    uint32_t brick = field->cells[cell_index(field, cell)];
    if (brick >= DF_CELL_INSIDE) {
        for (int c = 0; c < 8; c++) corners[c] = brick == DF_CELL_INSIDE ? -INFINITY : INFINITY;
        return false;
    }
    uint64_t first = (uint64_t)brick * df_brick_sample_count(k);
    for (int c = 0; c < 8; c++) {
        uint32_t at = local[0] + (c & 1) + side * (local[1] + (c >> 1 & 1) + side * (local[2] + (c >> 2)));
        corners[c] = df_field_decode(field, first + at, brick_exponent(field, brick));
    }
    return true;
}

bool df_field_sample(const df_field *field, const uint32_t sample[3], float *value) {
    /* A sample is corner of up to 8 voxels; any that stores it will do. */
    for (int c = 0; c < 8; c++) {
        uint32_t voxel[3];
        int corner = 0;
        bool exists = true;
        for (int a = 0; a < 3; a++) {
            uint32_t back = c >> a & 1;
            exists = exists && sample[a] >= back && sample[a] - back < field->voxel_count[a];
            voxel[a] = sample[a] - back;
            corner |= (int)back << a;
        }
        float corners[8];
        if (!exists) continue;
        bool stored = df_field_corners(field, voxel, corners);
        *value = corners[corner];
        if (stored) return true;
    }
    return false;
}

double df_trilinear(const float v[8], const double local[3]) { return df_octree_interpolate(v, local); }

void df_trilinear_gradient(const float v[8], const double local[3], double gradient[3]) {
    for (int axis = 0; axis < 3; axis++) {
        int u = (axis + 1) % 3, w = (axis + 2) % 3;
        double sum = 0;
        for (int c = 0; c < 8; c++) {
            double weight = (c >> u & 1 ? local[u] : 1 - local[u]) * (c >> w & 1 ? local[w] : 1 - local[w]);
            sum += (c >> axis & 1 ? weight : -weight) * (double)v[c];
        }
        gradient[axis] = sum;
    }
}

void df_field_world_to_grid(const df_field *field, const double world[3], double grid[3]) {
    for (int a = 0; a < 3; a++) grid[a] = (world[a] - field->origin[a]) / field->voxel_size[a];
}

void df_field_grid_to_world(const df_field *field, const double grid[3], double world[3]) {
    for (int a = 0; a < 3; a++) world[a] = field->origin[a] + grid[a] * field->voxel_size[a];
}

/* The corners around a grid position within the box, the position among them, and the cell's side in voxels. Returns
 * false where nothing is stored. */
static bool corners_at(const df_field *field, const double grid[3], float corners[8], double local[3], double *side) {
    uint32_t voxel[3];
    if (field->kind == DF_FIELD_ADF) {
        df_adf_cell cell;
        df_adf_find(field, grid, DF_LEVEL_COUNT_MAX, &cell);
        df_adf_corners(field, cell.family, cell.child, corners);
        for (int a = 0; a < 3; a++) local[a] = (grid[a] - cell.corner[a]) / cell.side;
        *side = cell.side;
        return true;
    }
    for (int a = 0; a < 3; a++) {
        voxel[a] = (uint32_t)grid[a];
        if (voxel[a] == field->voxel_count[a]) voxel[a]--; /* the upper face belongs to the last voxel */
        local[a] = grid[a] - voxel[a];
    }
    *side = 1;
    return df_field_corners(field, voxel, corners);
}

void df_field_query(const df_field *field, const double world[3], df_point_info *info) {
    double grid[3], local[3], side;
    float corners[8];
    memset(info, 0, sizeof *info);
    df_field_world_to_grid(field, world, grid);
    for (int a = 0; a < 3; a++) {
        if (grid[a] >= 0 && grid[a] <= field->voxel_count[a]) continue;
        info->side = DF_SIDE_BEYOND;
        return;
    }
    info->stored = corners_at(field, grid, corners, local, &side);
    if (!info->stored) {
        info->side = corners[0] < 0 ? DF_SIDE_INSIDE : DF_SIDE_OUTSIDE;
        return;
    }
    info->surface = df_corners_straddle(corners, 0);
    info->value = df_trilinear(corners, local);
    info->side = info->value < 0 ? DF_SIDE_INSIDE : DF_SIDE_OUTSIDE;
    df_trilinear_gradient(corners, local, info->gradient);
    for (int a = 0; a < 3; a++) info->gradient[a] /= side * field->voxel_size[a];
}

uint64_t df_field_surface_voxel_count(const df_field *field) {
    uint64_t count = 0;
    if (field->kind == DF_FIELD_ADF) {
        for (uint32_t f = 0; f < field->family_count; f++) {
            uint32_t states = field->families[f].states;
            count += (uint64_t)__builtin_popcount(states >> 1 & ~states & 0x5555); /* DF_CHILD_SURFACE is binary 10 */
        }
        return count;
    }
    if (field->kind == DF_FIELD_BRICKS) {
        uint64_t words = (uint64_t)field->brick_count * df_brick_mask_words(field->brick_size);
        for (uint64_t i = 0; i < words; i++) count += (uint64_t)__builtin_popcountll(field->brick_masks[i]);
        return count;
    }
#pragma omp parallel for reduction(+ : count) if (df_dense_sample_count(field->voxel_count) > PARALLEL_SAMPLES)
    for (uint32_t z = 0; z < field->voxel_count[2]; z++) {
        for (uint32_t y = 0; y < field->voxel_count[1]; y++) {
            for (uint32_t x = 0; x < field->voxel_count[0]; x++) {
                float corners[8];
                df_field_corners(field, (uint32_t[3]){x, y, z}, corners);
                count += df_corners_straddle(corners, 0);
            }
        }
    }
    return count;
}

/* The range of the samples on the face of a brick: axis 0..2, upper 0 or 1. */
static void face_range(const df_field *field, uint32_t brick, int axis, uint32_t upper, float range[2]) {
    uint32_t k = field->brick_size, side = k + 1, stride[3] = {1, side, side * side};
    uint64_t first = (uint64_t)brick * df_brick_sample_count(k) + (upper ? (uint64_t)k * stride[axis] : 0);
    uint32_t u = stride[(axis + 1) % 3], v = stride[(axis + 2) % 3];
    range[0] = INFINITY;
    range[1] = -INFINITY;
    for (uint32_t j = 0; j < side; j++) {
        for (uint32_t i = 0; i < side; i++) {
            float value =
                df_field_decode(field, first + i * (uint64_t)u + j * (uint64_t)v, brick_exponent(field, brick));
            range[0] = fminf(range[0], value);
            range[1] = fmaxf(range[1], value);
        }
    }
}

void df_field_iso_range(const df_field *field, float *low, float *high) {
    *low = -INFINITY;
    *high = INFINITY;
    if (field->kind == DF_FIELD_ADF) {
        *low = -0x1p-149f; /* the largest number below 0 */
        *high = 0;
    }
    if (field->kind != DF_FIELD_BRICKS) return;
    for (uint32_t brick = 0; brick < field->brick_count; brick++) {
        uint32_t at = field->brick_cells[brick];
        uint32_t cell[3] = {at % field->cell_count[0], at / field->cell_count[0] % field->cell_count[1],
                            at / field->cell_count[0] / field->cell_count[1]};
        for (int face = 0; face < 6; face++) {
            int axis = face / 2;
            uint32_t upper = face % 2, other[3] = {cell[0], cell[1], cell[2]};
            if (upper ? cell[axis] + 1 >= field->cell_count[axis] : cell[axis] == 0) continue;
            other[axis] = upper ? cell[axis] + 1 : cell[axis] - 1;
            uint32_t token = field->cells[cell_index(field, other)];
            if (token < DF_CELL_INSIDE) continue;
            float range[2];
            face_range(field, brick, axis, upper, range);
            if (token == DF_CELL_OUTSIDE) *high = fminf(*high, range[0]);
            else *low = fmaxf(*low, range[1]);
        }
    }
}

static df_status check_dimensions(df_field *field, const char *name, df_error *err) {
    for (int a = 0; a < 3; a++) {
        if (field->voxel_count[a] < 1 || field->voxel_count[a] > DF_VOXEL_COUNT_MAX) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu32 " voxels along axis %d (1 to %u are possible)", name,
                           field->voxel_count[a], a, DF_VOXEL_COUNT_MAX);
        }
        if (!(field->voxel_size[a] > 0) || !isfinite(field->voxel_size[a]) || !isfinite(field->origin[a]) ||
            !isfinite(field->origin[a] + field->voxel_size[a] * field->voxel_count[a])) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: voxel size %g at origin %g along axis %d is not usable", name,
                           field->voxel_size[a], field->origin[a], a);
        }
    }
    return DF_OK;
}

/* Ranges of a run of samples; returns false at the first one that is not finite. */
static bool sample_range(const df_field *field, uint64_t first, uint64_t count, int exponent, float range[2]) {
    float low = INFINITY, high = -INFINITY;
    if (field->sample_type == DF_SAMPLE_F32) {
        const float *values = (const float *)field->samples + first;
        float sum = 0; /* becomes NaN when any value is not finite, and then only */
        for (uint64_t i = 0; i < count; i++) {
            low = values[i] < low ? values[i] : low;
            high = values[i] > high ? values[i] : high;
            sum += values[i] * 0.0f;
        }
        range[0] = low;
        range[1] = high;
        return sum == 0.0f;
    }
    uint32_t qlow = UINT32_MAX, qhigh = 0;
    for (uint64_t i = first; i < first + count; i++) {
        uint32_t q = field->sample_type == DF_SAMPLE_U16 ? ((const uint16_t *)field->samples)[i]
                                                         : ((const uint8_t *)field->samples)[i];
        qlow = q < qlow ? q : qlow;
        qhigh = q > qhigh ? q : qhigh;
    }
    int zero = field->sample_type == DF_SAMPLE_U16 ? 32768 : 128;
    range[0] = (float)((int)qlow - zero) * df_power_of_two(exponent);
    range[1] = (float)((int)qhigh - zero) * df_power_of_two(exponent);
    return isfinite(range[0]) && isfinite(range[1]);
}

static df_status finish_dense(df_field *field, const char *name, df_error *err) {
    uint64_t slice = ((uint64_t)field->voxel_count[0] + 1) * ((uint64_t)field->voxel_count[1] + 1);
    float low = INFINITY, high = -INFINITY;
    uint64_t bad = 0;
    field->sample_count = df_dense_sample_count(field->voxel_count);
#pragma omp parallel for reduction(min : low) reduction(max : high) reduction(+ : bad) if (field->sample_count > PARALLEL_SAMPLES)
    for (uint32_t z = 0; z <= field->voxel_count[2]; z++) {
        float range[2];
        if (!sample_range(field, z * slice, slice, field->step_exponent, range)) bad++;
        low = range[0] < low ? range[0] : low;
        high = range[1] > high ? range[1] : high;
    }
    if (bad) return df_fail(err, DF_ERROR_FORMAT, "%s: samples that are not finite in %" PRIu64 " slices", name, bad);
    field->value_min = low;
    field->value_max = high;
    return DF_OK;
}

/* The straddle mask of a brick from its samples; voxels past voxel_count stay clear. */
static void brick_mask(const df_field *field, uint32_t brick, uint64_t *mask) {
    uint32_t k = field->brick_size, side = k + 1, at = field->brick_cells[brick], limit[3];
    uint32_t cell[3] = {at % field->cell_count[0], at / field->cell_count[0] % field->cell_count[1],
                        at / field->cell_count[0] / field->cell_count[1]};
    for (int a = 0; a < 3; a++) {
        uint32_t left = field->voxel_count[a] - cell[a] * k;
        limit[a] = left < k ? left : k;
    }
    /* Per row of samples, one bit a sample: inside or not. */
    uint32_t rows[9][9];
    uint64_t first = (uint64_t)brick * df_brick_sample_count(k);
    for (uint32_t z = 0; z < side; z++) {
        for (uint32_t y = 0; y < side; y++) {
            uint32_t bits = 0;
            for (uint32_t x = 0; x < side; x++, first++) {
                bool inside;
                switch (field->sample_type) {
                case DF_SAMPLE_U16: inside = ((const uint16_t *)field->samples)[first] < 32768; break;
                case DF_SAMPLE_U8: inside = ((const uint8_t *)field->samples)[first] < 128; break;
                default: inside = ((const float *)field->samples)[first] < 0; break;
                }
                bits |= (uint32_t)inside << x;
            }
            rows[z][y] = bits;
        }
    }
    memset(mask, 0, df_brick_mask_words(k) * sizeof *mask);
    for (uint32_t z = 0; z < limit[2]; z++) {
        for (uint32_t y = 0; y < limit[1]; y++) {
            uint32_t any = rows[z][y] | rows[z][y + 1] | rows[z + 1][y] | rows[z + 1][y + 1];
            uint32_t all = rows[z][y] & rows[z][y + 1] & rows[z + 1][y] & rows[z + 1][y + 1];
            uint64_t straddle = (any | any >> 1) & ~(all & all >> 1) & ((1u << limit[0]) - 1);
            uint32_t bit = k * (y + k * z);
            mask[bit / 64] |= straddle << (bit % 64);
        }
    }
}

/* Numbers the bricks by their cells and checks that each is named once, in order. */
static df_status index_bricks(const df_field *field, uint32_t *brick_cells, const char *name, df_error *err) {
    uint64_t cell_total = (uint64_t)field->cell_count[0] * field->cell_count[1] * field->cell_count[2];
    uint32_t next = 0;
    for (uint64_t i = 0; i < cell_total; i++) {
        uint32_t token = field->cells[i];
        if (token >= DF_CELL_INSIDE) continue;
        if (token != next || next >= field->brick_count) {
            return df_fail(err, DF_ERROR_FORMAT,
                           "%s: coarse cell %" PRIu64 " names brick %" PRIu32 ", expected %" PRIu32 " of %" PRIu32,
                           name, i, token, next, field->brick_count);
        }
        brick_cells[next++] = (uint32_t)i;
    }
    if (next != field->brick_count) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: the coarse cells name %" PRIu32 " of %" PRIu32 " bricks", name, next,
                       field->brick_count);
    }
    return DF_OK;
}

static df_status finish_bricks(df_field *field, const char *name, df_error *err) {
    uint32_t k = field->brick_size;
    if (k != 4 && k != 8)
        return df_fail(err, DF_ERROR_FORMAT, "%s: brick size %" PRIu32 " (4 and 8 are possible)", name, k);
    for (int a = 0; a < 3; a++) field->cell_count[a] = (field->voxel_count[a] + k - 1) / k;
    uint64_t cell_total = (uint64_t)field->cell_count[0] * field->cell_count[1] * field->cell_count[2];
    if (cell_total >= DF_BRICK_COUNT_MAX || field->brick_count > cell_total) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: %" PRIu32 " bricks in %" PRIu64 " coarse cells", name,
                       field->brick_count, cell_total);
    }
    field->sample_count = (uint64_t)field->brick_count * df_brick_sample_count(k);

    uint32_t *brick_cells;
    float *ranges;
    uint64_t *masks;
    df_status status = df_alloc((void **)&brick_cells, field->brick_count, sizeof *brick_cells, "bricks", err);
    if (status != DF_OK) return status;
    df_field_own(field, brick_cells);
    status = df_alloc((void **)&ranges, field->brick_count, 2 * sizeof *ranges, "brick ranges", err);
    if (status != DF_OK) return status;
    df_field_own(field, ranges);
    uint32_t words = df_brick_mask_words(k);
    status = df_alloc((void **)&masks, (uint64_t)field->brick_count * words, sizeof *masks, "brick masks", err);
    if (status != DF_OK) return status;
    df_field_own(field, masks);
    status = index_bricks(field, brick_cells, name, err);
    if (status != DF_OK) return status;
    field->brick_cells = brick_cells;
    field->brick_ranges = ranges;
    field->brick_masks = masks;

    float low = INFINITY, high = -INFINITY;
    uint64_t bad = 0;
    uint32_t per_brick = df_brick_sample_count(k);
#pragma omp parallel for reduction(min : low) reduction(max : high) reduction(+ : bad) if (field->sample_count > PARALLEL_SAMPLES)
    for (uint32_t b = 0; b < field->brick_count; b++) {
        if (!sample_range(field, (uint64_t)b * per_brick, per_brick, brick_exponent(field, b),
                          ranges + 2 * (uint64_t)b))
            bad++;
        low = ranges[2 * (uint64_t)b] < low ? ranges[2 * (uint64_t)b] : low;
        high = ranges[2 * (uint64_t)b + 1] > high ? ranges[2 * (uint64_t)b + 1] : high;
        brick_mask(field, b, masks + (uint64_t)b * words);
    }
    if (bad) return df_fail(err, DF_ERROR_FORMAT, "%s: samples that are not finite in %" PRIu64 " bricks", name, bad);
    field->value_min = field->brick_count ? low : 0;
    field->value_max = field->brick_count ? high : 0;
    return DF_OK;
}

df_status df_field_finish(df_field *field, const char *name, df_error *err) {
    df_status status = check_dimensions(field, name, err);
    if (status != DF_OK) return status;
    if (!field->provenance) field->provenance = "{}";
    if (field->kind == DF_FIELD_DENSE) return finish_dense(field, name, err);
    if (field->kind == DF_FIELD_BRICKS) return finish_bricks(field, name, err);
    if (field->kind == DF_FIELD_ADF) return df_octree_finish(field, name, err);
    return df_fail(err, DF_ERROR_FORMAT, "%s: kind %d is not known", name, (int)field->kind);
}
