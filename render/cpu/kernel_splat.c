/*
 * Object order: surface voxels are projected, DF_LANES at a time, and every pixel whose centre may see one makes a pair
 * (voxel, ray). Pairs are queued and tested at full width by the same text as every other tracer. The nearest accepted
 * voxel of each ray stays.
 */
#include "render/cpu/kernel.h"

#include <math.h>

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"

/* Pixels by which projected bounds are widened: far more than the rounding of the projection. */
#define MARGIN 0.02f

/* Voxels nearer to the eye's plane than this, in grid units of depth, count as covering the whole tile. */
#define NEAR_DEPTH 0.01f

enum { QUEUE_FLUSH = 4 * DF_LANES, QUEUE_ROOM = QUEUE_FLUSH + 2 * DF_LANES };

typedef struct queue {
    uint32_t count;
    uint32_t block;
    int32_t ray[QUEUE_ROOM], record[QUEUE_ROOM];
    float cell[3][QUEUE_ROOM];
} queue;

/* Of two voxels that a ray enters at the same t the one entered across the lower axis comes first (cell.h). */
static int entry_axis(const df_rays *rays, uint32_t ray, const float cell[3], float t_in) {
    int axis = 3;
    for (int a = 0; a < 3; a++) {
        const float origin = rays->origin[a][0], inverse = rays->inverse[a][ray];
        const float low = (cell[a] - origin) * inverse, high = ((cell[a] + 1.0f) - origin) * inverse;
        if ((low < high ? low : high) == t_in) axis = a;
    }
    return axis;
}

static void voxel_of(const df_scene *scene, uint32_t block, uint32_t bit, float cell[3]) {
    const uint32_t at = scene->block_cells[block], k = scene->k;
    cell[0] = (float)(at % scene->coarse_count[0] * k + (bit & (k - 1)));
    cell[1] = (float)(at / scene->coarse_count[0] % scene->coarse_count[1] * k + (bit >> scene->k_shift & (k - 1)));
    cell[2] = (float)(at / scene->coarse_count[0] / scene->coarse_count[1] * k + (bit >> 2 * scene->k_shift));
}

/* Keeps an accepted voxel where it is the nearest so far. */
static void keep(const df_splat_job *job, uint32_t ray, float t_in, uint32_t record, uint32_t block, int inside) {
    if (t_in > job->depth[ray]) return;
    if (t_in == job->depth[ray]) {
        float now[3], before[3];
        voxel_of(job->scene, block, job->surface->bits[record], now);
        voxel_of(job->scene, job->block[ray], job->surface->bits[job->record[ray]], before);
        if (entry_axis(&job->tile->rays, ray, now, t_in) >= entry_axis(&job->tile->rays, ray, before, t_in)) return;
    }
    job->depth[ray] = t_in;
    job->record[ray] = record;
    job->block[ray] = block;
    job->flags[ray] = inside ? DF_HIT_BACK : 0;
}

/* Tests DF_LANES pairs from entry `first` of the queue; only the first `count` are real. */
static void test_pairs(const df_splat_job *job, const queue *q, uint32_t first, uint32_t count) {
    const df_rays *rays = &job->tile->rays;
    const li ray = li_load(q->ray + first);
    lf origin[3], direction[3], inverse[3], cell[3], corner[8];
    for (int a = 0; a < 3; a++) {
        origin[a] = lf_set(rays->origin[a][0]);
        direction[a] = lf_gather(rays->direction[a], ray);
        inverse[a] = lf_set(1) / direction[a]; /* the bits of rays->inverse */
        cell[a] = lf_load(q->cell[a] + first);
    }
    df_segment_f32 segment;
    lm visited = df_cell_segment_f32(origin, direction, inverse, lf_set(0), cell, lf_set(1), &segment);
    visited = lm_and(visited, lf_le(segment.t_in, lf_gather(job->depth, ray)));
    if (!lm_any(visited)) return;
    const float *rows[DF_LANES];
    for (uint32_t i = 0; i < DF_LANES; i++) rows[i] = job->surface->corners + 8 * (ptrdiff_t)q->record[first + i];
    lf_load_8(rows, corner);
    lm inside;
    lm hit = lm_and(visited, df_accept_f32(corner, segment.a, segment.b, job->isolate, &inside));
    uint32_t bits = lm_bits(hit) & (uint32_t)((1ull << count) - 1);
    if (!bits) return;
    const uint32_t inside_bits = lm_bits(inside);
    float t_in[DF_LANES];
    lf_store(t_in, segment.t_in);
    for (; bits; bits &= bits - 1) {
        const int lane = __builtin_ctz(bits);
        keep(job, (uint32_t)q->ray[first + (uint32_t)lane], t_in[lane], (uint32_t)q->record[first + (uint32_t)lane],
             q->block, inside_bits >> lane & 1);
    }
}

/* Tests what is queued: whole vectors, or all of it. The rest moves to the front. */
static void flush(const df_splat_job *job, queue *q, int all, df_counters *counters) {
    uint32_t done = 0;
    for (; done + DF_LANES <= q->count; done += DF_LANES) test_pairs(job, q, done, DF_LANES);
    counters->cells_tested += done;
    counters->lanes_active += done;
    counters->lanes_total += done;
    uint32_t rest = q->count - done;
    if (rest && all) {
        for (uint32_t i = q->count; i < done + DF_LANES; i++) { /* pad with the last pair */
            q->ray[i] = q->ray[q->count - 1];
            q->record[i] = q->record[q->count - 1];
            for (int a = 0; a < 3; a++) q->cell[a][i] = q->cell[a][q->count - 1];
        }
        test_pairs(job, q, done, rest);
        counters->cells_tested += rest;
        counters->lanes_active += rest;
        counters->lanes_total += DF_LANES;
        rest = 0;
    }
    for (uint32_t i = 0; i < rest; i++) {
        q->ray[i] = q->ray[done + i];
        q->record[i] = q->record[done + i];
        for (int a = 0; a < 3; a++) q->cell[a][i] = q->cell[a][done + i];
    }
    q->count = rest;
}

/* Projected bounds of DF_LANES voxels in pixels of the tile, clamped to it; empty where high < low. */
typedef struct bounds {
    lf x0, x1, y0, y1, t_near;
} bounds;

static bounds project(const df_splat_job *job, const lf cell[3]) {
    const df_projection *p = job->projection;
    const df_tile *tile = job->tile;
    const lf half = lf_set(0.5f), zero = lf_set(0), margin = lf_set(MARGIN);
    const lf last_x = lf_set((float)(tile->width - 1)), last_y = lf_set((float)(tile->height - 1));
    lf from_eye[3], w, u, v;
    for (int a = 0; a < 3; a++) from_eye[a] = cell[a] + lf_set(0.5f - p->eye[a]);
    w = lf_set(p->rows[0][0]) * from_eye[0] + lf_set(p->rows[0][1]) * from_eye[1] + lf_set(p->rows[0][2]) * from_eye[2];
    u = lf_set(p->rows[1][0]) * from_eye[0] + lf_set(p->rows[1][1]) * from_eye[1] + lf_set(p->rows[1][2]) * from_eye[2];
    v = lf_set(p->rows[2][0]) * from_eye[0] + lf_set(p->rows[2][1]) * from_eye[1] + lf_set(p->rows[2][2]) * from_eye[2];
    const lf reach_w = lf_set(0.5f * (fabsf(p->rows[0][0]) + fabsf(p->rows[0][1]) + fabsf(p->rows[0][2])));
    const lf nearest = w - reach_w;
    const lm beside = lf_lt(nearest, lf_set(NEAR_DEPTH)); /* at or behind the eye's plane: no bounds */
    const lf inverse_w = lf_set(1) / lf_select(beside, lf_set(1), w),
             inverse_near = lf_set(1) / lf_select(beside, lf_set(1), nearest);
    u = u * inverse_w;
    v = v * inverse_w;
    lf reach_u = zero, reach_v = zero;
    for (int a = 0; a < 3; a++) {
        reach_u = reach_u + lf_abs(lf_set(p->rows[1][a]) - u * lf_set(p->rows[0][a]));
        reach_v = reach_v + lf_abs(lf_set(p->rows[2][a]) - v * lf_set(p->rows[0][a]));
    }
    reach_u = reach_u * half * inverse_near + margin;
    reach_v = reach_v * half * inverse_near + margin;
    u = u - lf_set((float)tile->x);
    v = v - lf_set((float)tile->y);
    bounds b;
    b.x0 = lf_select(beside, zero, lf_max(zero - lf_floor(zero - lf_max(u - reach_u, zero - lf_set(1))), zero));
    b.y0 = lf_select(beside, zero, lf_max(zero - lf_floor(zero - lf_max(v - reach_v, zero - lf_set(1))), zero));
    b.x1 = lf_select(beside, last_x, lf_min(lf_floor(lf_min(u + reach_u, last_x)), last_x));
    b.y1 = lf_select(beside, last_y, lf_min(lf_floor(lf_min(v + reach_v, last_y)), last_y));
    b.t_near = lf_select(beside, zero, nearest * lf_set(0.99999f));
    const lm behind = lf_lt(w + reach_w, zero);
    b.x1 = lf_select(behind, zero - lf_set(1), b.x1);
    return b;
}

/* False where all pixels of the block's rectangle already hold something nearer. */
static int block_may_show(const df_splat_job *job, const df_block_rect *rect) {
    const df_tile *tile = job->tile;
    int32_t x0 = rect->x0 - (int32_t)tile->x, x1 = rect->x1 - (int32_t)tile->x;
    int32_t y0 = rect->y0 - (int32_t)tile->y, y1 = rect->y1 - (int32_t)tile->y;
    x0 = x0 < 0 ? 0 : x0;
    y0 = y0 < 0 ? 0 : y0;
    x1 = x1 >= (int32_t)tile->width ? (int32_t)tile->width - 1 : x1;
    y1 = y1 >= (int32_t)tile->height ? (int32_t)tile->height - 1 : y1;
    const lf t_near = lf_set(rect->t_near);
    for (int32_t y = y0; y <= y1; y++) {
        const float *row = job->depth + (size_t)y * tile->width;
        for (int32_t x = x0; x <= x1; x += DF_LANES) { /* what is read past the rectangle only makes this careful */
            if (lm_any(lf_le(t_near, lf_load(row + x)))) return 1;
        }
    }
    return 0;
}

/* Queues the pairs of DF_LANES voxels with the pixels of their bounds, as far as nothing nearer is there yet. */
static void queue_pairs(const df_splat_job *job, queue *q, const lf cell[3], li record, const bounds *b, lm valid,
                        df_counters *counters) {
    const lf width = lf_set((float)job->tile->width);
    for (lf y = b->y0; lm_any(valid); y = y + lf_set(1)) {
        valid = lm_and(valid, lf_le(y, b->y1));
        lm row = valid;
        for (lf x = b->x0; lm_any(row); x = x + lf_set(1)) {
            row = lm_and(row, lf_le(x, b->x1));
            const li ray = li_from_lf(lf_select(row, y * width + x, lf_set(0)));
            const lm open = lm_and(row, lf_le(b->t_near, lf_gather(job->depth, ray)));
            const uint32_t bits = lm_bits(open);
            if (!bits) continue;
            li_compress(q->ray + q->count, open, ray);
            li_compress(q->record + q->count, open, record);
            for (int a = 0; a < 3; a++) lf_compress(q->cell[a] + q->count, open, cell[a]);
            q->count += (uint32_t)__builtin_popcount(bits);
            if (q->count >= QUEUE_FLUSH) flush(job, q, 0, counters);
        }
    }
}

void DF_KERNEL(df_kernel_splat)(const df_splat_job *job, df_counters *counters) {
    const df_scene *scene = job->scene;
    const df_surface *surface = job->surface;
    int32_t iota[DF_LANES];
    for (int i = 0; i < DF_LANES; i++) iota[i] = i;
    const li lane = li_load(iota), mask = li_set((int32_t)scene->k - 1);
    queue q;
    q.count = 0;
    for (uint32_t n = 0; n < job->count; n++) {
        const df_block_rect *rect = &job->rects[job->order[n]];
        const uint32_t block = rect->block, last = surface->first[block + 1];
        counters->coarse_steps++;
        if (!block_may_show(job, rect)) continue;
        float corner[3];
        voxel_of(scene, block, 0, corner);
        q.block = block;
        for (uint32_t first = surface->first[block]; first < last; first += DF_LANES) {
            const li bits = li_load_u16(surface->bits + first);
            const li x = li_and(bits, mask), y = li_and(li_shift_right(bits, scene->k_shift), mask);
            const li z = li_shift_right(bits, 2 * scene->k_shift);
            const lf cell[3] = {lf_from_li(x) + lf_set(corner[0]), lf_from_li(y) + lf_set(corner[1]),
                                lf_from_li(z) + lf_set(corner[2])};
            const bounds b = project(job, cell);
            lm valid = lm_and(lf_le(b.x0, b.x1), lf_le(b.y0, b.y1));
            valid = lm_and(valid, lf_lt(lf_from_li(lane), lf_set((float)(last - first))));
            counters->fine_steps += last - first < DF_LANES ? last - first : DF_LANES;
            if (lm_any(valid)) queue_pairs(job, &q, cell, li_add(li_set((int32_t)first), lane), &b, valid, counters);
        }
        flush(job, &q, 1, counters);
    }
}
