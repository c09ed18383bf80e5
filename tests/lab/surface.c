#include "surface.h"
#include "random.h"

#include <assert.h>
#include <math.h>

const char *const lab_shape_names[LAB_SHAPE_COUNT + 1] = {"sphere", "torus", "box",   "rotated-box", "gyroid",
                                                          "shell",  "noise", "pairs", NULL};

static double length3(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

/* A point relative to the middle of the shape: a little off the middle of the field, so that nothing lies on the grid
 * by chance. */
static void centred(const lab_surface *s, const double p[3], double q[3]) {
    q[0] = p[0] - s->size / 2 - 0.137;
    q[1] = p[1] - s->size / 2 + 0.211;
    q[2] = p[2] - s->size / 2 - 0.058;
}

static double sphere(const double p[3], const void *surface) {
    const lab_surface *s = surface;
    double q[3];
    centred(s, p, q);
    return length3(q) - 0.375 * s->size;
}

static double torus(const double p[3], const void *surface) {
    const lab_surface *s = surface;
    double q[3];
    centred(s, p, q);
    double ring = hypot(q[0], q[2] * 0.8 + q[1] * 0.6) - 0.28 * s->size, height = q[1] * 0.8 - q[2] * 0.6;
    return hypot(ring, height) - 0.12 * s->size;
}

static double box_distance(const double q[3], const double half[3]) {
    double outside[3], inside = -INFINITY;
    for (int a = 0; a < 3; a++) {
        double d = fabs(q[a]) - half[a];
        outside[a] = fmax(d, 0);
        inside = fmax(inside, d);
    }
    return length3(outside) + fmin(inside, 0);
}

static double box(const double p[3], const void *surface) {
    const lab_surface *s = surface;
    const double half = floor(s->size / 4), middle = floor(s->size / 2);
    return box_distance((double[3]){p[0] - middle, p[1] - middle, p[2] - middle}, (double[3]){half, half, half});
}

static double rotated_box(const double p[3], const void *surface) {
    /* an orthonormal frame with no simple component */
    static const double frame[3][3] = {
        {2.0 / 3, 2.0 / 3, 1.0 / 3}, {-2.0 / 3, 1.0 / 3, 2.0 / 3}, {1.0 / 3, -2.0 / 3, 2.0 / 3}};
    const lab_surface *s = surface;
    double q[3], r[3];
    centred(s, p, q);
    for (int i = 0; i < 3; i++) r[i] = frame[i][0] * q[0] + frame[i][1] * q[1] + frame[i][2] * q[2];
    return box_distance(r, (double[3]){0.2 * s->size, 0.25 * s->size, 0.16 * s->size});
}

/* |gyroid| / its steepest slope, less half a wall; cut off by a sphere. */
static double gyroid(const double p[3], const void *surface) {
    const lab_surface *s = surface;
    const double k = 2 * M_PI * 2.5 / s->size;
    double q[3];
    centred(s, p, q);
    double x = k * q[0], y = k * q[1], z = k * q[2];
    double g = sin(x) * cos(y) + sin(y) * cos(z) + sin(z) * cos(x);
    return fmax(fabs(g) / (sqrt(3) * k) - 0.04 * s->size, length3(q) - 0.42 * s->size);
}

static double shell(const double p[3], const void *surface) {
    const lab_surface *s = surface;
    return fabs(sphere(p, surface)) - s->parameter / 2;
}

/* A random number of [-1,1] that belongs to a lattice point. */
static double lattice_random(int64_t x, int64_t y, int64_t z) {
    uint64_t seed = (uint64_t)x * 0x8DA6B343u + (uint64_t)y * 0xD8163841u + (uint64_t)z * 0xCB1AB31Fu;
    lab_random_bits(&seed);
    return lab_random(&seed, -1, 1);
}

static double noise(const double p[3], const void *surface) {
    const lab_surface *s = surface;
    double sum = 0, q[3];
    int64_t base[3];
    for (int a = 0; a < 3; a++) {
        base[a] = (int64_t)floor(p[a] / s->parameter);
        q[a] = p[a] / s->parameter - (double)base[a];
        q[a] = q[a] * q[a] * (3 - 2 * q[a]);
    }
    for (int c = 0; c < 8; c++) {
        double w = (c & 1 ? q[0] : 1 - q[0]) * (c >> 1 & 1 ? q[1] : 1 - q[1]) * (c >> 2 ? q[2] : 1 - q[2]);
        sum += w * lattice_random(base[0] + (c & 1), base[1] + (c >> 1 & 1), base[2] + (c >> 2));
    }
    centred(s, p, q);
    return fmax(s->parameter * sum, length3(q) - 0.42 * s->size);
}

static double pairs(const double p[3], const void *surface) {
    const lab_surface *s = surface;
    for (int a = 0; a < 3; a++) {
        if (p[a] < 1.5 || p[a] > s->size - 1.5) return 1;
    }
    return lattice_random((int64_t)floor(p[0]), (int64_t)floor(p[1]), (int64_t)floor(p[2]));
}

lab_surface lab_surface_make(lab_shape shape, double size, double parameter) {
    static const struct {
        const char *summary;
        double (*value)(const double grid[3], const void *surface);
        double lipschitz, parameter;
    } shapes[LAB_SHAPE_COUNT] = {
        [LAB_SPHERE] = {"a sphere, off the grid", sphere, 1, 0},
        [LAB_TORUS] = {"a tilted torus", torus, 1, 0},
        [LAB_BOX] = {"a box with its faces on grid planes", box, 1, 0},
        [LAB_ROTATED_BOX] = {"a box at odd angles", rotated_box, 1, 0},
        [LAB_GYROID] = {"a slab of the gyroid in a sphere", gyroid, 1, 0},
        [LAB_SHELL] = {"a thin hull of a sphere", shell, 1, 0.9},
        [LAB_NOISE] = {"smooth noise in a sphere", noise, 0, 6},
        [LAB_PAIRS] = {"random samples: pairs of crossings everywhere", pairs, 0, 0},
    };
    return (lab_surface){lab_shape_names[shape],
                         shapes[shape].summary,
                         shapes[shape].value,
                         shapes[shape].lipschitz,
                         size,
                         parameter > 0 ? parameter : shapes[shape].parameter};
}

static double value_at(const lab_surface *s, const double origin[3], const double direction[3], double t) {
    const double p[3] = {origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]};
    return s->value(p, s);
}

static double bisect(const lab_surface *s, const double origin[3], const double direction[3], double low, double high,
                     bool inside) {
    for (;;) {
        double middle = low + (high - low) / 2;
        if (middle <= low || middle >= high) return high;
        if ((value_at(s, origin, direction, middle) < 0) == inside) low = middle;
        else high = middle;
    }
}

static bool clip(const double box_size[3], const double origin[3], const double direction[3], double *t_in,
                 double *t_out) {
    *t_in = 0;
    *t_out = INFINITY;
    for (int a = 0; a < 3; a++) {
        if (direction[a] == 0) {
            if (origin[a] < 0 || origin[a] > box_size[a]) return false;
            continue;
        }
        double low = -origin[a] / direction[a], high = (box_size[a] - origin[a]) / direction[a];
        *t_in = fmax(*t_in, fmin(low, high));
        *t_out = fmin(*t_out, fmax(low, high));
    }
    return *t_in < *t_out;
}

void lab_surface_trace(const lab_surface *surface, const double box_size[3], const double origin[3],
                       const double direction[3], df_truth *out) {
    const double band = 1e-6, length = length3(direction);
    double t, t_out, near_since = -1;
    assert(surface->lipschitz > 0);
    *out = (df_truth){.band = band};
    if (!clip(box_size, origin, direction, &t, &t_out)) return;
    const bool inside = value_at(surface, origin, direction, t) < 0;
    for (double before = t;;) {
        double distance = fabs(value_at(surface, origin, direction, t)) / surface->lipschitz;
        if (t > before && (value_at(surface, origin, direction, t) < 0) != inside) {
            *out = (df_truth){
                .hit = true, .back = inside, .t = bisect(surface, origin, direction, before, t, inside), .band = band};
            return;
        }
        if (distance >= band) out->tangent |= near_since >= 0;
        else if (near_since < 0) near_since = t;
        else out->tangent |= (t - near_since) * length > DF_TRUTH_RUN_MAX;
        if (out->tangent || t >= t_out) break; /* a tangent ray is not judged: its t does not matter */
        before = t;
        t = fmin(t_out, t + fmax(distance, band / 4) / length);
    }
    out->tangent |= near_since >= 0;
}

void lab_surface_gradient(const lab_surface *surface, const double grid[3], double gradient[3]) {
    const double h = 1e-5;
    for (int a = 0; a < 3; a++) {
        double low[3] = {grid[0], grid[1], grid[2]}, high[3] = {grid[0], grid[1], grid[2]};
        low[a] -= h;
        high[a] += h;
        gradient[a] = (surface->value(high, surface) - surface->value(low, surface)) / (2 * h);
    }
}
