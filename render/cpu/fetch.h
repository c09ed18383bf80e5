/*
 * Quick access to f32 samples for the kernels: where the samples around a voxel lie, as pointers. What lies elsewhere,
 * in other sample types or beyond what is stored, goes through scene.h, which this must agree with.
 */
#ifndef DF_FETCH_H
#define DF_FETCH_H

#include "render/methods/gradient.h"
#include "render/scene.h"

/* Strides of a run of samples, and the first corner of a voxel in it. */
typedef struct df_fetch {
    const float *corner;
    size_t row, slice;
} df_fetch;

/* block: of the voxel, when the field is made of bricks. f32 samples only. */
static inline df_fetch df_fetch_corner(const df_scene *scene, const uint32_t voxel[3], uint32_t block) {
    const df_field *field = scene->field;
    const float *samples = (const float *)field->samples;
    if (field->kind == DF_FIELD_BRICKS) {
        const uint32_t side = scene->k + 1, mask = scene->k - 1;
        const df_fetch f = {samples + (size_t)block * (side * side * side) + (voxel[0] & mask) +
                                side * (voxel[1] & mask) + side * side * (voxel[2] & mask),
                            side, side * side};
        return f;
    }
    const size_t row = (size_t)field->voxel_count[0] + 1, slice = row * ((size_t)field->voxel_count[1] + 1);
    const df_fetch f = {samples + voxel[0] + row * voxel[1] + slice * voxel[2], row, slice};
    return f;
}

/* The first of the 4 samples beyond each face of the voxel: before and after along x, y, z. Returns false where one of
 * them is not stored in the face's own brick or lies outside the field. */
static inline bool df_fetch_faces(const df_scene *scene, const uint32_t voxel[3], uint32_t block, const df_fetch *f,
                                  const float *faces[6]) {
    const ptrdiff_t stride[3] = {1, (ptrdiff_t)f->row, (ptrdiff_t)f->slice};
    const bool bricks = scene->field->kind == DF_FIELD_BRICKS;
    const uint32_t k = scene->k, mask = k - 1;
    const ptrdiff_t samples = (ptrdiff_t)(k + 1) * (k + 1) * (k + 1);
    const ptrdiff_t cells[3] = {1, scene->coarse_count[0], (ptrdiff_t)scene->coarse_count[0] * scene->coarse_count[1]};
    for (int a = 0; a < 3; a++) {
        if (voxel[a] < 1 || voxel[a] + 2 > scene->voxel_count[a]) return false;
        faces[2 * a] = f->corner - stride[a];
        faces[2 * a + 1] = f->corner + 2 * stride[a];
        if (!bricks) continue;
        const uint32_t within = voxel[a] & mask;
        if (within == 0) {
            const uint32_t other = scene->coarse[(ptrdiff_t)scene->block_cells[block] - cells[a]];
            if (other >= DF_CELL_INSIDE) return false;
            faces[2 * a] = f->corner + ((ptrdiff_t)other - (ptrdiff_t)block) * samples + (ptrdiff_t)(k - 1) * stride[a];
        } else if (within == mask) {
            const uint32_t other = scene->coarse[(ptrdiff_t)scene->block_cells[block] + cells[a]];
            if (other >= DF_CELL_INSIDE) return false;
            faces[2 * a + 1] =
                f->corner + ((ptrdiff_t)other - (ptrdiff_t)block) * samples - (ptrdiff_t)(k - 2) * stride[a];
        }
    }
    return true;
}

/* df_scene_stencil for f32 samples, quickly where all is at hand. */
static inline void df_fetch_stencil(const df_scene *scene, const uint32_t voxel[3], uint32_t block, float *stencil,
                                    size_t step) {
    const df_fetch f = df_fetch_corner(scene, voxel, block);
    const float *faces[6];
    if (!df_fetch_faces(scene, voxel, block, &f, faces)) {
        df_scene_stencil(scene, voxel, block, true, stencil, step);
        return;
    }
    for (int c = 0; c < 8; c++) {
        stencil[(size_t)DF_STENCIL(c & 1, c >> 1 & 1, c >> 2) * step] =
            f.corner[(c & 1) + (c & 2 ? f.row : 0) + (c & 4 ? f.slice : 0)];
    }
    for (int i = 0; i < 4; i++) {
        const int u = i & 1, v = i >> 1;
        const size_t x = (size_t)u * f.row + (size_t)v * f.slice, y = (size_t)u + (size_t)v * f.slice,
                     z = (size_t)u + (size_t)v * f.row;
        stencil[(size_t)DF_STENCIL(-1, u, v) * step] = faces[0][x];
        stencil[(size_t)DF_STENCIL(2, u, v) * step] = faces[1][x];
        stencil[(size_t)DF_STENCIL(u, -1, v) * step] = faces[2][y];
        stencil[(size_t)DF_STENCIL(u, 2, v) * step] = faces[3][y];
        stencil[(size_t)DF_STENCIL(u, v, -1) * step] = faces[4][z];
        stencil[(size_t)DF_STENCIL(u, v, 2) * step] = faces[5][z];
    }
}

#endif
