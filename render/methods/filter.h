/*
 * Cubic reconstruction of a field between its samples, in double: the reference for what trilinear interpolation costs
 * in quality. Scalar C. A stencil is that of gradient.h, all of it, s[i] at position i.
 */
#ifndef DF_FILTER_H
#define DF_FILTER_H

#define DF_FILTER_TRILINEAR 0
#define DF_FILTER_CATMULL_ROM \
    1 /* Mitchell and Netravali's B = 0, C = 1/2: goes through the samples, exact on quadratics */
#define DF_FILTER_B_SPLINE 2 /* B = 1, C = 0: two continuous derivatives, but smooths */
#define DF_FILTER_COUNT 3

/* The weights of the samples at -1, 0, 1, 2 for a position x in [0,1], and their derivatives. */
static inline void df_filter_weights(int filter, double x, double weight[4], double slope[4]) {
    const double y = 1 - x;
    if (filter == DF_FILTER_B_SPLINE) {
        weight[0] = y * y * y / 6;
        weight[1] = (3 * x * x * x - 6 * x * x + 4) / 6;
        weight[2] = (3 * y * y * y - 6 * y * y + 4) / 6;
        weight[3] = x * x * x / 6;
        slope[0] = -y * y / 2;
        slope[1] = (3 * x * x - 4 * x) / 2;
        slope[2] = -(3 * y * y - 4 * y) / 2;
        slope[3] = x * x / 2;
        return;
    }
    weight[0] = -x * y * y / 2;
    weight[1] = (3 * x * x * x - 5 * x * x + 2) / 2;
    weight[2] = (3 * y * y * y - 5 * y * y + 2) / 2;
    weight[3] = -y * x * x / 2;
    slope[0] = (2 * x * y - y * y) / 2;
    slope[1] = (9 * x * x - 10 * x) / 2;
    slope[2] = -(9 * y * y - 10 * y) / 2;
    slope[3] = (x * x - 2 * x * y) / 2;
}

/* The value at p in [0,1]^3 of the cell, and unless NULL the gradient, per voxel. */
static inline double df_filter_value(int filter, const float stencil[64], const double p[3], double gradient[3]) {
    double w[3][4], d[3][4], value = 0, g[3] = {0, 0, 0};
    for (int a = 0; a < 3; a++) df_filter_weights(filter, p[a], w[a], d[a]);
    for (int k = 0; k < 4; k++) {
        for (int j = 0; j < 4; j++) {
            const float *s = stencil + 4 * (j + 4 * k);
            double row = 0, slope = 0;
            for (int i = 0; i < 4; i++) {
                row += w[0][i] * (double)s[i];
                slope += d[0][i] * (double)s[i];
            }
            value += w[1][j] * w[2][k] * row;
            g[0] += w[1][j] * w[2][k] * slope;
            g[1] += d[1][j] * w[2][k] * row;
            g[2] += w[1][j] * d[2][k] * row;
        }
    }
    for (int a = 0; a < 3 && gradient; a++) gradient[a] = g[a];
    return value;
}

#endif
