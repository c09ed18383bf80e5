#include "families.h"
#include "random.h"

#include <math.h>

const char *const lab_family_names[LAB_FAMILY_COUNT + 1] = {"random",    "grazing", "lattice", "camera",
                                                            "secondary", "inside",  NULL};

/* Draws to find a voxel of the surface or a point inside. */
#define TRIES_MAX 5000

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void random_point(const df_field *field, uint64_t *seed, double p[3]) {
    for (int a = 0; a < 3; a++) p[a] = lab_random(seed, 0, field->voxel_count[a]);
}

static double longest_side(const df_field *field) {
    return fmax(field->voxel_count[0], fmax(field->voxel_count[1], field->voxel_count[2]));
}

/* The corners of the voxel or leaf around a point, and where it lies. Returns false where nothing is stored. */
static bool cell_at(const df_field *field, const double p[3], float corners[8], double lower[3], double *side) {
    if (field->kind == DF_FIELD_ADF) {
        df_adf_cell cell;
        df_adf_find(field, p, DF_LEVEL_COUNT_MAX, &cell);
        df_adf_corners(field, cell.family, cell.child, corners);
        *side = cell.side;
        for (int a = 0; a < 3; a++) lower[a] = cell.corner[a];
        return true;
    }
    uint32_t voxel[3];
    *side = 1;
    for (int a = 0; a < 3; a++) {
        voxel[a] = p[a] < field->voxel_count[a] ? (uint32_t)p[a] : field->voxel_count[a] - 1;
        lower[a] = voxel[a];
    }
    return df_field_corners(field, voxel, corners);
}

/* A point of the surface and its unit normal: Newton steps along the gradient inside one cell. */
static bool surface_point(const df_field *field, uint64_t *seed, double p[3], double normal[3]) {
    for (int i = 0; i < TRIES_MAX; i++) {
        float corners[8];
        double lower[3], side, local[3];
        random_point(field, seed, p);
        if (!cell_at(field, p, corners, lower, &side) || !df_corners_straddle(corners, 0)) continue;
        for (int a = 0; a < 3; a++) local[a] = (p[a] - lower[a]) / side;
        for (int step = 0; step < 20; step++) {
            df_trilinear_gradient(corners, local, normal);
            double f = df_trilinear(corners, local), slope = dot(normal, normal);
            if (slope == 0) break;
            for (int a = 0; a < 3; a++) local[a] = fmin(1, fmax(0, local[a] - f / slope * normal[a]));
        }
        double slope = sqrt(dot(normal, normal));
        if (slope == 0 || fabs(df_trilinear(corners, local)) > 1e-9 * slope) continue;
        for (int a = 0; a < 3; a++) {
            p[a] = lower[a] + local[a] * side;
            normal[a] /= slope;
        }
        return true;
    }
    return false;
}

static void random_ray(const df_field *field, uint64_t *seed, double origin[3], double direction[3]) {
    double target[3];
    random_point(field, seed, target);
    lab_random_direction(seed, direction);
    for (int a = 0; a < 3; a++) {
        origin[a] = field->voxel_count[a] / 2.0 - 1.5 * longest_side(field) * direction[a];
        direction[a] = target[a] - origin[a];
    }
}

static bool grazing_ray(const df_field *field, uint64_t *seed, double origin[3], double direction[3]) {
    double p[3], normal[3];
    if (!surface_point(field, seed, p, normal)) return false;
    double off = pow(10, lab_random(seed, -7, -1)), sign = lab_random(seed, -1, 1) < 0 ? -1 : 1, along;
    lab_random_direction(seed, direction);
    along = dot(direction, normal);
    for (int a = 0; a < 3; a++) direction[a] -= along * normal[a];
    double reach = lab_random(seed, 0.1, 2) * longest_side(field) / sqrt(dot(direction, direction));
    for (int a = 0; a < 3; a++) origin[a] = p[a] + sign * off * normal[a] - reach * direction[a];
    return true;
}

static void lattice_ray(const df_field *field, uint64_t *seed, double origin[3], double direction[3]) {
    /* steps of a few voxels along each axis; the ray passes a corner, an edge (one coordinate between) or a face (two)
     */
    const uint32_t free = lab_random_index(seed, 8) & lab_random_index(seed, 8),
                   reach = lab_random_index(seed, 3) ? 1 : 3;
    double largest = 0;
    for (int a = 0; a < 3; a++) {
        direction[a] = (double)lab_random_index(seed, 2 * reach + 1) - (double)reach;
        origin[a] = lab_random_index(seed, field->voxel_count[a] + 1);
        if (free >> a & 1) origin[a] += lab_random_index(seed, 2) ? 0.5 : lab_random(seed, 0, 1);
        largest = fmax(largest, fabs(direction[a]));
    }
    if (largest == 0) direction[lab_random_index(seed, 3)] = 1;
    const double back = lab_random_index(seed, 4) ? longest_side(field) * 1.5 : 0;
    for (int a = 0; a < 3; a++) origin[a] -= floor(back) * direction[a];
}

static void camera_ray(const df_field *field, uint64_t *seed, double origin[3], double direction[3]) {
    const double azimuth = lab_random_index(seed, 36) * M_PI / 18, elevation = 0.3,
                 distance = 1.6 * longest_side(field);
    const double toward[3] = {sin(azimuth) * cos(elevation), sin(elevation), cos(azimuth) * cos(elevation)};
    const double right[3] = {cos(azimuth), 0, -sin(azimuth)};
    const double up[3] = {-sin(azimuth) * sin(elevation), cos(elevation), -cos(azimuth) * sin(elevation)};
    const double x = lab_random(seed, -0.6, 0.6),
                 y = lab_random(seed, -0.55, 0.55); /* tan of half the view: 1 rad high */
    for (int a = 0; a < 3; a++) {
        origin[a] = field->voxel_count[a] / 2.0 + distance * toward[a];
        direction[a] = x * right[a] + y * up[a] - toward[a];
    }
}

static bool secondary_ray(const df_field *field, uint64_t *seed, double origin[3], double direction[3]) {
    double p[3], normal[3];
    if (!surface_point(field, seed, p, normal)) return false;
    const double off = pow(10, lab_random(seed, -4, -2));
    lab_random_direction(seed, direction);
    if (dot(direction, normal) < 0) {
        for (int a = 0; a < 3; a++) direction[a] = -direction[a];
    }
    for (int a = 0; a < 3; a++) origin[a] = p[a] + off * normal[a];
    return true;
}

static bool inside_ray(const df_field *field, uint64_t *seed, double origin[3], double direction[3]) {
    bool found = false;
    for (int i = 0; i < TRIES_MAX && !found; i++) {
        float corners[8];
        double lower[3], side;
        random_point(field, seed, origin);
        const bool stored = cell_at(field, origin, corners, lower, &side);
        const double local[3] = {(origin[0] - lower[0]) / side, (origin[1] - lower[1]) / side,
                                 (origin[2] - lower[2]) / side};
        found = stored ? df_trilinear(corners, local) < 0 : corners[0] < 0;
    }
    lab_random_direction(seed, direction);
    if (!found || lab_random_index(seed, 2)) return found;
    /* exactly through a corner; an edge or a face where some coordinates are left free */
    const uint32_t free = lab_random_index(seed, 8) & lab_random_index(seed, 8);
    for (int a = 0; a < 3; a++) {
        origin[a] = (double)(float)origin[a];
        double target = lab_random_index(seed, field->voxel_count[a] + 1);
        if (free >> a & 1) target = lab_random_index(seed, 2) ? origin[a] : lab_random(seed, 0, field->voxel_count[a]);
        direction[a] = target - origin[a];
    }
    if (dot(direction, direction) == 0) direction[0] = 1;
    return true;
}

bool lab_family_ray(const df_field *field, lab_family family, uint64_t seed, uint64_t index, double origin[3],
                    double direction[3]) {
    uint64_t state = seed + 0x632BE59BD9B4E019u * (index + 1) + (uint64_t)family;
    lab_random_bits(&state);
    switch (family) {
    case LAB_RANDOM: random_ray(field, &state, origin, direction); return true;
    case LAB_GRAZING: return grazing_ray(field, &state, origin, direction);
    case LAB_LATTICE: lattice_ray(field, &state, origin, direction); return true;
    case LAB_CAMERA: camera_ray(field, &state, origin, direction); return true;
    case LAB_SECONDARY: return secondary_ray(field, &state, origin, direction);
    case LAB_INSIDE: return inside_ray(field, &state, origin, direction);
    case LAB_FAMILY_COUNT: break;
    }
    return false;
}

void lab_eye_ray(const df_field *field, const double eye[3], uint64_t seed, uint64_t index, double origin[3],
                 double direction[3]) {
    uint64_t state = seed + 0x632BE59BD9B4E019u * (index + 1) + LAB_FAMILY_COUNT;
    lab_random_bits(&state);
    for (int a = 0; a < 3; a++) {
        origin[a] = eye[a];
        direction[a] = lab_random(&state, 0, field->voxel_count[a]) - eye[a];
    }
}
