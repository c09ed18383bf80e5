/*
 * One ray in one cell: where it enters and leaves, the field along it, and whether the surface lies between.
 *
 * This text is compiled for float and for double, for one lane and for many, and as OpenCL C: include lane_f32.h or
 * lane_f64.h, then this header (it has no include guard; names end in _f32 or _f64). All is in grid space. `corner`
 * holds the 8 values of the cell's corners minus iso (common/field.h gives their order), so that inside is simply "<
 * 0".
 *
 * Watertight: the value on a face of a cell depends on the ray, the axis, the plane and the cell's indices along the
 * other axes, and on nothing else, so that both neighbours compute the same bits. A plane's parameter is (plane -
 * origin) * inverse, never a sum of steps. Direction components are never zero (df_ray_direction), so no parameter is
 * NaN.
 */
#ifndef LR /* alone, as when a compiler checks this header, it is the text of float */
#include "render/methods/lane_f32.h"
#endif

/* The ray inside a cell. Crossing events are ordered by (t, axis, plane); the start of the ray counts as axis 3. */
typedef struct LR(df_segment) {
    lr t_in, t_out;
    lr a[3], b[3]; /* the points of entry and exit, local to the cell, in [0,1]; a crossed coordinate is 0 or 1 */
} LR(df_segment);

static inline lr LR(df_lerp)(lr a, lr b, lr t) {
    return (lr_set(1) - t) * a + t * b; /* the convex form: exact at both ends, monotone, never outside [a,b] in sign */
}

/* Local coordinate of the ray at t: 0 or 1 where the ray crosses this axis there, otherwise computed and clamped. */
static inline lr LR(df_local)(lr origin, lr direction, lr t, lr cell, lr scale, lrm crossed, lr plane) {
    lr p = ((origin + t * direction) - cell) * scale;
    p = lr_min(lr_max(p, lr_set(0)), lr_set(1));
    return lr_select(crossed, plane, p);
}

/*
 * Where the ray passes through the cell with its lower corner at `cell` and edges of length `size`, a power of two.
 * Returns which lanes visit it: those whose entry precedes their exit in the order of events, so that of two cells that
 * meet in an edge which the ray hits exactly, one is visited and the other is not.
 */
static inline lrm LR(df_cell_segment)(const lr origin[3], const lr direction[3], const lr inverse[3], lr t_start,
                                      const lr cell[3], lr size, LR(df_segment) * segment) {
    lr enter[3], leave[3];
    const lr zero = lr_set(0), one = lr_set(1);
    for (int i = 0; i < 3; i++) {
        lr low = (cell[i] - origin[i]) * inverse[i];
        lr high = ((cell[i] + size) - origin[i]) * inverse[i];
        enter[i] = lr_min(low, high);
        leave[i] = lr_max(low, high);
    }
    /* Of equal entries the highest axis is the last, of equal exits the lowest axis is the first. */
    lr enter_xy = lr_max(enter[0], enter[1]), leave_yz = lr_min(leave[1], leave[2]);
    lr enter_all = lr_max(enter_xy, enter[2]);
    lr t_in = lr_max(enter_all, t_start), t_out = lr_min(leave[0], leave_yz);
    lrm by_plane = lr_lt(t_start, enter_all);
    lrm in_z = lr_le(enter_xy, enter[2]);
    lrm in_y = lrm_and(lrm_not(in_z), lr_le(enter[0], enter[1]));
    lrm in_x = lrm_and(by_plane, lrm_not(lrm_or(in_z, in_y)));
    in_z = lrm_and(by_plane, in_z);
    in_y = lrm_and(by_plane, in_y);
    lrm out_x = lr_le(leave[0], leave_yz);
    lrm out_y = lrm_and(lrm_not(out_x), lr_le(leave[1], leave[2]));
    lrm out_z = lrm_not(lrm_or(out_x, out_y));
    lrm axes_in_order = lrm_or(in_x, lrm_or(lrm_and(in_y, lrm_not(out_x)), lrm_and(in_z, out_z)));

    const lrm in[3] = {in_x, in_y, in_z}, out[3] = {out_x, out_y, out_z};
    const lr scale = one / size; /* exact */
    for (int i = 0; i < 3; i++) {
        lrm upward = lr_lt(zero, direction[i]);
        segment->a[i] =
            LR(df_local)(origin[i], direction[i], t_in, cell[i], scale, in[i], lr_select(upward, zero, one));
        segment->b[i] =
            LR(df_local)(origin[i], direction[i], t_out, cell[i], scale, out[i], lr_select(upward, one, zero));
    }
    segment->t_in = t_in;
    segment->t_out = t_out;
    return lrm_or(lr_lt(t_in, t_out), lrm_and(lr_le(t_in, t_out), axes_in_order));
}

/* Trilinear interpolation: x first, then y, then z. */
static inline lr LR(df_interpolate)(const lr corner[8], const lr p[3]) {
    lr y0 = LR(df_lerp)(LR(df_lerp)(corner[0], corner[1], p[0]), LR(df_lerp)(corner[2], corner[3], p[0]), p[1]);
    lr y1 = LR(df_lerp)(LR(df_lerp)(corner[4], corner[5], p[0]), LR(df_lerp)(corner[6], corner[7], p[0]), p[1]);
    return LR(df_lerp)(y0, y1, p[2]);
}

/*
 * The field along the segment as a cubic over s in [0,1], u = 1 - s:
 *
 *     bern[0] u^3 + bern[1] u^2 s + bern[2] u s^2 + bern[3] s^3
 *
 * so bern[1] and bern[2] are three times the Bernstein coefficients: thirds would be rounded, and a ray that touches
 * the surface exactly would cross it. All four are convex combinations of the corners (the blossom of the trilinear
 * form), or three times one, so nothing cancels; bern[0] and bern[3] are the values at entry and exit, bit for bit what
 * df_interpolate gives.
 */
static inline void LR(df_bernstein)(const lr corner[8], const lr a[3], const lr b[3], lr bern[4]) {
    lr xa[4], xb[4], yaa[2], yab[2], yba[2], ybb[2]; /* interpolated along x at a or b, then along y at a or b */
    for (int i = 0; i < 4; i++) {
        xa[i] = LR(df_lerp)(corner[2 * i], corner[2 * i + 1], a[0]);
        xb[i] = LR(df_lerp)(corner[2 * i], corner[2 * i + 1], b[0]);
    }
    for (int i = 0; i < 2; i++) {
        yaa[i] = LR(df_lerp)(xa[2 * i], xa[2 * i + 1], a[1]);
        yab[i] = LR(df_lerp)(xa[2 * i], xa[2 * i + 1], b[1]);
        yba[i] = LR(df_lerp)(xb[2 * i], xb[2 * i + 1], a[1]);
        ybb[i] = LR(df_lerp)(xb[2 * i], xb[2 * i + 1], b[1]);
    }
    lr aab = LR(df_lerp)(yaa[0], yaa[1], b[2]), aba = LR(df_lerp)(yab[0], yab[1], a[2]);
    lr baa = LR(df_lerp)(yba[0], yba[1], a[2]), bba = LR(df_lerp)(ybb[0], ybb[1], a[2]);
    lr bab = LR(df_lerp)(yba[0], yba[1], b[2]), abb = LR(df_lerp)(yab[0], yab[1], b[2]);
    bern[0] = LR(df_lerp)(yaa[0], yaa[1], a[2]);
    bern[1] = (baa + aba) + aab;
    bern[2] = (bba + bab) + abb;
    bern[3] = LR(df_lerp)(ybb[0], ybb[1], b[2]);
}

/* The cubic at s. */
static inline lr LR(df_cubic)(const lr bern[4], lr s) {
    lr u = lr_set(1) - s;
    return (u * bern[0] + s * bern[1]) * (u * u) + (u * bern[2] + s * bern[3]) * (s * s);
}

/* Divides by the largest magnitude, so that products neither vanish nor overflow. */
static inline void LR(df_cubic_scale)(lr bern[4]) {
    lr largest = lr_max(lr_max(lr_abs(bern[0]), lr_abs(bern[1])), lr_max(lr_abs(bern[2]), lr_abs(bern[3])));
    largest = lr_select(lr_lt(lr_set(0), largest), largest, lr_set(1));
    for (int i = 0; i < 4; i++) bern[i] = bern[i] / largest;
}

/* Where the cubic's derivative changes sign inside (0,1): *minimum with a positive and *maximum with a negative second
 * derivative; 2 where there is none. */
static inline void LR(df_cubic_extrema)(const lr bern[4], lr *minimum, lr *maximum) {
    const lr zero = lr_set(0), one = lr_set(1), none = lr_set(2);
    const lr three = lr_set(3);
    lr q0 = bern[1] - three * bern[0], q1 = bern[2] - bern[1], q2 = three * bern[3] - bern[2];
    lr a = (q0 - q1) + (q2 - q1), b = q1 - q0; /* the derivative is a s^2 + 2 b s + q0 */
    lr discriminant = q1 * q1 - q0 * q2;
    lrm real = lr_lt(zero, discriminant);
    lr root = lr_sqrt(lr_max(discriminant, zero));
    /* (-b + root) / a = q0 / (-b - root): take the form in which nothing cancels. */
    lrm positive = lr_lt(zero, b);
    lr far = lr_select(positive, zero - b - root, root - b);
    lr by_a = far / a, by_far = q0 / far;
    lr up = lr_select(positive, by_far, by_a), down = lr_select(positive, by_a, by_far);
    *minimum = lr_select(lrm_and(real, lrm_and(lr_lt(zero, up), lr_lt(up, one))), up, none);
    *maximum = lr_select(lrm_and(real, lrm_and(lr_lt(zero, down), lr_lt(down, one))), down, none);
}

/* True where a segment with both ends on one side of the surface reaches the other side between them. */
static inline lrm LR(df_cubic_reaches)(const lr bern[4], lrm inside) {
    const lr zero = lr_set(0), one = lr_set(1);
    lr scaled[4] = {bern[0], bern[1], bern[2], bern[3]}, minimum, maximum;
    LR(df_cubic_scale)(scaled);
    LR(df_cubic_extrema)(scaled, &minimum, &maximum);
    lr s = lr_select(inside, maximum, minimum);
    lrm reached = lrm_xor(lr_lt(LR(df_cubic)(scaled, s), zero), inside);
    return lrm_and(lr_lt(s, one), reached);
}

/*
 * Whether the surface lies on the segment: the cell is accepted. *inside tells the side at the entry. Without `isolate`
 * only the ends are compared (for the midpoint and the linear solves, which see no more); with it, pairs of crossings
 * between ends on one side are found as well.
 */
static inline lrm LR(df_accept)(const lr corner[8], const lr a[3], const lr b[3], int isolate, lrm *inside) {
    lr bern[4];
    const lr zero = lr_set(0);
    LR(df_bernstein)(corner, a, b, bern);
    *inside = lr_lt(bern[0], zero);
    lrm hit = lrm_xor(*inside, lr_lt(bern[3], zero));
    if (isolate) {
        lrm between = lrm_or(lrm_xor(*inside, lr_lt(bern[1], zero)), lrm_xor(*inside, lr_lt(bern[2], zero)));
        lrm maybe = lrm_and(between, lrm_not(hit));
        if (lrm_any(maybe)) hit = lrm_or(hit, lrm_and(maybe, LR(df_cubic_reaches)(bern, *inside)));
    }
    return hit;
}
