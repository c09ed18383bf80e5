/*
 * The 3DDDA over lanes: every lane walks its own ray by the rules of dda.h. Lanes walk coarse cells until each holds a
 * block or has left, then voxels until each has found one with surface or has left its block, and so on. The rays of a
 * picture go by squares of pixels: coarse cells that no ray of a square can find a block in, before the first and after
 * the last, are not walked at all.
 */
#include "render/cpu/fetch.h"
#include "render/cpu/frustum.h"
#include "render/cpu/kernel.h"
#include "render/cpu/packet_rays.h"

#include <math.h>

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"

#define SQUARE 8u /* pixels along the edge: whole packets of pictures of several rows */

/* Where rays of a picture begin and end: by coarse planes across an axis. axis 3: nothing is known. */
typedef struct ray_limits {
    int axis;
    int32_t slice; /* the coarse cell that they begin in */
    float from, to;
} ray_limits;

typedef struct packet {
    lf origin[3], direction[3], inverse[3];
    lf first, last;    /* as in dda_ray */
    lf up[3], sign[3]; /* 1 or 0, and 1 or -1 */
    lf entered[3];     /* the coarse cell behind an entry across an axis */
    lm upward[3];
    li fine_step[3]; /* fine_walk */
} packet;

/* The event by which each lane came into its cell: t and axis, 3 at the start of the ray. */
typedef struct events {
    lf t, axis;
} events;

/* A box of cells of `size` voxels: low <= cell <= end, by lane. */
typedef struct boxes {
    lf low[3], end[3], size, inverse_size;
} boxes;

typedef struct found_cells {
    lf lower[3];
    li block;
    lm inside;
} found_cells;

/* Lanes that walk on alone, and from which t: before every event that they have not passed. */
typedef struct left_over {
    uint32_t lanes;
    float first[DF_LANES];
} left_over;

/* What the packets of a tile share. */
typedef struct tile_walk {
    const df_packet_job *job;
    const df_scene *scene;
    boxes box; /* of the outer walk */
    li stride[3];
    uint32_t extent[3];
    li coarse, fine; /* cells visited, by lane */
    uint64_t steps;
    df_counters *counters;
} tile_walk;

static lf plane_t(const packet *p, int axis, lf plane) { return (plane - p->origin[axis]) * p->inverse[axis]; }

static lm precedes(lf t, int axis, events at) {
    return lm_or(lf_lt(t, at.t), lm_and(lf_eq(t, at.t), lf_lt(lf_set((float)axis), at.axis)));
}

/* dda_cell_after: the cell along an axis that the events do not cross. */
static lf cell_after(const boxes *box, const packet *p, int axis, events at, lf cell, lm active) {
    const lf up = p->up[axis], down = lf_set(1) - up, step = p->sign[axis];
    const lf first = lf_select(p->upward[axis], box->low[axis], box->end[axis]),
             last = lf_select(p->upward[axis], box->end[axis], box->low[axis]);
    for (lm go = active; lm_any(go);) {
        go = lm_and(go,
                    lm_and(lm_not(lf_eq(cell, last)), precedes(plane_t(p, axis, (cell + up) * box->size), axis, at)));
        cell = lf_select(go, cell + step, cell);
    }
    for (lm go = active; lm_any(go);) {
        go = lm_and(go, lm_and(lm_not(lf_eq(cell, first)),
                               lm_not(precedes(plane_t(p, axis, (cell + down) * box->size), axis, at))));
        cell = lf_select(go, cell - step, cell);
    }
    return cell;
}

/* The cells of the active lanes after events, by axis, as dda_begin finds them: `entered` where the event crosses the
 * axis. The plane by which each leaves its cell and the t at which it does. */
static inline void locate(const packet *p, const boxes *box, const lf entered[3], events at, lm active, lf cell[3],
                          lf plane[3], lf leave[3]) {
    lm unsure = lm_first(0);
    for (int a = 0; a < 3; a++) {
        const lm crossed = lf_eq(at.axis, lf_set((float)a));
        const lf position = (p->origin[a] + at.t * p->direction[a]) * box->inverse_size;
        cell[a] = lf_floor(lf_min(lf_max(position, box->low[a]), box->end[a]));
        cell[a] = lf_select(crossed, entered[a], cell[a]);
        plane[a] = (cell[a] + p->up[a]) * box->size;
        leave[a] = plane_t(p, a, plane[a]);
        const lf enter = plane_t(p, a, plane[a] - p->sign[a] * box->size);
        unsure = lm_or(unsure, lm_andnot(lm_or(lf_le(leave[a], at.t), lf_le(at.t, enter)), crossed));
    }
    if (!lm_any(lm_and(unsure, active))) return;
    for (int a = 0; a < 3; a++) {
        const lm crossed = lf_eq(at.axis, lf_set((float)a));
        cell[a] = lf_select(crossed, cell[a], cell_after(box, p, a, at, cell[a], lm_andnot(active, crossed)));
        plane[a] = (cell[a] + p->up[a]) * box->size;
        leave[a] = plane_t(p, a, plane[a]);
    }
}

/* Where lanes leave their cells: t and the masks of the axes, of which every active lane has one. */
typedef struct exits {
    lf t;
    lm y, z;
} exits;

static inline exits leave(const lf t[3]) {
    const lf xy = lf_min(t[1], t[0]);
    return (exits){lf_min(t[2], xy), lf_lt(t[1], t[0]), lf_lt(t[2], xy)};
}

static inline void across(const exits *e, lm active, lm out[3]) {
    out[0] = lm_andnot(active, lm_or(e->y, e->z));
    out[1] = lm_andnot(lm_and(active, e->y), e->z);
    out[2] = lm_and(active, e->z);
}

/* ---- voxels of one block a lane ---- */

/* `place` holds in one number the voxel's bit in its block's mask and for each axis how many voxels follow it before
 * the end of the block. Those wrap around below 0, into a bit of their own, where a lane leaves its block. */
#define PLACE_LEFT(axis) (10 + 4 * (axis)) /* above the 9 bits of a place, and one for their overflow */
#define PLACE_ENDED (8 << PLACE_LEFT(0) | 8 << PLACE_LEFT(1) | 8 << PLACE_LEFT(2))

typedef struct fine_walk {
    lf leave[3], plane[3];
    li place;
} fine_walk;

/* What a step along each axis adds to the place. */
static void set_fine_steps(const df_scene *scene, packet *p) {
    for (int a = 0; a < 3; a++) {
        const lf stride = lf_set((float)(1u << (unsigned)a * scene->k_shift));
        p->fine_step[a] = li_from_lf(p->sign[a] * stride - lf_set((float)(1 << PLACE_LEFT(a))));
    }
}

static inline void begin_block(fine_walk *w, const df_scene *scene, const packet *p, const boxes *box, events at,
                               lm active) {
    const float last = (float)(scene->k - 1);
    lf entered[3], cell[3], place = lf_set(0);
    for (int a = 0; a < 3; a++) entered[a] = lf_select(p->upward[a], box->low[a], box->end[a]);
    locate(p, box, entered, at, active, cell, w->plane, w->leave);
    for (int a = 0; a < 3; a++) {
        const float stride = (float)(1u << (unsigned)a * scene->k_shift), unit = (float)(1 << PLACE_LEFT(a));
        const lf from_low = cell[a] - box->low[a], left = p->up[a] * lf_set(last) - p->sign[a] * from_low;
        place = place + (from_low * lf_set(stride) + left * lf_set(unit)); /* whole numbers below 2^24: exact */
    }
    w->place = li_from_lf(lf_masked(active, place));
}

/* Steps the active lanes; returns those that are still in their block. */
static inline lm step_fine(fine_walk *w, const packet *p, lm active) {
    const exits e = leave(w->leave);
    lm cross[3];
    across(&e, active, cross);
    for (int a = 0; a < 3; a++) {
        w->plane[a] = w->plane[a] + lf_masked(cross[a], p->sign[a]);
        w->leave[a] = plane_t(p, a, w->plane[a]);
        w->place = li_add(w->place, li_masked(cross[a], p->fine_step[a]));
    }
    return lm_andnot(active, li_lt(li_set(0), li_and(w->place, li_set(PLACE_ENDED))));
}

/* Which of the lanes' voxels are accepted; fills `out` for them. */
static lm accept(tile_walk *walk, const packet *p, const lf lower[3], li block, lm lanes, found_cells *out) {
    const df_scene *scene = walk->scene;
    int32_t voxel[3][DF_LANES], blocks[DF_LANES];
    df_segment_f32 segment;
    lf corner[8];
    lm inside;
    lanes =
        lm_and(lanes, df_cell_segment_f32(p->origin, p->direction, p->inverse, lf_set(0), lower, lf_set(1), &segment));
    const uint32_t bits = lm_bits(lanes);
    if (!bits) return lanes;
    walk->counters->cells_tested += lm_count(bits);
    for (int a = 0; a < 3; a++) li_store(voxel[a], li_from_lf(lower[a]));
    li_store(blocks, block);
    DF_FETCH_BY_TYPE(scene->field->sample_type, df_fetch_cells, scene, voxel, blocks, bits, corner);
    const lm hit = lm_and(lanes, df_accept_f32(corner, segment.a, segment.b, walk->job->isolate, &inside));
    for (int a = 0; a < 3; a++) out->lower[a] = lf_select(hit, lower[a], out->lower[a]);
    out->block = li_select(hit, block, out->block);
    out->inside = lm_or(lm_andnot(out->inside, hit), lm_and(hit, inside));
    return hit;
}

/* The mask of the block that all active lanes are in, if it is one; NULL where it has not 16 words, or 4 lanes would
 * not read it faster so. */
static const int32_t *shared_mask(const df_scene *scene, li block, lm active) {
    int32_t blocks[DF_LANES];
    li_store(blocks, block);
    const int32_t any = blocks[__builtin_ctz(lm_bits(active))];
    const lm others = lm_or(li_lt(block, li_set(any)), li_lt(li_set(any), block));
    if (DF_LANES <= 4 || scene->k != 8 || lm_any(lm_and(active, others))) return NULL;
    return (const int32_t *)(const void *)(scene->masks + (size_t)any * df_brick_mask_words(8));
}

/* Walks the voxels of every active lane's block, whose lower corner and number are given; returns the lanes that hit.
 * Lanes that have come to a voxel with surface wait for the others. */
static lm walk_blocks(tile_walk *walk, const packet *p, const lf corner[3], li block, events at, lm active,
                      found_cells *out) {
    const df_scene *scene = walk->scene;
    const int32_t *masks = (const int32_t *)(const void *)scene->masks, *shared = shared_mask(scene, block, active);
    const int32_t words = 2 * (int32_t)df_brick_mask_words(scene->k);
    const li first = li_mul(li_masked(active, block), li_set(words));
    boxes box;
    fine_walk w;
    lm hits = lm_first(0);
    box.size = box.inverse_size = lf_set(1);
    for (int a = 0; a < 3; a++) {
        box.low[a] = corner[a];
        box.end[a] = corner[a] + lf_set((float)(scene->k - 1));
    }
    begin_block(&w, scene, p, &box, at, active);
    while (lm_any(active)) {
        lm waiting = lm_first(0);
        do {
            walk->fine = li_tally(walk->fine, active);
            walk->steps++;
            const li at_word = li_and(li_shift_right(w.place, 5), li_set(words - 1));
            const li word = shared ? li_lookup(shared, at_word) : li_gather(masks, li_add(first, at_word));
            const lm surface = lm_and(active, li_bit(word, li_and(w.place, li_set(31))));
            waiting = lm_or(waiting, surface);
            active = step_fine(&w, p, lm_andnot(active, surface));
        } while (lm_any(active));
        if (!lm_any(waiting)) break;
        lf lower[3];
        for (int a = 0; a < 3; a++) lower[a] = w.plane[a] - p->up[a];
        const lm hit = accept(walk, p, lower, block, waiting, out);
        hits = lm_or(hits, hit);
        active = step_fine(&w, p, lm_andnot(waiting, hit));
    }
    return hits;
}

/* ---- coarse cells, and the voxels of a uniform grid ---- */

typedef struct walks {
    lf leave[3], plane[3], plane_step[3];
    lf last[3]; /* the plane by which a ray leaves the grid */
    li index, stride[3];
    lf start; /* t where the walk began in mid-cell, else -INFINITY */
} walks;

/* dda_enter_box. */
static lm enter(const tile_walk *walk, packet *p, const ray_limits *limits, events *at) {
    lf t_out = lf_set(INFINITY);
    events in = {lf_set(-INFINITY), lf_set(0)};
    for (int a = 0; a < 3; a++) {
        const lf low = plane_t(p, a, lf_set(0)), high = plane_t(p, a, lf_set((float)walk->extent[a]));
        const lf near = lf_min(low, high), far = lf_max(low, high);
        const lm later = lf_le(in.t, near);
        in.t = lf_select(later, near, in.t);
        in.axis = lf_select(later, lf_set((float)a), in.axis);
        t_out = lf_min(t_out, far);
        p->entered[a] = lf_select(p->upward[a], walk->box.low[a], walk->box.end[a]);
    }
    const lm outside = lf_lt(lf_set(0), in.t);
    at->t = lf_select(outside, in.t, lf_set(0));
    at->axis = lf_select(outside, in.axis, lf_set(3));
    const lm later = lf_lt(at->t, p->first);
    at->t = lf_select(later, p->first, at->t);
    at->axis = lf_select(later, lf_set((float)limits->axis), at->axis);
    if (limits->axis < 3) {
        lf *entered = &p->entered[limits->axis];
        *entered = lf_select(later, lf_set((float)limits->slice), *entered);
    }
    return lf_le(at->t, lf_min(t_out, p->last));
}

/* dda_begin for the active lanes; the others get walks that must not be stepped, with index 0. */
static void begin(walks *w, const tile_walk *walk, const packet *p, events at, lm active) {
    const boxes *box = &walk->box;
    lf cell[3];
    locate(p, box, p->entered, at, active, cell, w->plane, w->leave);
    w->index = li_set(0);
    w->start = lf_select(lf_eq(at.axis, lf_set(3)), at.t, lf_set(-INFINITY));
    for (int a = 0; a < 3; a++) {
        w->plane_step[a] = p->sign[a] * box->size;
        w->stride[a] = li_mul(walk->stride[a], li_from_lf(p->sign[a]));
        w->last[a] = lf_select(p->upward[a], box->end[a] + lf_set(1), box->low[a]) * box->size;
        w->index = li_add(w->index, li_mul(li_from_lf(lf_masked(active, cell[a])), walk->stride[a]));
    }
}

/* The events by which the lanes came into their cells. */
static events entry(const walks *w, const packet *p) {
    events at = {lf_set(-INFINITY), lf_set(0)};
    for (int a = 0; a < 3; a++) {
        const lf t = plane_t(p, a, w->plane[a] - w->plane_step[a]);
        const lm later = lf_le(at.t, t);
        at.t = lf_select(later, t, at.t);
        at.axis = lf_select(later, lf_set((float)a), at.axis);
    }
    const lm here = lf_le(at.t, w->start);
    return (events){lf_select(here, w->start, at.t), lf_select(here, lf_set(3), at.axis)};
}

/* Steps the active lanes out of their cells; returns those that are still in the grid and before their last t. The
 * indices of the others are not to be read. */
static inline lm step(walks *w, const packet *p, lm active) {
    const exits e = leave(w->leave);
    lm cross[3], ends = lm_first(0);
    active = lm_and(active, lf_le(e.t, p->last));
    across(&e, active, cross);
    for (int a = 0; a < 3; a++) {
        ends = lm_or(ends, lm_and(cross[a], lf_eq(w->plane[a], w->last[a])));
        w->index = li_add(w->index, li_masked(cross[a], w->stride[a]));
        w->plane[a] = w->plane[a] + lf_masked(cross[a], w->plane_step[a]);
        w->leave[a] = plane_t(p, a, w->plane[a]);
    }
    return lm_andnot(active, ends);
}

static inline void lower_of(const walks *w, const packet *p, lf lower[3]) {
    for (int a = 0; a < 3; a++) lower[a] = lf_select(p->upward[a], w->plane[a] - w->plane_step[a], w->plane[a]);
}

/* Hands the lanes over where so few are left; returns whether it did. */
static inline bool split(const df_packet_job *job, const walks *w, const packet *p, lm active, left_over *alone) {
    if (!job->split) return false;
    const uint32_t bits = lm_bits(active);
    if (lm_count(bits) > job->split) return false;
    alone->lanes = bits;
    lf_store(alone->first, entry(w, p).t);
    for (int i = 0; i < DF_LANES; i++) alone->first[i] = nextafterf(alone->first[i], -INFINITY);
    return true;
}

static lm trace_two_level(tile_walk *walk, packet *p, const ray_limits *limits, found_cells *out, left_over *alone) {
    const int32_t *coarse = (const int32_t *)(const void *)walk->scene->coarse;
    events at;
    walks w;
    lm hits = lm_first(0), active = enter(walk, p, limits, &at);
    if (!lm_any(active)) return hits;
    begin(&w, walk, p, at, active);
    set_fine_steps(walk->scene, p);
    while (lm_any(active)) {
        lm searching = active, holding = lm_first(0);
        li block = li_set(0);
        do {
            if (split(walk->job, &w, p, lm_or(searching, holding), alone)) return hits;
            walk->coarse = li_tally(walk->coarse, searching);
            walk->steps++;
            const li token = li_gather(coarse, li_masked(searching, w.index));
            /* blocks are below 2^31 here, so the two marks of empty cells are negative */
            const lm held = lm_andnot(searching, li_lt(token, li_set(0)));
            block = li_select(held, token, block);
            holding = lm_or(holding, held);
            searching = step(&w, p, lm_andnot(searching, held));
        } while (lm_any(searching));
        if (!lm_any(holding)) break;
        lf corner[3];
        lower_of(&w, p, corner);
        const lm hit = walk_blocks(walk, p, corner, block, entry(&w, p), holding, out);
        hits = lm_or(hits, hit);
        active = step(&w, p, lm_andnot(holding, hit));
    }
    return hits;
}

static lm trace_uniform(tile_walk *walk, packet *p, const ray_limits *limits, found_cells *out, left_over *alone) {
    const int32_t *rows = (const int32_t *)(const void *)walk->scene->rows;
    events at;
    walks w;
    lm hits = lm_first(0), active = enter(walk, p, limits, &at);
    if (!lm_any(active)) return hits;
    begin(&w, walk, p, at, active);
    while (lm_any(active)) {
        if (split(walk->job, &w, p, active, alone)) break;
        walk->fine = li_tally(walk->fine, active);
        walk->steps++;
        const li index = li_masked(active, w.index);
        const li word = li_gather(rows, li_shift_right(index, 5));
        const lm surface = lm_and(active, li_bit(word, li_and(index, li_set(31))));
        if (lm_any(surface)) {
            lf lower[3];
            lower_of(&w, p, lower);
            const lm hit = accept(walk, p, lower, li_set(0), surface, out);
            hits = lm_or(hits, hit);
            active = lm_andnot(active, hit);
        }
        active = step(&w, p, active);
    }
    return hits;
}

/* ---- packets and squares of rays ---- */

static void begin_tile(tile_walk *walk, const df_packet_job *job, df_counters *counters) {
    const df_scene *scene = job->scene;
    const bool uniform = scene->levels == 1;
    const uint32_t *count = uniform ? scene->voxel_count : scene->coarse_count, size = uniform ? 1 : scene->k;
    const int32_t row = uniform ? 64 * (int32_t)scene->row_words : (int32_t)count[0]; /* uniform: bits */
    walk->job = job;
    walk->scene = scene;
    walk->box.size = lf_set((float)size);
    walk->box.inverse_size = lf_set(1) / walk->box.size;
    walk->stride[0] = li_set(1);
    walk->stride[1] = li_set(row);
    walk->stride[2] = li_set(row * (int32_t)count[1]);
    for (int a = 0; a < 3; a++) {
        walk->box.low[a] = lf_set(0);
        walk->box.end[a] = lf_set((float)(count[a] - 1));
        walk->extent[a] = count[a] * size;
    }
    walk->coarse = walk->fine = li_set(0);
    walk->steps = 0;
    walk->counters = counters;
}

static void end_tile(const tile_walk *walk) {
    int32_t coarse[DF_LANES], fine[DF_LANES];
    df_counters *counters = walk->counters;
    li_store(coarse, walk->coarse);
    li_store(fine, walk->fine);
    for (int i = 0; i < DF_LANES; i++) {
        counters->coarse_steps += (uint32_t)coarse[i];
        counters->fine_steps += (uint32_t)fine[i];
        counters->lanes_active += (uint32_t)coarse[i] + (uint32_t)fine[i];
    }
    counters->lanes_total += walk->steps * DF_LANES;
}

/* The intervals of the rays of a packet; false where none of them can hit. */
static bool load_bounds(const df_packet_job *job, uint32_t x, uint32_t y, uint32_t width, packet *p) {
    float first[DF_LANES], last[DF_LANES];
    const df_tile *tile = job->tile;
    for (uint32_t i = 0; i < DF_LANES; i++) {
        const uint32_t r = df_packet_ray(tile, x, y, width, i);
        df_bounds_ray(job->bounds, tile->x + r % tile->width, tile->y + r / tile->width,
                      tile->rays.t_base ? tile->rays.t_base[r] : 0, &first[i], &last[i]);
    }
    p->first = lf_load(first);
    p->last = lf_load(last);
    return lm_any(lf_le(p->first, p->last));
}

static uint32_t put_candidates(const df_tile *tile, uint32_t x, uint32_t y, uint32_t width, uint32_t lanes,
                               const found_cells *found, df_candidate *candidates) {
    int32_t cell[3][DF_LANES], block[DF_LANES];
    const uint32_t inside = lm_bits(found->inside);
    uint32_t count = 0;
    for (int a = 0; a < 3; a++) li_store(cell[a], li_from_lf(found->lower[a]));
    li_store(block, found->block);
    for (; lanes; lanes &= lanes - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(lanes);
        candidates[count++] = (df_candidate){.ray = df_packet_ray(tile, x, y, width, i),
                                             .block = (uint32_t)block[i],
                                             .cell = {(uint16_t)cell[0][i], (uint16_t)cell[1][i], (uint16_t)cell[2][i]},
                                             .flags = inside >> i & 1 ? DF_HIT_BACK : 0};
    }
    return count;
}

/* Traces the packet at pixel (x,y) of the tile; returns the number of candidates. */
static uint32_t trace_packet(tile_walk *walk, uint32_t x, uint32_t y, uint32_t width, const ray_limits *limits,
                             df_candidate *candidates) {
    const df_packet_job *job = walk->job;
    packet p;
    found_cells out;
    left_over alone;
    uint32_t count = 0;
    if (job->bounds && !load_bounds(job, x, y, width, &p)) return 0;
    const uint32_t valid = df_packet_load(job->tile, x, y, width, p.origin, p.direction, p.inverse);
    for (int a = 0; a < 3; a++) {
        p.upward[a] = lf_lt(lf_set(0), p.direction[a]);
        p.up[a] = lf_masked(p.upward[a], lf_set(1));
        p.sign[a] = p.up[a] + p.up[a] - lf_set(1);
        out.lower[a] = lf_set(0);
    }
    out.block = li_set(0);
    out.inside = lm_first(0);
    alone.lanes = 0;
    if (!job->bounds) {
        const bool known = limits->axis < 3;
        p.first = known ? plane_t(&p, limits->axis, lf_set(limits->from)) : lf_set(0);
        p.last = known ? plane_t(&p, limits->axis, lf_set(limits->to)) : lf_set(INFINITY);
    }
    const lm hit = walk->scene->levels == 1 ? trace_uniform(walk, &p, limits, &out, &alone)
                                            : trace_two_level(walk, &p, limits, &out, &alone);
    for (uint32_t bits = alone.lanes & valid; bits; bits &= bits - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(bits), ray = df_packet_ray(job->tile, x, y, width, i);
        candidates[count].ray = ray;
        count += job->alone(job, ray, alone.first[i], &candidates[count], walk->counters);
    }
    const uint32_t lanes = lm_bits(hit) & valid;
    return lanes ? count + put_candidates(job->tile, x, y, width, lanes, &out, candidates + count) : count;
}

/* The frustum of a rectangle of pixels, inclusive, whose directions are linear in x and y: that of its corners. False
 * where its rays do not go together. */
static bool rectangle(const df_tile *tile, uint32_t x0, uint32_t y0, uint32_t x1, uint32_t y1, df_frustum *frustum) {
    const df_rays *rays = &tile->rays;
    const float origin[3] = {rays->origin[0][0], rays->origin[1][0], rays->origin[2][0]};
    for (int i = 0; i < 4; i++) {
        const uint32_t ray = (i & 2 ? y1 : y0) * tile->width + (i & 1 ? x1 : x0);
        const float direction[3] = {rays->direction[0][ray], rays->direction[1][ray], rays->direction[2][ray]};
        if (i == 0) df_frustum_begin(frustum, origin, direction);
        if (!df_frustum_add(frustum, direction)) return false;
    }
    return true;
}

/* Slices of coarse cells from the first to the last, counted along the rays, in which a frustum may meet a block. */
typedef struct slices {
    int32_t first, last;
} slices;

/* Returns whether any is left. */
static bool narrow(const df_scene *scene, const df_frustum *frustum, slices *s) {
    while (s->first <= s->last && !df_frustum_holds(frustum, scene, s->first)) s->first++;
    while (s->first < s->last && !df_frustum_holds(frustum, scene, s->last)) s->last--;
    return s->first <= s->last;
}

static ray_limits make_limits(const df_scene *scene, const df_frustum *frustum, const slices *s) {
    const int32_t count = (int32_t)scene->coarse_count[frustum->main];
    const float k = (float)scene->k;
    if (frustum->sign > 0) return (ray_limits){frustum->main, s->first, (float)s->first * k, (float)(s->last + 1) * k};
    return (ray_limits){frustum->main, count - 1 - s->first, (float)(count - s->first) * k,
                        (float)(count - 1 - s->last) * k};
}

static slices all_slices(const df_scene *scene, int axis) {
    return (slices){0, (int32_t)scene->coarse_count[axis] - 1};
}

uint32_t DF_KERNEL(df_kernel_packet)(const df_packet_job *job, df_candidate *candidates, df_counters *counters) {
    const df_tile *tile = job->tile;
    const df_scene *scene = job->scene;
    const uint32_t width = df_packet_width(tile), height = DF_LANES / width;
    const bool picture = tile->view && tile->rays.shared_origin && !job->bounds && scene->levels == 2;
    const uint32_t edge_x = !picture         ? tile->width
                            : width > SQUARE ? width
                                             : SQUARE,
                   edge_y = picture ? SQUARE : tile->height;
    df_frustum whole, part;
    slices of_whole = {0, 0};
    uint32_t hits = 0;
    tile_walk walk;
    const bool together = picture && rectangle(tile, 0, 0, tile->width - 1, tile->height - 1, &whole);
    if (together) {
        of_whole = all_slices(scene, whole.main);
        if (!narrow(scene, &whole, &of_whole)) return 0;
    }
    begin_tile(&walk, job, counters);
    for (uint32_t top = 0; top < tile->height; top += edge_y) {
        for (uint32_t left = 0; left < tile->width; left += edge_x) {
            const uint32_t right = left + edge_x < tile->width ? left + edge_x : tile->width,
                           bottom = top + edge_y < tile->height ? top + edge_y : tile->height;
            ray_limits limits = {.axis = 3};
            if (picture && rectangle(tile, left, top, right - 1, bottom - 1, &part)) {
                const bool within = together && part.main == whole.main && part.sign == whole.sign;
                slices s = within ? of_whole : all_slices(scene, part.main);
                if (!narrow(scene, &part, &s)) continue;
                limits = make_limits(scene, &part, &s);
            }
            for (uint32_t y = top; y < bottom; y += height) {
                for (uint32_t x = left; x < right; x += width)
                    hits += trace_packet(&walk, x, y, width, &limits, candidates + hits);
            }
        }
    }
    end_tile(&walk);
    return hits;
}
