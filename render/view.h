/*
 * Views and rays in grid space: 1 unit = 1 voxel.
 *
 * A ray is what its floats say: origin, direction and, where the camera is far from the field, a shift t_base that was
 * applied in double before rounding. Everything that is computed later, in float or in double, takes these floats as
 * exact. Parameters t are in units of the direction, which is not normalised.
 */
#ifndef DF_VIEW_H
#define DF_VIEW_H

#include "common/field.h"
#include "render/methods/ray.h"

#include <stdbool.h>
#include <stdint.h>

/* Where a picture is taken from, in world space. */
typedef struct df_camera {
    double eye[3], look_at[3], up[3];
    double fov_y; /* vertical field of view, radians */
} df_camera;

/* Fails with DF_ERROR_USAGE for a camera without a direction (eye = look_at, up along the view) or numbers that are not
 * usable. */
df_status df_view_make(const df_camera *camera, const df_field *field, uint32_t width, uint32_t height, df_view *view,
                       df_error *err);

/* The camera on a sphere around the field's box: degrees of azimuth (0: looking along -z, 90: along -x) and elevation
 * above the horizon, distance of the eye from the box's centre in multiples of its longest side. +y is up; at the poles
 * -z or +z. */
void df_camera_orbit(const df_field *field, double azimuth, double elevation, double distance, df_camera *camera);

/* Rays as arrays. count may be anything; the arrays hold a multiple of DF_RAY_PADDING, the last ray repeated. */
#define DF_RAY_PADDING 16u
typedef struct df_rays {
    uint32_t count;
    bool shared_origin; /* the origin of ray 0 is that of all; otherwise one by ray */
    float *origin[3];
    float *direction[3]; /* no component is smaller in magnitude than DF_DIRECTION_MIN */
    float *inverse[3];   /* 1 / direction */
    double *t_base;      /* added to t for the caller; NULL: 0 */
} df_rays;

/* Room for `count` rays; free with df_rays_free. with_base: t_base is there as well. */
df_status df_rays_alloc(uint32_t count, bool with_base, df_rays *rays, df_error *err);
void df_rays_free(df_rays *rays);

/* The rays of a rectangle of pixels, row by row, made with the kernels of some instruction set. */
typedef struct df_kernels df_kernels; /* kernels.h */
void df_view_rays(const df_view *view, const df_kernels *kernels, uint32_t x, uint32_t y, uint32_t width,
                  uint32_t height, df_rays *rays);

/* An arbitrary ray, in grid space, as entry `index`: rebased when it starts far away. The direction is scaled so that
 * its largest component is 1; *t_scale is what to multiply a hit's t with to get it in units of the caller's direction.
 * Returns false for a ray that is refused: not finite, or without a direction. `rays` must have t_base and origins of
 * its own. */
bool df_rays_set(df_rays *rays, uint32_t index, const double box[3], const double origin[3], const double direction[3],
                 double *t_scale);

/* Repeats the last ray up to the padding. */
void df_rays_pad(df_rays *rays);

/* The number of rays that meet the box [0, box]. */
uint32_t df_rays_entering(const df_rays *rays, const double box[3]);

#endif
