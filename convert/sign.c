#include "convert/sign.h"

#include "convert/mesh_repair.h"

#include <math.h>
#include <string.h>

df_status df_sign_orient(df_sign *sign, const df_mesh *input, df_error *err) {
    df_status status = df_sign_mesh_make(input, &sign->made, err);
    if (status == DF_OK) sign->mesh = &sign->made.mesh;
    return status;
}

/* A wrap whose holes may be a tenth of the mesh wide, and that keeps a small distance: as coarse as it may be to be
 * quick, because the nearest faces decide about what is near. */
#define WRAP_ALPHA (1 / 20.0)
#define WRAP_OFFSET (1 / 600.0)

df_status df_sign_prepare_normals(df_sign *sign, const df_mesh *input, df_error *err) {
    df_status status = df_sign_mesh_make(input, &sign->made, err);
    if (status == DF_OK)
        status = df_sign_normals_make(&sign->made.mesh, sign->made.real_face_count, &sign->normals, err);
    if (status != DF_OK || sign->method == DF_SIGN_NORMAL) return status;
    double low[3], high[3], longest = 0;
    df_mesh_bounds(input, low, high);
    for (int a = 0; a < 3; a++) longest = fmax(longest, high[a] - low[a]);
    status = df_mesh_wrap(input, longest * WRAP_ALPHA, longest * WRAP_OFFSET, &sign->wrap, err);
    sign->mesh = &sign->wrap;
    return status;
}

bool df_sign_may_orient(const df_sign *sign, const df_mesh *input) {
    return sign->mesh == input && (sign->method == DF_SIGN_AUTO || sign->method == DF_SIGN_WINDING);
}

void df_sign_free(df_sign *sign) {
    df_sign_normals_free(&sign->normals);
    df_mesh_free(&sign->wrap);
    df_sign_mesh_free(&sign->made);
    *sign = (df_sign){0};
}

static const double *vertex(const df_sign_mesh *m, uint32_t face, uint32_t corner) {
    return m->mesh.positions + (size_t)m->mesh.faces[(size_t)face * 3 + corner] * 3;
}

static double distance_to_segment(const double p[3], const double *a, const double *b) {
    double u[3], v[3], dot = 0, square = 0, out = 0;
    for (int i = 0; i < 3; i++) {
        u[i] = b[i] - a[i];
        v[i] = p[i] - a[i];
        dot += u[i] * v[i];
        square += u[i] * u[i];
    }
    double t = square > 0 ? fmin(1, fmax(0, dot / square)) : 0;
    for (int i = 0; i < 3; i++) out += (v[i] - t * u[i]) * (v[i] - t * u[i]);
    return sqrt(out);
}

/* True where the ball lies on one side of the plane of a fan's triangle, or beyond its box. */
static bool clear_of_face(const df_sign_mesh *m, uint32_t face, const double p[3], double radius) {
    const double *a = vertex(m, face, 0), *b = vertex(m, face, 1), *c = vertex(m, face, 2);
    double n[3], length = 0, height = 0;
    for (int i = 0; i < 3; i++) {
        if (fmin(a[i], fmin(b[i], c[i])) > p[i] + radius || fmax(a[i], fmax(b[i], c[i])) < p[i] - radius) return true;
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        n[i] = (b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j]);
        length += n[i] * n[i];
        height += n[i] * (p[i] - a[i]);
    }
    return fabs(height) > radius * sqrt(length) * 1.000001;
}

/* A bound on how much the correction differs between points of the ball: by Biot and Savart, a border edge of length l
 * at a distance r turns it by at most l / (4 pi r^2) a unit. INFINITY where the ball meets a fan, across which it
 * jumps, or an edge. */
static double variation(const df_sign_mesh *m, const uint32_t *active, uint32_t count, const double p[3],
                        double radius) {
    double gradient = 0;
    for (uint32_t i = 0; i < count; i++) {
        const df_cap *cap = &m->caps[active[i]];
        for (uint32_t f = cap->first_face; f < cap->first_face + cap->face_count; f++) {
            if (!clear_of_face(m, f, p, radius)) return INFINITY;
            const double *a = vertex(m, f, 0), *b = vertex(m, f, 1);
            double distance = distance_to_segment(p, a, b) - radius,
                   length = sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) +
                                 (a[2] - b[2]) * (a[2] - b[2]));
            if (!(distance > 0)) return INFINITY;
            gradient += length / (12.566370614359172 * distance * distance);
        }
    }
    return gradient * radius;
}

void df_sign_make_rule(const df_sign *sign, const double centre[3], double radius, uint32_t *active,
                       df_sign_rule *rule) {
    *rule = (df_sign_rule){.sign = sign, .threshold = 1, .active = active};
    const df_sign_mesh *m = &sign->made;
    rule->needs_points = sign->method == DF_SIGN_NORMAL || sign->method == DF_SIGN_WRAP;
    if (m->cap_count == 0 || sign->method == DF_SIGN_PARITY || rule->needs_points) return;
    rule->active_count = df_sign_mesh_near(m, centre, radius, active);
    rule->needs_points = rule->active_count > 0;
    if (!rule->needs_points) return;
    double change = variation(m, active, rule->active_count, centre, radius) + 1e-9;
    if (!(change < 0.5)) return;
    double points[3][8], corrections[8];
    for (int a = 0; a < 3; a++) {
        for (int p = 0; p < 8; p++) points[a][p] = centre[a];
    }
    df_sign_mesh_corrections(m, active, rule->active_count, (const double(*)[8])points, corrections);
    double correction = corrections[0];
    /* inside: winding >= correction + 0.5; the same whole number for all of the ball? */
    double low = ceil(correction - change + 0.5), high = ceil(correction + change + 0.5);
    if (low != high) return;
    rule->threshold = (int32_t)low;
    rule->active_count = 0;
    rule->needs_points = false;
}

static float with_side(float value, bool inside) {
    float magnitude = fabsf(value);
    return inside && magnitude != 0 ? -magnitude : magnitude;
}

static void apply_normals(const df_sign *sign, const int32_t *windings, const double (*points)[3], uint32_t count,
                          float *values) {
    uint32_t nearest = 0;
    for (uint32_t i = 0; i < count; i++) {
        const bool wrapped = sign->method == DF_SIGN_NORMAL || windings[i] >= 1;
        values[i] = with_side(values[i], wrapped && df_sign_normals_inside(&sign->normals, points[i], &nearest));
    }
}

void df_sign_apply(const df_sign_rule *rule, const int32_t *windings, const double (*points)[3], uint32_t count,
                   float *values) {
    if (rule->sign->method == DF_SIGN_NORMAL || rule->sign->method == DF_SIGN_WRAP) {
        apply_normals(rule->sign, windings, points, count, values);
        return;
    }
    if (rule->active_count == 0) {
        bool parity = rule->sign->method == DF_SIGN_PARITY;
        for (uint32_t i = 0; i < count; i++) {
            values[i] = with_side(values[i], parity ? (windings[i] & 1) != 0 : windings[i] >= rule->threshold);
        }
        return;
    }
    for (uint32_t i = 0; i < count; i += 8) {
        double eight[3][8], corrections[8];
        for (uint32_t p = 0; p < 8; p++) {
            for (int a = 0; a < 3; a++) eight[a][p] = points[i + p < count ? i + p : count - 1][a];
        }
        df_sign_mesh_corrections(&rule->sign->made, rule->active, rule->active_count, (const double(*)[8])eight,
                                 corrections);
        for (uint32_t p = 0; p < 8 && i + p < count; p++) {
            values[i + p] = with_side(values[i + p], windings[i + p] - corrections[p] >= 0.5);
        }
    }
}
