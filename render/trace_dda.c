/*
 * The scalar 3DDDA, ray by ray: the specification of what every tracer returns.
 *
 * A walk is a sequence of events (t, axis): the ray crosses a grid plane of that axis. Of events at the same t the lower axis comes
 * first. The cell after an event is therefore a pure function of the ray and the event, and a walk through bricks visits the very
 * voxels that a walk through the uniform grid visits there.
 */
#include "render/tracer.h"
#include "common/memory.h"
#include "render/solve_methods.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

#include "render/lane_f32.h"

#include "render/cell.h"

typedef struct dda_state {
    const df_scene *scene;
    df_trace_options options;
    df_candidate **candidates; /* by thread, tile_rays each */
} dda_state;

typedef struct walk_ray {
    float origin[3], direction[3], inverse[3];
} walk_ray;

typedef struct event {
    float t;
    int axis; /* of the crossed plane; 3: the ray starts here */
} event;

/* A walk over cells of `size` voxels, low <= cell < high, which lie at index base + stride * (cell - low) of some array. */
typedef struct walk_box {
    int32_t low[3], high[3];
    int64_t base, stride[3];
    float size, inverse_size; /* powers of two */
} walk_box;

typedef struct walk {
    float leave[3];      /* where the ray leaves the cell, by axis */
    float plane[3];      /* the plane it crosses there, grid space */
    float plane_step[3]; /* to the next one */
    int32_t left[3];     /* cells up to the end of the box, this one included */
    int64_t index, stride[3];
} walk;

static float plane_t(const walk_ray *ray, int axis, float plane) {
    return (plane - ray->origin[axis]) * ray->inverse[axis];
}

static bool precedes(float t, int axis, event other) {
    return t < other.t || (t == other.t && axis < other.axis);
}

/* The index along an axis, not the one that the event crosses, of the cell in which the ray goes on after it: between the last
 * plane before the event and the first one after it. */
static int32_t cell_after(const walk_box *box, const walk_ray *ray, int axis, int32_t upward, event at) {
    float position = (ray->origin[axis] + at.t * ray->direction[axis]) * box->inverse_size;
    float low = (float)box->low[axis], high = (float)(box->high[axis] - 1);
    int32_t cell = (int32_t)(position < low ? low : position > high ? high : position), step = upward ? 1 : -1;
    int32_t first = upward ? box->low[axis] : box->high[axis] - 1, last = upward ? box->high[axis] - 1 : box->low[axis];
    while (cell != last && precedes(plane_t(ray, axis, (float)(cell + upward) * box->size), axis, at)) cell += step;
    while (cell != first && !precedes(plane_t(ray, axis, (float)(cell + !upward) * box->size), axis, at)) cell -= step;
    return cell;
}

/* Places the walk in the cell after an event at which the ray enters the box, or starts in it. */
static void walk_begin(walk *w, const walk_box *box, const walk_ray *ray, event at) {
    w->index = box->base;
    for (int a = 0; a < 3; a++) {
        const int32_t upward = ray->direction[a] > 0, first = upward ? box->low[a] : box->high[a] - 1;
        const int32_t cell = a == at.axis ? first : cell_after(box, ray, a, upward, at);
        w->plane_step[a] = upward ? box->size : -box->size;
        w->stride[a] = upward ? box->stride[a] : -box->stride[a];
        w->left[a] = upward ? box->high[a] - cell : cell - box->low[a] + 1;
        w->index += (cell - box->low[a]) * box->stride[a];
        w->plane[a] = (float)(cell + upward) * box->size;
        w->leave[a] = plane_t(ray, a, w->plane[a]);
    }
}

/* The lower corner of the cell, grid space. */
static void walk_cell(const walk *w, float lower[3]) {
    for (int a = 0; a < 3; a++) lower[a] = w->plane_step[a] > 0 ? w->plane[a] - w->plane_step[a] : w->plane[a];
}

/* The axis along which the ray leaves the cell: the lowest where it leaves through an edge. */
static int walk_axis(const walk *w) {
    int axis = w->leave[1] < w->leave[0];
    return w->leave[2] < w->leave[axis] ? 2 : axis;
}

/* Goes on to the next cell; false where that is outside the box. */
static bool walk_step(walk *w, const walk_ray *ray, int axis) {
    if (--w->left[axis] == 0) return false;
    w->index += w->stride[axis];
    w->plane[axis] += w->plane_step[axis]; /* whole numbers below 2^24: exact */
    w->leave[axis] = plane_t(ray, axis, w->plane[axis]);
    return true;
}

/* The event at which the ray enters [0, box], or its start inside; false where it misses. */
static bool enter_box(const walk_ray *ray, const uint32_t box[3], event *at) {
    float t_out = INFINITY;
    event in = {-INFINITY, 0};
    for (int a = 0; a < 3; a++) {
        float low = plane_t(ray, a, 0), high = plane_t(ray, a, (float)box[a]);
        float enter = low < high ? low : high, leave = low < high ? high : low;
        if (enter >= in.t) in = (event){enter, a};
        if (leave < t_out) t_out = leave;
    }
    *at = in.t > 0 ? in : (event){0, 3};
    return at->t <= t_out;
}

/* Solves nothing yet: is the surface between the ray's entry into this voxel and its exit? */
static bool accept(const dda_state *state, const walk_ray *ray, const float lower[3], uint32_t block, df_candidate *candidate,
                   df_counters *counters) {
    uint32_t voxel[3];
    float corner[8];
    df_segment_f32 segment;
    int inside;
    if (!df_cell_segment_f32(ray->origin, ray->direction, ray->inverse, 0, lower, 1, &segment)) return false;
    for (int a = 0; a < 3; a++) voxel[a] = (uint32_t)lower[a];
    df_scene_corners(state->scene, voxel, block, corner);
    counters->cells_tested++;
    if (!df_accept_f32(corner, segment.a, segment.b, DF_SOLVE_ISOLATES(state->options.solve), &inside)) return false;
    candidate->block = block;
    candidate->flags = inside ? DF_HIT_BACK : 0;
    for (int a = 0; a < 3; a++) candidate->cell[a] = (uint16_t)voxel[a];
    return true;
}

/* Walks the voxels of one block of k*k*k. */
static bool walk_block(const dda_state *state, const walk_ray *ray, const float lower[3], uint32_t block, event at,
                       df_candidate *candidate, df_counters *counters) {
    const df_scene *scene = state->scene;
    const int32_t k = (int32_t)scene->k;
    const uint64_t *mask = scene->masks + (uint64_t)block * df_brick_mask_words(scene->k);
    walk_box box = {.size = 1, .inverse_size = 1, .stride = {1, k, k * k}};
    walk w;
    for (int a = 0; a < 3; a++) {
        box.low[a] = (int32_t)lower[a];
        box.high[a] = box.low[a] + k;
    }
    walk_begin(&w, &box, ray, at);
    do {
        counters->fine_steps++;
        if (mask[(uint64_t)w.index / 64] >> (w.index & 63) & 1) {
            float voxel[3];
            walk_cell(&w, voxel);
            if (accept(state, ray, voxel, block, candidate, counters)) return true;
        }
    } while (walk_step(&w, ray, walk_axis(&w)));
    return false;
}

static bool trace_two_level(const dda_state *state, const walk_ray *ray, df_candidate *candidate, df_counters *counters) {
    const df_scene *scene = state->scene;
    const uint32_t *count = scene->coarse_count;
    walk_box box = {.size = (float)scene->k, .inverse_size = 1.0f / (float)scene->k,
                    .stride = {1, count[0], (int64_t)count[0] * count[1]}};
    uint32_t extent[3];
    event at;
    walk w;
    for (int a = 0; a < 3; a++) {
        box.high[a] = (int32_t)count[a];
        extent[a] = count[a] * scene->k;
    }
    if (!enter_box(ray, extent, &at)) return false;
    walk_begin(&w, &box, ray, at);
    do {
        counters->coarse_steps++;
        uint32_t block = scene->coarse[w.index];
        if (block < DF_CELL_INSIDE) {
            float lower[3];
            walk_cell(&w, lower);
            if (walk_block(state, ray, lower, block, at, candidate, counters)) return true;
        }
        at.axis = walk_axis(&w);
        at.t = w.leave[at.axis];
    } while (walk_step(&w, ray, at.axis));
    return false;
}

static bool trace_uniform(const dda_state *state, const walk_ray *ray, df_candidate *candidate, df_counters *counters) {
    const df_scene *scene = state->scene;
    const uint32_t *count = scene->voxel_count;
    const int64_t row = 64 * (int64_t)scene->row_words; /* bits */
    walk_box box = {.size = 1, .inverse_size = 1, .stride = {1, row, row * count[1]}};
    event at;
    walk w;
    for (int a = 0; a < 3; a++) box.high[a] = (int32_t)count[a];
    if (!enter_box(ray, count, &at)) return false;
    walk_begin(&w, &box, ray, at);
    do {
        counters->fine_steps++;
        if (scene->rows[(uint64_t)w.index / 64] >> (w.index & 63) & 1) {
            float voxel[3];
            walk_cell(&w, voxel);
            if (accept(state, ray, voxel, 0, candidate, counters)) return true;
        }
    } while (walk_step(&w, ray, walk_axis(&w)));
    return false;
}

static df_status dda_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters, df_error *err) {
    (void)err;
    const dda_state *state = opaque;
    const df_rays *rays = &tile->rays;
    df_candidate *candidates = state->candidates[thread];
    uint32_t count = 0;
    for (uint32_t i = 0; i < rays->count; i++) {
        walk_ray ray;
        for (int a = 0; a < 3; a++) {
            ray.origin[a] = rays->origin[a][rays->shared_origin ? 0 : i];
            ray.direction[a] = rays->direction[a][i];
            ray.inverse[a] = rays->inverse[a][i];
        }
        candidates[count].ray = i;
        bool hit = state->scene->levels == 1 ? trace_uniform(state, &ray, &candidates[count], counters)
                                             : trace_two_level(state, &ray, &candidates[count], counters);
        count += hit;
    }
    df_candidates_solve(state->scene, &state->options, rays, candidates, count, hits);
    return DF_OK;
}

static void dda_release(void *opaque) {
    dda_state *state = opaque;
    if (!state) return;
    if (state->candidates) {
        for (uint32_t i = 0; i < state->options.threads; i++) free(state->candidates[i]);
    }
    free(state->candidates);
    free(state);
}

static df_status dda_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    dda_state *state;
    *out = NULL;
    df_status status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status != DF_OK) return status;
    state->scene = scene;
    state->options = *options;
    status = df_alloc((void **)&state->candidates, options->threads, sizeof *state->candidates, "tracer", err);
    for (uint32_t i = 0; i < options->threads && status == DF_OK; i++) {
        /* one more than there are rays: the walk fills the next entry before it knows */
        status = df_alloc_raw((void **)&state->candidates[i], options->tile_rays + 1ull, sizeof **state->candidates, "candidates", err);
    }
    if (status != DF_OK) {
        dda_release(state);
        return status;
    }
    *out = state;
    return DF_OK;
}

const df_tracer df_tracer_dda = {
    .name = "dda",
    .summary = "scalar 3DDDA, one ray at a time: the reference",
    .prepare = dda_prepare,
    .release = dda_release,
    .trace = dda_trace,
};
