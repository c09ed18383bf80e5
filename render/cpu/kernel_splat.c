/*
 * Object order: surface voxels, or leaves of an octree, are projected, DF_LANES at a time, and every pixel whose centre
 * may see one makes a pair (voxel, ray). Pairs are queued and tested at full width by the same text as every other
 * tracer. The nearest accepted voxel of each ray stays.
 *
 * `octree` is a constant wherever these functions are called: voxels know nothing of sizes.
 */
#include "render/cpu/fetch.h"
#include "render/cpu/kernel.h"

#include <math.h>

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"

/* Pixels by which projected bounds of voxels and of blocks are widened: far more than the rounding of the projection.
 */
#define MARGIN 0.02f
#define BLOCK_MARGIN 0.05f

/* Voxels nearer to the eye's plane than this, in grid units of depth, count as covering the whole tile. */
#define NEAR_DEPTH 0.01f

enum { QUEUE_FLUSH = 4 * DF_LANES, QUEUE_ROOM = QUEUE_FLUSH + 2 * DF_LANES };

/* Pairs of a voxel and a ray. */
typedef struct queue {
    uint32_t count;
    int32_t ray[QUEUE_ROOM], record[QUEUE_ROOM], block[QUEUE_ROOM];
    float cell[3][QUEUE_ROOM], size[QUEUE_ROOM]; /* size: of leaves */
} queue;

/* The size of the leaf of a record, in voxels. */
static inline float leaf_size(uint32_t voxel) { return (float)(1u << (voxel >> DF_SURFACE_SIZE & 15)); }

/* Of two voxels that a ray enters at the same t the one entered across the lower axis comes first (cell.h). */
static int entry_axis(const df_rays *rays, uint32_t ray, const float cell[3], float size, float t_in) {
    int axis = 3;
    for (int a = 0; a < 3; a++) {
        const float origin = rays->origin[a][0], inverse = rays->inverse[a][ray];
        const float low = (cell[a] - origin) * inverse, high = ((cell[a] + size) - origin) * inverse;
        if ((low < high ? low : high) == t_in) axis = a;
    }
    return axis;
}

/* A record's lower corner, and its size; 1 for voxels. */
static float voxel_of(const df_splat_job *job, uint32_t block, uint32_t record, float cell[3]) {
    const df_surface *surface = job->surface;
    for (int a = 0; a < 3; a++) {
        const uint32_t within = surface->voxels[record] >> a * (int)surface->k_shift & ((1u << surface->k_shift) - 1);
        cell[a] = (float)(surface->corner[a][block] + within);
    }
    return leaf_size(surface->voxels[record]);
}

/* Keeps an accepted voxel where it is the nearest so far. */
static void keep(const df_splat_job *job, uint32_t ray, float t_in, uint32_t record, uint32_t block, int inside) {
    if (t_in > job->depth[ray]) return;
    if (t_in == job->depth[ray]) {
        float now[3], before[3];
        const float size = voxel_of(job, block, record, now);
        const float size_before = voxel_of(job, job->block[ray], job->record[ray] & ~DF_SPLAT_BACK, before);
        if (entry_axis(&job->tile->rays, ray, now, size, t_in) >=
            entry_axis(&job->tile->rays, ray, before, size_before, t_in))
            return;
    }
    job->depth[ray] = t_in;
    job->record[ray] = inside ? record | DF_SPLAT_BACK : record;
    job->block[ray] = block;
}

/* Tests DF_LANES pairs from entry `first` of the queue; only the first `count` are real. */
static inline void test_pairs(const df_splat_job *job, const queue *q, uint32_t first, uint32_t count, bool octree) {
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
    const lf size = octree ? lf_load(q->size + first) : lf_set(1);
    lm visited = df_cell_segment_f32(origin, direction, inverse, lf_set(0), cell, size, &segment);
    visited = lm_and(visited, lf_le(segment.t_in, lf_gather(job->depth, ray)));
    if (!lm_any(visited)) return;
    DF_FETCH_BY_TYPE(job->surface->sample_type, df_fetch_records, job->scene, job->surface, q->record + first,
                     q->block + first, corner);
    lm inside;
    lm hit = df_accept_f32(corner, segment.a, segment.b, job->isolate, &inside);
    if (octree) hit = lm_or(hit, inside); /* it comes from outside */
    hit = lm_and(visited, hit);
    uint32_t bits = lm_bits(hit) & (uint32_t)((1ull << count) - 1);
    if (!bits) return;
    const uint32_t inside_bits = octree ? 0 : lm_bits(inside);
    float t_in[DF_LANES];
    lf_store(t_in, segment.t_in);
    for (; bits; bits &= bits - 1) {
        const int lane = __builtin_ctz(bits);
        keep(job, (uint32_t)q->ray[first + (uint32_t)lane], t_in[lane], (uint32_t)q->record[first + (uint32_t)lane],
             (uint32_t)q->block[first + (uint32_t)lane], inside_bits >> lane & 1);
    }
}

/* Tests what is queued: whole vectors, or all of it. The rest moves to the front. */
static inline void flush(const df_splat_job *job, queue *q, int all, df_counters *counters, bool octree) {
    uint32_t done = 0;
    for (; done + DF_LANES <= q->count; done += DF_LANES) test_pairs(job, q, done, DF_LANES, octree);
    counters->cells_tested += done;
    counters->lanes_active += done;
    counters->lanes_total += done;
    uint32_t rest = q->count - done;
    if (rest && all) {
        for (uint32_t i = q->count; i < done + DF_LANES; i++) { /* pad with the last pair */
            q->ray[i] = q->ray[q->count - 1];
            q->record[i] = q->record[q->count - 1];
            q->block[i] = q->block[q->count - 1];
            for (int a = 0; a < 3; a++) q->cell[a][i] = q->cell[a][q->count - 1];
            if (octree) q->size[i] = q->size[q->count - 1];
        }
        test_pairs(job, q, done, rest, octree);
        counters->cells_tested += rest;
        counters->lanes_active += rest;
        counters->lanes_total += DF_LANES;
        rest = 0;
    }
    for (uint32_t i = 0; i < rest; i++) {
        q->ray[i] = q->ray[done + i];
        q->record[i] = q->record[done + i];
        q->block[i] = q->block[done + i];
        for (int a = 0; a < 3; a++) q->cell[a][i] = q->cell[a][done + i];
        if (octree) q->size[i] = q->size[done + i];
    }
    q->count = rest;
}

/* DF_LANES voxels: the pixels of the tile that may see their surface, inclusive, none where x1 < x0 or y1 < y0, and the
 * least t at which they can. Pixels are whole numbers. */
typedef struct voxels {
    lf cell[3], size, x0, x1, y0, y1, t_near;
    uint32_t first, block; /* the record of lane 0, and the block of all */
} voxels;

/* Returns which of the voxels, or blocks, with boxes around `centre`, to both sides `half`, may be seen. */
static inline __attribute__((always_inline)) lm project(const df_projection *p, const df_tile *tile, const lf centre[3],
                                                        const lf half[3], lf margin, voxels *out) {
    const lf zero = lf_set(0), one = lf_set(1);
    const lf last_x = lf_set((float)(tile->width - 1)), last_y = lf_set((float)(tile->height - 1));
    lf from_eye[3], at[3], reach[3];
    for (int a = 0; a < 3; a++) from_eye[a] = centre[a] - lf_set(p->eye[a]);
    for (int i = 0; i < 3; i++) {
        at[i] = lf_set(p->rows[i][0]) * from_eye[0] + lf_set(p->rows[i][1]) * from_eye[1] +
                lf_set(p->rows[i][2]) * from_eye[2];
    }
    reach[0] = lf_set(fabsf(p->rows[0][0])) * half[0] + lf_set(fabsf(p->rows[0][1])) * half[1] +
               lf_set(fabsf(p->rows[0][2])) * half[2];
    const lf nearest = at[0] - reach[0];
    const lm beside = lf_lt(nearest, lf_set(NEAR_DEPTH)); /* at or behind the eye's plane: no bounds */
    const lf inverse_w = one / lf_select(beside, one, at[0]), inverse_near = one / lf_select(beside, one, nearest);
    lf low[2], high[2];
    for (int i = 0; i < 2; i++) {
        const lf u = at[1 + i] * inverse_w, first = lf_set((float)(i == 0 ? tile->x : tile->y));
        lf sum = zero;
        for (int a = 0; a < 3; a++) {
            sum = sum + lf_abs(lf_set(p->rows[1 + i][a]) - u * lf_set(p->rows[0][a])) * half[a];
        }
        sum = sum * inverse_near + margin;
        const lf last = i == 0 ? last_x : last_y;
        low[i] = zero - lf_floor(zero - lf_max((u - first) - sum, zero));
        high[i] = lf_floor(lf_min((u - first) + sum, last));
        low[i] = lf_select(beside, zero, low[i]);
        high[i] = lf_select(beside, last, high[i]);
    }
    out->x0 = low[0];
    out->y0 = low[1];
    out->x1 = high[0];
    out->y1 = high[1];
    out->t_near = lf_select(beside, zero, nearest * lf_set(0.99999f));
    const lm ahead = lf_le(zero, at[0] + reach[0]);
    return lm_and(ahead, lm_and(lf_le(low[0], high[0]), lf_le(low[1], high[1])));
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

static li lane_numbers(void) {
    int32_t lane[DF_LANES];
    for (int i = 0; i < DF_LANES; i++) lane[i] = i;
    return li_load(lane);
}

/* Voxels of up to SMALL x SMALL pixels are paired side by side, pixel by pixel; larger ones by rows of pixels. */
#define SMALL 3

/* Queues the pairs of the voxels `seen` with the pixels of their bounds, as far as nothing nearer is there yet. */
static inline void queue_small(const df_splat_job *job, queue *q, const voxels *of, lm seen, df_counters *counters,
                               bool octree) {
    const lf width = lf_set((float)job->tile->width), one = lf_set(1);
    const li record = li_add(lane_numbers(), li_set((int32_t)of->first));
    for (lf y = of->y0; lm_any(seen); y = y + one) {
        seen = lm_and(seen, lf_le(y, of->y1));
        lm row = seen;
        for (lf x = of->x0; lm_any(row); x = x + one) {
            row = lm_and(row, lf_le(x, of->x1));
            const li ray = li_from_lf(lf_select(row, y * width + x, lf_set(0)));
            const lm open = lm_and(row, lf_le(of->t_near, lf_gather(job->depth, ray)));
            li_compress(q->ray + q->count, open, ray);
            li_compress(q->record + q->count, open, record);
            li_store(q->block + q->count, li_set((int32_t)of->block));
            for (int a = 0; a < 3; a++) lf_compress(q->cell[a] + q->count, open, of->cell[a]);
            if (octree) lf_compress(q->size + q->count, open, of->size);
            q->count += lm_count(lm_bits(open));
            if (q->count >= QUEUE_FLUSH) flush(job, q, 0, counters, octree);
        }
    }
}

/* Completes the pairs from entry `first` of the queue on: all are of one voxel. */
static inline void name_voxel(queue *q, uint32_t first, const float cell[3], float size, uint32_t record,
                              uint32_t block, bool octree) {
    for (uint32_t at = first; at < q->count; at += DF_LANES) {
        li_store(q->record + at, li_set((int32_t)record));
        li_store(q->block + at, li_set((int32_t)block));
        for (int a = 0; a < 3; a++) lf_store(q->cell[a] + at, lf_set(cell[a]));
        if (octree) lf_store(q->size + at, lf_set(size));
    }
}

/* queue_small for voxels of any size. */
static inline void queue_large(const df_splat_job *job, queue *q, const voxels *of, lm seen, df_counters *counters,
                               bool octree) {
    const int32_t width = (int32_t)job->tile->width;
    const li lane = lane_numbers();
    int32_t x0[DF_LANES], x1[DF_LANES], y0[DF_LANES], y1[DF_LANES];
    float cells[3][DF_LANES], sizes[DF_LANES], t_near[DF_LANES];
    li_store(x0, li_from_lf(of->x0));
    li_store(x1, li_from_lf(of->x1));
    li_store(y0, li_from_lf(of->y0));
    li_store(y1, li_from_lf(of->y1));
    lf_store(t_near, of->t_near);
    lf_store(sizes, of->size);
    for (int a = 0; a < 3; a++) lf_store(cells[a], of->cell[a]);
    for (uint32_t bits = lm_bits(seen); bits; bits &= bits - 1) {
        const int i = __builtin_ctz(bits);
        const float cell[3] = {cells[0][i], cells[1][i], cells[2][i]};
        const lf nearest = lf_set(t_near[i]);
        uint32_t named = q->count;
        for (int32_t y = y0[i]; y <= y1[i]; y++) {
            for (int32_t x = x0[i]; x <= x1[i]; x += DF_LANES) {
                const int32_t ray = y * width + x;
                const lm open = lm_and(lf_le(nearest, lf_load(job->depth + ray)), lm_first((uint32_t)(x1[i] - x + 1)));
                li_compress(q->ray + q->count, open, li_add(li_set(ray), lane));
                q->count += lm_count(lm_bits(open));
                if (q->count < QUEUE_FLUSH) continue;
                name_voxel(q, named, cell, sizes[i], of->first + (uint32_t)i, of->block, octree);
                flush(job, q, 0, counters, octree);
                named = q->count;
            }
        }
        name_voxel(q, named, cell, sizes[i], of->first + (uint32_t)i, of->block, octree);
    }
}

static inline lf leaf_sizes(li voxel) {
    static const float sizes[16] = {1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768};
    return lf_gather(sizes, li_and(li_shift_right(voxel, DF_SURFACE_SIZE), li_set(15)));
}

/* Pairs DF_LANES records of a block from `first` on, of which the first `count` count. */
static inline void splat_voxels(const df_splat_job *job, queue *q, uint32_t block, uint32_t first, uint32_t count,
                                df_counters *counters, bool octree) {
    const int shift = (int)job->surface->k_shift;
    const li mask = li_set((1 << shift) - 1), eighth = li_set(7);
    const li voxel = li_load((const int32_t *)job->surface->voxels + first);
    voxels of = {.first = first, .block = block};
    lf centre[3], half[3], sixteenth = lf_set(1.0f / 16);
    of.size = lf_set(1);
    if (octree) {
        of.size = leaf_sizes(voxel);
        sixteenth = sixteenth * of.size;
    }
    for (int a = 0; a < 3; a++) {
        const lf low = lf_from_li(li_and(li_shift_right(voxel, DF_SURFACE_LOW + 3 * a), eighth));
        const lf high = lf_from_li(li_and(li_shift_right(voxel, DF_SURFACE_HIGH + 3 * a), eighth)) + lf_set(1);
        const li within = li_and(li_shift_right(voxel, a * shift), mask);
        of.cell[a] = lf_from_li(li_add(within, li_set((int32_t)job->surface->corner[a][block])));
        centre[a] = of.cell[a] + (low + high) * sixteenth;
        half[a] = (high - low) * sixteenth;
    }
    counters->fine_steps += count;
    const lm seen = lm_and(project(job->projection, job->tile, centre, half, lf_set(MARGIN), &of), lm_first(count));
    if (!lm_any(seen)) return;
    const lm large = lm_or(lf_le(lf_set(SMALL), of.x1 - of.x0), lf_le(lf_set(SMALL), of.y1 - of.y0));
    if (lm_any(lm_and(seen, large))) queue_large(job, q, &of, seen, counters, octree);
    else queue_small(job, q, &of, seen, counters, octree);
}

static inline void splat_blocks(const df_splat_job *job, df_counters *counters, bool octree) {
    const df_surface *surface = job->surface;
    queue q;
    q.count = 0;
    for (uint32_t n = 0; n < job->count; n++) {
        const uint32_t block = job->order[n], last = surface->first[block + 1];
        counters->coarse_steps++;
        if (!block_may_show(job, &job->rects[block])) continue;
        for (uint32_t first = surface->first[block]; first < last; first += DF_LANES) {
            const uint32_t count = last - first < DF_LANES ? last - first : DF_LANES;
            splat_voxels(job, &q, block, first, count, counters, octree);
        }
    }
    flush(job, &q, 1, counters, octree);
}

void DF_KERNEL(df_kernel_block_rects)(const df_surface *surface, const df_projection *projection,
                                      const df_tile *picture, uint32_t first, uint32_t count, df_block_rect *rects) {
    for (uint32_t n = first; n < first + count; n += DF_LANES) {
        const uint32_t lanes = first + count - n < DF_LANES ? first + count - n : DF_LANES;
        float half_sizes[DF_LANES], t_near[DF_LANES];
        int32_t x0[DF_LANES], y0[DF_LANES], x1[DF_LANES], y1[DF_LANES];
        lf centre[3], half[3];
        voxels of;
        for (uint32_t i = 0; i < DF_LANES; i++) {
            const bool varies = surface->block_log2 && i < lanes;
            half_sizes[i] = 0.5f * (float)(1u << (varies ? surface->block_log2[n + i] : surface->k_shift));
        }
        for (int a = 0; a < 3; a++) {
            half[a] = lf_load(half_sizes);
            centre[a] = lf_from_li(li_load((const int32_t *)surface->corner[a] + n)) + half[a];
        }
        const lm seen = project(projection, picture, centre, half, lf_set(BLOCK_MARGIN), &of);
        const uint32_t bits = lm_bits(seen);
        li_store(x0, li_from_lf(lf_masked(seen, of.x0)));
        li_store(y0, li_from_lf(lf_masked(seen, of.y0)));
        li_store(x1, li_from_lf(lf_masked(seen, of.x1)));
        li_store(y1, li_from_lf(lf_masked(seen, of.y1)));
        lf_store(t_near, of.t_near);
        for (uint32_t i = 0; i < lanes; i++) {
            const bool visible = bits >> i & 1 && surface->first[n + i] < surface->first[n + i + 1];
            const uint32_t top = picture->y + (uint32_t)y0[i], bottom = picture->y + (uint32_t)y1[i];
            rects[n + i] =
                visible ? (df_block_rect){(uint16_t)x0[i], (uint16_t)top, (uint16_t)x1[i], (uint16_t)bottom, t_near[i]}
                        : (df_block_rect){.x0 = 1};
        }
    }
}

void DF_KERNEL(df_kernel_splat)(const df_splat_job *job, df_counters *counters) {
    if (job->surface->leaves) splat_blocks(job, counters, true);
    else splat_blocks(job, counters, false);
}
