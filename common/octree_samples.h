/*
 * Reading an octree: its samples decoded, and its cells found. C and OpenCL C; field.h has the same as functions.
 *
 * A device defines df_field, with the members that stand here, and df_power_of_two before it includes this. It is given
 * the corners of the divided cells of all families that are not exact, where C decodes them from an exact one down.
 */
#ifndef DF_OCTREE_SAMPLES_H
#define DF_OCTREE_SAMPLES_H

#ifndef DF_OPENCL
#include "common/field.h" /* not for devices */
#endif

#include "common/octree.h"

/* Trilinear interpolation within a cell, in double: df_trilinear of field.h. */
static inline double df_octree_interpolate(const float v[8], const double within[3]) {
    const double x = within[0], y = within[1], z = within[2];
    const double a = (1 - x) * (double)v[0] + x * (double)v[1], b = (1 - x) * (double)v[2] + x * (double)v[3];
    const double c = (1 - x) * (double)v[4] + x * (double)v[5], d = (1 - x) * (double)v[6] + x * (double)v[7];
    return (1 - z) * ((1 - y) * a + y * b) + z * ((1 - y) * c + y * d);
}

/* Where the samples of a family lie, and what makes values of them. */
typedef struct df_coded {
    const DF_GLOBAL void *samples; /* floats of an exact family; residuals of another */
    uint32_t size;                 /* bytes of one: 4; 2 or 1 */
    float step;                    /* of residuals */
} df_coded;

static inline df_coded df_octree_coded(const df_field *field, uint32_t family) {
    const DF_GLOBAL float *exact = (const DF_GLOBAL float *)field->samples + 8;
    df_coded coded = {exact, 4, 0};
    if (field->sample_type == DF_SAMPLE_F32 || family < field->exact_count) {
        coded.samples = exact + (size_t)family * DF_FAMILY_STORED_COUNT;
        return coded;
    }
    const DF_GLOBAL void *rest = exact + (size_t)field->exact_count * DF_FAMILY_STORED_COUNT;
    const size_t number = family - field->exact_count, at = number * DF_FAMILY_STORED_COUNT;
    coded.size = field->sample_type == DF_SAMPLE_U16 ? 2 : 1;
    coded.samples = (const DF_GLOBAL uint8_t *)rest + at * coded.size;
    coded.step = df_power_of_two(field->brick_exponents[number]);
    return coded;
}

/* A sample of a family whose divided cell has these corners. */
static inline float df_coded_sample(const df_coded *coded, const float cell[8], uint32_t sample) {
    const int slot = df_family_slot(sample);
    if (slot < 0) return cell[df_family_cell_corner(sample)];
    if (coded->size == 4) return ((const DF_GLOBAL float *)coded->samples)[slot];
    const int q = coded->size == 2 ? (int)((const DF_GLOBAL uint16_t *)coded->samples)[slot] - 32768
                                   : (int)((const DF_GLOBAL uint8_t *)coded->samples)[slot] - 128;
    return df_family_predict(cell, sample) + (float)q * coded->step;
}

/* The corners of a child of a family from those of the family's divided cell; `corners` may be `cell`. */
static inline void df_octree_child_corners(const df_field *field, uint32_t family, uint32_t child, const float cell[8],
                                           float corners[8]) {
    const df_coded coded = df_octree_coded(field, family);
    float out[8];
    for (uint32_t i = 0; i < 8; i++) out[i] = df_coded_sample(&coded, cell, df_family_corner(child, i));
    for (uint32_t i = 0; i < 8; i++) corners[i] = out[i];
}

/* Corner `corner` of the divided cell of a family whose parents are exact: it is a sample of the parent's family, or
 * again a corner of that family's cell. */
static inline float df_octree_exact_corner(const df_field *field, uint32_t family, uint32_t corner) {
    const DF_GLOBAL float *exact = (const DF_GLOBAL float *)field->samples;
    while (family) {
        const uint32_t parent = field->families[family].parent, child = parent & 7;
        family = parent >> 3;
        if (child == corner) continue;
        return exact[8 + (size_t)family * DF_FAMILY_STORED_COUNT +
                     (size_t)df_family_slot(df_family_corner(child, corner))];
    }
    return exact[corner];
}

/* The corners of the divided cell of a family, decoded from the first exact family down. */
#ifdef DF_OPENCL
static inline void df_octree_cell_corners(const df_field *field, uint32_t family, float cell[8]) {
    const DF_GLOBAL float *decoded = field->cells + (size_t)(family - field->exact_count) * 8;
    for (uint32_t c = 0; c < 8; c++) cell[c] = decoded[c];
}
#else
static inline void df_octree_cell_corners(const df_field *field, uint32_t family, float cell[8]) {
    uint32_t path[DF_LEVEL_COUNT_MAX], depth = 0; /* from the family up to the first whose parents are exact */
    path[depth++] = family;
    while (family && (family = field->families[family].parent >> 3) >= field->exact_count) path[depth++] = family;
    for (uint32_t c = 0; c < 8; c++) cell[c] = df_octree_exact_corner(field, path[depth - 1], c);
    while (--depth)
        df_octree_child_corners(field, path[depth], field->families[path[depth - 1]].parent & 7, cell, cell);
}
#endif

static inline void df_octree_corners(const df_field *field, uint32_t family, uint32_t child, float corners[8]) {
    float cell[8];
    if (family < field->exact_count)
        cell[child] = df_octree_exact_corner(field, family, child); /* the only one that is looked at */
    else df_octree_cell_corners(field, family, cell);
    df_octree_child_corners(field, family, child, cell, corners);
}

static inline void df_octree_find(const df_field *field, const double grid[3], uint32_t level_limit,
                                  df_adf_cell *cell) {
    cell->corner[0] = cell->corner[1] = cell->corner[2] = cell->family = 0;
    cell->side = 1u << field->level_count;
    for (uint32_t level = 1;; level++) {
        const df_family family = field->families[cell->family];
        cell->side /= 2;
        cell->child = 0;
        for (int a = 0; a < 3; a++) {
            const bool upper = grid[a] >= cell->corner[a] + cell->side;
            cell->child |= (uint32_t)upper << a;
            cell->corner[a] += upper ? cell->side : 0;
        }
        cell->state = df_family_state(&family, cell->child);
        if (cell->state != DF_CHILD_FAMILY || level == level_limit) return;
        cell->family = df_family_child(&family, cell->child);
    }
}

#endif
