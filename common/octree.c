#include "common/octree.h"
#include "common/field.h"
#include "common/memory.h"
#include "common/octree_samples.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { PARALLEL_FAMILIES = 4000 }; /* below that, threads cost more than they gain */

void df_adf_find(const df_field *field, const double grid[3], uint32_t level_limit, df_adf_cell *cell) {
    assert(field->kind == DF_FIELD_ADF && level_limit >= 1);
    df_octree_find(field, grid, level_limit, cell);
}

void df_adf_corners(const df_field *field, uint32_t family, uint32_t child, float corners[8]) {
    df_octree_corners(field, family, child, corners);
}

void df_adf_cell_corners(const df_field *field, uint32_t family, float cell[8]) {
    df_octree_cell_corners(field, family, cell);
}

void df_adf_child_corners(const df_field *field, uint32_t family, uint32_t child, const float cell[8],
                          float corners[8]) {
    df_octree_child_corners(field, family, child, cell, corners);
}

void df_adf_samples(const df_field *field, uint32_t family, const float cell[8],
                    float samples[DF_FAMILY_SAMPLE_COUNT]) {
    const df_coded coded = df_octree_coded(field, family);
    for (uint32_t s = 0; s < DF_FAMILY_SAMPLE_COUNT; s++) samples[s] = df_coded_sample(&coded, cell, s);
}

df_child_state df_leaf_state(const float corners[8]) {
    if (df_corners_straddle(corners, 0)) return DF_CHILD_SURFACE;
    return corners[0] < 0 ? DF_CHILD_INSIDE : DF_CHILD_OUTSIDE;
}

static df_status check_dimensions(const df_field *field, const char *name, df_error *err) {
    uint32_t longest = field->voxel_count[0];
    for (int a = 1; a < 3; a++) longest = field->voxel_count[a] > longest ? field->voxel_count[a] : longest;
    if (field->level_count < 1 || field->level_count > DF_LEVEL_COUNT_MAX || longest > 1u << field->level_count) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: an octree of %" PRIu32 " levels for %" PRIu32 " voxels", name,
                       field->level_count, longest);
    }
    if (field->family_count < 1 || field->family_count > DF_FAMILY_COUNT_MAX ||
        field->exact_count > field->family_count) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: an octree of %" PRIu32 " families, %" PRIu32 " of them exact", name,
                       field->family_count, field->exact_count);
    }
    return DF_OK;
}

/* Links the families by which children are divided, and finds where the levels begin: starts[0] = 0, ... */
static df_status link_families(const df_field *field, df_family *families, uint32_t starts[DF_LEVEL_COUNT_MAX + 1],
                               const char *name, df_error *err) {
    uint64_t next = 1; /* the number of the next child family */
    uint32_t level = 0, level_end = 1;
    for (uint32_t f = 0; f < field->family_count && next <= field->family_count; f++) {
        if (f == level_end) {
            starts[++level] = f;
            level_end = (uint32_t)next;
        }
        uint32_t divided = df_family_divided_count(&families[f]);
        families[f].first_child = divided ? (uint32_t)next : 0;
        if (families[f].states >> 16 || (divided && level + 1 >= field->level_count)) {
            return df_fail(err, DF_ERROR_FORMAT,
                           "%s: octree family %" PRIu32 " is divided below the last of %" PRIu32 " levels", name, f,
                           field->level_count);
        }
        for (uint32_t c = 0; c < 8 && next < field->family_count; c++) {
            if (df_family_state(&families[f], c) == DF_CHILD_FAMILY) families[next++].parent = 8 * f + c, divided--;
        }
        next += divided;          /* those that there are not */
        if (f + 1 == next) break; /* the rest hangs on nothing */
    }
    for (level++; level <= DF_LEVEL_COUNT_MAX; level++) starts[level] = field->family_count;
    if (next == field->family_count) return DF_OK;
    return df_fail(err, DF_ERROR_FORMAT, "%s: the octree names %" PRIu64 " of %" PRIu32 " families", name, next,
                   field->family_count);
}

/* Sets the states of a family's leaves, hands their corners to the families below, and widens `range`. Returns false
 * where a sample is not finite. */
static bool finish_family(const df_field *field, df_family *families, uint32_t f, float (*cells)[8], float range[2]) {
    float samples[DF_FAMILY_SAMPLE_COUNT];
    bool finite = true;
    df_adf_samples(field, f, cells[f], samples);
    for (uint32_t s = 0; s < DF_FAMILY_SAMPLE_COUNT; s++) {
        range[0] = samples[s] < range[0] ? samples[s] : range[0];
        range[1] = samples[s] > range[1] ? samples[s] : range[1];
        finite = finite && isfinite(samples[s]);
    }
    for (uint32_t c = 0; c < 8; c++) {
        float corners[8];
        for (uint32_t i = 0; i < 8; i++) corners[i] = samples[df_family_corner(c, i)];
        if (df_family_state(&families[f], c) == DF_CHILD_FAMILY) {
            memcpy(cells[df_family_child(&families[f], c)], corners, sizeof corners);
        } else {
            families[f].states = (families[f].states & ~(3u << 2 * c)) | (uint32_t)df_leaf_state(corners) << 2 * c;
        }
    }
    return finite;
}

df_status df_octree_finish(df_field *field, const char *name, df_error *err) {
    uint32_t starts[DF_LEVEL_COUNT_MAX + 1] = {0};
    df_family *families = (df_family *)(uintptr_t)field->families; /* the field's own */
    float(*cells)[8], low = INFINITY, high = -INFINITY;
    uint64_t bad = 0;
    if (field->sample_type == DF_SAMPLE_F32) field->exact_count = field->family_count;
    df_status status = check_dimensions(field, name, err);
    if (status == DF_OK) status = link_families(field, families, starts, name, err);
    if (status == DF_OK) status = df_alloc_raw((void **)&cells, field->family_count, sizeof *cells, "octree", err);
    if (status != DF_OK) return status;
    field->sample_count = 8 + (uint64_t)field->family_count * DF_FAMILY_STORED_COUNT;
    memcpy(cells[0], field->samples, sizeof cells[0]);
    for (uint32_t level = 0; level < field->level_count; level++) {
#pragma omp parallel for reduction(min : low) reduction(max : high) reduction(+ : bad) if (starts[level + 1] - starts[level] > PARALLEL_FAMILIES)
        for (uint32_t f = starts[level]; f < starts[level + 1]; f++) {
            float range[2] = {low, high};
            bad += !finish_family(field, families, f, cells, range);
            low = range[0];
            high = range[1];
        }
    }
    free(cells);
    if (bad) return df_fail(err, DF_ERROR_FORMAT, "%s: samples that are not finite in %" PRIu64 " families", name, bad);
    field->value_min = low;
    field->value_max = high;
    return DF_OK;
}
