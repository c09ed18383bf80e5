#include "convert/shape.h"

#include "common/options.h"
#include "convert/cells.h"

#include <assert.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

static const char *const names[] = {"sphere", "torus", "box", "rotated-box", "gyroid", "shell", NULL};

/* A parameter: which shapes have it (a bit each), where it is stored, its default and its range. */
static const struct parameter {
    const char *key;
    unsigned shapes;
    size_t offset;
    double initial;
    double low, high;
} parameters[] = {
#define BIT(kind) (1u << DF_SHAPE_##kind)
#define ALL_SHAPES 0xFFu
    {"cx", ALL_SHAPES, offsetof(df_shape, centre[0]), 0, -1e12, 1e12},
    {"cy", ALL_SHAPES, offsetof(df_shape, centre[1]), 0, -1e12, 1e12},
    {"cz", ALL_SHAPES, offsetof(df_shape, centre[2]), 0, -1e12, 1e12},
    {"radius", BIT(SPHERE) | BIT(SHELL), offsetof(df_shape, radius), 1, 1e-12, 1e12},
    {"major", BIT(TORUS), offsetof(df_shape, major), 1, 1e-12, 1e12},
    {"minor", BIT(TORUS), offsetof(df_shape, minor), 0.4, 1e-12, 1e12},
    {"x", BIT(BOX) | BIT(ROTATED_BOX), offsetof(df_shape, side[0]), 2, 1e-12, 1e12},
    {"y", BIT(BOX) | BIT(ROTATED_BOX), offsetof(df_shape, side[1]), 2, 1e-12, 1e12},
    {"z", BIT(BOX) | BIT(ROTATED_BOX), offsetof(df_shape, side[2]), 2, 1e-12, 1e12},
    {"angle", BIT(ROTATED_BOX), offsetof(df_shape, angle), 30, -360, 360},
    {"period", BIT(GYROID), offsetof(df_shape, period), 1, 1e-12, 1e12},
    {"size", BIT(GYROID), offsetof(df_shape, size), 2, 1e-12, 1e12},
    {"thickness", BIT(GYROID) | BIT(SHELL), offsetof(df_shape, thickness), 0.1, 1e-12, 1e12},
};
#define PARAMETER_COUNT (sizeof parameters / sizeof *parameters)

/* The gyroid of period 2 pi curves by at most 1 / GYROID_REACH: a critical point of the distance that is nearer is the
 * nearest. */
#define GYROID_REACH 0.7

bool df_shape_is_name(const char *name) { return strncmp(name, "shape:", 6) == 0; }

static double *field_of(df_shape *shape, const struct parameter *p) { return (double *)((char *)shape + p->offset); }

static df_status parse_parameter(df_shape *shape, const char *name, const char *key, df_error *err) {
    char *value = strchr(key, '=');
    if (!value) return df_fail(err, DF_ERROR_USAGE, "%s: expected key=value, found '%s'", name, key);
    *value++ = 0;
    for (size_t i = 0; i < PARAMETER_COUNT; i++) {
        const struct parameter *p = &parameters[i];
        if (strcmp(p->key, key) != 0 || !(p->shapes >> shape->kind & 1)) continue;
        char option[64];
        snprintf(option, sizeof option, "shape:%s: %s", names[shape->kind], key);
        return df_parse_double(option, value, p->low, p->high, field_of(shape, p), err);
    }
    char known[256] = "";
    for (size_t i = 0; i < PARAMETER_COUNT; i++) {
        if (!(parameters[i].shapes >> shape->kind & 1)) continue;
        snprintf(known + strlen(known), sizeof known - strlen(known), "%s%s", *known ? ", " : "", parameters[i].key);
    }
    return df_fail(err, DF_ERROR_USAGE, "%s: a %s has no '%s' (it has %s)", name, names[shape->kind], key, known);
}

/* Rodrigues' rotation by the shape's angle about (1,2,3), transposed: it takes points to the box's axes. */
static void set_rotation(df_shape *shape) {
    double radians = shape->angle * 3.14159265358979323846 / 180, c = cos(radians), s = sin(radians), length = sqrt(14);
    double axis[3] = {1 / length, 2 / length, 3 / length};
    double cross[3][3] = {{0, -axis[2], axis[1]}, {axis[2], 0, -axis[0]}, {-axis[1], axis[0], 0}};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            shape->rotation[j][i] = (i == j) * c + s * cross[i][j] + (1 - c) * axis[i] * axis[j];
    }
}

static df_status check_shape(const df_shape *shape, const char *name, df_error *err) {
    if (shape->kind == DF_SHAPE_TORUS && shape->minor >= shape->major) {
        return df_fail(err, DF_ERROR_USAGE, "%s: minor=%g must be less than major=%g", name, shape->minor,
                       shape->major);
    }
    if (shape->kind == DF_SHAPE_SHELL && shape->thickness >= 2 * shape->radius) {
        return df_fail(err, DF_ERROR_USAGE, "%s: thickness=%g must be less than twice radius=%g", name,
                       shape->thickness, shape->radius);
    }
    double limit = 2 * GYROID_REACH * shape->period / 6.283185307179586;
    if (shape->kind == DF_SHAPE_GYROID && shape->thickness > limit) {
        return df_fail(err, DF_ERROR_USAGE, "%s: thickness=%g must be at most %g for its period", name,
                       shape->thickness, limit);
    }
    return DF_OK;
}

df_status df_shape_parse(const char *name, df_shape *shape, df_error *err) {
    assert(df_shape_is_name(name));
    char text[512];
    *shape = (df_shape){0};
    if (strlen(name) >= sizeof text)
        return df_fail(err, DF_ERROR_USAGE, "%.40s...: the name of the shape is too long", name);
    strcpy(text, name + 6);
    char *rest = strchr(text, ':');
    if (rest) *rest++ = 0;
    uint32_t kind;
    df_status status = df_parse_name("shape:", text, names, &kind, err);
    if (status != DF_OK) return status;
    shape->kind = (df_shape_kind)kind;
    for (size_t i = 0; i < PARAMETER_COUNT; i++) {
        if (parameters[i].shapes >> kind & 1) *field_of(shape, &parameters[i]) = parameters[i].initial;
    }
    for (char *save, *key = rest ? strtok_r(rest, ",", &save) : NULL; key; key = strtok_r(NULL, ",", &save)) {
        status = parse_parameter(shape, name, key, err);
        if (status != DF_OK) return status;
    }
    set_rotation(shape);
    return check_shape(shape, name, err);
}

void df_shape_bounds(const df_shape *shape, double low[3], double high[3]) {
    for (int a = 0; a < 3; a++) {
        double half = 0;
        switch (shape->kind) {
        case DF_SHAPE_SPHERE: half = shape->radius; break;
        case DF_SHAPE_TORUS: half = a == 2 ? shape->minor : shape->major + shape->minor; break;
        case DF_SHAPE_BOX: half = shape->side[a] / 2; break;
        case DF_SHAPE_ROTATED_BOX:
            for (int i = 0; i < 3; i++) half += fabs(shape->rotation[i][a]) * shape->side[i] / 2;
            break;
        case DF_SHAPE_GYROID: half = shape->size / 2; break;
        case DF_SHAPE_SHELL: half = shape->radius + shape->thickness / 2; break;
        }
        low[a] = shape->centre[a] - half;
        high[a] = shape->centre[a] + half;
    }
}

static double box_distance(const double side[3], const double p[3]) {
    double outside = 0, inside = -INFINITY;
    for (int a = 0; a < 3; a++) {
        double d = fabs(p[a]) - side[a] / 2;
        if (d > 0) outside += d * d;
        inside = fmax(inside, d);
    }
    return outside > 0 ? sqrt(outside) : inside;
}

/* The gyroid's function, gradient and Hessian's entries (xx yy zz xy yz zx) at q. */
static double gyroid(const double q[3], double gradient[3], double hessian[6]) {
    double s[3], c[3], value = 0;
    for (int a = 0; a < 3; a++) s[a] = sin(q[a]), c[a] = cos(q[a]);
    for (int a = 0; a < 3; a++) {
        int next = (a + 1) % 3, last = (a + 2) % 3;
        value += s[a] * c[next];
        gradient[a] = c[a] * c[next] - s[last] * s[a];
        hessian[a] = -s[a] * c[next] - s[last] * c[a];
        hessian[3 + a] = -c[a] * s[next];
    }
    return value;
}

/* Solves the symmetric 3x3 system H x = b by Cramer's rule. */
static bool solve3(const double h[6], const double b[3], double x[3]) {
    double c0 = h[1] * h[2] - h[4] * h[4], c1 = h[4] * h[5] - h[3] * h[2], c2 = h[3] * h[4] - h[1] * h[5];
    double det = h[0] * c0 + h[3] * c1 + h[5] * c2;
    if (!(fabs(det) > 1e-12)) return false;
    x[0] = (c0 * b[0] + c1 * b[1] + c2 * b[2]) / det;
    x[1] = (c1 * b[0] + (h[0] * h[2] - h[5] * h[5]) * b[1] + (h[3] * h[5] - h[0] * h[4]) * b[2]) / det;
    x[2] = (c2 * b[0] + (h[3] * h[5] - h[0] * h[4]) * b[1] + (h[0] * h[1] - h[3] * h[3]) * b[2]) / det;
    return true;
}

/* Pulls q to the gyroid along the gradient; false where that fails. */
static bool gyroid_pull(double q[3]) {
    double n[3], h[6];
    for (int step = 0; step < 6; step++) {
        double g = gyroid(q, n, h), square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        if (!(square > 1e-6)) return false;
        for (int a = 0; a < 3; a++) q[a] -= g * n[a] / square;
    }
    return fabs(gyroid(q, n, h)) < 1e-12; /* some pulls end elsewhere */
}

static double distance_between(const double p[3], const double q[3]) {
    return sqrt((q[0] - p[0]) * (q[0] - p[0]) + (q[1] - p[1]) * (q[1] - p[1]) + (q[2] - p[2]) * (q[2] - p[2]));
}

/* The distance from p to a critical point of it on the gyroid, found by Newton steps on q - p + l grad g = 0, g = 0
 * from a start near the surface; INFINITY where they do not converge. */
static double gyroid_critical(const double p[3], const double start[3]) {
    double q[3] = {start[0], start[1], start[2]}, n[3], h[6], lambda = 0;
    gyroid(q, n, h);
    for (int a = 0; a < 3; a++) lambda += (p[a] - q[a]) * n[a] / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int step = 0; step < 30; step++) {
        double g = gyroid(q, n, h), residual[3], m[6], u[3], v[3];
        for (int a = 0; a < 3; a++) residual[a] = q[a] - p[a] + lambda * n[a];
        for (int i = 0; i < 6; i++) m[i] = (i < 3) + lambda * h[i];
        double error = fabs(g) + fabs(residual[0]) + fabs(residual[1]) + fabs(residual[2]);
        if (error < 1e-14) break;
        if (step == 29 && error > 1e-12) return INFINITY;
        if (!solve3(m, residual, u) || !solve3(m, n, v)) return INFINITY;
        double top = g - (n[0] * u[0] + n[1] * u[1] + n[2] * u[2]), bottom = n[0] * v[0] + n[1] * v[1] + n[2] * v[2];
        if (!(fabs(bottom) > 1e-12)) return INFINITY;
        double change = top / bottom;
        for (int a = 0; a < 3; a++) q[a] -= u[a] + change * v[a];
        lambda += change;
    }
    return distance_between(p, q);
}

#define GYROID_STARTS 27 /* directions to search in, and the point itself */
#define GYROID_TRIES 4   /* of them, the nearest to the point are refined */

/* The distance to the gyroid of period 2 pi. A critical point nearer than the reach is the nearest; where none is
 * found, points around are pulled to the surface, and the nearest of these are where the search goes on. */
static double gyroid_distance(const double p[3]) {
    double starts[GYROID_STARTS][3], distances[GYROID_STARTS];
    for (int i = 0; i < GYROID_STARTS; i++) {
        int j = (i + 13) % 27; /* the point itself first */
        int d[3] = {j % 3 - 1, j / 3 % 3 - 1, j / 9 - 1};
        double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        for (int a = 0; a < 3; a++) starts[i][a] = p[a] + (length > 0 ? d[a] / length : 0);
        distances[i] = gyroid_pull(starts[i]) ? distance_between(p, starts[i]) : HUGE_VAL;
        if (i == 0 && distances[0] < HUGE_VAL) {
            double nearest = gyroid_critical(p, starts[0]);
            if (nearest < GYROID_REACH) return nearest;
        }
    }
    double nearest = HUGE_VAL;
    for (int n = 0; n < GYROID_TRIES; n++) {
        int best = 0;
        for (int i = 1; i < GYROID_STARTS; i++) best = distances[i] < distances[best] ? i : best;
        if (!(distances[best] < HUGE_VAL)) break;
        nearest = fmin(nearest, gyroid_critical(p, starts[best]));
        nearest = fmin(nearest, distances[best]); /* on the surface to rounding, where Newton fails */
        distances[best] = HUGE_VAL;
    }
    return nearest;
}

/* The gyroid's function grows by at most sqrt(3) a unit: a distance that is not too large, without a search. */
static double gyroid_at_least(const double p[3]) {
    double n[3], h[6];
    return fabs(gyroid(p, n, h)) / 1.7320508075688773;
}

static void gyroid_point(const df_shape *shape, const double world[3], double q[3], double *scale) {
    *scale = 6.283185307179586 / shape->period;
    for (int a = 0; a < 3; a++) q[a] = fmod((world[a] - shape->centre[a]) * *scale, 6.283185307179586);
}

double df_shape_distance(const df_shape *shape, const double world[3]) {
    double p[3], q[3];
    for (int a = 0; a < 3; a++) p[a] = world[a] - shape->centre[a];
    switch (shape->kind) {
    case DF_SHAPE_SPHERE: return sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) - shape->radius;
    case DF_SHAPE_SHELL:
        return fabs(sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) - shape->radius) - shape->thickness / 2;
    case DF_SHAPE_TORUS: {
        double ring = sqrt(p[0] * p[0] + p[1] * p[1]) - shape->major;
        return sqrt(ring * ring + p[2] * p[2]) - shape->minor;
    }
    case DF_SHAPE_BOX: return box_distance(shape->side, p);
    case DF_SHAPE_ROTATED_BOX:
        for (int i = 0; i < 3; i++)
            q[i] = shape->rotation[i][0] * p[0] + shape->rotation[i][1] * p[1] + shape->rotation[i][2] * p[2];
        return box_distance(shape->side, q);
    case DF_SHAPE_GYROID: {
        double scale;
        gyroid_point(shape, world, q, &scale);
        return gyroid_distance(q) / scale - shape->thickness / 2;
    }
    }
    return 0;
}

static void fill(const void *context, const df_lattice *lattice, const df_sample_box *box, float *out) {
    for (uint32_t k = 0; k < box->count[2]; k++) {
        for (uint32_t j = 0; j < box->count[1]; j++) {
            for (uint32_t i = 0; i < box->count[0]; i++) {
                double p[3] = {df_lattice_at(lattice, 0, box->first[0] + i),
                               df_lattice_at(lattice, 1, box->first[1] + j),
                               df_lattice_at(lattice, 2, box->first[2] + k)};
                double d = df_shape_distance(context, p);
                *out++ = d < 0 ? -df_distance_round(-d) : df_distance_round(d);
            }
        }
    }
}

static double at(const void *context, const double p[3]) { return df_shape_distance(context, p); }

void df_distance_shape(const df_shape *shape, df_distance_source *source) {
    *source = (df_distance_source){(void *)(uintptr_t)shape, true, fill, at, NULL};
}

/* False where the surface is further than `reach` from a point. */
static bool may_reach(const df_shape *shape, const double p[3], double reach) {
    double q[3], scale;
    if (shape->kind == DF_SHAPE_GYROID) {
        gyroid_point(shape, p, q, &scale);
        if (gyroid_at_least(q) / scale - shape->thickness / 2 > reach) return false;
    }
    return fabs(df_shape_distance(shape, p)) <= reach;
}

bool df_shape_keeps_cell(const void *context, const uint32_t cell[3]) {
    const df_shape_cells *c = context;
    double centre[3], half = c->lattice->brick_size * 0.5;
    for (int a = 0; a < 3; a++)
        centre[a] = df_lattice_at(c->lattice, a, cell[a] * c->lattice->brick_size) + half * c->lattice->voxel_size;
    return may_reach(c->shape, centre, (half + DF_CELL_REACH) * 1.7320508075688773 * c->lattice->voxel_size);
}

bool df_shape_crosses(const void *context, const uint32_t corner[3], uint32_t side) {
    const df_shape_cells *c = context;
    double centre[3], half = side * 0.5 * c->lattice->voxel_size;
    for (int a = 0; a < 3; a++) centre[a] = df_lattice_at(c->lattice, a, corner[a]) + half;
    return may_reach(c->shape, centre, half * 1.7320508075688773 * (1 + 1e-9));
}
