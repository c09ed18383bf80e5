/*
 * One ray of a view, in grid space. C and OpenCL C; view.h says what the rays are, and makes many at once with the same
 * arithmetic.
 */
#ifndef DF_RAY_H
#define DF_RAY_H

#include "common/dialect.h"

/* A camera in the grid of a field, for an image of width x height pixels. Only doubles and 32-bit numbers: a device
 * gets it as it is. */
typedef struct df_view {
    double eye[3];                       /* grid space */
    double corner[3], right[3], down[3]; /* pixel (x,y), from the top left: direction corner + x right + y down */
    double box[3];                       /* the field reaches from 0 to box */
    float relative_size[3];              /* voxel size by axis over the largest of them */
    uint32_t width, height;
    uint32_t rebase; /* 1: every ray gets an origin of its own before the field's box, and a t_base */
    double
        world_unit; /* the largest voxel size: distance in the world = t * |direction * relative_size| * world_unit */
} df_view;

/* Zero directions along an axis (and negative zeros, and what would overflow when inverted) are moved by this much,
 * which moves no point of the field: o + 1e-30 t rounds to o, or lies 1e-25 from a plane that goes through the origin.
 * So no parameter is ever NaN or 0 * infinity, and a ray in a grid plane belongs to the cells above it. */
#define DF_DIRECTION_MIN 1e-30f

static inline float df_ray_direction(double d) {
    float f = (float)d;
    if (f < DF_DIRECTION_MIN && f > -DF_DIRECTION_MIN) return f < 0 ? -DF_DIRECTION_MIN : DF_DIRECTION_MIN;
    return f;
}

/* Moves the origin of a ray from afar to two voxels before the box, or to its closest approach where it misses. */
static inline void df_ray_rebase(const double box[3], const double origin[3], const double direction[3],
                                 double moved[3], double *t_base) {
    double t_in = 0,
           length = sqrt(direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2]);
    for (int a = 0; a < 3; a++) {
        if (direction[a] == 0) continue;
        double plane = direction[a] > 0 ? 0 : box[a];
        t_in = fmax(t_in, (plane - origin[a]) / direction[a]);
    }
    *t_base = fmax(0.0, t_in - 2 / length);
    for (int a = 0; a < 3; a++) moved[a] = origin[a] + *t_base * direction[a];
}

/* The ray of a pixel: what df_view_rays gives, bit for bit. */
static inline void df_view_ray(const df_view *view, uint32_t x, uint32_t y, float origin[3], float direction[3],
                               double *t_base) {
    double exact[3], moved[3];
    for (int a = 0; a < 3; a++) exact[a] = (view->corner[a] + y * view->down[a]) + x * view->right[a];
    for (int a = 0; a < 3; a++) moved[a] = view->eye[a];
    *t_base = 0;
    if (view->rebase) df_ray_rebase(view->box, view->eye, exact, moved, t_base);
    for (int a = 0; a < 3; a++) {
        origin[a] = (float)moved[a];
        direction[a] = df_ray_direction(exact[a]);
    }
}

/* 1 / voxel size along an axis, world units. */
static inline float df_view_inverse_size(const df_view *view, int axis) {
    return 1.0f / (float)((double)view->relative_size[axis] * view->world_unit);
}

/* The distance from the eye, in world units, of a hit at t. */
static inline float df_view_distance(const df_view *view, const float direction[3], double t) {
    double length = 0;
    for (int a = 0; a < 3; a++) {
        double w = (double)direction[a] * (double)view->relative_size[a];
        length += w * w;
    }
    return (float)(t * sqrt(length) * view->world_unit);
}

#endif
