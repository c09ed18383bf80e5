/*
 * Gradients of the field at a hit. Float lanes, also OpenCL C: include lane.h first.
 *
 * A stencil holds the 4x4x4 samples around a cell: sample (i,j,k), each in -1..2 relative to the cell's lower corner,
 * stands at (i+1) + 4 ((j+1) + 4 (k+1)). How much of it a method reads is its df_gradient_reach. Where the field stores
 * no sample, the stencil holds the linear extrapolation from the two samples before it, so that a difference there
 * becomes one-sided.
 *
 * All gradients are per step between samples, a voxel or the side of an octree's leaf; the caller divides by its size
 * along each axis.
 */
#ifndef DF_GRADIENT_H
#define DF_GRADIENT_H

#include "render/methods/lane.h"

#define DF_GRADIENT_ANALYTIC 0       /* of the trilinear field: exact, but jumps from cell to cell */
#define DF_GRADIENT_CENTRAL 1        /* differences of interpolated values one voxel before and after the hit */
#define DF_GRADIENT_FORWARD 2        /* the hit and one voxel after it */
#define DF_GRADIENT_BACKWARD 3       /* one voxel before the hit and the hit */
#define DF_GRADIENT_CORNER_CENTRAL 4 /* central differences at the corners, interpolated */
#define DF_GRADIENT_CORNER_FORWARD 5 /* forward differences at the corners, interpolated */
#define DF_GRADIENT_C0 6             /* analytic in the 8 nearest cells, blended: continuous */
#define DF_GRADIENT_CREASE 7         /* corner-central, or analytic where its length betrays an edge */
#define DF_GRADIENT_COUNT 8

#define DF_STENCIL(i, j, k) (((i) + 1) + 4 * (((j) + 1) + 4 * ((k) + 1)))

/* The part of a stencil that is filled: the cell's corners, also the samples beyond its faces, or all. */
#define DF_REACH_CELL 0
#define DF_REACH_FACES 1
#define DF_REACH_ALL 2

static inline int df_gradient_reach(int method) {
    return method == DF_GRADIENT_ANALYTIC ? DF_REACH_CELL : method == DF_GRADIENT_C0 ? DF_REACH_ALL : DF_REACH_FACES;
}

/* The sample (i,j,k) = at, outside the cell, extended from the two before it along the first axis on which it is
 * outside; sample s stands at stencil[s * step]. */
static inline float df_stencil_extend(const float *stencil, size_t step, const int at[3]) {
    int near[3] = {at[0], at[1], at[2]}, next[3] = {at[0], at[1], at[2]}, a = 0;
    while (a < 2 && at[a] >= 0 && at[a] <= 1) a++;
    near[a] = at[a] < 0 ? 0 : 1;
    next[a] = 1 - near[a];
    float value = stencil[(size_t)DF_STENCIL(near[0], near[1], near[2]) * step];
    return (value + value) - stencil[(size_t)DF_STENCIL(next[0], next[1], next[2]) * step];
}

/* Of how many axes a sample lies outside the cell. */
static inline int df_stencil_outside(const int at[3]) {
    return (at[0] < 0 || at[0] > 1) + (at[1] < 0 || at[1] > 1) + (at[2] < 0 || at[2] > 1);
}

static inline lf df_mix(lf a, lf b, lf t) { return (lf_set(1) - t) * a + t * b; }

/* Interpolation of the 8 samples of the stencil whose lower corner is at offset (i,j,k). */
static inline lf df_stencil_interpolate(const lf *stencil, int i, int j, int k, const lf p[3]) {
    const lf *c = stencil + DF_STENCIL(i, j, k);
    lf y0 = df_mix(df_mix(c[0], c[1], p[0]), df_mix(c[4], c[5], p[0]), p[1]);
    lf y1 = df_mix(df_mix(c[16], c[17], p[0]), df_mix(c[20], c[21], p[0]), p[1]);
    return df_mix(y0, y1, p[2]);
}

static inline void df_gradient_analytic(const lf *stencil, const lf p[3], lf gradient[3]) {
    const lf *c = stencil + DF_STENCIL(0, 0, 0);
    const int stride[3] = {1, 4, 16};
    for (int a = 0; a < 3; a++) {
        int u = (a + 1) % 3, v = (a + 2) % 3, s = stride[a], su = stride[u], sv = stride[v];
        lf low = df_mix(c[s] - c[0], c[s + su] - c[su], p[u]);
        lf high = df_mix(c[s + sv] - c[sv], c[s + su + sv] - c[su + sv], p[u]);
        gradient[a] = df_mix(low, high, p[v]);
    }
}

/* Differences of values interpolated at the hit moved by `before` and `after` voxels along each axis. */
static inline void df_gradient_difference(const lf *stencil, const lf p[3], int before, int after, lf gradient[3]) {
    const lf scale = lf_set(before + after == 2 ? 0.5f : 1.0f);
    for (int a = 0; a < 3; a++) {
        int x = a == 0, y = a == 1, z = a == 2;
        lf high = df_stencil_interpolate(stencil, x * after, y * after, z * after, p);
        lf low = df_stencil_interpolate(stencil, -x * before, -y * before, -z * before, p);
        gradient[a] = (high - low) * scale;
    }
}

/* Differences at the corners, interpolated at the hit. */
static inline void df_gradient_corners(const lf *stencil, const lf p[3], int before, int after, lf gradient[3]) {
    const lf scale = lf_set(before + after == 2 ? 0.5f : 1.0f);
    const int stride[3] = {1, 4, 16};
    for (int a = 0; a < 3; a++) {
        const lf *high = stencil + DF_STENCIL(0, 0, 0) + after * stride[a];
        const lf *low = stencil + DF_STENCIL(0, 0, 0) - before * stride[a];
        lf x[4];
        for (int i = 0; i < 4; i++) {
            int at = 4 * (i & 1) + 16 * (i >> 1);
            x[i] = df_mix(high[at] - low[at], high[at + 1] - low[at + 1], p[0]);
        }
        gradient[a] = df_mix(df_mix(x[0], x[1], p[1]), df_mix(x[2], x[3], p[1]), p[2]) * scale;
    }
}

/* The 2x2x2 cells whose middles surround the hit, each with its own analytic gradient at the hit (extended beyond the
 * cell), blended by the hit's place between the middles: no jump at a face, nor where the cells change. */
static inline void df_gradient_c0(const lf *stencil, const lf p[3], lf gradient[3]) {
    const lf half_cell = lf_set(0.5f), one = lf_set(1);
    lf x[48], y[36], s[27], q[3], weight[3]; /* 3 samples of 4 along x, then along y, then along z */
    lm low[3];
    for (int a = 0; a < 3; a++) {
        low[a] = lf_lt(p[a], half_cell);
        q[a] = lf_select(low[a], p[a] + one, p[a]); /* from the lower corner of the 2x2x2 cells */
        weight[a] = q[a] - half_cell;
    }
    for (int i = 0; i < 48; i++)
        x[i] = lf_select(low[0], stencil[4 * (i / 3) + i % 3], stencil[4 * (i / 3) + i % 3 + 1]);
    for (int i = 0; i < 36; i++) y[i] = lf_select(low[1], x[12 * (i / 9) + i % 9], x[12 * (i / 9) + i % 9 + 3]);
    for (int i = 0; i < 27; i++) s[i] = lf_select(low[2], y[i], y[i + 9]);
    for (int a = 0; a < 3; a++) {
        const int u = (a + 1) % 3, v = (a + 2) % 3, stride[3] = {1, 3, 9};
        const int sa = stride[a], su = stride[u], sv = stride[v];
        lf along[2]; /* the component in the cells below and above the hit along a */
        for (int i = 0; i < 2; i++) {
            lf of_cell[4];
            for (int n = 0; n < 4; n++) {
                const lf *c = s + i * sa + (n & 1) * su + (n >> 1) * sv;
                const lf pu = q[u] - lf_set((float)(n & 1)), pv = q[v] - lf_set((float)(n >> 1));
                const lf first = df_mix(c[sa] - c[0], c[sa + su] - c[su], pu);
                const lf second = df_mix(c[sa + sv] - c[sv], c[sa + su + sv] - c[su + sv], pu);
                of_cell[n] = df_mix(first, second, pv);
            }
            along[i] =
                df_mix(df_mix(of_cell[0], of_cell[1], weight[u]), df_mix(of_cell[2], of_cell[3], weight[u]), weight[v]);
        }
        gradient[a] = df_mix(along[0], along[1], weight[a]);
    }
}

/* The seed's rule (Vavra 2010, 3.1.2): a distance has a gradient of length 1; where that of corner-central is more than
 * 3 % away from it, its samples lie on both sides of an edge, and the analytic one, which looks no farther than the
 * cell, is nearer to the truth. */
static inline void df_gradient_crease(const lf *stencil, const lf p[3], const lf inverse_step[3], lf gradient[3]) {
    lf inner[3], sum = lf_set(0);
    df_gradient_corners(stencil, p, 1, 1, gradient);
    for (int a = 0; a < 3; a++) {
        const lf slope = gradient[a] * inverse_step[a];
        sum = sum + slope * slope;
    }
    const lm edge = lf_lt(lf_set(0.03f), lf_abs(lf_sqrt(sum) - lf_set(1)));
    if (!lm_any(edge)) return;
    df_gradient_analytic(stencil, p, inner);
    for (int a = 0; a < 3; a++) gradient[a] = lf_select(edge, inner[a], gradient[a]);
}

/* inverse_step: 1 / the distance between samples along each axis, in the field's unit of value. */
static inline void df_gradient(int method, const lf *stencil, const lf p[3], const lf inverse_step[3], lf gradient[3]) {
    switch (method) {
    case DF_GRADIENT_C0: df_gradient_c0(stencil, p, gradient); break;
    case DF_GRADIENT_CREASE: df_gradient_crease(stencil, p, inverse_step, gradient); break;
    case DF_GRADIENT_CENTRAL: df_gradient_difference(stencil, p, 1, 1, gradient); break;
    case DF_GRADIENT_FORWARD: df_gradient_difference(stencil, p, 0, 1, gradient); break;
    case DF_GRADIENT_BACKWARD: df_gradient_difference(stencil, p, 1, 0, gradient); break;
    case DF_GRADIENT_CORNER_CENTRAL: df_gradient_corners(stencil, p, 1, 1, gradient); break;
    case DF_GRADIENT_CORNER_FORWARD: df_gradient_corners(stencil, p, 0, 1, gradient); break;
    default: df_gradient_analytic(stencil, p, gradient); break;
    }
}

#endif
