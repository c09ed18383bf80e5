/* Accepted cells to hits: DF_DOUBLE_LANES cells at a time, each ray rebased to its cell in double. */
#include "render/cpu/fetch.h"
#include "render/cpu/kernel.h"
#include "render/methods/cubic.h"

#include <assert.h>

#include "render/methods/lane_f64.h"

#include "render/methods/cell.h"
#include "render/methods/solve.h"

/* Illinois steps end where the position moves less than this, in parts of the segment: the step that shows it has
 * converged to far less, as its order is 1.44. The same as in hit.h. */
#define SOLVE_TOLERANCE 1e-8

enum { N = DF_DOUBLE_LANES };

/* The inputs of DF_LANES cells as columns. */
typedef struct batch {
    float origin[3][DF_LANES], direction[3][DF_LANES], cell[3][DF_LANES], size[DF_LANES], corner[8][DF_LANES],
        inside[DF_LANES];
} batch;

static inline void fetch_corners(const df_scene *scene, const df_candidate *candidates, uint32_t lanes,
                                 float corners[DF_LANES][8], df_sample_type type) {
    for (uint32_t i = 0; i < lanes; i++) {
        const uint32_t voxel[3] = {candidates[i].cell[0], candidates[i].cell[1], candidates[i].cell[2]};
        df_fetch_corners(scene, voxel, candidates[i].block, corners[i], type);
    }
}

/* Lanes past the last candidate repeat it. */
static void gather(const df_scene *scene, const df_rays *rays, const df_candidate *candidates, uint32_t lanes,
                   batch *in) {
    float corners[DF_LANES][8];
    const float *from[DF_LANES];
    lf corner[8];
    if (scene->levels) {
        DF_FETCH_BY_TYPE(scene->field->sample_type, fetch_corners, scene, candidates, lanes, corners);
    } else {
        for (uint32_t i = 0; i < lanes; i++) df_scene_corners(scene, NULL, candidates[i].block, corners[i]);
    }
    for (uint32_t i = 0; i < DF_LANES; i++) {
        const uint32_t lane = i < lanes ? i : lanes - 1;
        const df_candidate *c = &candidates[lane];
        for (int a = 0; a < 3; a++) {
            in->origin[a][i] = rays->origin[a][rays->shared_origin ? 0 : c->ray];
            in->direction[a][i] = rays->direction[a][c->ray];
            in->cell[a][i] = (float)c->cell[a];
        }
        in->size[i] = (float)(1u << (c->flags >> DF_HIT_SIZE_SHIFT));
        in->inside[i] = c->flags & DF_HIT_BACK ? 1 : 0;
        from[i] = corners[lane];
    }
    lf_load_8(from, corner);
    for (int k = 0; k < 8; k++) lf_store(in->corner[k], corner[k]);
}

/* The closed form is no text of lanes: isolation as always, then the root inside the bracket, lane by lane. */
static ld solve_analytic(const ld bernstein[4], ldm inside) {
    ld bern[4] = {bernstein[0], bernstein[1], bernstein[2], bernstein[3]}, extremum;
    df_cubic_scale_f64(bern);
    df_bracket_f64 part = df_isolate_f64(bern, inside, &extremum);
    double b[4][N], low[N], high[N], s[N];
    for (int i = 0; i < 4; i++) ld_store(b[i], bern[i]);
    ld_store(low, part.low);
    ld_store(high, part.high);
    for (int i = 0; i < N; i++)
        s[i] = df_cubic_first_root((const double[4]){b[0][i], b[1][i], b[2][i], b[3][i]}, low[i], high[i]);
    return ld_select(part.found, ld_load(s), df_solve_f64(DF_SOLVE_MARMITT, 0, bernstein, inside, ld_set(0)));
}

/* N cells of a batch from lane `first` on. size: of the cells; a constant 1 where it is known, which saves a division.
 */
static inline void solve_part(const batch *in, int first, ld size, const df_trace_options *options, int steps,
                              double *t, float *const local[3]) {
    ld origin[3], direction[3], inverse[3], cell[3], corner[8], bern[4];
    for (int a = 0; a < 3; a++) {
        origin[a] = ld_load_f32(in->origin[a] + first);
        direction[a] = ld_load_f32(in->direction[a] + first);
        inverse[a] = ld_set(1) / direction[a];
        cell[a] = ld_load_f32(in->cell[a] + first);
    }
    for (int k = 0; k < 8; k++) corner[k] = ld_load_f32(in->corner[k] + first);
    const ldm inside = ld_lt(ld_set(0), ld_load_f32(in->inside + first));
    df_segment_f64 segment;
    df_cell_segment_f64(origin, direction, inverse, ld_set(0), cell, size, &segment);
    df_bernstein_f64(corner, segment.a, segment.b, bern);
    ld s = options->solve == DF_SOLVE_ANALYTIC
               ? solve_analytic(bern, inside)
               : df_solve_f64(options->solve, steps, bern, inside, ld_set(SOLVE_TOLERANCE));
    ld_store(t + first, df_lerp_f64(segment.t_in, ld_max(segment.t_in, segment.t_out), s));
    for (int a = 0; a < 3; a++) ld_store_f32(local[a] + first, df_lerp_f64(segment.a[a], segment.b[a], s));
}

void DF_KERNEL(df_kernel_solve)(const df_scene *scene, const df_trace_options *options, const df_rays *rays,
                                const df_candidate *candidates, uint32_t count, df_hits *hits) {
    assert(hits->count + count <= hits->capacity);
    const int steps = options->steps ? options->steps : df_solve_steps(options->solve);
    for (uint32_t first = 0; first < count; first += DF_LANES) {
        const uint32_t at = hits->count, lanes = count - first < DF_LANES ? count - first : DF_LANES;
        batch in;
        gather(scene, rays, candidates + first, lanes, &in);
        float *const local[3] = {hits->local[0] + at, hits->local[1] + at, hits->local[2] + at};
        for (int part = 0; part < DF_LANES; part += N) {
            if (scene->levels) solve_part(&in, part, ld_set(1), options, steps, hits->t + at, local);
            else solve_part(&in, part, ld_load_f32(in.size + part), options, steps, hits->t + at, local);
        }
        for (uint32_t i = 0; i < lanes; i++) {
            const df_candidate *c = &candidates[first + i];
            hits->ray[at + i] = c->ray;
            hits->block[at + i] = c->block;
            hits->flags[at + i] = c->flags;
            for (int a = 0; a < 3; a++) hits->cell[a][at + i] = c->cell[a];
            if (rays->t_base) hits->t[at + i] += rays->t_base[c->ray];
        }
        hits->count += lanes;
    }
}
