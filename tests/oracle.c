#include "oracle.h"

#include <math.h>

typedef long double real;

static real dot(const real a[3], const real b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static real to_segment(const real p[3], const real a[3], const real b[3]) {
    real ab[3], ap[3], d[3];
    for (int i = 0; i < 3; i++) ab[i] = b[i] - a[i], ap[i] = p[i] - a[i];
    real length = dot(ab, ab), t = length > 0 ? dot(ap, ab) / length : 0;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    for (int i = 0; i < 3; i++) d[i] = ap[i] - t * ab[i];
    return dot(d, d);
}

/* Squared distance: to the plane where the foot of the perpendicular lies inside all three edges, otherwise to the
 * nearest edge. */
static real to_triangle(const real p[3], const real c[3][3]) {
    real n[3], u[3], v[3], best = INFINITY;
    for (int i = 0; i < 3; i++) u[i] = c[1][i] - c[0][i], v[i] = c[2][i] - c[0][i];
    for (int i = 0; i < 3; i++) n[i] = u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3];
    int inside = dot(n, n) > 0;
    for (int e = 0; e < 3; e++) {
        const real *a = c[e], *b = c[(e + 1) % 3];
        real ab[3], ap[3], across[3];
        for (int i = 0; i < 3; i++) ab[i] = b[i] - a[i], ap[i] = p[i] - a[i];
        for (int i = 0; i < 3; i++) across[i] = n[(i + 1) % 3] * ab[(i + 2) % 3] - n[(i + 2) % 3] * ab[(i + 1) % 3];
        inside = inside && dot(across, ap) >= 0;
        real d = to_segment(p, a, b);
        if (d < best) best = d;
    }
    if (!inside) return best;
    real ap[3] = {p[0] - c[0][0], p[1] - c[0][1], p[2] - c[0][2]}, height = dot(n, ap);
    real plane = height * height / dot(n, n);
    return plane < best ? plane : best;
}

double oracle_distance(const double *positions, const uint32_t *faces, size_t face_count, const double p[3]) {
    real best = INFINITY, point[3] = {p[0], p[1], p[2]};
    for (size_t f = 0; f < face_count; f++) {
        real c[3][3];
        double low2 = 0; /* squared distance to the triangle's box, to skip most of them */
        for (int i = 0; i < 3; i++) {
            double low = INFINITY, high = -INFINITY;
            for (int k = 0; k < 3; k++) {
                double x = positions[(size_t)faces[f * 3 + (size_t)k] * 3 + (size_t)i];
                c[k][i] = x;
                low = fmin(low, x);
                high = fmax(high, x);
            }
            double d = fmax(0, fmax(low - p[i], p[i] - high));
            low2 += d * d;
        }
        if ((real)low2 * (1 - 1e-12L) > best) continue;
        real d = to_triangle(point, (const real(*)[3])c);
        if (d < best) best = d;
    }
    return (double)sqrtl(best);
}

double oracle_winding(const double *positions, const uint32_t *faces, size_t face_count, const double p[3]) {
    double sum = 0;
    for (size_t f = 0; f < face_count; f++) {
        double v[3][3], length[3];
        for (int c = 0; c < 3; c++) {
            for (int i = 0; i < 3; i++) v[c][i] = positions[(size_t)faces[f * 3 + (size_t)c] * 3 + (size_t)i] - p[i];
            length[c] = sqrt(v[c][0] * v[c][0] + v[c][1] * v[c][1] + v[c][2] * v[c][2]);
        }
        double det = v[0][0] * (v[1][1] * v[2][2] - v[1][2] * v[2][1]) -
                     v[0][1] * (v[1][0] * v[2][2] - v[1][2] * v[2][0]) +
                     v[0][2] * (v[1][0] * v[2][1] - v[1][1] * v[2][0]);
        double ab = 0, bc = 0, ca = 0;
        for (int i = 0; i < 3; i++) ab += v[0][i] * v[1][i], bc += v[1][i] * v[2][i], ca += v[2][i] * v[0][i];
        sum += atan2(det, length[0] * length[1] * length[2] + ab * length[2] + bc * length[0] + ca * length[1]);
    }
    return sum / (2 * 3.14159265358979323846);
}

double oracle_random(uint64_t *state) {
    uint64_t z = *state += 0x9E3779B97F4A7C15u;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}
