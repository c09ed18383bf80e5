#include "fields.h"
#include "common/memory.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static float value_at(const uint32_t voxel_count[3], int64_t i, int64_t j, int64_t k, test_function function,
                      const void *context) {
    int64_t at[3] = {i, j, k};
    double grid[3];
    for (int a = 0; a < 3; a++)
        grid[a] = (double)(at[a] < 0 ? 0 : at[a] > voxel_count[a] ? (int64_t)voxel_count[a] : at[a]);
    return (float)function(grid, context) + 0.0f;
}

static df_status make_dense(df_field *field, test_function function, const void *context, df_error *err) {
    float *samples;
    df_status status =
        df_alloc_raw((void **)&samples, df_dense_sample_count(field->voxel_count), sizeof *samples, "samples", err);
    if (status != DF_OK) return status;
    df_field_own(field, samples);
    field->samples = samples;
    for (uint32_t k = 0; k <= field->voxel_count[2]; k++) {
        for (uint32_t j = 0; j <= field->voxel_count[1]; j++) {
            for (uint32_t i = 0; i <= field->voxel_count[0]; i++) {
                *samples++ = value_at(field->voxel_count, i, j, k, function, context);
            }
        }
    }
    return df_field_finish(field, "test field", err);
}

/* True when a sample of the cell belongs to the 4x4x4 neighbourhood of a surface voxel. */
static bool cell_is_needed(const df_field *field, const uint32_t cell[3], test_function function, const void *context) {
    int64_t low[3], high[3]; /* surface voxels v whose samples v-1..v+2 meet the cell's samples */
    for (int a = 0; a < 3; a++) {
        low[a] = (int64_t)cell[a] * field->brick_size - 2;
        high[a] = (int64_t)(cell[a] + 1) * field->brick_size + 1;
        low[a] = low[a] < 0 ? 0 : low[a];
        high[a] = high[a] >= field->voxel_count[a] ? (int64_t)field->voxel_count[a] - 1 : high[a];
    }
    for (int64_t z = low[2]; z <= high[2]; z++) {
        for (int64_t y = low[1]; y <= high[1]; y++) {
            for (int64_t x = low[0]; x <= high[0]; x++) {
                float corners[8];
                for (int c = 0; c < 8; c++) {
                    corners[c] =
                        value_at(field->voxel_count, x + (c & 1), y + (c >> 1 & 1), z + (c >> 2), function, context);
                }
                if (df_corners_straddle(corners, 0)) return true;
            }
        }
    }
    return false;
}

static df_status make_bricks(df_field *field, test_function function, const void *context, df_error *err) {
    uint32_t k = field->brick_size, count[3], per_brick = df_brick_sample_count(k), *cells;
    for (int a = 0; a < 3; a++) count[a] = (field->voxel_count[a] + k - 1) / k;
    uint64_t cell_total = (uint64_t)count[0] * count[1] * count[2];
    float *samples;
    df_status status = df_alloc((void **)&cells, cell_total, sizeof *cells, "cells", err);
    if (status != DF_OK) return status;
    df_field_own(field, cells);
    field->cells = cells;
    for (uint64_t c = 0; c < cell_total; c++) {
        uint32_t cell[3] = {(uint32_t)(c % count[0]), (uint32_t)(c / count[0] % count[1]),
                            (uint32_t)(c / count[0] / count[1])};
        if (cell_is_needed(field, cell, function, context)) cells[c] = field->brick_count++;
        else
            cells[c] = value_at(field->voxel_count, cell[0] * k, cell[1] * k, cell[2] * k, function, context) < 0
                           ? DF_CELL_INSIDE
                           : DF_CELL_OUTSIDE;
    }
    status = df_alloc_raw((void **)&samples, (uint64_t)field->brick_count * per_brick, sizeof *samples, "samples", err);
    if (status != DF_OK) return status;
    df_field_own(field, samples);
    field->samples = samples;
    for (uint64_t c = 0; c < cell_total; c++) {
        if (cells[c] >= DF_CELL_INSIDE) continue;
        int64_t cell[3] = {(int64_t)(c % count[0]), (int64_t)(c / count[0] % count[1]),
                           (int64_t)(c / count[0] / count[1])};
        for (uint32_t s = 0; s < per_brick; s++) {
            *samples++ = value_at(field->voxel_count, cell[0] * k + s % (k + 1), cell[1] * k + s / (k + 1) % (k + 1),
                                  cell[2] * k + s / (k + 1) / (k + 1), function, context);
        }
    }
    return df_field_finish(field, "test field", err);
}

/* A family in the making. */
typedef struct family_place {
    uint32_t corner[3], side; /* of the parent cell */
} family_place;

static void sample_family(const family_place *place, test_function function, const void *context, float samples[27]) {
    for (uint32_t s = 0; s < 27; s++) {
        double half = place->side / 2.0;
        double grid[3] = {place->corner[0] + half * (s % 3), place->corner[1] + half * (s / 3 % 3),
                          place->corner[2] + half * (s / 9)};
        samples[s] = (float)function(grid, context) + 0.0f;
    }
}

/* True when the voxel samples of the closed cell lie on both sides. */
static bool cell_is_mixed(const family_place *place, test_function function, const void *context) {
    bool any[2] = {false, false};
    for (uint32_t k = 0; k <= place->side; k++) {
        for (uint32_t j = 0; j <= place->side; j++) {
            for (uint32_t i = 0; i <= place->side; i++) {
                double grid[3] = {place->corner[0] + i, place->corner[1] + j, place->corner[2] + k};
                any[(float)function(grid, context) < 0] = true;
            }
        }
    }
    return any[0] && any[1];
}

static df_status make_adf(df_field *field, test_function function, const void *context, df_error *err) {
    enum { FAMILY_MAX = 1 << 20 };
    df_family *families;
    family_place *places = NULL;
    float *samples;
    uint64_t most = 1, level = 1; /* families */
    for (field->level_count = 1; (1u << field->level_count) < field->voxel_count[0] ||
                                 (1u << field->level_count) < field->voxel_count[1] ||
                                 (1u << field->level_count) < field->voxel_count[2];) {
        field->level_count++;
        most += level *= 8;
    }
    if (most > FAMILY_MAX) most = FAMILY_MAX;
    df_status status = df_alloc((void **)&families, most, sizeof *families, "families", err);
    if (status != DF_OK) return status;
    df_field_own(field, families);
    status = df_alloc_raw((void **)&samples, 8 + most * DF_FAMILY_STORED_COUNT, sizeof *samples, "samples", err);
    if (status != DF_OK) return status;
    df_field_own(field, samples);
    status = df_alloc((void **)&places, most, sizeof *places, "places", err);
    if (status != DF_OK) return status;
    places[0].side = 1u << field->level_count;
    uint32_t count = 1;
    for (uint32_t f = 0; f < count; f++) {
        float family[27];
        sample_family(&places[f], function, context, family);
        df_family_store(family, f, samples);
        for (uint32_t child = 0; child < 8; child++) {
            family_place place = {.side = places[f].side / 2};
            for (int a = 0; a < 3; a++) place.corner[a] = places[f].corner[a] + (child >> a & 1) * place.side;
            bool mixed = place.side > 1 && cell_is_mixed(&place, function, context);
            if (mixed && count < most) {
                families[f].states |= (uint32_t)DF_CHILD_FAMILY << 2 * child;
                places[count++] = place;
            }
        }
    }
    free(places);
    field->families = families;
    field->samples = samples;
    field->family_count = count;
    return df_field_finish(field, "test field", err);
}

df_status test_field_from_function(df_field *field, df_field_kind kind, uint32_t brick_size,
                                   const uint32_t voxel_count[3], test_function function, const void *context,
                                   df_error *err) {
    *field = (df_field){
        .kind = kind, .sample_type = DF_SAMPLE_F32, .voxel_size = {1, 1, 1}, .error_max = -1, .error_rms = -1};
    memcpy(field->voxel_count, voxel_count, sizeof field->voxel_count);
    if (kind == DF_FIELD_BRICKS) field->brick_size = brick_size;
    df_status status = kind == DF_FIELD_BRICKS ? make_bricks(field, function, context, err)
                       : kind == DF_FIELD_ADF  ? make_adf(field, function, context, err)
                                               : make_dense(field, function, context, err);
    if (status != DF_OK) df_field_free(field);
    return status;
}

typedef struct sphere {
    double centre[3], radius;
} sphere;

static double sphere_distance(const double grid[3], const void *context) {
    const sphere *s = context;
    double x = grid[0] - s->centre[0], y = grid[1] - s->centre[1], z = grid[2] - s->centre[2];
    return sqrt(x * x + y * y + z * z) - s->radius;
}

df_status test_field_sphere(df_field *field, df_field_kind kind, uint32_t brick_size, const uint32_t voxel_count[3],
                            double radius, df_error *err) {
    sphere s = {{voxel_count[0] / 2.0, voxel_count[1] / 2.0, voxel_count[2] / 2.0}, radius};
    return test_field_from_function(field, kind, brick_size, voxel_count, sphere_distance, &s, err);
}

df_status test_field_quantise(df_field *field, df_sample_type type, df_error *err) {
    enum { EXPONENT = -3 };
    const bool adf = field->kind == DF_FIELD_ADF;
    const uint64_t floats = adf ? 8 + DF_FAMILY_STORED_COUNT : 0;
    const uint32_t blocks = adf ? field->family_count - 1 : field->brick_count;
    const float *values = field->samples;
    uint8_t *samples, *exponents;
    df_status status = df_alloc((void **)&samples, field->sample_count, sizeof(float), "samples", err);
    if (status != DF_OK) return status;
    df_field_own(field, samples);
    status = df_alloc((void **)&exponents, blocks + 1, 1, "exponents", err);
    if (status != DF_OK) return status;
    df_field_own(field, exponents);
    memcpy(samples, values, floats * sizeof(float));
    uint8_t *quantised = samples + floats * sizeof(float);
    for (uint64_t i = floats; i < field->sample_count; i++) {
        double q = (double)values[i] / 0.125;
        int whole = (int)(q < 0 ? q - 1 : q), limit = type == DF_SAMPLE_U16 ? 32767 : 127;
        whole = whole < -limit ? -limit : whole > limit ? limit : whole;
        if (type == DF_SAMPLE_U16) ((uint16_t *)quantised)[i - floats] = (uint16_t)(whole + 32768);
        else quantised[i - floats] = (uint8_t)(whole + 128);
    }
    memset(exponents, EXPONENT & 0xFF, blocks);
    field->samples = samples;
    field->sample_type = type;
    if (adf) field->exact_count = 1;
    if (field->kind == DF_FIELD_DENSE) field->step_exponent = EXPONENT;
    else field->brick_exponents = (const int8_t *)exponents;
    return df_field_finish(field, "test field", err);
}
