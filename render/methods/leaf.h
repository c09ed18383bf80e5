/*
 * The samples around a leaf of an octree, as far apart as its corners, for gradients. C and OpenCL C.
 */
#ifndef DF_LEAF_H
#define DF_LEAF_H

#include "common/octree_samples.h"
#include "render/methods/gradient.h"

/* The field at a corner of the grid of the leaf's size, from the leaf that holds it; false outside the root cube. */
static inline bool df_leaf_sample(const df_field *field, const int64_t at[3], float *value) {
    double grid[3], within[3];
    df_adf_cell cell;
    float corners[8];
    for (int a = 0; a < 3; a++) {
        if (at[a] < 0 || at[a] > (int64_t)1 << field->level_count) return false;
        grid[a] = (double)at[a];
    }
    df_octree_find(field, grid, DF_LEVEL_COUNT_MAX, &cell);
    df_octree_corners(field, cell.family, cell.child, corners);
    for (int a = 0; a < 3; a++) within[a] = (grid[a] - cell.corner[a]) / cell.side;
    *value = (float)df_octree_interpolate(corners, within);
    return true;
}

/* The 4 samples beyond a face of a leaf of 2^size_log2 voxels whose neighbour of that size there has its lower corner
 * at `lower`: from the cell with these corners that is it, or that it lies in. */
static inline void df_leaf_beyond(const int64_t lower[3], uint32_t size_log2, int axis, int after,
                                  const uint32_t cell_corner[3], uint32_t cell_side, const float corners[8],
                                  float value[4]) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    if (cell_side == 1u << size_log2) {
        for (int i = 0; i < 4; i++) value[i] = corners[(i & 1) << u | (i >> 1) << v | after << axis];
        return;
    }
    /* df_octree_interpolate at the 4 places, what they share once: places 0 and 1 along each axis, of which there is
     * one across the face. */
    const double scale = 1.0 / cell_side; /* exact */
    const int64_t size = (int64_t)1 << size_log2;
    double at[3][2], x[2][4], y[2][2][2];
    int count[3] = {2, 2, 2};
    count[axis] = 1;
    for (int a = 0; a < 3; a++) {
        const int64_t low = lower[a] - cell_corner[a];
        at[a][0] = (double)(low + (a == axis && after ? size : 0)) * scale;
        at[a][1] = (double)(low + size) * scale;
    }
    for (int i = 0; i < count[0]; i++) {
        const double t = at[0][i];
        for (int r = 0; r < 4; r++) x[i][r] = (1 - t) * (double)corners[2 * r] + t * (double)corners[2 * r + 1];
    }
    for (int i = 0; i < count[0]; i++) {
        for (int j = 0; j < count[1]; j++) {
            const double t = at[1][j];
            for (int k = 0; k < 2; k++) y[i][j][k] = (1 - t) * x[i][2 * k] + t * x[i][2 * k + 1];
        }
    }
    for (int i = 0; i < 4; i++) {
        int place[3] = {0, 0, 0};
        place[u] = i & 1;
        place[v] = i >> 1;
        const double t = at[2][place[2]], *pair = y[place[0]][place[1]];
        value[i] = (float)((1 - t) * pair[0] + t * pair[1]);
    }
}

/* The same from the cell of its size there or the larger leaf
 * around that; false outside the root cube. */
static inline bool df_leaf_face(const df_field *field, const uint32_t corner[3], uint32_t size_log2, int axis,
                                int after, float value[4]) {
    const int64_t size = (int64_t)1 << size_log2;
    int64_t lower[3] = {corner[0], corner[1], corner[2]};
    double middle[3];
    df_adf_cell cell;
    float corners[8];
    lower[axis] += after ? size : -size;
    if (lower[axis] < 0 || lower[axis] >= (int64_t)1 << field->level_count) return false;
    for (int a = 0; a < 3; a++) middle[a] = (double)lower[a] + 0.5 * (double)size;
    df_octree_find(field, middle, field->level_count - size_log2, &cell);
    df_octree_corners(field, cell.family, cell.child, corners);
    df_leaf_beyond(lower, size_log2, axis, after, cell.corner, cell.side, corners, value);
    return true;
}

/* The corners of a child of a family whose own cell, `cell`, is decoded already, unless it is exact. */
static inline void df_leaf_corners(const df_field *field, uint32_t family, uint32_t child, const float cell[8],
                                   float corners[8]) {
    if (family < field->exact_count) df_octree_corners(field, family, child, corners);
    else df_octree_child_corners(field, family, child, cell, corners);
}

/* df_scene_leaf_stencil (scene.h). */
static inline void df_leaf_stencil(const df_field *field, const uint32_t corner[3], uint32_t block, uint32_t size_log2,
                                   int reach, float *stencil, size_t step) {
    const int64_t size = (int64_t)1 << size_log2;
    const uint32_t family = block >> 3, child = block & 7;
    float cell[8], corners[8];
    if (family >= field->exact_count) df_octree_cell_corners(field, family, cell);
    df_leaf_corners(field, family, child, cell, corners);
    for (int c = 0; c < 8; c++) stencil[(size_t)DF_STENCIL(c & 1, c >> 1 & 1, c >> 2) * step] = corners[c];
    for (int face = 0; reach >= DF_REACH_FACES && face < 6; face++) {
        const int axis = face >> 1, after = face & 1, u = (axis + 1) % 3, v = (axis + 2) % 3;
        float value[4];
        bool stored = true;
        if ((child >> axis & 1) != (uint32_t)after) { /* the neighbour is of the same family */
            df_leaf_corners(field, family, child ^ 1u << axis, cell, corners);
            for (int i = 0; i < 4; i++) value[i] = corners[(i & 1) << u | (i >> 1) << v | after << axis];
        } else {
            stored = df_leaf_face(field, corner, size_log2, axis, after, value);
        }
        for (int i = 0; i < 4; i++) {
            int at[3];
            at[axis] = after ? 2 : -1;
            at[u] = i & 1;
            at[v] = i >> 1;
            stencil[(size_t)DF_STENCIL(at[0], at[1], at[2]) * step] =
                stored ? value[i] : df_stencil_extend(stencil, step, at);
        }
    }
    for (int outside = 2; reach == DF_REACH_ALL && outside <= 3; outside++) {
        for (int i = 0; i < 64; i++) {
            const int at[3] = {i % 4 - 1, i / 4 % 4 - 1, i / 16 - 1};
            int64_t place[3];
            if (df_stencil_outside(at) != outside) continue;
            for (int a = 0; a < 3; a++) place[a] = (int64_t)corner[a] + at[a] * size;
            if (!df_leaf_sample(field, place, &stencil[(size_t)i * step]))
                stencil[(size_t)i * step] = df_stencil_extend(stencil, step, at);
        }
    }
}

#endif
