/* The bounds of neighbouring rays from one point, and the cells that they meet slice by slice across an axis. C only.
 */
#ifndef DF_FRUSTUM_H
#define DF_FRUSTUM_H

#include "render/scene.h"

#include <math.h>

/* Grid units by which bounds are widened: far more than their rounding. */
#define DF_FRUSTUM_MARGIN 0.01f

typedef struct df_frustum {
    float origin[3];
    int main, u, v;    /* the axis along which its rays go most, and the others */
    float sign;        /* the direction along the main one: 1 or -1 */
    float least;       /* a ray belongs to it only if it goes that far along the main axis */
    float slope[2][2]; /* by minor axis u, v: least and greatest of direction over |direction along the main axis| */
} df_frustum;

/* A rectangle of cells across the main axis, inclusive. */
typedef struct df_frustum_cells {
    int32_t low[2], high[2]; /* by minor axis */
} df_frustum_cells;

/* The frustum of nothing yet, along the main axis of a direction. */
static inline void df_frustum_begin(df_frustum *f, const float origin[3], const float direction[3]) {
    const float d[3] = {fabsf(direction[0]), fabsf(direction[1]), fabsf(direction[2])};
    for (int a = 0; a < 3; a++) f->origin[a] = origin[a];
    f->main = d[0] >= d[1] && d[0] >= d[2] ? 0 : d[1] >= d[2] ? 1 : 2;
    f->u = (f->main + 1) % 3;
    f->v = (f->main + 2) % 3;
    f->sign = direction[f->main] > 0 ? 1 : -1;
    f->least = 0.01f * d[f->main];
    for (int i = 0; i < 2; i++) {
        f->slope[i][0] = INFINITY;
        f->slope[i][1] = -INFINITY;
    }
}

/* Widens it by a ray; false where that goes another way. */
static inline bool df_frustum_add(df_frustum *f, const float direction[3]) {
    const float along = direction[f->main] * f->sign;
    if (!(along > f->least)) return false;
    for (int i = 0; i < 2; i++) {
        const float slope = direction[i ? f->v : f->u] / along;
        f->slope[i][0] = slope < f->slope[i][0] ? slope : f->slope[i][0];
        f->slope[i][1] = slope > f->slope[i][1] ? slope : f->slope[i][1];
    }
    return true;
}

/* The cells of `size` voxels that it may meet between two planes across the main axis; false when none within the
 * limits. */
static inline bool df_frustum_slice(const df_frustum *f, float plane_low, float plane_high, float size,
                                    const int32_t low[2], const int32_t high[2], df_frustum_cells *out) {
    const float near = ((f->sign > 0 ? plane_low : plane_high) - f->origin[f->main]) * f->sign;
    const float to = ((f->sign > 0 ? plane_high : plane_low) - f->origin[f->main]) * f->sign;
    if (to < 0) return false; /* behind the eye */
    const float from = near < 0 ? 0 : near;
    for (int i = 0; i < 2; i++) {
        const float origin = f->origin[i ? f->v : f->u], least = f->slope[i][0], most = f->slope[i][1];
        const float below = least < 0 ? to * least : from * least, above = most > 0 ? to * most : from * most;
        const float first = floorf((origin + below - DF_FRUSTUM_MARGIN) / size);
        const float last = floorf((origin + above + DF_FRUSTUM_MARGIN) / size);
        if (!(last >= (float)low[i]) || !(first <= (float)high[i])) return false;
        out->low[i] = first < (float)low[i] ? low[i] : (int32_t)first;
        out->high[i] = last > (float)high[i] ? high[i] : (int32_t)last;
    }
    return true;
}

/* Whether it may meet a coarse cell with a block in slice n of a scene of two levels, counted along the rays. */
static inline bool df_frustum_holds(const df_frustum *f, const df_scene *scene, int32_t n) {
    const uint32_t *count = scene->coarse_count;
    const size_t stride[3] = {1, count[0], (size_t)count[0] * count[1]};
    const int32_t along = f->sign > 0 ? n : (int32_t)count[f->main] - 1 - n, low[2] = {0, 0},
                  high[2] = {(int32_t)count[f->u] - 1, (int32_t)count[f->v] - 1};
    const float k = (float)scene->k;
    df_frustum_cells cells;
    if (!df_frustum_slice(f, (float)along * k, (float)(along + 1) * k, k, low, high, &cells)) return false;
    const uint32_t *slice = scene->coarse + (size_t)along * stride[f->main];
    for (int32_t v = cells.low[1]; v <= cells.high[1]; v++) {
        for (int32_t u = cells.low[0]; u <= cells.high[0]; u++) {
            if (slice[(size_t)u * stride[f->u] + (size_t)v * stride[f->v]] < DF_CELL_INSIDE) return true;
        }
    }
    return false;
}

#endif
