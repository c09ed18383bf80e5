/*
 * The first hit of rays in a dense field under cubic reconstruction (methods/filter.h), in double: slow, the reference
 * for the quality of trilinear interpolation. Each voxel with samples on both sides in its stencil is looked through in
 * SEARCH_PARTS parts; where two ends lie on different sides the crossing is bisected. Pairs of crossings within one
 * part are not seen.
 */
#include "common/memory.h"
#include "render/cpu/kernels.h"
#include "render/methods/filter.h"
#include "render/methods/gradient.h"

#include <math.h>
#include <stdlib.h>

enum { SEARCH_PARTS = 16, BISECTIONS = 48 };

typedef struct tricubic_state {
    const df_scene *scene;
    int filter;
    uint8_t *active; /* by voxel: its stencil has samples on both sides */
} tricubic_state;

/* A ray, and the voxel it is in. */
typedef struct cubic_ray {
    double origin[3], direction[3];
    int64_t voxel[3];
    double t_in, t_out;
    int out_axis;
} cubic_ray;

static uint64_t voxel_index(const df_scene *scene, const int64_t voxel[3]) {
    return (uint64_t)voxel[0] +
           scene->voxel_count[0] * ((uint64_t)voxel[1] + (uint64_t)scene->voxel_count[1] * (uint64_t)voxel[2]);
}

/* Which voxels have corners on both sides. */
static void mark_straddling(const df_scene *scene, uint8_t *straddles) {
    const uint32_t *count = scene->voxel_count;
#pragma omp parallel for schedule(dynamic)
    for (uint32_t z = 0; z < count[2]; z++) {
        for (uint32_t i = 0; i < count[0] * count[1]; i++) {
            const uint32_t voxel[3] = {i % count[0], i / count[0], z};
            float corner[8];
            df_scene_corners(scene, voxel, 0, corner);
            straddles[voxel_index(scene, (const int64_t[3]){voxel[0], voxel[1], z})] = df_corners_straddle(corner, 0);
        }
    }
}

static bool near_straddling(const df_scene *scene, const uint8_t *straddles, const int64_t voxel[3]) {
    for (int n = 0; n < 27; n++) {
        const int64_t at[3] = {voxel[0] + n % 3 - 1, voxel[1] + n / 3 % 3 - 1, voxel[2] + n / 9 - 1};
        bool within = true;
        for (int a = 0; a < 3; a++) within = within && at[a] >= 0 && at[a] < scene->voxel_count[a];
        if (within && straddles[voxel_index(scene, at)]) return true;
    }
    return false;
}

static void mark_active(tricubic_state *state, const uint8_t *straddles) {
    const uint32_t *count = state->scene->voxel_count;
#pragma omp parallel for schedule(dynamic)
    for (uint32_t z = 0; z < count[2]; z++) {
        for (uint32_t i = 0; i < count[0] * count[1]; i++) {
            const int64_t voxel[3] = {i % count[0], i / count[0], z};
            state->active[voxel_index(state->scene, voxel)] = near_straddling(state->scene, straddles, voxel);
        }
    }
}

static void tricubic_release(void *opaque) {
    tricubic_state *state = opaque;
    if (!state) return;
    free(state->active);
    free(state);
}

static df_status tricubic_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    tricubic_state *state;
    *out = NULL;
    if (scene->field->kind != DF_FIELD_DENSE)
        return df_fail(err, DF_ERROR_USAGE,
                       "--filter %s reads samples two voxels from the surface, which only dense fields store all of",
                       df_filter_names[options->filter]);
    df_status status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status != DF_OK) return status;
    state->scene = scene;
    state->filter = options->filter;
    const uint32_t *count = scene->voxel_count;
    const uint64_t total = (uint64_t)count[0] * count[1] * count[2];
    uint8_t *straddles = NULL;
    status = df_alloc((void **)&state->active, total, 1, "surface voxels", err);
    if (status == DF_OK) status = df_alloc((void **)&straddles, total, 1, "surface voxels", err);
    if (status != DF_OK) {
        tricubic_release(state);
        return status;
    }
    mark_straddling(scene, straddles);
    mark_active(state, straddles);
    free(straddles);
    *out = state;
    return DF_OK;
}

static uint64_t tricubic_bytes(const void *opaque) {
    const uint32_t *count = ((const tricubic_state *)opaque)->scene->voxel_count;
    return (uint64_t)count[0] * count[1] * count[2];
}

static double plane_t(const cubic_ray *ray, int axis, int64_t plane) {
    return ((double)plane - ray->origin[axis]) / ray->direction[axis];
}

static void find_exit(cubic_ray *ray) {
    ray->t_out = INFINITY;
    ray->out_axis = 0;
    for (int a = 0; a < 3; a++) {
        const double t = plane_t(ray, a, ray->voxel[a] + (ray->direction[a] > 0));
        if (t < ray->t_out) {
            ray->t_out = t;
            ray->out_axis = a;
        }
    }
}

/* Places the ray where it enters the field, or starts in it; false where it misses. */
static bool enter(const df_scene *scene, cubic_ray *ray) {
    double t_in = 0, t_out = INFINITY;
    for (int a = 0; a < 3; a++) {
        const double low = plane_t(ray, a, 0), high = plane_t(ray, a, scene->voxel_count[a]);
        t_in = fmax(t_in, fmin(low, high));
        t_out = fmin(t_out, fmax(low, high));
    }
    if (!(t_in <= t_out)) return false;
    for (int a = 0; a < 3; a++) {
        const double at = floor(ray->origin[a] + t_in * ray->direction[a]);
        ray->voxel[a] = (int64_t)fmin(fmax(at, 0), scene->voxel_count[a] - 1.0);
    }
    ray->t_in = t_in;
    find_exit(ray);
    return true;
}

static bool next_voxel(const df_scene *scene, cubic_ray *ray) {
    const int a = ray->out_axis;
    ray->voxel[a] += ray->direction[a] > 0 ? 1 : -1;
    if (ray->voxel[a] < 0 || ray->voxel[a] >= scene->voxel_count[a]) return false;
    ray->t_in = fmax(ray->t_in, ray->t_out);
    find_exit(ray);
    return true;
}

static double value_at(const tricubic_state *state, const cubic_ray *ray, const float stencil[64], double t,
                       double local[3], double gradient[3]) {
    for (int a = 0; a < 3; a++) {
        const double p = ray->origin[a] + t * ray->direction[a] - (double)ray->voxel[a];
        local[a] = fmin(fmax(p, 0), 1);
    }
    return df_filter_value(state->filter, stencil, local, gradient) - (double)state->scene->iso;
}

/* Looks for the first change of side in the ray's voxel. */
static bool search(const tricubic_state *state, const cubic_ray *ray, bool inside, const float stencil[64], double *t) {
    double local[3], before = ray->t_in;
    for (int i = 0; i <= SEARCH_PARTS; i++) {
        double after = ray->t_in + (ray->t_out - ray->t_in) * i / SEARCH_PARTS;
        if ((value_at(state, ray, stencil, after, local, NULL) < 0) == inside) {
            before = after;
            continue;
        }
        for (int n = 0; n < BISECTIONS; n++) {
            const double middle = 0.5 * (before + after);
            if ((value_at(state, ray, stencil, middle, local, NULL) < 0) == inside) before = middle;
            else after = middle;
        }
        *t = after;
        return true;
    }
    return false;
}

static void append(const tricubic_state *state, const cubic_ray *ray, const float stencil[64], bool inside, double t,
                   uint32_t index, const df_rays *rays, df_hits *hits) {
    const uint32_t n = hits->count++;
    double local[3], gradient[3];
    value_at(state, ray, stencil, t, local, gradient);
    hits->ray[n] = index;
    hits->block[n] = 0;
    hits->flags[n] = inside ? DF_HIT_BACK : 0;
    hits->t[n] = t + (rays->t_base ? rays->t_base[index] : 0);
    for (int a = 0; a < 3; a++) {
        hits->cell[a][n] = (uint16_t)ray->voxel[a];
        hits->local[a][n] = (float)local[a];
        hits->normal[a][n] = (float)(gradient[a] / state->scene->field->voxel_size[a]);
    }
}

static void trace_ray(const tricubic_state *state, cubic_ray *ray, uint32_t index, const df_rays *rays, df_hits *hits,
                      df_counters *counters) {
    const df_scene *scene = state->scene;
    int inside = -1;
    if (!enter(scene, ray)) return;
    do {
        const uint32_t voxel[3] = {(uint32_t)ray->voxel[0], (uint32_t)ray->voxel[1], (uint32_t)ray->voxel[2]};
        float stencil[64];
        double local[3], t;
        const bool active = state->active[voxel_index(scene, ray->voxel)];
        counters->fine_steps++;
        if (!active && inside >= 0) continue;
        df_scene_stencil(scene, voxel, 0, DF_REACH_ALL, stencil, 1);
        if (inside < 0) inside = value_at(state, ray, stencil, ray->t_in, local, NULL) < 0;
        if (!active) continue;
        counters->cells_tested++;
        if (!search(state, ray, inside, stencil, &t)) continue;
        append(state, ray, stencil, inside, t, index, rays, hits);
        return;
    } while (next_voxel(scene, ray));
}

static df_status tricubic_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits,
                                df_counters *counters, df_error *err) {
    (void)thread;
    (void)err;
    const df_rays *rays = &tile->rays;
    hits->has_normals = true;
    for (uint32_t i = 0; i < rays->count; i++) {
        cubic_ray ray;
        for (int a = 0; a < 3; a++) {
            ray.origin[a] = (double)rays->origin[a][rays->shared_origin ? 0 : i];
            ray.direction[a] = (double)rays->direction[a][i];
        }
        trace_ray(opaque, &ray, i, rays, hits, counters);
    }
    return DF_OK;
}

const df_tracer df_tracer_tricubic = {
    .name = "tricubic",
    .own_methods = true,
    .summary = "cubic reconstruction between samples, in double: a reference of quality",
    .prepare = tricubic_prepare,
    .release = tricubic_release,
    .bytes = tricubic_bytes,
    .trace = tricubic_trace,
};
