/*
 * First hits, and pictures of them: the kernels. The maths is the CPU's own text. As compilers take seconds, a build holds what is needed
 * together: df_trace_view or, with DF_CGT, df_cgt_view; or, with DF_SHADE, df_shade_view; or, with DF_RAYS, the kernels of arbitrary rays.
 *
 * What a walk does at every step is a constant of the build, so that nothing else takes its registers: DF_ISOLATE (0 or 1, as df_accept has
 * it), DF_BOUNDS (1: the rays of a view have bounds) and DF_COUNT (defined: steps are counted).
 */
#include "render/opencl/scene.cl"

#include "render/methods/dda.h"
#if DF_LEVELS == 0
#include "render/methods/adf.h"
#endif
#include "render/methods/hit.h"
#include "render/methods/ray.h"
#include "render/methods/shade.h"

#ifndef DF_SHADE

/* ---- finding ---- */

/* What a ray has found, at index i of the arrays that grid.h describes. */
static inline void df_store_found(bool hit, const df_candidate *candidate, const df_counters *counters, size_t i, size_t count,
                                  __global uchar *found, __global uint4 *candidates, __global uint *counts) {
    if (hit) candidates[i] = (uint4)(candidate->cell[0] | (uint)candidate->cell[1] << 16, candidate->cell[2], candidate->block, candidate->flags >> DF_HIT_SIZE_SHIFT);
    found[i] = (uchar)(!hit ? 0 : candidate->flags & DF_HIT_BACK ? DF_FOUND | DF_FOUND_BACK : DF_FOUND);
#ifdef DF_COUNT
    counts[i] = counters->coarse_steps;
    counts[i + count] = counters->fine_steps;
    counts[i + 2 * count] = counters->cells_tested;
#endif
}

/* The first hit of a ray that walks alone. */
static inline bool df_walk(const df_scene *scene, const dda_ray *ray, df_candidate *candidate, df_counters *counters) {
#if DF_LEVELS == 0
    return adf_walk_scene(scene, DF_ISOLATE, ray, candidate, counters);
#else
    return dda_walk_scene(scene, DF_ISOLATE, ray, candidate, counters);
#endif
}

static inline void df_find(const df_scene *scene, const dda_ray *ray, size_t i, size_t count, __global uchar *found,
                           __global uint4 *candidates, __global uint *counts) {
    df_candidate candidate;
    df_counters counters = {0, 0, 0};
    const bool hit = ray->first <= ray->last && df_walk(scene, ray, &candidate, &counters);
    df_store_found(hit, &candidate, &counters, i, count, found, candidates, counts);
}

#endif

#if defined DF_SHADE || defined DF_RAYS

/* ---- solving ---- */

/* The t of a hit that was found, its voxel and its position there. */
static inline double df_solve_candidate(const df_scene *scene, int solve, int steps, const float origin[3], const float direction[3],
                                        uint flags, uint4 candidate, uint32_t voxel[3], float position[3]) {
    float stored[8];
    voxel[0] = candidate.x & 0xFFFF;
    voxel[1] = candidate.x >> 16;
    voxel[2] = candidate.y;
    df_scene_corners(scene, voxel, candidate.z, stored);
    return df_hit_solve(solve, steps, origin, direction, voxel, (float)(1u << candidate.w), stored, (flags & DF_FOUND_BACK) != 0, position);
}

#endif

#if defined DF_RAYS

/* ---- arbitrary rays ---- */

/* Arbitrary rays: 9 arrays of `stride` floats, origin x y z, direction x y z and inverse x y z; origin_step 0: all rays share the first
 * origin, 1: each has its own. Writes as df_trace_view does. One work item a ray, `count`, rounded up to work groups. */
__kernel void df_trace_rays(DF_SCENE_PARAMETERS, __global const float *rays, uint stride, uint origin_step, uint count,
                            __global uchar *found, __global uint4 *candidates, __global uint *counts) {
    const size_t i = get_global_id(0), pitch = stride;
    if (i >= count) return;
    const df_scene scene = df_scene_make(DF_SCENE_ARGUMENTS);
    dda_ray ray = {.first = 0, .last = INFINITY};
    for (int a = 0; a < 3; a++) {
        ray.origin[a] = rays[pitch * a + i * origin_step];
        ray.direction[a] = rays[pitch * (3 + a) + i];
        ray.inverse[a] = rays[pitch * (6 + a) + i];
    }
    df_find(&scene, &ray, i, count, found, candidates, counts);
}

/* The hits of arbitrary rays that df_trace_rays has found: t without the ray's t_base, and the position in the cell as 3 arrays of `count`.
 * One work item a ray. */
__kernel void df_solve_rays(DF_SCENE_PARAMETERS, __global const float *rays, uint stride, uint origin_step, uint count, int solve,
                            int steps, __global const uchar *found, __global const uint4 *candidates, __global double *t,
                            __global float *positions) {
    const size_t i = get_global_id(0), pitch = stride;
    if (i >= count || !found[i]) return;
    const df_scene scene = df_scene_make(DF_SCENE_ARGUMENTS);
    float origin[3], direction[3], position[3];
    uint32_t voxel[3];
    for (int a = 0; a < 3; a++) {
        origin[a] = rays[pitch * a + i * origin_step];
        direction[a] = rays[pitch * (3 + a) + i];
    }
    t[i] = df_solve_candidate(&scene, solve, steps, origin, direction, found[i], candidates[i], voxel, position);
    for (int a = 0; a < 3; a++) positions[i + (size_t)count * a] = position[a];
}

#elif !defined DF_SHADE

/* ---- views ---- */

/* Edge of the squares that bounds are for, pixels: DF_BOUNDS_SQUARE of cpu/bounds.h. */
#define DF_BOUNDS_SQUARE 8

/* The ray of pixel (x, first_row + y) for the walks. bounds, built with DF_BOUNDS: where rays of each square of the row_count rows can meet
 * surface: the least t of all squares, then the greatest. first > last where the ray cannot hit. */
static inline dda_ray df_pixel_ray(const df_view *view, uint x, uint first_row, uint y, uint row_count, __global const double *bounds) {
    dda_ray ray = {.first = 0, .last = INFINITY};
    double t_base;
    df_view_ray(view, x, first_row + y, ray.origin, ray.direction, &t_base);
    for (int a = 0; a < 3; a++) ray.inverse[a] = 1.0f / ray.direction[a];
#if DF_BOUNDS
    const uint columns = (view->width + DF_BOUNDS_SQUARE - 1) / DF_BOUNDS_SQUARE, rows = (row_count + DF_BOUNDS_SQUARE - 1) / DF_BOUNDS_SQUARE;
    const size_t square = x / DF_BOUNDS_SQUARE + (size_t)columns * (y / DF_BOUNDS_SQUARE);
    ray.first = (float)(bounds[square] - t_base);
    ray.last = (float)(bounds[square + (size_t)columns * rows] - t_base);
#endif
    return ray;
}

#ifdef DF_CGT
#include "render/opencl/cgt.cl"
#else
/* Rows first_row to first_row + row_count - 1 of a view, within bounds (df_pixel_ray): writes found and candidates (grid.h), and counts, built with DF_COUNT: coarse steps, fine
 * steps and tested cells as three arrays; the first row at index 0. One work item a pixel, width * row_count, rounded up to work groups. */
__kernel void df_trace_view(DF_SCENE_PARAMETERS, const df_view view, uint first_row, uint row_count, __global const double *bounds,
                            __global uchar *found, __global uint4 *candidates, __global uint *counts) {
    const uint x = get_global_id(0), y = get_global_id(1);
    if (x >= view.width || y >= row_count) return;
    const df_scene scene = df_scene_make(DF_SCENE_ARGUMENTS);
    const dda_ray ray = df_pixel_ray(&view, x, first_row, y, row_count, bounds);
    df_find(&scene, &ray, x + (size_t)view.width * y, (size_t)view.width * row_count, found, candidates, counts);
}
#endif

#else

/* ---- pictures ---- */

static inline void df_put_pixel(size_t i, const float linear[3], float distance, const float normal[3], __global const uchar *table,
                                __global uchar *rgb, __global float *depth, __global float *normals) {
    if (rgb) {
        for (int c = 0; c < 3; c++) rgb[3 * i + c] = table[(uint)(linear[c] * (DF_SHADE_LEVELS - 1) + 0.5f)];
    }
    if (depth) depth[i] = distance;
    if (normals) {
        for (int a = 0; a < 3; a++) normals[3 * i + a] = normal[a];
    }
}

/* Solves, gradients and light of the rows that df_trace_view has traced: writes rgb (3 bytes a pixel), depth and normals (3 floats a pixel), each unless
 * NULL, the first row at index 0. table: df_shade_table. Built with DF_IMAGES, gradients read the samples from an image. One work item a pixel, as
 * df_trace_view. */
__kernel void df_shade_view(DF_SCENE_PARAMETERS, const df_view view, uint first_row, uint row_count, int solve, int steps,
                            int gradient_method, __global const uchar *table, __global const uchar *found,
                            __global const uint4 *candidates, __global uchar *rgb, __global float *depth, __global float *normals
#ifdef DF_IMAGES
                            , __read_only image3d_t image
#endif
) {
    const uint x = get_global_id(0), y = get_global_id(1);
    if (x >= view.width || y >= row_count) return;
    const size_t i = x + (size_t)view.width * y;
    const uint flags = found[i];
    float colour[3] = DF_SHADE_BACKGROUND, normal[3] = {0, 0, 0};
    if (!flags) {
        df_put_pixel(i, colour, INFINITY, normal, table, rgb, depth, normals);
        return;
    }
    const df_scene scene = df_scene_make(DF_SCENE_ARGUMENTS);
    const float albedo[3] = DF_SHADE_ALBEDO;
    float origin[3], direction[3], position[3], stencil[64], gradient[3], toward_eye[3], inverse_size[3], inverse_step[3];
    uint32_t voxel[3];
    double t_base;
    df_view_ray(&view, x, first_row + y, origin, direction, &t_base);
    const double t = df_solve_candidate(&scene, solve, steps, origin, direction, flags, candidates[i], voxel, position);
#if DF_LEVELS == 0
    df_leaf_stencil(scene.field, voxel, candidates[i].z, candidates[i].w, df_gradient_reach(gradient_method), stencil, 1);
#elif defined DF_IMAGES
    df_image_stencil(&scene, image, voxel, df_gradient_reach(gradient_method), stencil);
#else
    df_scene_stencil(&scene, voxel, candidates[i].z, df_gradient_reach(gradient_method), stencil);
#endif
    for (int a = 0; a < 3; a++) inverse_step[a] = df_view_inverse_size(&view, a) / (float)(1u << candidates[i].w);
    df_gradient(gradient_method, stencil, position, inverse_step, gradient);
    for (int a = 0; a < 3; a++) inverse_size[a] = 1.0f / view.relative_size[a];
    df_shade_toward_eye(direction, view.relative_size, toward_eye);
    df_shade_normal(gradient, inverse_size, toward_eye, normal);
    const float light = df_shade_light(normal, toward_eye);
    for (int c = 0; c < 3; c++) colour[c] = albedo[c] * light;
    df_put_pixel(i, colour, df_view_distance(&view, direction, t + t_base), normal, table, rgb, depth, normals);
}

#endif
