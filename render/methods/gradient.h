/*
 * Gradients of the field at a hit. Float lanes, also OpenCL C: include lane.h first.
 *
 * A stencil holds the 4x4x4 samples around a cell: sample (i,j,k), each in -1..2 relative to the cell's lower corner,
 * stands at (i+1) + 4 ((j+1) + 4 (k+1)). Its 8 edges and corners that lie outside the cell along more than one axis are
 * never read. Where the field stores no sample, the stencil holds the linear extrapolation from the two samples before
 * it, so that a difference there becomes one-sided.
 *
 * All gradients are per voxel; the caller divides by the voxel size of each axis.
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
#define DF_GRADIENT_COUNT 6

#define DF_STENCIL(i, j, k) (((i) + 1) + 4 * (((j) + 1) + 4 * ((k) + 1)))

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

static inline void df_gradient(int method, const lf *stencil, const lf p[3], lf gradient[3]) {
    switch (method) {
    case DF_GRADIENT_CENTRAL: df_gradient_difference(stencil, p, 1, 1, gradient); break;
    case DF_GRADIENT_FORWARD: df_gradient_difference(stencil, p, 0, 1, gradient); break;
    case DF_GRADIENT_BACKWARD: df_gradient_difference(stencil, p, 1, 0, gradient); break;
    case DF_GRADIENT_CORNER_CENTRAL: df_gradient_corners(stencil, p, 1, 1, gradient); break;
    case DF_GRADIENT_CORNER_FORWARD: df_gradient_corners(stencil, p, 0, 1, gradient); break;
    default: df_gradient_analytic(stencil, p, gradient); break;
    }
}

#endif
