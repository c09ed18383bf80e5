/* Where in a cell its surface lies, by lanes: the box of a record (df_surface.voxels). */
#ifndef DF_SURFACE_BOX_H
#define DF_SURFACE_BOX_H

#include "render/cpu/kernels.h"
#include "render/methods/lane.h"

/* How far from one of a cell's faces the surface begins: the largest s in [0,1] such that within s of the face no value
 * comes within `least` of 0. axis: the bit of the axis in a corner's number; face: the same bit, or 0. */
static inline lf df_surface_begin(const lf corner[8], int axis, int face, lf least) {
    const lf zero = lf_set(0), sign = lf_select(lf_lt(corner[face], zero), lf_set(-1), lf_set(1));
    const int u = axis == 1 ? 2 : 1, v = axis == 4 ? 2 : 4;
    lf begin = lf_set(1);
    for (int i = 0; i < 4; i++) {
        const int c = face + (i & 1 ? u : 0) + (i & 2 ? v : 0);
        const lf low = sign * corner[c], high = sign * corner[c ^ axis];
        const lm at_once = lf_le(low, least);
        const lf fall = lf_select(at_once, lf_set(1), low - lf_min(high, least));
        begin = lf_min(lf_select(at_once, zero, (low - least) / fall), begin);
    }
    return begin;
}

/* The box, in its bits of a record, of all points where the field's magnitude is not far above what rounding makes of
 * 0, widened by `margin`, in parts of the cell, for what rounding does to places: no ray that any arithmetic lets hit
 * the surface in the cell passes it by. */
static inline li df_surface_box_bits(const lf corner[8], lf margin) {
    const lf zero = lf_set(0), one = lf_set(1), eight = lf_set(8);
    lf largest = zero;
    li bits = li_set(0);
    for (int c = 0; c < 8; c++) largest = lf_max(lf_abs(corner[c]), largest);
    const lf least = lf_set(1e-5f) * largest;
    for (int a = 0; a < 3; a++) {
        const lf first = df_surface_begin(corner, 1 << a, 0, least) - margin;
        const lf last = (one - df_surface_begin(corner, 1 << a, 1 << a, least)) + margin;
        const li low = li_from_lf(eight * lf_max(first, zero)), high = li_from_lf(lf_min(eight * last, lf_set(7)));
        bits = li_add(bits, li_mul(low, li_set(1 << (DF_SURFACE_LOW + 3 * a))));
        bits = li_add(bits, li_mul(high, li_set(1 << (DF_SURFACE_HIGH + 3 * a))));
    }
    return bits;
}

#endif
