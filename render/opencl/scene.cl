/*
 * A field in the memory of a device: what the texts shared with the CPU expect of tracer.h and scene.h. The functions here do what
 * those of the same name in scene.c do.
 */
#include "common/dialect.h"
#include "render/opencl/grid.h"
#include "render/methods/gradient.h"

#include "common/octree.h"

#define DF_KIND_BRICKS 2 /* df_field_kind and df_sample_type of common/field.h */
#define DF_SAMPLE_F32 1
#define DF_SAMPLE_U16 2
#define DF_CELL_INSIDE 0xFFFFFFFEu
#define DF_HIT_BACK 1u /* tracer.h */
#define DF_HIT_SIZE_SHIFT 4

#if DF_SAMPLE == DF_SAMPLE_F32
typedef float df_sample;
#elif DF_SAMPLE == DF_SAMPLE_U16
typedef ushort df_sample;
#define DF_SAMPLE_ZERO 32768
#else
typedef uchar df_sample;
#define DF_SAMPLE_ZERO 128
#endif

/* Of an octree only. */
typedef struct df_field {
    int sample_type;
    uint32_t level_count, exact_count;
    __global const void *samples;
    __global const char *brick_exponents;
    __global const df_family *families;
    __global const float *cells; /* 8 corners of the divided cell of each family after the exact ones */
} df_field;

typedef struct df_scene {
    df_field field[1];
    uint32_t voxel_count[3], coarse_count[3];
    uint32_t levels, k, k_shift, row_words;
    int32_t step_exponent;
    float iso;
    __global const df_sample *samples;
    __global const char *exponents;
    __global const uint32_t *coarse;
    __global const uint64_t *masks, *rows;
} df_scene;

/* The arguments with which every kernel that looks at a field begins. coarse: cells, or the families of an octree; masks: of blocks,
 * or of rows where DF_LEVELS is 1, or the cells of an octree's families. */
#define DF_SCENE_PARAMETERS \
    const df_grid grid, __global const df_sample *samples, __global const char *exponents, __global const uint32_t *coarse, \
        __global const uint64_t *masks
#define DF_SCENE_ARGUMENTS &grid, samples, exponents, coarse, masks

typedef struct df_candidate {
    uint32_t block;
    uint16_t cell[3];
    uint8_t flags;
} df_candidate;

typedef struct df_counters {
    uint32_t coarse_steps, fine_steps, cells_tested;
} df_counters;

static inline df_scene df_scene_make(const df_grid *grid, __global const df_sample *samples, __global const char *exponents,
                                     __global const uint32_t *coarse, __global const uint64_t *masks) {
    df_scene scene;
    scene.field->sample_type = DF_SAMPLE;
    scene.field->level_count = grid->level_count;
    scene.field->exact_count = grid->exact_count;
    scene.field->samples = samples;
    scene.field->brick_exponents = exponents;
    scene.field->families = (__global const df_family *)coarse;
    scene.field->cells = (__global const float *)masks;
    for (int a = 0; a < 3; a++) {
        scene.voxel_count[a] = grid->voxel_count[a];
        scene.coarse_count[a] = grid->coarse_count[a];
    }
    scene.levels = DF_LEVELS;
    scene.k = DF_K;
    scene.k_shift = DF_K == 8 ? 3 : 2;
    scene.row_words = grid->row_words;
    scene.step_exponent = grid->step_exponent;
    scene.iso = grid->iso;
    scene.samples = samples;
    scene.exponents = exponents;
    scene.coarse = coarse;
    scene.masks = masks;
    scene.rows = masks;
    return scene;
}

static inline float df_power_of_two(int exponent) {
    return as_float((exponent + 127) << 23);
}

static inline bool df_corners_straddle(const float corners[8], float iso) {
    int inside = 0;
    for (int c = 0; c < 8; c++) inside += corners[c] < iso;
    return inside > 0 && inside < 8;
}

#include "render/methods/leaf.h"

static inline uint32_t df_brick_mask_words(uint32_t k) {
    return k == 8 ? 8 : 1;
}

static inline float df_scene_decode(const df_scene *scene, uint64_t index, uint32_t block) {
#if DF_SAMPLE == DF_SAMPLE_F32
    return scene->samples[index];
#else
    int exponent = DF_KIND == DF_KIND_BRICKS ? scene->exponents[block] : scene->step_exponent;
    return (float)((int)scene->samples[index] - DF_SAMPLE_ZERO) * df_power_of_two(exponent);
#endif
}

#ifdef DF_IMAGES
/* The same from a 3D image of the samples of a dense field. */
static inline float df_image_decode(const df_scene *scene, __read_only image3d_t image, const int at[3]) {
    const sampler_t nearest = CLK_NORMALIZED_COORDS_FALSE | CLK_ADDRESS_CLAMP_TO_EDGE | CLK_FILTER_NEAREST;
#if DF_SAMPLE == DF_SAMPLE_F32
    return read_imagef(image, nearest, (int4)(at[0], at[1], at[2], 0)).x;
#else
    const int value = (int)read_imageui(image, nearest, (int4)(at[0], at[1], at[2], 0)).x;
    return (float)(value - DF_SAMPLE_ZERO) * df_power_of_two(scene->step_exponent);
#endif
}
#endif

/* The index of a voxel's lower corner among the samples, and the steps to the next row and slice. */
static inline uint64_t df_scene_index(const df_scene *scene, const uint32_t voxel[3], uint32_t block, uint64_t *row, uint64_t *slice) {
#if DF_KIND == DF_KIND_BRICKS
    const uint32_t side = DF_K + 1, mask = DF_K - 1;
    *row = side;
    *slice = side * side;
    return (uint64_t)block * (side * side * side) + ((voxel[0] & mask) + side * (voxel[1] & mask) + side * side * (voxel[2] & mask));
#else
    *row = (uint64_t)scene->voxel_count[0] + 1;
    *slice = *row * ((uint64_t)scene->voxel_count[1] + 1);
    return voxel[0] + *row * voxel[1] + *slice * voxel[2];
#endif
}

static inline void df_scene_corners(const df_scene *scene, const uint32_t voxel[3], uint32_t block, float corner[8]) {
#if DF_LEVELS == 0
    df_octree_corners(scene->field, block >> 3, block & 7, corner);
    for (int c = 0; c < 8; c++) corner[c] -= scene->iso;
#else
    uint64_t row, slice, at = df_scene_index(scene, voxel, block, &row, &slice);
    for (int c = 0; c < 8; c++) {
        corner[c] = df_scene_decode(scene, at + (c & 1) + (c & 2 ? row : 0) + (c & 4 ? slice : 0), block) - scene->iso;
    }
#endif
}

/* Whether a voxel of the field has its corners stored, and in which block. */
static inline bool df_scene_stored(const df_scene *scene, const uint32_t voxel[3], uint32_t *block) {
    *block = 0;
#if DF_KIND == DF_KIND_BRICKS
    uint64_t row = voxel[1] / DF_K + (uint64_t)scene->coarse_count[1] * (voxel[2] / DF_K);
    *block = scene->coarse[voxel[0] / DF_K + scene->coarse_count[0] * row];
    return *block < DF_CELL_INSIDE;
#else
    return true;
#endif
}

/* A sample that may lie in another brick than the voxel's own, or outside the field. Returns false when it is not stored. */
static inline bool df_scene_sample(const df_scene *scene, const int at[3], float *value) {
    for (int a = 0; a < 3; a++) {
        if (at[a] < 0 || at[a] > (int)scene->voxel_count[a]) return false;
    }
    uint64_t row, slice;
#if DF_KIND == DF_KIND_BRICKS
    for (int c = 0; c < 8; c++) { /* a sample is corner of up to 8 voxels; any that stores it will do */
        uint32_t voxel[3], back[3], block;
        bool exists = true;
        for (int a = 0; a < 3; a++) {
            back[a] = c >> a & 1;
            exists = exists && at[a] >= (int)back[a] && at[a] - (int)back[a] < (int)scene->voxel_count[a];
            voxel[a] = (uint32_t)at[a] - back[a];
        }
        if (!exists || !df_scene_stored(scene, voxel, &block)) continue;
        uint64_t first = df_scene_index(scene, voxel, block, &row, &slice);
        *value = df_scene_decode(scene, first + back[0] + row * back[1] + slice * back[2], block);
        return true;
    }
    return false;
#else
    const uint32_t sample[3] = {(uint32_t)at[0], (uint32_t)at[1], (uint32_t)at[2]};
    *value = df_scene_decode(scene, df_scene_index(scene, sample, 0, &row, &slice), 0);
    return true;
#endif
}

/* Fills the samples beyond the cell along `axis`: 4 before and 4 after. They are a face of the next voxel, so where that voxel is stored one
 * look-up finds all 4; otherwise each is searched for alone. */
static inline void df_stencil_axis(const df_scene *scene, const uint32_t voxel[3], int axis, float stencil[64]) {
    const int stride[3] = {1, 4, 16}, u = (axis + 1) % 3, v = (axis + 2) % 3;
    for (int side = 0; side < 2; side++) {
        uint32_t next[3] = {voxel[0], voxel[1], voxel[2]}, block;
        uint64_t step[3] = {1, 0, 0}, first = 0;
        next[axis] += side ? 1 : -1; /* wraps to a huge number before the field */
        const bool stored = next[axis] < scene->voxel_count[axis] && df_scene_stored(scene, next, &block);
        if (stored) first = df_scene_index(scene, next, block, &step[1], &step[2]);
        if (stored && side) first += step[axis];
        for (int corner = 0; corner < 4; corner++) {
            int base = DF_STENCIL(0, 0, 0) + (corner & 1) * stride[u] + (corner >> 1) * stride[v];
            int at[3] = {(int)voxel[0], (int)voxel[1], (int)voxel[2]};
            at[axis] += side ? 2 : -1;
            at[u] += corner & 1;
            at[v] += corner >> 1;
            float value;
            if (stored) {
                value = df_scene_decode(scene, first + (corner & 1) * step[u] + (corner >> 1) * step[v], block);
            } else if (!df_scene_sample(scene, at, &value)) {
                float near = stencil[base + (side ? 1 : 0) * stride[axis]], after = stencil[base + (side ? 0 : 1) * stride[axis]];
                value = (near + near) - after;
            }
            stencil[base + (side ? 2 : -1) * stride[axis]] = value;
        }
    }
}

static inline void df_scene_stencil(const df_scene *scene, const uint32_t voxel[3], uint32_t block, int reach, float stencil[64]) {
    uint64_t row, slice, at = df_scene_index(scene, voxel, block, &row, &slice);
    for (int c = 0; c < 8; c++) {
        uint64_t index = at + (c & 1) + (c & 2 ? row : 0) + (c & 4 ? slice : 0);
        stencil[DF_STENCIL(c & 1, c >> 1 & 1, c >> 2)] = df_scene_decode(scene, index, block);
    }
    if (reach == DF_REACH_CELL) return;
    for (int axis = 0; axis < 3; axis++) df_stencil_axis(scene, voxel, axis, stencil);
    for (int outside = 2; reach == DF_REACH_ALL && outside <= 3; outside++) {
        for (int i = 0; i < 64; i++) {
            const int offset[3] = {i % 4 - 1, i / 4 % 4 - 1, i / 16 - 1};
            const int at[3] = {(int)voxel[0] + offset[0], (int)voxel[1] + offset[1], (int)voxel[2] + offset[2]};
            if (df_stencil_outside(offset) != outside) continue;
            if (!df_scene_sample(scene, at, &stencil[i])) stencil[i] = df_stencil_extend(stencil, 1, offset);
        }
    }
}

#ifdef DF_IMAGES
/* df_scene_stencil with all samples from an image. */
static inline void df_image_stencil(const df_scene *scene, __read_only image3d_t image, const uint32_t voxel[3], int reach,
                                    float stencil[64]) {
    for (int c = 0; c < 8; c++) {
        const int at[3] = {(int)voxel[0] + (c & 1), (int)voxel[1] + (c >> 1 & 1), (int)voxel[2] + (c >> 2)};
        stencil[DF_STENCIL(c & 1, c >> 1 & 1, c >> 2)] = df_image_decode(scene, image, at);
    }
    for (int outside = 1; outside <= (reach == DF_REACH_CELL ? 0 : reach == DF_REACH_FACES ? 1 : 3); outside++) {
        for (int i = 0; i < 64; i++) {
            const int offset[3] = {i % 4 - 1, i / 4 % 4 - 1, i / 16 - 1};
            const int at[3] = {(int)voxel[0] + offset[0], (int)voxel[1] + offset[1], (int)voxel[2] + offset[2]};
            if (df_stencil_outside(offset) != outside) continue;
            bool stored = true;
            for (int a = 0; a < 3; a++) stored = stored && at[a] >= 0 && at[a] <= (int)scene->voxel_count[a];
            stencil[i] = stored ? df_image_decode(scene, image, at) : df_stencil_extend(stencil, 1, offset);
        }
    }
}
#endif
