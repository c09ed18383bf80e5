/*
 * The 3DDDA over lanes: every lane walks its own ray by the rules of dda.h. Lanes walk coarse cells until each holds a
 * block or has left, then voxels until each has an accepted one or has left its block, and so on.
 */
#include "render/cpu/fetch.h"
#include "render/cpu/kernel.h"
#include "render/cpu/packet_rays.h"

#include <math.h>

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"

typedef struct packet {
    lf origin[3], direction[3], inverse[3];
    lf first, last; /* as in dda_ray */
    lm upward[3];
} packet;

/* The event by which each lane came into its cell: t and axis, 3 at the start of the ray. */
typedef struct events {
    lf t, axis;
} events;

/* A box of cells of `size` voxels: low <= cell < high, by lane. */
typedef struct boxes {
    lf low[3], high[3];
    li stride[3];
    lf size, inverse_size;
} boxes;

typedef struct walks {
    lf leave[3], plane[3], plane_step[3];
    lf last[3]; /* the plane by which a ray leaves the box */
    li index, stride[3];
} walks;

static lf plane_t(const packet *p, int axis, lf plane) { return (plane - p->origin[axis]) * p->inverse[axis]; }

static lm precedes(lf t, int axis, events at) {
    return lm_or(lf_lt(t, at.t), lm_and(lf_eq(t, at.t), lf_lt(lf_set((float)axis), at.axis)));
}

/* dda_cell_after: the cell along an axis that the events do not cross. */
static lf cell_after(const boxes *box, const packet *p, int axis, events at, lm active) {
    const lf one = lf_set(1), zero = lf_set(0), up = lf_select(p->upward[axis], one, zero), down = one - up;
    const lf step = up - down, end = box->high[axis] - one;
    const lf position = (p->origin[axis] + at.t * p->direction[axis]) * box->inverse_size;
    const lf first = lf_select(p->upward[axis], box->low[axis], end),
             last = lf_select(p->upward[axis], end, box->low[axis]);
    lf cell = lf_floor(lf_min(lf_max(position, box->low[axis]), end));
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

/* dda_begin for the active lanes; the others get walks that must not be stepped, with index 0. */
static void begin(walks *w, const boxes *box, const packet *p, events at, lm active) {
    const lf one = lf_set(1), zero = lf_set(0);
    li index = li_set(0);
    for (int a = 0; a < 3; a++) {
        const lf up = lf_select(p->upward[a], one, zero), end = box->high[a] - one;
        const lf first = lf_select(p->upward[a], box->low[a], end);
        const lf cell = lf_select(lf_eq(at.axis, lf_set((float)a)), first, cell_after(box, p, a, at, active));
        const lf from_low = cell - box->low[a];
        w->plane_step[a] = lf_select(p->upward[a], box->size, zero - box->size);
        w->stride[a] = li_select(p->upward[a], box->stride[a], li_mul(box->stride[a], li_set(-1)));
        w->last[a] = lf_select(p->upward[a], box->high[a], box->low[a]) * box->size;
        w->plane[a] = (cell + up) * box->size;
        w->leave[a] = plane_t(p, a, w->plane[a]);
        index = li_add(index, li_mul(li_from_lf(lf_select(active, from_low, zero)), box->stride[a]));
    }
    w->index = index;
}

/* Where the lanes leave their cells: t and the masks of the axes, of which every lane has one. */
typedef struct exits {
    lf t;
    lm across[3];
} exits;

static inline exits leave(const walks *w) {
    const lf t = lf_min(w->leave[1], w->leave[0]);
    const lm y = lf_lt(w->leave[1], w->leave[0]), z = lf_lt(w->leave[2], t);
    return (exits){lf_min(w->leave[2], t), {lm_not(lm_or(y, z)), lm_andnot(y, z), z}};
}

static inline events event_of(const exits *e) {
    return (events){e->t, lf_select(e->across[2], lf_set(2), lf_masked(e->across[1], lf_set(1)))};
}

/* Steps the active lanes out of their cells; returns those that are still in their box. The indices of the others are
 * not to be read. */
static inline lm step(walks *w, const packet *p, const exits *e, lm active) {
    lm ends = lm_first(0);
    for (int a = 0; a < 3; a++) {
        const lm across = lm_and(active, e->across[a]);
        ends = lm_or(ends, lm_and(across, lf_eq(w->plane[a], w->last[a])));
        w->index = li_add(w->index, li_masked(across, w->stride[a]));
        w->plane[a] = w->plane[a] + lf_masked(across, w->plane_step[a]);
        w->leave[a] = plane_t(p, a, w->plane[a]);
    }
    return lm_andnot(active, ends);
}

static void cell_of(const walks *w, lf lower[3]) {
    for (int a = 0; a < 3; a++) {
        const lm up = lf_lt(lf_set(0), w->plane_step[a]);
        lower[a] = lf_select(up, w->plane[a] - w->plane_step[a], w->plane[a]);
    }
}

/* dda_enter_box. */
static lm enter(const packet *p, const uint32_t box[3], events *at) {
    lf t_out = lf_set(INFINITY);
    events in = {lf_set(-INFINITY), lf_set(0)};
    for (int a = 0; a < 3; a++) {
        const lf low = plane_t(p, a, lf_set(0)), high = plane_t(p, a, lf_set((float)box[a]));
        const lf near = lf_min(low, high), far = lf_max(low, high);
        const lm later = lf_le(in.t, near);
        in.t = lf_select(later, near, in.t);
        in.axis = lf_select(later, lf_set((float)a), in.axis);
        t_out = lf_min(t_out, far);
    }
    const lm outside = lf_lt(lf_set(0), in.t);
    at->t = lf_select(outside, in.t, lf_set(0));
    at->axis = lf_select(outside, in.axis, lf_set(3));
    const lm later = lf_lt(at->t, p->first);
    at->t = lf_select(later, p->first, at->t);
    at->axis = lf_select(later, lf_set(3), at->axis);
    return lf_le(at->t, lf_min(t_out, p->last));
}

/* Lanes that walk on alone, and from which t: before every event that they have not passed. */
typedef struct left_over {
    uint32_t lanes;
    float first[DF_LANES];
} left_over;

/* Hands the lanes over where so few are left; returns whether it did. */
static bool split(const df_packet_job *job, lm active, events at, left_over *alone) {
    const uint32_t bits = lm_bits(active);
    if (!job->split || lm_count(bits) > job->split) return false;
    alone->lanes = bits;
    lf_store(alone->first, at.t);
    for (int i = 0; i < DF_LANES; i++) alone->first[i] = nextafterf(alone->first[i], -INFINITY);
    return true;
}

typedef struct found {
    float lower[3][DF_LANES];
    int32_t block[DF_LANES];
} found;

/* Which of the lanes' voxels are accepted; fills `out` for them. */
static lm accept(const df_packet_job *job, const packet *p, const lf lower[3], const int32_t *block, lm lanes,
                 found *out, uint32_t *inside_bits, df_counters *counters) {
    const df_scene *scene = job->scene;
    static const float none[8];
    float corners[DF_LANES][8], at[3][DF_LANES];
    const float *rows[DF_LANES];
    df_segment_f32 segment;
    lanes =
        lm_and(lanes, df_cell_segment_f32(p->origin, p->direction, p->inverse, lf_set(0), lower, lf_set(1), &segment));
    uint32_t bits = lm_bits(lanes);
    if (!bits) return lanes;
    counters->cells_tested += lm_count(bits);
    for (int a = 0; a < 3; a++) lf_store(at[a], lower[a]);
    for (int i = 0; i < DF_LANES; i++) rows[i] = none;
    for (uint32_t rest = bits; rest; rest &= rest - 1) {
        const int i = __builtin_ctz(rest);
        const uint32_t voxel[3] = {(uint32_t)at[0][i], (uint32_t)at[1][i], (uint32_t)at[2][i]};
        DF_FETCH_BY_TYPE(scene->field->sample_type, df_fetch_corners, scene, voxel, (uint32_t)block[i], corners[i]);
        rows[i] = corners[i];
    }
    lf corner[8];
    lm inside;
    lf_load_8(rows, corner);
    const lm hit = lm_and(lanes, df_accept_f32(corner, segment.a, segment.b, job->isolate, &inside));
    for (uint32_t rest = lm_bits(hit); rest; rest &= rest - 1) {
        const int i = __builtin_ctz(rest);
        for (int a = 0; a < 3; a++) out->lower[a][i] = at[a][i];
        out->block[i] = block[i];
        *inside_bits = (*inside_bits & ~(1u << i)) | ((lm_bits(inside) >> i & 1u) << i);
    }
    return hit;
}

static void count(df_counters *counters, uint64_t *steps, lm active) {
    const uint32_t lanes = lm_count(lm_bits(active));
    *steps += lanes;
    counters->lanes_active += lanes;
    counters->lanes_total += DF_LANES;
}

/* Walks the voxels of every active lane's block; returns the lanes that hit. */
static lm walk_blocks(const df_packet_job *job, const packet *p, const walks *coarse, const int32_t *block, events at,
                      lm active, found *out, uint32_t *inside_bits, df_counters *counters) {
    const df_scene *scene = job->scene;
    const int32_t k = (int32_t)scene->k, words = 2 * (int32_t)df_brick_mask_words(scene->k);
    boxes box = {.size = lf_set(1), .inverse_size = lf_set(1), .stride = {li_set(1), li_set(k), li_set(k * k)}};
    walks w;
    lm hits = lm_first(0);
    cell_of(coarse, box.low);
    for (int a = 0; a < 3; a++) box.high[a] = box.low[a] + lf_set((float)k);
    begin(&w, &box, p, at, active);
    const li first = li_mul(li_select(active, li_load(block), li_set(0)), li_set(words));
    while (lm_any(active)) {
        count(counters, &counters->fine_steps, active);
        const li index = li_masked(active, w.index);
        const li word = li_gather((const int32_t *)(const void *)scene->masks, li_add(first, li_shift_right(index, 5)));
        const lm surface = lm_and(active, li_bit(word, li_and(index, li_set(31))));
        if (lm_any(surface)) {
            lf lower[3];
            cell_of(&w, lower);
            const lm hit = accept(job, p, lower, block, surface, out, inside_bits, counters);
            hits = lm_or(hits, hit);
            active = lm_and(active, lm_not(hit));
        }
        const exits out_at = leave(&w);
        active = step(&w, p, &out_at, active);
    }
    return hits;
}

static lm trace_two_level(const df_packet_job *job, const packet *p, lm active, found *out, uint32_t *inside_bits,
                          left_over *alone, df_counters *counters) {
    const df_scene *scene = job->scene;
    const uint32_t *coarse_count = scene->coarse_count;
    const lf size = lf_set((float)scene->k);
    boxes box = {
        .size = size,
        .inverse_size = lf_set(1) / size,
        .stride = {li_set(1), li_set((int32_t)coarse_count[0]), li_set((int32_t)(coarse_count[0] * coarse_count[1]))}};
    uint32_t extent[3];
    events at;
    walks w;
    lm hits = lm_first(0);
    for (int a = 0; a < 3; a++) {
        box.low[a] = lf_set(0);
        box.high[a] = lf_set((float)coarse_count[a]);
        extent[a] = coarse_count[a] * scene->k;
    }
    active = lm_and(active, enter(p, extent, &at));
    if (!lm_any(active)) return hits;
    begin(&w, &box, p, at, active);
    while (lm_any(active)) {
        lm searching = active, holding = lm_first(0);
        int32_t block[DF_LANES];
        li blocks = li_set(0);
        while (lm_any(searching)) {
            if (split(job, lm_or(searching, holding), at, alone)) return hits;
            count(counters, &counters->coarse_steps, searching);
            const li token = li_gather((const int32_t *)(const void *)scene->coarse, li_masked(searching, w.index));
            /* blocks are below 2^31 here, so the two marks of empty cells are negative */
            const lm held = lm_and(searching, lm_not(li_lt(token, li_set(0))));
            blocks = li_select(held, token, blocks);
            holding = lm_or(holding, held);
            searching = lm_and(searching, lm_not(held));
            const exits out_at = leave(&w);
            const events left = event_of(&out_at);
            at.t = lf_select(searching, left.t, at.t);
            at.axis = lf_select(searching, left.axis, at.axis);
            searching = step(&w, p, &out_at, lm_and(searching, lf_le(out_at.t, p->last)));
        }
        if (!lm_any(holding)) break;
        li_store(block, blocks);
        const lm hit = walk_blocks(job, p, &w, block, at, holding, out, inside_bits, counters);
        hits = lm_or(hits, hit);
        active = lm_and(holding, lm_not(hit));
        const exits out_at = leave(&w);
        at = event_of(&out_at);
        active = step(&w, p, &out_at, lm_and(active, lf_le(out_at.t, p->last)));
    }
    return hits;
}

static lm trace_uniform(const df_packet_job *job, const packet *p, lm active, found *out, uint32_t *inside_bits,
                        left_over *alone, df_counters *counters) {
    const df_scene *scene = job->scene;
    const uint32_t *voxels = scene->voxel_count;
    const int32_t row = 64 * (int32_t)scene->row_words; /* bits */
    const int32_t none[DF_LANES] = {0};
    boxes box = {.size = lf_set(1),
                 .inverse_size = lf_set(1),
                 .stride = {li_set(1), li_set(row), li_set(row * (int32_t)voxels[1])}};
    events at;
    walks w;
    lm hits = lm_first(0);
    for (int a = 0; a < 3; a++) {
        box.low[a] = lf_set(0);
        box.high[a] = lf_set((float)voxels[a]);
    }
    active = lm_and(active, enter(p, voxels, &at));
    if (!lm_any(active)) return hits;
    begin(&w, &box, p, at, active);
    while (lm_any(active)) {
        if (split(job, active, at, alone)) break;
        count(counters, &counters->fine_steps, active);
        const li index = li_masked(active, w.index);
        const li word = li_gather((const int32_t *)(const void *)scene->rows, li_shift_right(index, 5));
        const lm surface = lm_and(active, li_bit(word, li_and(index, li_set(31))));
        if (lm_any(surface)) {
            lf lower[3];
            cell_of(&w, lower);
            const lm hit = accept(job, p, lower, none, surface, out, inside_bits, counters);
            hits = lm_or(hits, hit);
            active = lm_and(active, lm_not(hit));
        }
        const exits out_at = leave(&w);
        at.t = out_at.t;
        active = step(&w, p, &out_at, lm_and(active, lf_le(out_at.t, p->last)));
    }
    return hits;
}

/* The intervals of the rays of a packet; false where none of them can hit. */
static bool load_bounds(const df_packet_job *job, const int32_t ray[DF_LANES], packet *p) {
    float first[DF_LANES], last[DF_LANES];
    const df_tile *tile = job->tile;
    p->first = lf_set(0);
    p->last = lf_set(INFINITY);
    if (!job->bounds) return true;
    for (uint32_t i = 0; i < DF_LANES; i++) {
        const uint32_t r = (uint32_t)ray[i];
        df_bounds_ray(job->bounds, tile->x + r % tile->width, tile->y + r / tile->width,
                      tile->rays.t_base ? tile->rays.t_base[r] : 0, &first[i], &last[i]);
    }
    p->first = lf_load(first);
    p->last = lf_load(last);
    return lm_any(lf_le(p->first, p->last));
}

uint32_t DF_KERNEL(df_kernel_packet)(const df_packet_job *job, df_candidate *candidates, df_counters *counters) {
    const df_tile *tile = job->tile;
    const uint32_t width = df_packet_width(tile), height = DF_LANES / width;
    uint32_t hits = 0;
    for (uint32_t y = 0; y < tile->height; y += height) {
        for (uint32_t x = 0; x < tile->width; x += width) {
            int32_t ray[DF_LANES];
            packet p;
            found out;
            uint32_t inside_bits = 0;
            const uint32_t valid = df_packet_rays(tile, x, y, width, ray);
            if (!load_bounds(job, ray, &p)) continue;
            df_packet_load(&tile->rays, ray, p.origin, p.direction, p.inverse);
            for (int a = 0; a < 3; a++) p.upward[a] = lf_lt(lf_set(0), p.direction[a]);
            const lm all = lm_first(DF_LANES);
            left_over alone = {0};
            const lm hit = job->scene->levels == 1
                               ? trace_uniform(job, &p, all, &out, &inside_bits, &alone, counters)
                               : trace_two_level(job, &p, all, &out, &inside_bits, &alone, counters);
            for (uint32_t bits = alone.lanes & valid; bits; bits &= bits - 1) {
                const int i = __builtin_ctz(bits);
                candidates[hits].ray = (uint32_t)ray[i];
                hits += job->alone(job, (uint32_t)ray[i], alone.first[i], &candidates[hits], counters);
            }
            for (uint32_t bits = lm_bits(hit) & valid; bits; bits &= bits - 1) {
                const int i = __builtin_ctz(bits);
                candidates[hits++] = (df_candidate){
                    .ray = (uint32_t)ray[i],
                    .block = (uint32_t)out.block[i],
                    .cell = {(uint16_t)out.lower[0][i], (uint16_t)out.lower[1][i], (uint16_t)out.lower[2][i]},
                    .flags = inside_bits >> i & 1 ? DF_HIT_BACK : 0};
            }
        }
    }
    return hits;
}
