#include "render/view.h"
#include "common/memory.h"
#include "render/cpu/kernels.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Cameras farther from the field than this many times its longest side get rays with origins of their own. Up to here a
 * float origin is good to 1 ulp of coordinates that the walk has anyway. */
#define NEAR_FACTOR 3.0

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double a[3], const double b[3], double out[3]) {
    for (int i = 0; i < 3; i++) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/* Returns false when there is no direction. */
static bool normalise(double v[3]) {
    double largest = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
    if (!(largest > 0) || !isfinite(largest)) return false;
    for (int i = 0; i < 3; i++) v[i] /= largest;
    double length = sqrt(dot(v, v));
    for (int i = 0; i < 3; i++) v[i] /= length;
    return true;
}

static double longest_side(const double box[3]) { return fmax(box[0], fmax(box[1], box[2])); }

static bool far_away(const double box[3], const double origin[3]) {
    double limit = NEAR_FACTOR * longest_side(box);
    return fabs(origin[0]) > limit || fabs(origin[1]) > limit || fabs(origin[2]) > limit;
}

df_status df_view_make(const df_camera *camera, const df_field *field, uint32_t width, uint32_t height, df_view *view,
                       df_error *err) {
    double forward[3], right[3], down[3], unit = 0;
    memset(view, 0, sizeof *view);
    for (int a = 0; a < 3; a++) {
        if (!isfinite(camera->eye[a]) || !isfinite(camera->look_at[a]) || !isfinite(camera->up[a])) {
            return df_fail(err, DF_ERROR_USAGE, "the camera has coordinates that are not finite");
        }
        forward[a] = camera->look_at[a] - camera->eye[a];
        unit = fmax(unit, field->voxel_size[a]);
    }
    if (!normalise(forward)) return df_fail(err, DF_ERROR_USAGE, "--eye and --look-at are the same point");
    cross(forward, camera->up, right);
    double up_length = sqrt(dot(camera->up, camera->up));
    if (!(sqrt(dot(right, right)) > 1e-9 * up_length) || !normalise(right)) {
        return df_fail(err, DF_ERROR_USAGE, "--up lies along the view direction: choose another");
    }
    cross(forward, right, down);
    double step = 2 * tan(camera->fov_y / 2) / height; /* of a pixel, at distance 1 */
    for (int a = 0; a < 3; a++) {
        double scale =
            unit / field->voxel_size[a]; /* world to grid, up to a factor that leaves t in voxels of the largest size */
        double first = forward[a] + (0.5 - width / 2.0) * step * right[a] + (0.5 - height / 2.0) * step * down[a];
        view->corner[a] = first * scale;
        view->right[a] = right[a] * step * scale;
        view->down[a] = down[a] * step * scale;
        view->box[a] = field->voxel_count[a];
        view->relative_size[a] = (float)(field->voxel_size[a] / unit);
    }
    df_field_world_to_grid(field, camera->eye, view->eye);
    for (int a = 0; a < 3; a++) {
        if (!(fabs(view->eye[a]) < 1e15)) return df_fail(err, DF_ERROR_USAGE, "the eye is too far away from the field");
    }
    view->width = width;
    view->height = height;
    view->world_unit = unit;
    view->rebase = far_away(view->box, view->eye);
    return DF_OK;
}

void df_camera_orbit(const df_field *field, double azimuth, double elevation, double distance, df_camera *camera) {
    double centre[3], longest = 0, az = azimuth * M_PI / 180, el = elevation * M_PI / 180;
    for (int a = 0; a < 3; a++) {
        double side = field->voxel_size[a] * field->voxel_count[a];
        centre[a] = field->origin[a] + side / 2;
        longest = fmax(longest, side);
    }
    const double toward[3] = {sin(az) * cos(el), sin(el), cos(az) * cos(el)};
    const double up[3] = {-sin(az) * sin(el), cos(el), -cos(az) * sin(el)};
    for (int a = 0; a < 3; a++) {
        camera->look_at[a] = centre[a];
        camera->eye[a] = centre[a] + distance * longest * toward[a];
        camera->up[a] = up[a];
    }
}

df_status df_rays_alloc(uint32_t count, bool with_base, df_rays *rays, df_error *err) {
    uint64_t padded = ((uint64_t)count + DF_RAY_PADDING - 1) / DF_RAY_PADDING * DF_RAY_PADDING;
    float *block;
    memset(rays, 0, sizeof *rays);
    df_status status = df_alloc((void **)&block, padded * 9, sizeof *block, "rays", err);
    if (status != DF_OK) return status;
    for (int a = 0; a < 3; a++) {
        rays->origin[a] = block + padded * (uint64_t)a;
        rays->direction[a] = block + padded * (uint64_t)(3 + a);
        rays->inverse[a] = block + padded * (uint64_t)(6 + a);
    }
    if (with_base) status = df_alloc((void **)&rays->t_base, padded, sizeof *rays->t_base, "rays", err);
    if (status != DF_OK) df_rays_free(rays);
    return status;
}

void df_rays_free(df_rays *rays) {
    free(rays->origin[0]);
    free(rays->t_base);
    memset(rays, 0, sizeof *rays);
}

void df_rays_pad(df_rays *rays) {
    assert(rays->count > 0);
    uint32_t last = rays->count - 1, padded = (rays->count + DF_RAY_PADDING - 1) / DF_RAY_PADDING * DF_RAY_PADDING;
    for (uint32_t i = rays->count; i < padded; i++) {
        for (int a = 0; a < 3; a++) {
            rays->direction[a][i] = rays->direction[a][last];
            rays->inverse[a][i] = rays->inverse[a][last];
            if (!rays->shared_origin) rays->origin[a][i] = rays->origin[a][last];
        }
        if (rays->t_base) rays->t_base[i] = rays->t_base[last];
    }
}

static void set_ray(df_rays *rays, uint32_t i, const double direction[3]) {
    for (int a = 0; a < 3; a++) {
        rays->direction[a][i] = df_ray_direction(direction[a]);
        rays->inverse[a][i] = 1.0f / rays->direction[a][i];
    }
}

static void far_rays(const df_view *view, uint32_t x0, uint32_t y0, uint32_t width, uint32_t height, df_rays *rays) {
    for (uint32_t y = 0, i = 0; y < height; y++) {
        for (uint32_t x = 0; x < width; x++, i++) {
            double direction[3], origin[3];
            for (int a = 0; a < 3; a++) {
                direction[a] = (view->corner[a] + (y0 + y) * view->down[a]) + (x0 + x) * view->right[a];
            }
            df_ray_rebase(view->box, view->eye, direction, origin, &rays->t_base[i]);
            for (int a = 0; a < 3; a++) rays->origin[a][i] = (float)origin[a];
            set_ray(rays, i, direction);
        }
    }
}

void df_view_rays(const df_view *view, const df_kernels *kernels, uint32_t x, uint32_t y, uint32_t width,
                  uint32_t height, df_rays *rays) {
    rays->count = width * height;
    rays->shared_origin = !view->rebase;
    if (view->rebase) {
        assert(rays->t_base);
        far_rays(view, x, y, width, height, rays);
    } else {
        kernels->view_rays(view, x, y, width, height, rays);
        if (rays->t_base) memset(rays->t_base, 0, rays->count * sizeof *rays->t_base);
    }
    df_rays_pad(rays);
}

bool df_rays_set(df_rays *rays, uint32_t index, const double box[3], const double origin[3], const double direction[3],
                 double *t_scale) {
    double largest = fmax(fabs(direction[0]), fmax(fabs(direction[1]), fabs(direction[2]))), d[3], o[3];
    assert(rays->t_base && !rays->shared_origin);
    if (!(largest > 0) || !isfinite(largest)) return false;
    for (int a = 0; a < 3; a++) {
        if (!isfinite(direction[a]) || !(fabs(origin[a]) < 1e15)) return false;
        d[a] = direction[a] / largest;
        o[a] = origin[a];
    }
    rays->t_base[index] = 0;
    if (far_away(box, origin)) df_ray_rebase(box, origin, d, o, &rays->t_base[index]);
    for (int a = 0; a < 3; a++) rays->origin[a][index] = (float)o[a];
    for (int a = 0; a < 3; a++) {
        /* A ray along a grid plane belongs to the cells above it; along the last one, to those below. */
        if (fabs(d[a]) < (double)DF_DIRECTION_MIN)
            d[a] = (double)(o[a] >= box[a] ? -DF_DIRECTION_MIN : DF_DIRECTION_MIN);
    }
    set_ray(rays, index, d);
    *t_scale = 1 / largest;
    return true;
}

uint32_t df_rays_entering(const df_rays *rays, const double box[3]) {
    uint32_t entering = 0;
    for (uint32_t i = 0; i < rays->count; i++) {
        float t_in = 0, t_out = INFINITY;
        for (int a = 0; a < 3; a++) {
            float o = rays->origin[a][rays->shared_origin ? 0 : i], inverse = rays->inverse[a][i];
            float low = (0 - o) * inverse, high = ((float)box[a] - o) * inverse;
            const float near = low < high ? low : high, far = low < high ? high : low;
            t_in = near > t_in ? near : t_in;
            t_out = far < t_out ? far : t_out;
        }
        entering += t_in <= t_out;
    }
    return entering;
}
