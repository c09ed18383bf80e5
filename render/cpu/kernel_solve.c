/* Accepted cells to hits, DF_LANES at a time: each ray rebased to its cell in double and solved there, DF_DOUBLE_LANES
 * of them together (DF_PRECISION_F64), or both in float (DF_PRECISION_F32). */
#include "render/cpu/fetch.h"
#include "render/cpu/kernel.h"
#include "render/methods/cubic.h"

#include <assert.h>
#include <stddef.h>

#include "render/methods/lane_f64.h"

#include "render/methods/cell.h"
#include "render/methods/solve.h"

#include "render/methods/lane_f32.h"

#include "render/methods/cell.h"
#include "render/methods/solve.h"

/* Illinois steps end where the position moves less than this, in parts of the segment: the step that shows it has
 * converged to far less, as its order is 1.44: to 3e-12 in double, where it is the same as in hit.h, and to 6e-8 in
 * float, half an ulp. */
#define SOLVE_TOLERANCE 1e-8
#define SOLVE_TOLERANCE_F32 1e-5f

/* The inputs of DF_LANES cells. */
typedef struct batch {
    lf origin[3], direction[3], cell[3], size, corner[8];
    lf inside; /* 1 or 0 */
} batch;

/* Candidates as lanes; those past the last one repeat it. */
typedef struct lanes_of {
    li ray, block, cell[3], flags;
} lanes_of;

static lanes_of load_candidates(const df_candidate *candidates, uint32_t lanes) {
    _Static_assert(sizeof(df_candidate) == 16 && offsetof(df_candidate, block) == 4 &&
                       offsetof(df_candidate, cell) == 8 && offsetof(df_candidate, flags) == 14,
                   "four words, as they are taken apart here");
    const void *from[DF_LANES];
    const li half = li_set(0xFFFF);
    li word[4];
    for (uint32_t i = 0; i < DF_LANES; i++) from[i] = &candidates[i < lanes ? i : lanes - 1];
    li_load_4(from, word);
    return (lanes_of){word[0],
                      word[1],
                      {li_and(word[2], half), li_shift_right(word[2], 16), li_and(word[3], half)},
                      li_and(li_shift_right(word[3], 16), li_set(0xFF))};
}

/* The sizes of octree leaves with these flags. */
static lf leaf_sizes(li flags) {
    int32_t flag[DF_LANES];
    float size[DF_LANES];
    li_store(flag, flags);
    for (int i = 0; i < DF_LANES; i++) size[i] = (float)(1u << (flag[i] >> DF_HIT_SIZE_SHIFT));
    return lf_load(size);
}

static void gather(const df_scene *scene, const df_rays *rays, const lanes_of *of, batch *in) {
    int32_t cell[3][DF_LANES], block[DF_LANES];
    for (int a = 0; a < 3; a++) {
        in->origin[a] = rays->shared_origin ? lf_set(rays->origin[a][0]) : lf_gather(rays->origin[a], of->ray);
        in->direction[a] = lf_gather(rays->direction[a], of->ray);
        in->cell[a] = lf_from_li(of->cell[a]);
        li_store(cell[a], of->cell[a]);
    }
    li_store(block, of->block);
    in->size = scene->levels ? lf_set(1) : leaf_sizes(of->flags);
    in->inside = lf_from_li(li_and(of->flags, li_set(DF_HIT_BACK)));
    if (scene->levels) {
        const uint32_t all = (uint32_t)((1ull << DF_LANES) - 1);
        DF_FETCH_BY_TYPE(scene->field->sample_type, df_fetch_cells, scene, cell, block, all, in->corner);
        return;
    }
    float corners[DF_LANES][8];
    const float *from[DF_LANES];
    for (uint32_t i = 0; i < DF_LANES; i++) {
        from[i] = corners[i];
        df_scene_corners(scene, NULL, (uint32_t)block[i], corners[i]);
    }
    lf_load_8(from, in->corner);
}

/* The closed form is no text of lanes: isolation as always, then the root inside the bracket, lane by lane. */
static ld solve_analytic(const ld bernstein[4], ldm inside) {
    ld bern[4] = {bernstein[0], bernstein[1], bernstein[2], bernstein[3]}, extremum;
    df_cubic_scale_f64(bern);
    df_bracket_f64 part = df_isolate_f64(bern, inside, &extremum);
    double b[4][DF_DOUBLE_LANES], low[DF_DOUBLE_LANES], high[DF_DOUBLE_LANES], s[DF_DOUBLE_LANES];
    for (int i = 0; i < 4; i++) ld_store(b[i], bern[i]);
    ld_store(low, part.low);
    ld_store(high, part.high);
    for (int i = 0; i < DF_DOUBLE_LANES; i++)
        s[i] = df_cubic_first_root((const double[4]){b[0][i], b[1][i], b[2][i], b[3][i]}, low[i], high[i]);
    return ld_select(part.found, ld_load(s), df_solve_f64(DF_SOLVE_MARMITT, 0, bernstein, inside, ld_set(0)));
}

enum { PARTS = DF_LANES / DF_DOUBLE_LANES };

/* The s of PARTS cubics. Robust steps take turns: one waits for the other's division. */
static inline void solve_cubics(const df_trace_options *options, const ld bern[PARTS][4], const ldm inside[PARTS],
                                ld s[PARTS]) {
    const int steps = options->steps ? options->steps : df_solve_steps(options->solve);
    const ld tolerance = ld_set(SOLVE_TOLERANCE);
    if (options->solve != DF_SOLVE_ROBUST) {
        for (int part = 0; part < PARTS; part++) {
            s[part] = options->solve == DF_SOLVE_ANALYTIC
                          ? solve_analytic(bern[part], inside[part])
                          : df_solve_f64(options->solve, steps, bern[part], inside[part], tolerance);
        }
        return;
    }
    df_root_f64 root[PARTS];
    for (int part = 0; part < PARTS; part++) df_root_begin_f64(DF_SOLVE_ROBUST, bern[part], inside[part], &root[part]);
    for (int i = 0; i < steps; i++) {
        ldm done = root[0].done;
        for (int part = 1; part < PARTS; part++) done = ldm_and(done, root[part].done);
        if (!ldm_any(ldm_not(done))) break;
        for (int part = 0; part < PARTS; part++) df_illinois_step_f64(&root[part], tolerance);
    }
    for (int part = 0; part < PARTS; part++) s[part] = df_root_end_f64(&root[part]);
}

/* Solves a batch for the hits from `at` on, in double. size_is_1: of all cells, which saves a division. */
static inline void solve_batch_f64(const batch *in, bool size_is_1, const df_trace_options *options, df_hits *hits,
                                   uint32_t at) {
    df_segment_f64 segment[PARTS];
    ldm inside[PARTS];
    ld bern[PARTS][4], s[PARTS];
    for (int part = 0; part < PARTS; part++) {
        ld origin[3], direction[3], inverse[3], cell[3], corner[8];
        for (int a = 0; a < 3; a++) {
            origin[a] = ld_part(in->origin[a], part);
            direction[a] = ld_part(in->direction[a], part);
            inverse[a] = ld_set(1) / direction[a];
            cell[a] = ld_part(in->cell[a], part);
        }
        for (int k = 0; k < 8; k++) corner[k] = ld_part(in->corner[k], part);
        const ld size = size_is_1 ? ld_set(1) : ld_part(in->size, part);
        inside[part] = ld_lt(ld_set(0), ld_part(in->inside, part));
        df_cell_segment_f64(origin, direction, inverse, ld_set(0), cell, size, &segment[part]);
        df_bernstein_f64(corner, segment[part].a, segment[part].b, bern[part]);
    }
    solve_cubics(options, bern, inside, s);
    for (int part = 0; part < PARTS; part++, at += DF_DOUBLE_LANES) {
        const df_segment_f64 *g = &segment[part];
        ld_store(hits->t + at, df_lerp_f64(g->t_in, ld_max(g->t_in, g->t_out), s[part]));
        for (int a = 0; a < 3; a++) ld_store_f32(hits->local[a] + at, df_lerp_f64(g->a[a], g->b[a], s[part]));
    }
}

/* The same in float: the very segment and cubic that the walk has accepted. Only t is put together in double, so that
 * what rounds is the entry and the position between entry and exit, not their sum. */
static inline void solve_batch_f32(const batch *in, const df_trace_options *options, df_hits *hits, uint32_t at) {
    const int steps = options->steps ? options->steps : df_solve_steps(options->solve);
    df_segment_f32 g;
    lf inverse[3], bern[4];
    for (int a = 0; a < 3; a++) inverse[a] = lf_set(1) / in->direction[a];
    df_cell_segment_f32(in->origin, in->direction, inverse, lf_set(0), in->cell, in->size, &g);
    df_bernstein_f32(in->corner, g.a, g.b, bern);
    const lm inside = lf_lt(lf_set(0), in->inside);
    const lf s = df_solve_f32(options->solve, steps, bern, inside, lf_set(SOLVE_TOLERANCE_F32));
    const lf t_out = lf_max(g.t_in, g.t_out);
    for (int a = 0; a < 3; a++) lf_store(hits->local[a] + at, df_lerp_f32(g.a[a], g.b[a], s));
    for (int part = 0; part < PARTS; part++) {
        const ld t = df_lerp_f64(ld_part(g.t_in, part), ld_part(t_out, part), ld_part(s, part));
        ld_store(hits->t + at + part * DF_DOUBLE_LANES, t);
    }
}

static inline void solve_batch(const batch *in, bool size_is_1, const df_trace_options *options, df_hits *hits,
                               uint32_t at) {
    for (int a = 0; a < 3; a++) lf_store(hits->direction[a] + at, in->direction[a]);
    if (options->precision == DF_PRECISION_F32) solve_batch_f32(in, options, hits, at);
    else solve_batch_f64(in, size_is_1, options, hits, at);
}

void DF_KERNEL(df_kernel_solve)(const df_scene *scene, const df_trace_options *options, const df_rays *rays,
                                const df_candidate *candidates, uint32_t count, df_hits *hits) {
    assert(hits->count + count <= hits->capacity);
    for (uint32_t first = 0; first < count; first += DF_LANES) {
        const uint32_t at = hits->count, lanes = count - first < DF_LANES ? count - first : DF_LANES;
        const lanes_of of = load_candidates(candidates + first, lanes);
        batch in;
        gather(scene, rays, &of, &in);
        solve_batch(&in, scene->levels, options, hits, at);
        li_store((int32_t *)hits->ray + at, of.ray);
        li_store((int32_t *)hits->block + at, of.block);
        for (int a = 0; a < 3; a++) li_store_u16(hits->cell[a] + at, of.cell[a]);
        for (uint32_t i = 0; i < lanes; i++) hits->flags[at + i] = candidates[first + i].flags;
        for (uint32_t i = 0; i < lanes && rays->t_base; i++) hits->t[at + i] += rays->t_base[candidates[first + i].ray];
        hits->count += lanes;
    }
}

/* What splatting found, waiting to be solved DF_LANES at a time. */
typedef struct splats {
    uint32_t count;
    int32_t ray[2 * DF_LANES], record[2 * DF_LANES], block[2 * DF_LANES];
    float direction[3][2 * DF_LANES];
} splats;

/* Takes what was found for the DF_LANES rays from `first` on, of which `lanes` count. */
static void take_splats(const df_splat_job *job, uint32_t first, lm lanes, splats *found) {
    int32_t number[DF_LANES];
    for (int i = 0; i < DF_LANES; i++) number[i] = (int32_t)first + i;
    const lm hit = lm_and(lanes, lf_lt(lf_load(job->depth + first), lf_set(INFINITY)));
    const uint32_t at = found->count;
    if (!lm_any(hit)) return;
    li_compress(found->ray + at, hit, li_load(number));
    li_compress(found->record + at, hit, li_load((const int32_t *)job->record + first));
    li_compress(found->block + at, hit, li_load((const int32_t *)job->block + first));
    for (int a = 0; a < 3; a++)
        lf_compress(found->direction[a] + at, hit, lf_load(job->tile->rays.direction[a] + first));
    found->count += lm_count(lm_bits(hit));
}

/* Solves up to DF_LANES of what waits. */
static void solve_splats(const df_splat_job *job, const df_trace_options *options, splats *found, df_hits *hits) {
    const df_surface *surface = job->surface;
    const uint32_t lanes = found->count < DF_LANES ? found->count : DF_LANES, at = hits->count;
    for (uint32_t i = lanes; i < DF_LANES; i++) { /* repeats the first */
        found->record[i] = found->record[0];
        found->block[i] = found->block[0];
        for (int a = 0; a < 3; a++) found->direction[a][i] = found->direction[a][0];
    }
    const li block = li_load(found->block), back = li_shift_right(li_load(found->record), 31),
             record = li_and(li_load(found->record), li_set((int32_t)~DF_SPLAT_BACK)),
             voxel = li_gather((const int32_t *)surface->voxels, record), mask = li_set((1 << surface->k_shift) - 1);
    int32_t records[DF_LANES], backs[DF_LANES];
    batch in;
    li_store(records, record);
    li_store(backs, back);
    li_store((int32_t *)hits->ray + at, li_load(found->ray));
    if (!surface->leaves) {
        li_store((int32_t *)hits->block + at, block);
        for (uint32_t i = 0; i < lanes; i++) hits->flags[at + i] = (uint8_t)backs[i];
        in.size = lf_set(1);
    } else {
        const li size_log2 = li_and(li_shift_right(voxel, DF_SURFACE_SIZE), li_set(15));
        int32_t sizes[DF_LANES];
        float size[DF_LANES];
        li_store((int32_t *)hits->block + at, li_gather((const int32_t *)surface->leaves, record));
        li_store(sizes, size_log2);
        for (uint32_t i = 0; i < DF_LANES; i++) {
            hits->flags[at + i] = (uint8_t)(backs[i] | sizes[i] << DF_HIT_SIZE_SHIFT);
            size[i] = (float)(1u << sizes[i]);
        }
        in.size = lf_load(size);
    }
    for (int a = 0; a < 3; a++) {
        const li cell = li_add(li_gather((const int32_t *)surface->corner[a], block),
                               li_and(li_shift_right(voxel, a * (int)surface->k_shift), mask));
        li_store_u16(hits->cell[a] + at, cell);
        in.cell[a] = lf_from_li(cell);
        in.origin[a] = lf_set(job->tile->rays.origin[a][0]);
        in.direction[a] = lf_load(found->direction[a]);
    }
    in.inside = lf_from_li(back);
    DF_FETCH_BY_TYPE(surface->sample_type, df_fetch_records, job->scene, surface, records, found->block, in.corner);
    solve_batch(&in, !surface->leaves, options, hits, at);
    hits->count += lanes;
    found->count -= lanes;
    li_store(found->ray, li_load(found->ray + DF_LANES));
    li_store(found->record, li_load(found->record + DF_LANES));
    li_store(found->block, li_load(found->block + DF_LANES));
    for (int a = 0; a < 3; a++) lf_store(found->direction[a], lf_load(found->direction[a] + DF_LANES));
}

/* Hits come in squares of pixels this wide, so that what they read of the field stays in the nearest cache. */
#define SQUARE 16u

void DF_KERNEL(df_kernel_splat_solve)(const df_splat_job *job, const df_trace_options *options, df_hits *hits) {
    const uint32_t width = job->tile->width, height = job->tile->height;
    splats found;
    found.count = 0;
    for (uint32_t top = 0; top < height; top += SQUARE) {
        for (uint32_t left = 0; left < width; left += SQUARE) {
            const uint32_t bottom = top + SQUARE < height ? top + SQUARE : height;
            const uint32_t right = left + SQUARE < width ? left + SQUARE : width;
            for (uint32_t y = top; y < bottom; y++) {
                for (uint32_t x = left; x < right; x += DF_LANES) {
                    take_splats(job, y * width + x, lm_first(right - x), &found);
                    if (found.count >= DF_LANES) solve_splats(job, options, &found, hits);
                }
            }
        }
    }
    if (found.count) solve_splats(job, options, &found, hits);
}
