/*
 * The closed-form cubic (Schwarze's way: trigonometric for three real roots, Cardano for one), in double and only
 * there: in float its error reaches half a voxel where the cubic term is nearly zero. It polishes nothing, but it is
 * kept inside the bracket that isolation found, so that it can neither miss a hit nor leave the cell. Scalar C and
 * OpenCL C.
 */
#ifndef DF_CUBIC_H
#define DF_CUBIC_H

#include "render/methods/lane.h"

/* Real roots of c[3] s^3 + c[2] s^2 + c[1] s + c[0], the largest coefficient being about 1; returns how many, unsorted.
 */
static inline int df_cubic_roots(const double c[4], double roots[3]) {
    const double tiny = 1e-12;
    if (fabs(c[3]) < tiny) {
        if (fabs(c[2]) < tiny) {
            roots[0] = -c[0] / c[1];
            return c[1] == 0 ? 0 : 1;
        }
        double disc = c[1] * c[1] - 4 * c[2] * c[0];
        if (disc < 0) return 0;
        double q = -0.5 * (c[1] + (c[1] < 0 ? -sqrt(disc) : sqrt(disc)));
        roots[0] = q / c[2];
        if (q == 0) return 1;
        roots[1] = c[0] / q;
        return 2;
    }
    double a = c[2] / c[3], b = c[1] / c[3], d = c[0] / c[3], shift = a / 3;
    double p = (a * a - 3 * b) / 9, q = (2 * a * a * a - 9 * a * b + 27 * d) / 54, disc = q * q - p * p * p;
    if (disc < 0) {
        double angle = acos(q / sqrt(p * p * p)), size = -2 * sqrt(p);
        for (int i = 0; i < 3; i++) roots[i] = size * cos((angle + 6.283185307179586 * (i - 1)) / 3) - shift;
        return 3;
    }
    double u = cbrt(fabs(q) + sqrt(disc));
    if (q > 0) u = -u;
    roots[0] = (u == 0 ? 0 : u + p / u) - shift;
    roots[1] = u == 0 ? 0 - shift : -0.5 * (u + p / u) - shift; /* the double root, when there is one */
    return disc == 0 ? 2 : 1;
}

/* The first root of a cubic as df_bernstein gives it (scaled) inside [low, high]; the middle of the bracket when
 * rounding leaves none. */
static inline double df_cubic_first_root(const double bern[4], double low, double high) {
    const double c[4] = {bern[0], bern[1] - 3 * bern[0], 3 * bern[0] - 2 * bern[1] + bern[2],
                         (bern[3] - bern[0]) - (bern[2] - bern[1])};
    double roots[3], best = 2, slack = 1e-9;
    int count = df_cubic_roots(c, roots);
    for (int i = 0; i < count; i++) {
        if (roots[i] >= low - slack && roots[i] <= high + slack && roots[i] < best) best = roots[i];
    }
    if (best > 1.5) return 0.5 * (low + high);
    return best < low ? low : best > high ? high : best;
}

#endif
