/*
 * Coherent grid traversal (Wald et al. 2006): a packet of neighbouring rays goes through the grid slice by slice along
 * its main axis. The cells of a slice that the packet's bounds meet are looked at together, coarse cells first, then
 * voxels; every surface voxel is tested against all rays of the packet by the text that all tracers share, and the
 * nearest accepted voxel of each ray stays.
 */
#include "render/cpu/fetch.h"
#include "render/cpu/frustum.h"
#include "render/cpu/kernel.h"

#include <math.h>

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"

enum { RAYS_MAX = DF_CGT_PACKET_MAX * DF_CGT_PACKET_MAX + DF_LANES };

typedef struct packet {
    float direction[3][RAYS_MAX], inverse[3][RAYS_MAX], depth[RAYS_MAX]; /* padded with the last ray */
    uint32_t ray[RAYS_MAX], count, padded;
    df_frustum frustum;
    float reach[2]; /* along the main axis, from the eye: where rays may hit */
    df_candidate best[RAYS_MAX];
} packet;

/* Of two voxels that a ray enters at the same t the one entered across the lower axis comes first (cell.h). */
static int entry_axis(const packet *p, uint32_t i, const float cell[3], float t_in) {
    int axis = 3;
    for (int a = 0; a < 3; a++) {
        const float low = (cell[a] - p->frustum.origin[a]) * p->inverse[a][i],
                    high = ((cell[a] + 1.0f) - p->frustum.origin[a]) * p->inverse[a][i];
        if ((low < high ? low : high) == t_in) axis = a;
    }
    return axis;
}

static void keep(packet *p, uint32_t i, float t_in, const float cell[3], uint32_t block, int inside) {
    df_candidate *best = &p->best[i];
    if (t_in > p->depth[i]) return;
    if (t_in == p->depth[i]) {
        const float before[3] = {best->cell[0], best->cell[1], best->cell[2]};
        if (entry_axis(p, i, cell, t_in) >= entry_axis(p, i, before, t_in)) return;
    }
    p->depth[i] = t_in;
    best->block = block;
    best->flags = inside ? DF_HIT_BACK : 0;
    for (int a = 0; a < 3; a++) best->cell[a] = (uint16_t)cell[a];
}

/* Tests one voxel against all rays of the packet. */
static void test_voxel(const df_packet_job *job, packet *p, const uint32_t voxel[3], uint32_t block,
                       df_counters *counters) {
    const float cell[3] = {(float)voxel[0], (float)voxel[1], (float)voxel[2]};
    lf origin[3], lower[3], corner[8];
    float values[8];
    df_scene_corners(job->scene, voxel, block, values);
    for (int c = 0; c < 8; c++) corner[c] = lf_set(values[c]);
    for (int a = 0; a < 3; a++) {
        origin[a] = lf_set(p->frustum.origin[a]);
        lower[a] = lf_set(cell[a]);
    }
    for (uint32_t first = 0; first < p->count; first += DF_LANES) {
        lf direction[3], inverse[3];
        df_segment_f32 segment;
        for (int a = 0; a < 3; a++) {
            direction[a] = lf_load(p->direction[a] + first);
            inverse[a] = lf_load(p->inverse[a] + first);
        }
        lm visited = df_cell_segment_f32(origin, direction, inverse, lf_set(0), lower, lf_set(1), &segment);
        visited = lm_and(visited, lf_le(segment.t_in, lf_load(p->depth + first)));
        const uint32_t valid = p->count - first < DF_LANES ? (uint32_t)((1ull << (p->count - first)) - 1)
                                                           : (uint32_t)((1ull << DF_LANES) - 1);
        const uint32_t tested = lm_bits(visited) & valid;
        counters->lanes_total += DF_LANES;
        counters->lanes_active += lm_count(tested);
        counters->cells_tested += lm_count(tested);
        if (!tested) continue;
        lm inside;
        uint32_t bits = lm_bits(df_accept_f32(corner, segment.a, segment.b, job->isolate, &inside)) & tested;
        const uint32_t inside_bits = lm_bits(inside);
        float t_in[DF_LANES];
        lf_store(t_in, segment.t_in);
        for (; bits; bits &= bits - 1) {
            const int lane = __builtin_ctz(bits);
            keep(p, first + (uint32_t)lane, t_in[lane], cell, block, inside_bits >> lane & 1);
        }
    }
}

/* Looks at the voxels of one block, slice by slice; clip: only those that the packet's bounds meet. */
static void visit_block(const df_packet_job *job, packet *p, const uint32_t coarse[3], uint32_t block,
                        df_counters *counters) {
    const df_scene *scene = job->scene;
    const df_frustum *f = &p->frustum;
    const uint32_t k = scene->k, words = df_brick_mask_words(k);
    const uint64_t *mask = scene->masks + (uint64_t)block * words;
    const int32_t base[3] = {(int32_t)(coarse[0] * k), (int32_t)(coarse[1] * k), (int32_t)(coarse[2] * k)};
    const int32_t low[2] = {base[f->u], base[f->v]}, high[2] = {low[0] + (int32_t)k - 1, low[1] + (int32_t)k - 1};
    for (uint32_t n = 0; n < k; n++) {
        const uint32_t along = f->sign > 0 ? n : k - 1 - n;
        const float plane = (float)(base[f->main] + (int32_t)along);
        df_frustum_cells s = {{low[0], low[1]}, {high[0], high[1]}};
        if (job->clip && !df_frustum_slice(f, plane, plane + 1, 1, low, high, &s)) continue;
        for (int32_t v = s.low[1]; v <= s.high[1]; v++) {
            for (int32_t u = s.low[0]; u <= s.high[0]; u++) {
                uint32_t voxel[3];
                voxel[f->main] = (uint32_t)base[f->main] + along;
                voxel[f->u] = (uint32_t)u;
                voxel[f->v] = (uint32_t)v;
                const uint32_t bit = (voxel[0] - (uint32_t)base[0]) +
                                     k * ((voxel[1] - (uint32_t)base[1]) + k * (voxel[2] - (uint32_t)base[2]));
                counters->fine_steps++;
                if (mask[bit / 64] >> (bit % 64) & 1) test_voxel(job, p, voxel, block, counters);
            }
        }
    }
}

/* The distance along the main axis from the eye up to which rays still look for something nearer. */
static float farthest(const packet *p) {
    float most = 0;
    for (uint32_t i = 0; i < p->count; i++) {
        const float along = p->depth[i] * fabsf(p->direction[p->frustum.main][i]);
        most = along > most ? along : most;
    }
    return most;
}

static void walk(const df_packet_job *job, packet *p, df_counters *counters) {
    const df_scene *scene = job->scene;
    const df_frustum *f = &p->frustum;
    const float k = (float)scene->k;
    const int32_t low[2] = {0, 0},
                  high[2] = {(int32_t)scene->coarse_count[f->u] - 1, (int32_t)scene->coarse_count[f->v] - 1};
    const int32_t count = (int32_t)scene->coarse_count[f->main];
    for (int32_t n = 0; n < count; n++) {
        const int32_t along = f->sign > 0 ? n : count - 1 - n;
        const float from = ((f->sign > 0 ? (float)along : (float)along + 1) * k - f->origin[f->main]) * f->sign;
        df_frustum_cells s;
        if (from + k < p->reach[0] - DF_FRUSTUM_MARGIN) continue;
        if (from > p->reach[1] + DF_FRUSTUM_MARGIN) return;
        if (!df_frustum_slice(f, (float)along * k, (float)(along + 1) * k, k, low, high, &s)) continue;
        if (farthest(p) < from * 0.9999f) return;
        for (int32_t v = s.low[1]; v <= s.high[1]; v++) {
            for (int32_t u = s.low[0]; u <= s.high[0]; u++) {
                uint32_t coarse[3];
                coarse[f->main] = (uint32_t)along;
                coarse[f->u] = (uint32_t)u;
                coarse[f->v] = (uint32_t)v;
                counters->coarse_steps++;
                const uint64_t row = coarse[1] + (uint64_t)scene->coarse_count[1] * coarse[2];
                const uint32_t block = scene->coarse[coarse[0] + scene->coarse_count[0] * row];
                if (block < DF_CELL_INSIDE) visit_block(job, p, coarse, block, counters);
            }
        }
    }
}

/* Collects the rays of a square of pixels; false where they do not share the sign of a main axis. */
static bool gather(const df_packet_job *job, uint32_t x0, uint32_t y0, uint32_t size, packet *p) {
    const df_tile *tile = job->tile;
    const df_rays *rays = &tile->rays;
    p->count = 0;
    for (uint32_t y = y0; y < tile->height && y < y0 + size; y++) {
        for (uint32_t x = x0; x < tile->width && x < x0 + size; x++) {
            const uint32_t ray = y * tile->width + x, i = p->count++;
            p->ray[i] = ray;
            for (int a = 0; a < 3; a++) {
                p->direction[a][i] = rays->direction[a][ray];
                p->inverse[a][i] = rays->inverse[a][ray];
            }
        }
    }
    p->padded = (p->count + DF_LANES - 1) / DF_LANES * DF_LANES;
    for (uint32_t i = 0; i < p->padded; i++) {
        const uint32_t from = i < p->count ? i : p->count - 1;
        for (int a = 0; a < 3; a++) {
            p->direction[a][i] = p->direction[a][from];
            p->inverse[a][i] = p->inverse[a][from];
        }
        p->depth[i] = INFINITY;
    }
    const float origin[3] = {rays->origin[0][0], rays->origin[1][0], rays->origin[2][0]},
                first_direction[3] = {p->direction[0][0], p->direction[1][0], p->direction[2][0]};
    df_frustum_begin(&p->frustum, origin, first_direction);
    p->reach[0] = INFINITY;
    p->reach[1] = -INFINITY;
    for (uint32_t i = 0; i < p->count; i++) {
        const float direction[3] = {p->direction[0][i], p->direction[1][i], p->direction[2][i]};
        if (!df_frustum_add(&p->frustum, direction)) return false;
        const float along = fabsf(direction[p->frustum.main]);
        float first = 0, last = INFINITY;
        if (job->bounds) {
            const uint32_t ray = p->ray[i];
            df_bounds_ray(job->bounds, tile->x + ray % tile->width, tile->y + ray / tile->width, 0, &first, &last);
            if (!(first <= last)) continue;
        }
        const float from = first * along, to = last * along;
        p->reach[0] = from < p->reach[0] ? from : p->reach[0];
        p->reach[1] = to > p->reach[1] ? to : p->reach[1];
    }
    return true;
}

/* Walks a square of rays; where they do not go together, four smaller ones, down to single rays. */
static uint32_t trace_square(const df_packet_job *job, uint32_t x, uint32_t y, uint32_t size, df_candidate *candidates,
                             df_counters *counters) {
    packet p;
    uint32_t hits = 0;
    if (x >= job->tile->width || y >= job->tile->height) return 0;
    if (!gather(job, x, y, size, &p)) { /* never with a single ray */
        const uint32_t part = size / 2;
        for (uint32_t i = 0; i < 4; i++) {
            hits += trace_square(job, x + (i & 1) * part, y + (i >> 1) * part, part, candidates + hits, counters);
        }
        return hits;
    }
    if (p.reach[0] <= p.reach[1]) walk(job, &p, counters);
    for (uint32_t i = 0; i < p.count; i++) {
        if (!(p.depth[i] < INFINITY)) continue;
        candidates[hits] = p.best[i];
        candidates[hits++].ray = p.ray[i];
    }
    return hits;
}

uint32_t DF_KERNEL(df_kernel_cgt)(const df_packet_job *job, df_candidate *candidates, df_counters *counters) {
    const df_tile *tile = job->tile;
    uint32_t hits = 0;
    for (uint32_t y = 0; y < tile->height; y += job->packet) {
        for (uint32_t x = 0; x < tile->width; x += job->packet) {
            hits += trace_square(job, x, y, job->packet, candidates + hits, counters);
        }
    }
    return hits;
}
