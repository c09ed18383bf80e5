/*
 * A signed distance field in memory.
 *
 * Grid space: 1 unit = 1 voxel; sample (i,j,k) lies at grid position (i,j,k), voxel (i,j,k) spans
 * [i,i+1]x[j,j+1]x[k,k+1]. World position = origin + grid position * voxel_size, per axis, in double. Values are signed
 * distances in world units, negative inside. Inside means value < iso; zero is outside. Voxel corner c in 0..7 is the
 * sample at voxel + (c & 1, c >> 1 & 1, c >> 2). All arrays run x fastest, then y, then z.
 *
 * The field owns its memory: build it through df_field_own or read it, and release it with df_field_free. A zeroed
 * struct is an empty field. After df_field_finish (or a read) it is constant and may be shared by threads.
 */
#ifndef DF_FIELD_H
#define DF_FIELD_H

#include "common/octree.h"
#include "common/status.h"

#include <assert.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef enum df_field_kind {
    DF_FIELD_DENSE = 1,  /* every sample: (P+1)(Q+1)(R+1) */
    DF_FIELD_BRICKS = 2, /* a coarse grid of cells of k*k*k voxels; where the surface is, a brick of (k+1)^3 samples */
    DF_FIELD_ADF =
        3, /* adaptively sampled: an octree whose leaves are as small as the error bound asks, 8 corners each */
} df_field_kind;

typedef enum df_sample_type {
    DF_SAMPLE_F32 = 1,
    DF_SAMPLE_U16 = 2, /* (q - 32768) * 2^exponent; in an ADF that is the residual, see octree.h */
    DF_SAMPLE_U8 = 3,  /* (q - 128) * 2^exponent; the same */
} df_sample_type;

/* Values of df_field.cells for coarse cells without a brick: no voxel of the cell is crossed by the surface. */
#define DF_CELL_OUTSIDE 0xFFFFFFFFu
#define DF_CELL_INSIDE 0xFFFFFFFEu
#define DF_BRICK_COUNT_MAX 0xFFFFFFF0u
#define DF_FAMILY_COUNT_MAX 0x1FFFFFF0u /* family and child in 32 bits */

/* The longest side a field may have, in voxels. */
#define DF_VOXEL_COUNT_MAX 65536u

typedef enum df_verdict {
    DF_VERDICT_UNKNOWN = 0, /* nobody has looked, as for an imported field */
    DF_VERDICT_CERTAIN = 1,
    DF_VERDICT_REPAIRED = 2,
    DF_VERDICT_UNCERTAIN = 3,
} df_verdict;

typedef struct df_field {
    df_field_kind kind;
    df_sample_type sample_type;
    uint32_t voxel_count[3];    /* P, Q, R: each 1 to DF_VOXEL_COUNT_MAX */
    double voxel_size[3];       /* world units, > 0 */
    double origin[3];           /* world position of sample (0,0,0) */
    float value_min, value_max; /* over all stored samples, decoded */
    df_verdict verdict;         /* of the signs */
    double error_max,
        error_rms; /* measured against the source over surface cells, world units; negative: not measured */

    const void
        *samples; /* of sample_type; dense: by sample; bricks: brick_count * (k+1)^3; ADF: 8 floats, the root's corners,
                     then 19 floats for each of the exact families, then 19 of sample_type for each of the rest */
    uint64_t sample_count;
    int32_t step_exponent; /* u16 and u8 dense: the step is 2^step_exponent; 0 otherwise */

    /* Bricks; zero and NULL for other kinds. Where voxel_count is no multiple of k the last cells reach over the end:
     * samples there repeat the last one, and voxels there are never surface voxels. */
    uint32_t brick_size;    /* k: 4 or 8 */
    uint32_t cell_count[3]; /* ceil(voxel_count / k) */
    uint32_t brick_count;
    const uint32_t *cells; /* by coarse cell: brick index, DF_CELL_OUTSIDE or DF_CELL_INSIDE; bricks are numbered in
                              the order of their cells */
    const uint32_t *brick_cells;   /* by brick: the linear index of its coarse cell */
    const float *brick_ranges;     /* by brick: minimum, maximum of its samples, decoded */
    const uint64_t *brick_masks;   /* by brick: df_brick_mask_words(k) words; bit x + k*(y + k*z) of the k^3 bits is set
                                      when the corners of that voxel lie on both sides of iso 0 */
    const int8_t *brick_exponents; /* by brick, or by family after the exact ones, u16 and u8: its step is 2^exponent;
                                      NULL for f32 */

    /* ADF; zero and NULL for other kinds. */
    uint32_t level_count; /* 1 to DF_LEVEL_COUNT_MAX; 2^level_count >= every voxel_count */
    uint32_t family_count;
    uint32_t exact_count; /* families that are stored as floats, from the first; f32: all */
    const df_family *families;

    const char *provenance; /* JSON object, UTF-8, zero-terminated; never NULL after finish or read */

    void *blocks[12]; /* what df_field_free releases */
    uint32_t block_count;
    void *mapping; /* of a file read with DF_READ_MAP */
    size_t mapping_size;
    uint32_t checksum; /* of the file that was read or written: identifies its content (FORMAT.md); 0 before */
} df_field;

/* Releases all that the field owns and empties it. */
void df_field_free(df_field *field);

/* Hands a malloc'ed block over to the field. */
void df_field_own(df_field *field, void *block);

/* Completes a field whose dimensions, samples, exponents and (bricks) cells, brick_size, brick_count or (adf) families
 * with their divided children, family_count, exact_count, level_count are set: derives cell_count, sample_count,
 * brick_cells, brick_ranges, brick_masks, the rest of the families, value_min and value_max. Fails with DF_ERROR_FORMAT
 * where an invariant of this header does not hold (dimensions, order of bricks, number and depth of families,
 * non-finite samples); `name` stands for the field in messages. */
df_status df_field_finish(df_field *field, const char *name, df_error *err);

static inline uint32_t df_brick_mask_words(uint32_t brick_size) { return brick_size == 8 ? 8 : 1; }

/* Bytes of one sample of a type. */
static inline size_t df_sample_size(df_sample_type type) {
    return type == DF_SAMPLE_F32 ? 4 : type == DF_SAMPLE_U16 ? 2 : 1;
}

/* The number of samples in a dense field or a set of bricks. */
static inline uint64_t df_dense_sample_count(const uint32_t voxel_count[3]) {
    return ((uint64_t)voxel_count[0] + 1) * ((uint64_t)voxel_count[1] + 1) * ((uint64_t)voxel_count[2] + 1);
}
static inline uint32_t df_brick_sample_count(uint32_t brick_size) {
    return (brick_size + 1) * (brick_size + 1) * (brick_size + 1);
}

/* Names as they stand in options, reports and provenance: "dense", "bricks", "adf"; "f32", "u16", "u8";
 * "unknown", "certain", "repaired", "uncertain". */
const char *df_field_kind_name(df_field_kind kind);
const char *df_sample_type_name(df_sample_type type);
const char *df_verdict_name(df_verdict verdict);

/* 2^exponent, exact, for -126..127. */
static inline float df_power_of_two(int exponent) {
    assert(exponent >= -126 && exponent <= 127);
    const uint32_t bits = (uint32_t)(exponent + 127) << 23;
    float power;
    memcpy(&power, &bits, sizeof power);
    return power;
}

/* The decoded sample at `index` of the samples array, for a step of 2^exponent. */
float df_field_decode(const df_field *field, uint64_t index, int exponent);

/* The 8 corner values of a voxel, voxel[a] < voxel_count[a]. Returns true when the field stores them; otherwise false,
 * and all corners are +INFINITY (outside) or -INFINITY (inside). Not for ADF. */
bool df_field_corners(const df_field *field, const uint32_t voxel[3], float corners[8]);

/* One sample, sample[a] <= voxel_count[a]; otherwise like df_field_corners. A sample shared by a brick and a cell
 * without one is stored. */
bool df_field_sample(const df_field *field, const uint32_t sample[3], float *value);

/* True where the corners lie on both sides of iso: some < iso, some not. */
bool df_corners_straddle(const float corners[8], float iso);

/* Bytes of an ADF's samples. */
static inline uint64_t df_adf_sample_bytes(const df_field *field) {
    return (8 + (uint64_t)field->exact_count * DF_FAMILY_STORED_COUNT) * sizeof(float) +
           (uint64_t)(field->family_count - field->exact_count) * DF_FAMILY_STORED_COUNT *
               df_sample_size(field->sample_type);
}

/* The cell that holds a grid position in [0, 2^level_count]^3: a leaf, or the cell on level `level_limit` (1: children
 * of the root) where the tree is deeper. A position on a face belongs to the upper cell, except at the end. */
void df_adf_find(const df_field *field, const double grid[3], uint32_t level_limit, df_adf_cell *cell);

/* The 8 corner values of a child of a family. They are decoded from the first exact family down; a walk that goes from
 * families to their children does better with df_adf_child_corners. */
void df_adf_corners(const df_field *field, uint32_t family, uint32_t child, float corners[8]);

/* The corner values of the divided cell of a family; those of a child from them; all samples of the family from them.
 * `corners` may be `cell`. */
void df_adf_cell_corners(const df_field *field, uint32_t family, float cell[8]);
void df_adf_child_corners(const df_field *field, uint32_t family, uint32_t child, const float cell[8],
                          float corners[8]);
void df_adf_samples(const df_field *field, uint32_t family, const float cell[8], float samples[DF_FAMILY_SAMPLE_COUNT]);

/* The state that a leaf's corners ask for. */
df_child_state df_leaf_state(const float corners[8]);

/* Trilinear value and its gradient (per voxel) at `local` in [0,1]^3 of a voxel, in the convex form (1-t)a + tb. */
double df_trilinear(const float corners[8], const double local[3]);
void df_trilinear_gradient(const float corners[8], const double local[3], double gradient[3]);

/* What a field says about a point. */
typedef enum df_side { DF_SIDE_OUTSIDE, DF_SIDE_INSIDE, DF_SIDE_BEYOND /* not in the field's box */ } df_side;
typedef struct df_point_info {
    df_side side;
    bool stored;        /* value and gradient are valid; where not, only the side is known */
    bool surface;       /* the point's voxel (ADF: leaf) has corners on both sides */
    double value;       /* world units */
    double gradient[3]; /* per world unit */
} df_point_info;
void df_field_query(const df_field *field, const double world[3], df_point_info *info);

void df_field_world_to_grid(const df_field *field, const double world[3], double grid[3]);
void df_field_grid_to_world(const df_field *field, const double grid[3], double world[3]);

/* Counts the voxels (ADF: leaves) whose corners straddle iso 0. */
uint64_t df_field_surface_voxel_count(const df_field *field);

/* The values of iso for which a field's surface never leaves what is stored: *low < iso <= *high. Everything for dense;
 * for ADF just 0, as leaves are fine at that surface only. */
void df_field_iso_range(const df_field *field, float *low, float *high);

/* False where the values stored are all on one side of iso: there is no surface. */
static inline bool df_field_reaches(const df_field *field, float iso) {
    return field->value_min < iso && iso <= field->value_max;
}

/* df_field_finish for an ADF. */
df_status df_octree_finish(df_field *field, const char *name, df_error *err);

#ifdef __cplusplus
}
#endif
#endif
