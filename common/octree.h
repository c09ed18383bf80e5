/*
 * The octree of an adaptively sampled distance field (ADF), and how its samples are coded. C and OpenCL C.
 *
 * The root cell is the cube of 2^level_count voxels at grid position (0,0,0); the field's box clips it. Cells are
 * stored by families: the 8 children of one parent, child c at half side * (c & 1, c >> 1 & 1, c >> 2) of it. Family 0
 * holds the children of the root. Families are numbered breadth first, in the order of their parents; so a family's
 * children that are families themselves follow each other.
 *
 * A family has 3x3x3 samples: the corners of its children. The outer 8 are the corners of the parent, whose own family
 * holds them; so 19 are stored, and every level carries values. The first `exact_count` families store them as floats.
 * The others store residuals in few bits: what a sample differs from the mean of the parent's corners around it
 * (df_family_predict). On the border of a larger leaf that difference is 0, which makes the field continuous whatever
 * the steps are.
 */
#ifndef DF_OCTREE_H
#define DF_OCTREE_H

#include "common/dialect.h"

typedef struct df_family {
    uint32_t first_child; /* the number of the first child family; 0 when there is none */
    uint32_t parent;      /* 8 * family + child of the divided cell; 0 for family 0 */
    uint32_t states;      /* 2 bits a child, df_child_state; bits 16 to 31 are zero */
} df_family;

typedef enum df_child_state {
    DF_CHILD_OUTSIDE = 0, /* leaf, no corner < 0 */
    DF_CHILD_INSIDE = 1,  /* leaf, all corners < 0 */
    DF_CHILD_SURFACE = 2, /* leaf, corners on both sides */
    DF_CHILD_FAMILY = 3,  /* divided further */
} df_child_state;

#define DF_FAMILY_SAMPLE_COUNT 27u /* x + 3 * (y + 3 * z) */
#define DF_FAMILY_STORED_COUNT 19u
#define DF_LEVEL_COUNT_MAX 16u

/* A cell of the octree. */
typedef struct df_adf_cell {
    uint32_t corner[3]; /* lower corner, voxels */
    uint32_t side;      /* voxels */
    uint32_t family;    /* the family that holds its samples, and its number there */
    uint32_t child;
    df_child_state state;
} df_adf_cell;

static inline df_child_state df_family_state(const df_family *family, uint32_t child) {
    return (df_child_state)(family->states >> 2 * child & 3);
}

/* The number of the family that child `child`, which is divided, has become. */
static inline uint32_t df_family_child(const df_family *family, uint32_t child) {
    const uint32_t divided = family->states & family->states >> 1 & 0x5555; /* one bit a child */
    return family->first_child + df_bit_count(divided & ((1u << 2 * child) - 1));
}

static inline uint32_t df_family_divided_count(const df_family *family) {
    return df_bit_count(family->states & family->states >> 1 & 0x5555);
}

/* Which of a family's 27 samples is corner `corner` of child `child`. */
static inline uint32_t df_family_corner(uint32_t child, uint32_t corner) {
    return (child & 1) + (corner & 1) + 3 * ((child >> 1 & 1) + (corner >> 1 & 1)) + 9 * ((child >> 2) + (corner >> 2));
}

/* Where a sample stands among the 19 that are stored; -1 for the parent's corners. */
static inline int df_family_slot(uint32_t sample) {
    DF_TABLE int8_t slots[DF_FAMILY_SAMPLE_COUNT] = {-1, 0,  -1, 1,  2,  3,  -1, 4,  -1, 5,  6,  7,  8, 9,
                                                     10, 11, 12, 13, -1, 14, -1, 15, 16, 17, -1, 18, -1};
    return slots[sample];
}

/* Which of the parent's corners a sample is, where it is one. */
static inline uint32_t df_family_cell_corner(uint32_t sample) {
    return (sample % 3 >> 1) + (sample / 3 % 3 & 2) + (sample / 9 & 2) * 2;
}

/* The mean of the parent's corners around a sample: of pairs along x, then y, then z. For one of the corners, that. */
static inline float df_family_predict(const float corners[8], uint32_t sample) {
    const uint32_t x = sample % 3, y = sample / 3 % 3, z = sample / 9;
    const uint32_t x0 = x >> 1, x1 = (x + 1) >> 1, y0 = (y >> 1) * 2, y1 = ((y + 1) >> 1) * 2;
    const float *low = corners + (z >> 1) * 4, *high = corners + ((z + 1) >> 1) * 4;
    const float a = ((low[x0 + y0] + low[x1 + y0]) * 0.5f + (low[x0 + y1] + low[x1 + y1]) * 0.5f) * 0.5f;
    const float b = ((high[x0 + y0] + high[x1 + y0]) * 0.5f + (high[x0 + y1] + high[x1 + y1]) * 0.5f) * 0.5f;
    return (a + b) * 0.5f;
}

/* Stores 27 samples of an exact family in the samples of an ADF; those of family 0 with the root's corners. */
static inline void df_family_store(const float samples[DF_FAMILY_SAMPLE_COUNT], uint32_t family, float *stored) {
    float *to = stored + 8 + (size_t)family * DF_FAMILY_STORED_COUNT;
    for (uint32_t s = 0, corner = 0; s < DF_FAMILY_SAMPLE_COUNT; s++) {
        if (df_family_slot(s) >= 0) *to++ = samples[s];
        else if (family == 0) stored[corner++] = samples[s];
    }
}

#endif
