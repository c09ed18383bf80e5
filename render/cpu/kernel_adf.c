/*
 * Packets of rays through an octree, children from front to back: a family's samples are decoded once for all rays, and
 * lanes are rays. What a leaf does to a ray is what adf.h says.
 */
#include "render/cpu/kernel.h"
#include "render/cpu/packet_rays.h"

#include <math.h>

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"

typedef struct packet {
    lf origin[3], direction[3], inverse[3];
    lf footprint, footprint_base;
    uint32_t flip;    /* child n ^ flip is the n-th from front to back */
    lm known, inside; /* the side that each lane carries, once it is known */
    lm done;
    uint32_t block[DF_LANES], corner[3][DF_LANES];
    uint8_t flags[DF_LANES];
} packet;

/* A cell of the tree. */
typedef struct cell {
    uint32_t corner[3], size_log2;
    float values[8];
} cell;

static void accept(packet *p, lm lanes, const cell *c, uint32_t block) {
    const uint32_t inside = lm_bits(p->inside);
    for (uint32_t bits = lm_bits(lanes); bits; bits &= bits - 1) {
        const int i = __builtin_ctz(bits);
        p->block[i] = block;
        p->flags[i] = (uint8_t)((inside >> i & 1 ? DF_HIT_BACK : 0) | c->size_log2 << DF_HIT_SIZE_SHIFT);
        for (int a = 0; a < 3; a++) p->corner[a][i] = c->corner[a];
    }
    p->done = lm_or(p->done, lanes);
}

static void count(df_counters *counters, uint64_t *steps, lm lanes) {
    const uint32_t number = lm_count(lm_bits(lanes));
    *steps += number;
    counters->lanes_active += number;
    counters->lanes_total += DF_LANES;
}

/* Lanes that do not know their side yet are on that of the cell at their entry. */
static void learn_side(packet *p, lm lanes, lm inside) {
    const lm new = lm_and(lanes, lm_not(p->known));
    p->inside = lm_or(lm_and(p->inside, lm_not(new)), lm_and(new, inside));
    p->known = lm_or(p->known, new);
}

/* A leaf, or what is taken for one, before the lanes that may meet it. */
static void visit_leaf(const df_packet_job *job, packet *p, const cell *c, uint32_t block, bool mixed, bool inside,
                       lm lanes, df_counters *counters) {
    const lm all_inside = inside ? lm_first(DF_LANES) : lm_first(0);
    lf origin_cell[3], corner[8], bern[4];
    df_segment_f32 segment;
    if (!mixed) { /* mostly of the side that all lanes carry */
        count(counters, &counters->coarse_steps, lanes);
        if (!lm_any(lm_and(lanes, lm_or(lm_not(p->known), lm_xor(p->inside, all_inside))))) return;
    } else {
        count(counters, &counters->fine_steps, lanes);
    }
    for (int a = 0; a < 3; a++) origin_cell[a] = lf_set((float)c->corner[a]);
    lanes = lm_and(lanes, df_cell_segment_f32(p->origin, p->direction, p->inverse, lf_set(0), origin_cell,
                                              lf_set((float)(1u << c->size_log2)), &segment));
    if (!lm_any(lanes)) return;
    if (!mixed) {
        learn_side(p, lanes, all_inside);
        accept(p, lm_and(lanes, lm_xor(p->inside, all_inside)), c, block);
        return;
    }
    counters->cells_tested += lm_count(lm_bits(lanes));
    for (int i = 0; i < 8; i++) corner[i] = lf_set(c->values[i] - job->scene->iso);
    df_bernstein_f32(corner, segment.a, segment.b, bern);
    const lm inside_in = lf_lt(bern[0], lf_set(0));
    lm unused;
    learn_side(p, lanes, inside_in);
    const lm crossed = df_accept_f32(corner, segment.a, segment.b, job->isolate, &unused);
    accept(p, lm_and(lanes, lm_or(lm_xor(p->inside, inside_in), crossed)), c, block);
}

/* A leaf's state by its corners: at other iso values than 0, and for a divided cell that is not gone into. */
static bool straddles(const df_packet_job *job, const cell *c, bool *inside) {
    float corner[8];
    for (int i = 0; i < 8; i++) corner[i] = c->values[i] - job->scene->iso;
    *inside = corner[0] < 0;
    return df_corners_straddle(corner, 0);
}

/* Goes through the children of a family from front to back; parent: the cell that it divides. */
static void visit_family(const df_packet_job *job, packet *p, uint32_t family, const cell *parent, lm lanes,
                         df_counters *counters) {
    const df_scene *scene = job->scene;
    const df_family *children = &scene->field->families[family];
    const uint32_t size = 1u << (parent->size_log2 - 1);
    float samples[DF_FAMILY_SAMPLE_COUNT];
    bool decoded = false;
    lf t[3][3];
    for (int a = 0; a < 3; a++) {
        for (uint32_t i = 0; i < 3; i++) {
            const lf plane = lf_set((float)(parent->corner[a] + i * size));
            t[a][i] = (plane - p->origin[a]) * p->inverse[a];
        }
    }
    for (uint32_t n = 0; n < 8; n++) {
        const uint32_t child = n ^ p->flip, block = family << 3 | child;
        cell c = {.size_log2 = parent->size_log2 - 1};
        lf in[3], out[3];
        bool within = true, inside;
        for (int a = 0; a < 3; a++) {
            const uint32_t upper = child >> a & 1, down = p->flip >> a & 1;
            c.corner[a] = parent->corner[a] + upper * size;
            within = within && c.corner[a] < scene->voxel_count[a];
            in[a] = t[a][upper + down];
            out[a] = t[a][upper + !down];
        }
        if (!within) continue;
        const lf t_in = lf_max(lf_max(lf_max(in[0], in[1]), in[2]), lf_set(0));
        const lf t_out = lf_min(lf_min(out[0], out[1]), out[2]);
        lm meet = lm_and(lm_and(lanes, lm_not(p->done)), lf_le(t_in, t_out));
        if (!lm_any(meet)) continue;
        df_child_state state = df_family_state(children, child);
        if (state >= DF_CHILD_SURFACE || scene->iso != 0) {
            if (!decoded) df_adf_samples(scene->field, family, parent->values, samples);
            decoded = true;
            for (uint32_t i = 0; i < 8; i++) c.values[i] = samples[df_family_corner(child, i)];
        }
        if (state == DF_CHILD_FAMILY) {
            const lm small = lm_and(meet, lf_le(lf_set((float)size), t_in * p->footprint + p->footprint_base));
            if (lm_any(small)) {
                const bool mixed = straddles(job, &c, &inside);
                visit_leaf(job, p, &c, block, mixed, inside, small, counters);
                meet = lm_and(meet, lm_not(small));
            }
            if (lm_any(meet)) visit_family(job, p, df_family_child(children, child), &c, meet, counters);
            continue;
        }
        bool mixed = state == DF_CHILD_SURFACE;
        inside = state == DF_CHILD_INSIDE;
        if (mixed || scene->iso != 0) mixed = straddles(job, &c, &inside);
        visit_leaf(job, p, &c, block, mixed, inside, meet, counters);
    }
}

/* Lanes whose directions have the signs of lane `first`; sets flip. */
static lm same_octant(packet *p, int first) {
    lm lanes = lm_first(DF_LANES);
    p->flip = 0;
    for (int a = 0; a < 3; a++) {
        const lm upward = lf_lt(lf_set(0), p->direction[a]);
        const bool up = lm_bits(upward) >> first & 1;
        lanes = lm_and(lanes, up ? upward : lm_not(upward));
        p->flip |= (uint32_t)!up << a;
    }
    return lanes;
}

static void trace(const df_packet_job *job, packet *p, df_counters *counters) {
    const df_field *field = job->scene->field;
    cell root = {.size_log2 = field->level_count};
    df_adf_cell_corners(field, 0, root.values);
    p->known = p->inside = p->done = lm_first(0);
    for (uint32_t rest = lm_bits(lm_first(DF_LANES)); rest;) {
        const lm lanes = same_octant(p, __builtin_ctz(rest));
        visit_family(job, p, 0, &root, lanes, counters);
        rest &= ~lm_bits(lanes);
    }
}

uint32_t DF_KERNEL(df_kernel_adf)(const df_packet_job *job, df_candidate *candidates, df_counters *counters) {
    const df_tile *tile = job->tile;
    const uint32_t width = df_packet_width(tile), height = DF_LANES / width;
    uint32_t hits = 0;
    for (uint32_t y = 0; y < tile->height; y += height) {
        for (uint32_t x = 0; x < tile->width; x += width) {
            float base[DF_LANES];
            packet p;
            const uint32_t valid = df_packet_load(tile, x, y, width, p.origin, p.direction, p.inverse);
            for (uint32_t i = 0; i < DF_LANES; i++)
                base[i] = df_footprint_base(job->footprint, &tile->rays, df_packet_ray(tile, x, y, width, i));
            p.footprint = lf_set((float)job->footprint);
            p.footprint_base = lf_load(base);
            trace(job, &p, counters);
            for (uint32_t bits = lm_bits(p.done) & valid; bits; bits &= bits - 1) {
                const uint32_t i = (uint32_t)__builtin_ctz(bits);
                candidates[hits++] = (df_candidate){
                    .ray = df_packet_ray(tile, x, y, width, i),
                    .block = p.block[i],
                    .cell = {(uint16_t)p.corner[0][i], (uint16_t)p.corner[1][i], (uint16_t)p.corner[2][i]},
                    .flags = p.flags[i]};
            }
        }
    }
    return hits;
}
