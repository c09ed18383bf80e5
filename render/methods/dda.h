/*
 * The walk of the 3DDDA, ray by ray: C only, and OpenCL C. The text expects df_scene, df_candidate and df_counters
 * (tracer.h; on a device opencl/scene.cl).
 *
 * A walk is a sequence of events (t, axis): the ray crosses a grid plane of that axis. Of events at the same t the
 * lower axis comes first. The cell after an event is therefore a pure function of the ray and the event, and a walk
 * through bricks visits the very voxels that a walk through the uniform grid visits there.
 *
 * The walk from cell to cell stands twice, with the same functions and the same bits: here, and for devices with the
 * three axes in vectors (opencl/dda_walk.cl).
 */
#ifndef DF_DDA_H
#define DF_DDA_H

#ifndef DF_OPENCL
#include "render/tracer.h" /* not for devices */
#endif

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"

/* Cells that the ray leaves before `first` or enters after `last` need not be visited; 0 and INFINITY where nothing is
 * known. */
typedef struct dda_ray {
    float origin[3], direction[3], inverse[3];
    float first, last;
    float footprint,
        footprint_base; /* octrees: cells no larger than t * footprint + footprint_base, voxels, are leaves */
} dda_ray;

typedef struct dda_event {
    float t;
    int axis; /* of the crossed plane; 3: the ray starts here */
} dda_event;

/* A walk over cells of `size` voxels, low <= cell < high, which lie at index base + stride * (cell - low) of some
 * array. */
typedef struct dda_box {
    int32_t low[3], high[3];
    int64_t base, stride[3];
    float size, inverse_size; /* powers of two */
} dda_box;

static inline float dda_plane_t(const dda_ray *ray, int axis, float plane) {
    return (plane - ray->origin[axis]) * ray->inverse[axis];
}

static inline bool dda_precedes(float t, int axis, dda_event other) {
    return t < other.t || (t == other.t && axis < other.axis);
}

/* The index along an axis, not the one that the event crosses, of the cell in which the ray goes on after it: between
 * the last plane before the event and the first one after it. */
static DF_INLINE int32_t dda_cell_after(const dda_box *box, const dda_ray *ray, int axis, int32_t upward,
                                        dda_event at) {
    float position = (ray->origin[axis] + at.t * ray->direction[axis]) * box->inverse_size;
    float low = (float)box->low[axis], high = (float)(box->high[axis] - 1);
    int32_t cell = (int32_t)(position < low ? low : position > high ? high : position), step = upward ? 1 : -1;
    int32_t first = upward ? box->low[axis] : box->high[axis] - 1, last = upward ? box->high[axis] - 1 : box->low[axis];
    while (cell != last && dda_precedes(dda_plane_t(ray, axis, (float)(cell + upward) * box->size), axis, at))
        cell += step;
    while (cell != first && !dda_precedes(dda_plane_t(ray, axis, (float)(cell + !upward) * box->size), axis, at))
        cell -= step;
    return cell;
}

#ifdef DF_OPENCL
#include "render/opencl/dda_walk.cl"
#else

typedef struct dda_walk {
    float leave[3];      /* where the ray leaves the cell, by axis */
    float plane[3];      /* the plane it crosses there, grid space */
    float plane_step[3]; /* to the next one */
    int32_t left[3];     /* cells up to the end of the box, this one included */
    int64_t index, stride[3];
} dda_walk;

/* Places the walk in the cell after an event at which the ray enters the box, or starts in it. */
static DF_INLINE void dda_begin(dda_walk *w, const dda_box *box, const dda_ray *ray, dda_event at) {
    w->index = box->base;
    for (int a = 0; a < 3; a++) {
        const int32_t upward = ray->direction[a] > 0, first = upward ? box->low[a] : box->high[a] - 1;
        const int32_t cell = a == at.axis ? first : dda_cell_after(box, ray, a, upward, at);
        w->plane_step[a] = upward ? box->size : -box->size;
        w->stride[a] = upward ? box->stride[a] : -box->stride[a];
        w->left[a] = upward ? box->high[a] - cell : cell - box->low[a] + 1;
        w->index += (cell - box->low[a]) * box->stride[a];
        w->plane[a] = (float)(cell + upward) * box->size;
        w->leave[a] = dda_plane_t(ray, a, w->plane[a]);
    }
}

/* The lower corner of the cell, grid space. */
static inline void dda_cell(const dda_walk *w, float lower[3]) {
    for (int a = 0; a < 3; a++) lower[a] = w->plane_step[a] > 0 ? w->plane[a] - w->plane_step[a] : w->plane[a];
}

/* Where the ray leaves the cell: along the lowest axis where it leaves through an edge. */
static inline void dda_exit(const dda_walk *w, dda_event *out) {
    const bool y = w->leave[1] < w->leave[0];
    const float t = y ? w->leave[1] : w->leave[0];
    const bool z = w->leave[2] < t;
    out->t = z ? w->leave[2] : t;
    out->axis = z ? 2 : y;
}

/* Goes on to the next cell, through the event of dda_exit; false where that is outside the box. All three axes take the
 * step, two of them by nothing: no index depends on the ray, so the walk stays in registers. */
static inline bool dda_step(dda_walk *w, const dda_ray *ray, const dda_event *out) {
    int32_t ended = 0;
    for (int a = 0; a < 3; a++) {
        const bool crossed = a == out->axis;
        w->left[a] -= crossed;
        ended |= w->left[a] == 0;
        w->index += crossed ? w->stride[a] : 0;
        w->plane[a] += crossed ? w->plane_step[a] : 0; /* whole numbers below 2^24: exact */
        w->leave[a] = dda_plane_t(ray, a, w->plane[a]);
    }
    return !ended;
}

#endif

/* The event at which the walk begins: where the ray enters [0, box], its start inside, or its first t; false where it
 * misses. The cell after any event is that of the whole walk, so it may begin anywhere. */
static inline bool dda_enter_box(const dda_ray *ray, const uint32_t box[3], dda_event *at) {
    float t_out = INFINITY;
    dda_event in = {-INFINITY, 0};
    for (int a = 0; a < 3; a++) {
        float low = dda_plane_t(ray, a, 0), high = dda_plane_t(ray, a, (float)box[a]);
        float enter = low < high ? low : high, leave = low < high ? high : low;
        if (enter >= in.t) in = (dda_event){enter, a};
        if (leave < t_out) t_out = leave;
    }
    *at = in.t > 0 ? in : (dda_event){0, 3};
    if (ray->first > at->t) *at = (dda_event){ray->first, 3};
    return at->t <= t_out && at->t <= ray->last;
}

/* Solves nothing yet: is the surface between the ray's entry into this voxel and its exit? */
static inline bool dda_accept(const df_scene *scene, bool isolate, const dda_ray *ray, const float lower[3],
                              uint32_t block, df_candidate *candidate, df_counters *counters) {
    uint32_t voxel[3];
    float corner[8];
    df_segment_f32 segment;
    int inside;
    if (!df_cell_segment_f32(ray->origin, ray->direction, ray->inverse, 0, lower, 1, &segment)) return false;
    for (int a = 0; a < 3; a++) voxel[a] = (uint32_t)lower[a];
    df_scene_corners(scene, voxel, block, corner);
    counters->cells_tested++;
    if (!df_accept_f32(corner, segment.a, segment.b, isolate, &inside)) return false;
    candidate->block = block;
    candidate->flags = inside ? DF_HIT_BACK : 0;
    for (int a = 0; a < 3; a++) candidate->cell[a] = (uint16_t)voxel[a];
    return true;
}

/* Walks the voxels of one block of k*k*k. */
static inline bool dda_block(const df_scene *scene, bool isolate, const dda_ray *ray, const float lower[3],
                             uint32_t block, dda_event at, df_candidate *candidate, df_counters *counters) {
    const int32_t k = (int32_t)scene->k;
    const DF_GLOBAL uint64_t *mask = scene->masks + (uint64_t)block * df_brick_mask_words(scene->k);
    dda_box box = {.size = 1, .inverse_size = 1, .stride = {1, k, k * k}};
    dda_walk w;
    for (int a = 0; a < 3; a++) {
        box.low[a] = (int32_t)lower[a];
        box.high[a] = box.low[a] + k;
    }
    dda_begin(&w, &box, ray, at);
    do {
        counters->fine_steps++;
        if (mask[(uint64_t)w.index / 64] >> (w.index & 63) & 1) {
            float voxel[3];
            dda_cell(&w, voxel);
            if (dda_accept(scene, isolate, ray, voxel, block, candidate, counters)) return true;
        }
        dda_exit(&w, &at);
    } while (dda_step(&w, ray, &at));
    return false;
}

static inline bool dda_two_level(const df_scene *scene, bool isolate, const dda_ray *ray, df_candidate *candidate,
                                 df_counters *counters) {
    const uint32_t *count = scene->coarse_count;
    dda_box box = {.size = (float)scene->k,
                   .inverse_size = 1.0f / (float)scene->k,
                   .stride = {1, count[0], (int64_t)count[0] * count[1]}};
    uint32_t extent[3];
    dda_event at;
    dda_walk w;
    for (int a = 0; a < 3; a++) {
        box.high[a] = (int32_t)count[a];
        extent[a] = count[a] * scene->k;
    }
    if (!dda_enter_box(ray, extent, &at)) return false;
    dda_begin(&w, &box, ray, at);
    do {
        uint32_t block;
        counters->coarse_steps++;
        while ((block = scene->coarse[w.index]) >= DF_CELL_INSIDE) { /* a loop of few registers */
            dda_exit(&w, &at);
            if (at.t > ray->last || !dda_step(&w, ray, &at)) return false;
            counters->coarse_steps++;
        }
        float lower[3];
        dda_cell(&w, lower);
        if (dda_block(scene, isolate, ray, lower, block, at, candidate, counters)) return true;
        dda_exit(&w, &at);
    } while (!(at.t > ray->last) && dda_step(&w, ray, &at));
    return false;
}

static inline bool dda_uniform(const df_scene *scene, bool isolate, const dda_ray *ray, df_candidate *candidate,
                               df_counters *counters) {
    const uint32_t *count = scene->voxel_count;
    const int64_t row = 64 * (int64_t)scene->row_words; /* bits */
    dda_box box = {.size = 1, .inverse_size = 1, .stride = {1, row, row * count[1]}};
    dda_event at;
    dda_walk w;
    for (int a = 0; a < 3; a++) box.high[a] = (int32_t)count[a];
    if (!dda_enter_box(ray, count, &at)) return false;
    dda_begin(&w, &box, ray, at);
    do {
        counters->fine_steps++;
        if (scene->rows[(uint64_t)w.index / 64] >> (w.index & 63) & 1) {
            float voxel[3];
            dda_cell(&w, voxel);
            if (dda_accept(scene, isolate, ray, voxel, 0, candidate, counters)) return true;
        }
        dda_exit(&w, &at);
    } while (!(at.t > ray->last) && dda_step(&w, ray, &at));
    return false;
}

/* Finds the cell in which a ray hits, by the levels of the scene; false where it misses. isolate: as df_accept has it.
 */
static inline bool dda_walk_scene(const df_scene *scene, bool isolate, const dda_ray *ray, df_candidate *candidate,
                                  df_counters *counters) {
    return scene->levels == 1 ? dda_uniform(scene, isolate, ray, candidate, counters)
                              : dda_two_level(scene, isolate, ray, candidate, counters);
}

#endif
