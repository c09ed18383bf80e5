/*
 * The walk of a ray through an octree (ADF), leaf by leaf, from front to back. C only, and OpenCL C.
 *
 * It is the walk of dda.h with cells of different sizes: the ray's voxel is kept on the finest level, by the same
 * rules, and the leaf around it is found from the family where the paths of the old and the new voxel part. Leaves of
 * different levels may interpolate different corners on the face between them, so the ray carries its side: a leaf
 * whose value at the entry lies on the other side is hit there.
 */
#ifndef DF_ADF_H
#define DF_ADF_H

#include "common/octree_samples.h"
#include "render/methods/dda.h"

typedef struct adf_walk {
    uint32_t voxel[3];                 /* on the finest level */
    uint32_t path[DF_LEVEL_COUNT_MAX]; /* families from the root's down to the current leaf's */
    uint32_t depth;                    /* of the current leaf's family: path[depth] */
#ifndef DF_OPENCL
    float cells[DF_LEVEL_COUNT_MAX][8]; /* corner values of the cells that became the families of the path */
    uint32_t cells_known;               /* the first so many of them; the rest is decoded when a leaf needs it */
#endif
    uint32_t corner[3], size_log2, child; /* the current leaf */
    df_child_state state;
} adf_walk;

/* The child of path[depth] around the voxel. */
static inline uint32_t adf_child(const df_field *field, const adf_walk *w, uint32_t depth) {
    const uint32_t bit = field->level_count - 1 - depth;
    return (w->voxel[0] >> bit & 1) | (w->voxel[1] >> bit & 1) << 1 | (w->voxel[2] >> bit & 1) << 2;
}

/* Whether the child around the voxel is so small, seen from where the ray enters it, that it is not divided. */
static inline bool adf_small(const df_field *field, const dda_ray *ray, const adf_walk *w) {
    const uint32_t size_log2 = field->level_count - 1 - w->depth, size = 1u << size_log2;
    float t_in = 0;
    if (!(ray->footprint > 0 || ray->footprint_base > 0)) return false;
    for (int a = 0; a < 3; a++) {
        const uint32_t corner = w->voxel[a] >> size_log2 << size_log2;
        const float t = dda_plane_t(ray, a, (float)(corner + (ray->direction[a] > 0 ? 0 : size)));
        if (t > t_in) t_in = t;
    }
    return (float)size <= t_in * ray->footprint + ray->footprint_base;
}

/* Goes down from path[depth] to the leaf around the voxel. */
static inline void adf_descend(const df_field *field, const dda_ray *ray, adf_walk *w) {
    for (;;) {
        const df_family family = field->families[w->path[w->depth]];
        w->child = adf_child(field, w, w->depth);
        w->state = df_family_state(&family, w->child);
        if (w->state != DF_CHILD_FAMILY || adf_small(field, ray, w)) break;
        w->path[++w->depth] = df_family_child(&family, w->child);
    }
    w->size_log2 = field->level_count - 1 - w->depth;
    for (int a = 0; a < 3; a++) w->corner[a] = w->voxel[a] >> w->size_log2 << w->size_log2;
}

/* The corner values of the leaf, decoded along the path: df_octree_corners for less. A device has the cells decoded. */
static inline void adf_leaf_corners(const df_field *field, adf_walk *w, float corners[8]) {
#ifdef DF_OPENCL
    df_octree_corners(field, w->path[w->depth], w->child, corners);
#else
    for (; w->cells_known <= w->depth; w->cells_known++) {
        const uint32_t parent = w->cells_known - 1;
        df_octree_child_corners(field, w->path[parent], adf_child(field, w, parent), w->cells[parent],
                                w->cells[parent + 1]);
    }
    df_octree_child_corners(field, w->path[w->depth], w->child, w->cells[w->depth], corners);
#endif
}

/* Moves to the voxel after the event at which the ray leaves the leaf; false at the end of the root cube. */
static inline bool adf_step(const df_field *field, const dda_ray *ray, adf_walk *w, dda_event *at) {
    const uint32_t size = 1u << w->size_log2;
    dda_box box = {.size = 1, .inverse_size = 1};
    uint32_t changed = 0;
    dda_event out = {INFINITY, 0};
    for (int a = 0; a < 3; a++) {
        const float t = dda_plane_t(ray, a, (float)(w->corner[a] + (ray->direction[a] > 0 ? size : 0)));
        if (t < out.t) out = (dda_event){t, a};
        box.low[a] = (int32_t)w->corner[a];
        box.high[a] = (int32_t)(w->corner[a] + size);
    }
    for (int a = 0; a < 3; a++) {
        const int32_t upward = ray->direction[a] > 0;
        uint32_t next;
        if (a == out.axis) {
            if (upward ? w->corner[a] + size >= 1u << field->level_count : w->corner[a] == 0) return false;
            next = upward ? w->corner[a] + size : w->corner[a] - 1;
        } else {
            next = (uint32_t)dda_cell_after(&box, ray, a, upward, out);
        }
        changed |= next ^ w->voxel[a];
        w->voxel[a] = next;
    }
    *at = out;
    /* The family of the highest level on which the path changes. */
    const uint32_t highest = 31 - df_leading_zeros(changed), depth = field->level_count - 1 - highest;
    if (depth < w->depth) w->depth = depth;
#ifndef DF_OPENCL
    if (w->cells_known > w->depth + 1) w->cells_known = w->depth + 1;
#endif
    adf_descend(field, ray, w);
    return true;
}

/* The leaf as a candidate. */
static inline void adf_candidate(const adf_walk *w, bool inside, df_candidate *candidate) {
    candidate->block = w->path[w->depth] << 3 | w->child;
    candidate->flags = (uint8_t)((inside ? DF_HIT_BACK : 0) | w->size_log2 << DF_HIT_SIZE_SHIFT);
    for (int a = 0; a < 3; a++) candidate->cell[a] = (uint16_t)w->corner[a];
}

/* What a leaf does to a ray: returns true for a hit; otherwise *side becomes the side on which the ray leaves it (0
 * outside, 1 inside; -1 while nothing is known). */
static inline bool adf_visit(const df_scene *scene, bool isolate, const dda_ray *ray, adf_walk *w, int *side,
                             df_candidate *candidate, df_counters *counters) {
    bool mixed = w->state >= DF_CHILD_SURFACE, inside = w->state == DF_CHILD_INSIDE;
    const float lower[3] = {(float)w->corner[0], (float)w->corner[1], (float)w->corner[2]};
    float corner[8];
    for (int a = 0; a < 3; a++) {
        if (w->corner[a] >= scene->voxel_count[a]) return false; /* beyond the field's box */
    }
    if (mixed || scene->iso != 0) {
        adf_leaf_corners(scene->field, w, corner);
        for (int c = 0; c < 8; c++) corner[c] -= scene->iso;
        mixed = df_corners_straddle(corner, 0);
        inside = corner[0] < 0;
    }
    if (mixed) {
        df_segment_f32 segment;
        float bern[4];
        int side_in;
        counters->fine_steps++;
        if (!df_cell_segment_f32(ray->origin, ray->direction, ray->inverse, 0, lower, (float)(1u << w->size_log2),
                                 &segment))
            return false;
        counters->cells_tested++;
        df_bernstein_f32(corner, segment.a, segment.b, bern);
        inside = bern[0] < 0;
        if (*side < 0) *side = inside;
        adf_candidate(w, *side != 0, candidate);
        if (inside != (*side != 0)) return true;
        return df_accept_f32(corner, segment.a, segment.b, isolate, &side_in);
    }
    counters->coarse_steps++;
    if (*side < 0) *side = inside;
    if (inside == (*side != 0)) return false;
    adf_candidate(w, *side != 0, candidate);
    return true;
}

/* Finds the leaf in which a ray hits; false where it misses. */
static inline bool adf_walk_scene(const df_scene *scene, bool isolate, const dda_ray *ray, df_candidate *candidate,
                                  df_counters *counters) {
    const df_field *field = scene->field;
    const uint32_t side = 1u << field->level_count, cube[3] = {side, side, side};
    const dda_box box = {.high = {(int32_t)side, (int32_t)side, (int32_t)side}, .size = 1, .inverse_size = 1};
    adf_walk w;
    dda_event at;
    int carried = -1;
    if (!dda_enter_box(ray, cube, &at)) return false;
    for (int a = 0; a < 3; a++) {
        const int32_t upward = ray->direction[a] > 0, first = upward ? 0 : (int32_t)side - 1;
        w.voxel[a] = (uint32_t)(a == at.axis ? first : dda_cell_after(&box, ray, a, upward, at));
    }
    w.path[0] = w.depth = 0;
#ifndef DF_OPENCL
    for (int c = 0; c < 8; c++) w.cells[0][c] = ((const float *)field->samples)[c];
    w.cells_known = 1;
#endif
    adf_descend(field, ray, &w);
    do {
        if (adf_visit(scene, isolate, ray, &w, &carried, candidate, counters)) return true;
    } while (adf_step(field, ray, &w, &at));
    return false;
}

#endif
