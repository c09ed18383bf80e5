/*
 * A field made ready for tracing at one iso value. Borrows the field, which must outlive it; owns what it adds.
 * Constant and shared by threads after df_scene_prepare.
 *
 * All structures look alike to a two-level walk: coarse cells of k*k*k voxels, each outside, inside or with a block of
 * one bit a voxel that says where the surface can be. For bricks the blocks are the bricks; for dense fields they are
 * masks only and the samples stay where they are. For the uniform walk a dense field has one bit a voxel in rows
 * instead.
 */
#ifndef DF_SCENE_H
#define DF_SCENE_H

#include "common/field.h"

typedef struct df_scene_options {
    uint32_t levels; /* dense fields: 1 uniform, 2 two-level; 0: 2. Bricks: 0 or 2 */
    uint32_t coarse; /* k of a two-level walk over a dense field: 4 or 8; 0: 8. Bricks: 0 or their own */
} df_scene_options;

typedef struct df_scene {
    const df_field *field;
    float iso;
    uint32_t voxel_count[3];
    uint32_t levels;     /* of the walk: 1 or 2; 0: an octree, and the following are not used */
    uint32_t k, k_shift; /* voxels along a coarse cell, and its logarithm */
    uint32_t coarse_count[3];
    const uint32_t *coarse; /* by coarse cell: block index, DF_CELL_OUTSIDE or DF_CELL_INSIDE */
    uint32_t block_count;
    const uint32_t *block_cells; /* by block: linear index of its coarse cell */
    const uint64_t *masks; /* by block: df_brick_mask_words(k) words, bits as in df_field.brick_masks, at this iso */
    const uint64_t *rows;  /* levels = 1: voxel (x,y,z) is bit x of row y + voxel_count[1] * z; row_words words a row */
    uint32_t row_words;
    double precompute_ms;
    uint64_t precompute_bytes;
    void *owned[4];
} df_scene;

/* Fails with DF_ERROR_USAGE for options that make no sense for the field, and for an iso value at which the surface
 * leaves what the field stores (the message names the range). */
df_status df_scene_prepare(const df_field *field, float iso, const df_scene_options *options, df_scene *scene,
                           df_error *err);
void df_scene_free(df_scene *scene);

/* A short name of what is walked: "dense", "dense 2-level k=8", "bricks k=8". */
const char *df_scene_structure_name(const df_scene *scene);

/* The 8 corner values of a voxel minus iso. block: of its coarse cell when the field is made of bricks; 8 * family +
 * child for a leaf of an octree, whose lower corner `voxel` is; else ignored. */
void df_scene_corners(const df_scene *scene, const uint32_t voxel[3], uint32_t block, float corner[8]);

/* The stencil of a voxel (gradient.h), values as stored; entry i goes to stencil[i * step]. reach: DF_REACH_...,
 * how much is filled. */
void df_scene_stencil(const df_scene *scene, const uint32_t voxel[3], uint32_t block, int reach, float *stencil,
                      size_t step);

/* The same for a leaf of an octree with edges of 2^size_log2 voxels: the samples lie that far apart. */
void df_scene_leaf_stencil(const df_scene *scene, const uint32_t corner[3], uint32_t block, uint32_t size_log2,
                           int reach, float *stencil, size_t step);

/* The block of a voxel's coarse cell, or DF_CELL_OUTSIDE or DF_CELL_INSIDE. levels = 2 only. */
static inline uint32_t df_scene_block(const df_scene *scene, uint32_t x, uint32_t y, uint32_t z) {
    uint64_t row = (y >> scene->k_shift) + (uint64_t)scene->coarse_count[1] * (z >> scene->k_shift);
    return scene->coarse[(x >> scene->k_shift) + scene->coarse_count[0] * row];
}

#endif
