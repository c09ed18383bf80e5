/*
 * The hit of one ray in the cell that a walk has accepted, in double: the last step of every tracer. Scalar C and
 * OpenCL C.
 */
#ifndef DF_HIT_H
#define DF_HIT_H

#include "render/methods/lane_f64.h"

#include "render/methods/cell.h"
#include "render/methods/cubic.h"
#include "render/methods/solve.h"

/* Illinois steps end where the position moves less than this, in parts of the segment: the step that shows it has
 * converged to far less, as its order is 1.44. The same as in kernel_solve.c. */
#define DF_SOLVE_TOLERANCE 1e-8

/* The closed form is no text of lanes: isolation as always, then the root inside the bracket. */
static inline double df_solve_analytic(const double bernstein[4], int inside) {
    double bern[4] = {bernstein[0], bernstein[1], bernstein[2], bernstein[3]}, extremum;
    df_cubic_scale_f64(bern);
    df_bracket_f64 part = df_isolate_f64(bern, inside, &extremum);
    if (part.found) return df_cubic_first_root(bern, part.low, part.high);
    return df_solve_f64(DF_SOLVE_MARMITT, 0, bernstein, inside, 0);
}

/* Solves a cell with edges of `size` voxels for a ray. stored: the corners minus iso, as the walk saw them; inside: the
 * side at the entry; steps: as df_solve_steps gives them. Sets the hit's position in the cell and returns its t. */
static inline double df_hit_solve(int solve, int steps, const float ray_origin[3], const float ray_direction[3],
                                  const uint32_t voxel[3], float size, const float stored[8], int inside,
                                  float within[3]) {
    double origin[3], direction[3], inverse[3], cell[3], corner[8], bern[4];
    for (int a = 0; a < 3; a++) {
        origin[a] = (double)ray_origin[a];
        direction[a] = (double)ray_direction[a];
        inverse[a] = 1 / direction[a];
        cell[a] = voxel[a];
    }
    for (int k = 0; k < 8; k++) corner[k] = (double)stored[k];
    df_segment_f64 segment;
    df_cell_segment_f64(origin, direction, inverse, 0, cell, (double)size, &segment);
    df_bernstein_f64(corner, segment.a, segment.b, bern);
    double s = solve == DF_SOLVE_ANALYTIC ? df_solve_analytic(bern, inside)
                                          : df_solve_f64(solve, steps, bern, inside, DF_SOLVE_TOLERANCE);
    for (int a = 0; a < 3; a++) within[a] = (float)df_lerp_f64(segment.a[a], segment.b[a], s);
    return df_lerp_f64(segment.t_in, ld_max(segment.t_in, segment.t_out), s);
}

#endif
