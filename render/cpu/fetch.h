/*
 * Quick access to samples for the kernels, decoded on the way: where the samples around a voxel lie, and the stencil of
 * a voxel as rows. What lies beyond what is stored goes through scene.h, which this must agree with.
 *
 * The functions take the sample type as an argument so that callers can make it a constant (DF_FETCH_BY_TYPE): it is
 * then not asked for in the inner loops.
 */
#ifndef DF_FETCH_H
#define DF_FETCH_H

#include "render/cpu/kernels.h"
#include "render/methods/gradient.h"

#include <string.h>

/* Calls a function with a constant sample type as its last argument. */
#define DF_FETCH_BY_TYPE(type, function, ...)                         \
    ((type) == DF_SAMPLE_F32   ? function(__VA_ARGS__, DF_SAMPLE_F32) \
     : (type) == DF_SAMPLE_U16 ? function(__VA_ARGS__, DF_SAMPLE_U16) \
                               : function(__VA_ARGS__, DF_SAMPLE_U8))

/* A voxel's first corner as an index of samples, and the strides of the run that it lies in. */
typedef struct df_fetch {
    size_t corner, row, slice;
} df_fetch;

/* block: of the voxel, when the field is made of bricks. */
static inline df_fetch df_fetch_corner(const df_scene *scene, const uint32_t voxel[3], uint32_t block) {
    const df_field *field = scene->field;
    if (field->kind == DF_FIELD_BRICKS) {
        const uint32_t side = scene->k + 1, mask = scene->k - 1;
        const df_fetch f = {(size_t)block * (side * side * side) + (voxel[0] & mask) + side * (voxel[1] & mask) +
                                side * side * (voxel[2] & mask),
                            side, side * side};
        return f;
    }
    const size_t row = (size_t)field->voxel_count[0] + 1, slice = row * ((size_t)field->voxel_count[1] + 1);
    const df_fetch f = {voxel[0] + row * voxel[1] + slice * voxel[2], row, slice};
    return f;
}

/* The step of quantised samples of a block. */
static inline float df_fetch_step(const df_field *field, uint32_t block, df_sample_type type) {
    if (type == DF_SAMPLE_F32) return 1;
    return df_power_of_two(field->brick_exponents ? field->brick_exponents[block] : field->step_exponent);
}

/* Samples `at` and the `count` - 1 after it, decoded. */
static inline void df_fetch_row(const void *samples, size_t at, float step, int count, float *out,
                                df_sample_type type) {
    if (type == DF_SAMPLE_F32) memcpy(out, (const float *)samples + at, (size_t)count * sizeof *out);
    for (int i = 0; i < count && type != DF_SAMPLE_F32; i++) {
        out[i] = type == DF_SAMPLE_U16 ? (float)(((const uint16_t *)samples)[at + (size_t)i] - 32768) * step
                                       : (float)(((const uint8_t *)samples)[at + (size_t)i] - 128) * step;
    }
}

/* The corners of voxels and their blocks, minus iso, by lane, but not of octrees. Only the lanes of `bits`, of which
 * there is one, are looked at. */
static inline void df_fetch_cells(const df_scene *scene, const int32_t voxel[3][DF_LANES],
                                  const int32_t block[DF_LANES], uint32_t bits, lf corner[8], df_sample_type type) {
    float decoded[DF_LANES][8];
    const float *from[DF_LANES] = {NULL};
    size_t row = 2, slice = 4;
    const int first = __builtin_ctz(bits);
    for (int i = first; i < DF_LANES; i++) {
        from[i] = from[first];
        if (!(bits >> i & 1)) continue;
        const uint32_t at[3] = {(uint32_t)voxel[0][i], (uint32_t)voxel[1][i], (uint32_t)voxel[2][i]};
        const df_fetch f = df_fetch_corner(scene, at, (uint32_t)block[i]);
        if (type == DF_SAMPLE_F32) {
            from[i] = (const float *)scene->field->samples + f.corner;
            row = f.row;
            slice = f.slice;
            continue;
        }
        const float step = df_fetch_step(scene->field, (uint32_t)block[i], type);
        for (int pair = 0; pair < 4; pair++) {
            df_fetch_row(scene->field->samples, f.corner + (pair & 1 ? f.row : 0) + (pair & 2 ? f.slice : 0), step, 2,
                         decoded[i] + 2 * pair, type);
        }
        from[i] = decoded[i];
    }
    for (int i = 0; i < first; i++) from[i] = from[first];
    lf_load_pairs(from, row, slice, corner);
    for (int c = 0; c < 8; c++) corner[c] = corner[c] - lf_set(scene->iso);
}

/* The corners, minus iso, of records of a surface and their blocks, by lane. */
static inline void df_fetch_records(const df_scene *scene, const df_surface *surface, const int32_t record[DF_LANES],
                                    const int32_t block[DF_LANES], lf corner[8], df_sample_type type) {
    float decoded[DF_LANES][8];
    const float *from[DF_LANES];
    for (int i = 0; i < DF_LANES; i++) {
        const size_t first = 8 * (size_t)record[i];
        from[i] = type == DF_SAMPLE_F32 ? (const float *)surface->corners + first : decoded[i];
        if (type == DF_SAMPLE_F32) continue;
        const float step = df_fetch_step(scene->field, (uint32_t)block[i], type);
        df_fetch_row(surface->corners, first, step, 8, decoded[i], type);
    }
    lf_load_8(from, corner);
    for (int c = 0; c < 8; c++) corner[c] = corner[c] - lf_set(scene->iso);
}

/* The 4 samples beyond a face of a voxel: the first of them, and the step of the brick that they lie in. */
typedef struct df_fetch_face {
    size_t at;
    float step;
} df_fetch_face;

/* The faces before and after along x, y, z. Returns false where one of them is not stored in the face's own brick or
 * lies outside the field. */
static inline bool df_fetch_faces(const df_scene *scene, const uint32_t voxel[3], uint32_t block, const df_fetch *f,
                                  float step, df_fetch_face faces[6], df_sample_type type) {
    const size_t stride[3] = {1, f->row, f->slice};
    const bool bricks = scene->field->kind == DF_FIELD_BRICKS;
    const uint32_t k = scene->k, mask = k - 1;
    const size_t samples = (size_t)(k + 1) * (k + 1) * (k + 1);
    const uint32_t cells[3] = {1, scene->coarse_count[0], scene->coarse_count[0] * scene->coarse_count[1]};
    for (int a = 0; a < 3; a++) {
        if (voxel[a] < 1 || voxel[a] + 2 > scene->voxel_count[a]) return false;
        faces[2 * a] = (df_fetch_face){f->corner - stride[a], step};
        faces[2 * a + 1] = (df_fetch_face){f->corner + 2 * stride[a], step};
    }
    if (!bricks) return true;
    const uint32_t own = scene->block_cells[block];
    for (int a = 0; a < 3; a++) { /* without branches: which voxels are at a border of their brick is hard to predict */
        const uint32_t within = voxel[a] & mask;
        const size_t before = -(size_t)(within == 0), after = -(size_t)(within == mask); /* all bits set where true */
        const uint32_t other = scene->coarse[own + ((uint32_t)after & cells[a]) - ((uint32_t)before & cells[a])];
        if (other >= DF_CELL_INSIDE) return false;
        /* in the next brick, or by 0 in the own, and counted from the next one's side */
        const size_t away = ((size_t)other - block) * samples, across = k * stride[a];
        const float there = df_fetch_step(scene->field, other, type);
        faces[2 * a].at += before & (away + across);
        faces[2 * a + 1].at += after & (away - across);
        if (type == DF_SAMPLE_F32) continue;
        faces[2 * a].step = before ? there : step;
        faces[2 * a + 1].step = after ? there : step;
    }
    return true;
}

/*
 * The stencil of a voxel as 32 numbers: 4 rows of 4 through its corners, row (y,z) as number y + 2 z, then the pairs
 * beyond its faces, each along x: (y,z) = (-1,0) (-1,1) (2,0) (2,1) (0,-1) (1,-1) (0,2) (1,2).
 */
enum { DF_FETCH_STENCIL = 32 };

/* Where number i of the 32 stands in a stencil of gradient.h. */
static inline int df_fetch_place(int i) {
    static const signed char beyond[8][2] = {{-1, 0}, {-1, 1}, {2, 0}, {2, 1}, {0, -1}, {1, -1}, {0, 2}, {1, 2}};
    if (i < 16) return DF_STENCIL((i & 3) - 1, i >> 2 & 1, i >> 3);
    return DF_STENCIL(i & 1, beyond[(i - 16) >> 1][0], beyond[(i - 16) >> 1][1]);
}

/* Where the stencil of a voxel lies: found first, so that memory can be asked for it before it is needed. */
typedef struct df_fetch_way {
    uint32_t voxel[3], block;
    df_fetch corner;
    float step;
    bool known; /* whether the faces are */
    df_fetch_face faces[6];
} df_fetch_way;

/* Where row i of the 4 through the corners begins, at the corner; ... */
static inline size_t df_fetch_corner_row(const df_fetch *f, int i) {
    return f->corner + (i & 1 ? f->row : 0) + (i & 2 ? f->slice : 0);
}

/* ... and pair i of the 8 beyond the faces along y and z. */
static inline size_t df_fetch_face_row(const df_fetch_way *way, int i) {
    return way->faces[2 + (i >> 1)].at + (i & 1 ? (i < 4 ? way->corner.slice : way->corner.row) : 0);
}

/* Finds it, and asks memory for it. `beyond`: as for df_fetch_stencil. */
static inline void df_fetch_find(const df_scene *scene, const uint32_t voxel[3], uint32_t block, bool beyond,
                                 df_fetch_way *way, df_sample_type type) {
    const char *samples = (const char *)scene->field->samples;
    const size_t size = df_sample_size(type);
    for (int a = 0; a < 3; a++) way->voxel[a] = voxel[a];
    way->block = block;
    way->corner = df_fetch_corner(scene, voxel, block);
    way->step = df_fetch_step(scene->field, block, type);
    way->known = beyond && df_fetch_faces(scene, voxel, block, &way->corner, way->step, way->faces, type);
    for (int i = 0; i < 4; i++) __builtin_prefetch(samples + df_fetch_corner_row(&way->corner, i) * size);
    for (int i = 0; i < 8 && way->known; i++) __builtin_prefetch(samples + df_fetch_face_row(way, i) * size);
}

/* df_scene_stencil as 32 numbers: DF_REACH_FACES, without `beyond` DF_REACH_CELL. */
static inline void df_fetch_stencil(const df_scene *scene, const df_fetch_way *way, bool beyond,
                                    float out[DF_FETCH_STENCIL], df_sample_type type) {
    const void *samples = scene->field->samples;
    const df_fetch *f = &way->corner;
    const df_fetch_face *faces = way->faces;
    const bool whole_rows = way->known && faces[0].at + 1 == f->corner && faces[1].at == f->corner + 2;
    for (int i = 0; i < 4; i++) {
        const size_t row = df_fetch_corner_row(f, i);
        if (whole_rows) df_fetch_row(samples, row - 1, way->step, 4, out + 4 * i, type);
        else df_fetch_row(samples, row, way->step, 2, out + 4 * i + 1, type);
    }
    if (!beyond) return;
    if (!way->known) {
        float stencil[64];
        df_scene_stencil(scene, way->voxel, way->block, DF_REACH_FACES, stencil, 1);
        for (int i = 0; i < DF_FETCH_STENCIL; i++) out[i] = stencil[df_fetch_place(i)];
        return;
    }
    for (int i = 0; i < 4 && !whole_rows; i++) {
        const size_t away = df_fetch_corner_row(f, i) - f->corner;
        df_fetch_row(samples, faces[0].at + away, faces[0].step, 1, out + 4 * i, type);
        df_fetch_row(samples, faces[1].at + away, faces[1].step, 1, out + 4 * i + 3, type);
    }
    for (int i = 0; i < 8; i++)
        df_fetch_row(samples, df_fetch_face_row(way, i), faces[2 + (i >> 1)].step, 2, out + 16 + 2 * i, type);
}

/* Where the stencil of a leaf lies. */
typedef struct df_fetch_leaf_way {
    bool known; /* whether it is kept */
    uint32_t child;
    const float *own;        /* its family's 3x3x3 samples */
    const float (*outer)[4]; /* beyond the faces that are not inside the family; not a number where not known */
} df_fetch_leaf_way;

/* Finds it, and asks memory for it. leaf: 8 * family + child; stencils: NULL where none are kept. */
static inline void df_fetch_find_leaf(const df_leaf_stencils *stencils, const df_field *field, uint32_t leaf,
                                      df_fetch_leaf_way *way) {
    const uint32_t family = leaf >> 3;
    way->known = stencils && df_family_state(&field->families[family], leaf & 7) == DF_CHILD_SURFACE;
    if (!way->known) return;
    way->child = leaf & 7;
    way->own = stencils->samples[family];
    way->outer = stencils->outer[df_leaf_stencil_number(stencils, field, leaf)];
    __builtin_prefetch(way->own);
    __builtin_prefetch(way->own + 16);
    __builtin_prefetch(way->outer);
}

/* df_fetch_stencil for a leaf; false where it is not known. */
static inline bool df_fetch_leaf(const df_fetch_leaf_way *way, bool beyond, float out[DF_FETCH_STENCIL]) {
    if (!way->known || way->outer[0][0] != way->outer[0][0]) return false;
    const uint32_t x = way->child & 1, y = way->child >> 1 & 1, z = way->child >> 2 & 1;
    const float *own = way->own, (*outer)[4] = way->outer;
    /* Of the family's 3x3x3 samples a leaf's corners are 2x2x2; the third layers lie beyond its inner faces. */
    for (uint32_t i = 0; i < 4; i++) {
        memcpy(out + 4 * i + 1 - x, own + 3 * (y + (i & 1)) + 9 * (z + (i >> 1)), 3 * sizeof *own);
        out[4 * i + 3 * x] = outer[0][i];
    }
    if (!beyond) return true;
    float *at_y = out + 16, *at_z = out + 24;
    for (uint32_t i = 0; i < 2; i++) {
        memcpy(at_y + 4 * (1 - y) + 2 * i, own + x + 3 * (2 - 2 * y) + 9 * (z + i), 2 * sizeof *own);
        memcpy(at_z + 4 * (1 - z) + 2 * i, own + x + 3 * (y + i) + 9 * (2 - 2 * z), 2 * sizeof *own);
        at_y[4 * y + 2 * i] = outer[1][i];
        at_y[4 * y + 2 * i + 1] = outer[1][i + 2];
        memcpy(at_z + 4 * z + 2 * i, outer[2] + 2 * i, 2 * sizeof *own);
    }
    return true;
}

#endif
