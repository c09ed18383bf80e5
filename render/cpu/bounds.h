/*
 * The interval pre-pass of primary rays (the seed's DFRRT on the CPU): boxes around the surface are projected to small
 * squares of pixels, and each square keeps the least and the greatest t at which its rays can meet one. A walk then
 * starts and ends there; rays of squares without a box are not walked at all.
 *
 * DF_BOUNDS_GL lets OpenGL draw the boxes (gl/bounds_gl.h), which knows the pixels of a box and their t one by one.
 *
 * The boxes are widened by far more than the rounding of rays and walks, so that no cell in which a ray hits is left
 * out: hits have the same bits with and without.
 */
#ifndef DF_BOUNDS_H
#define DF_BOUNDS_H

#include "render/tracer.h"

/* Edge of a square, pixels. */
#define DF_BOUNDS_SQUARE 8u

/* Voxels low <= v <= last. */
typedef struct df_bounds_box {
    uint16_t low[3], last[3];
} df_bounds_box;

typedef struct df_bounds {
    df_bounds_box *boxes; /* of the scene: of the surface within each block, or of each surface voxel */
    uint64_t box_count;

    struct df_bounds_gl *gl; /* DF_BOUNDS_GL */

    /* Of the current view: by square, from the first row drawn; least > greatest where there is no box. */
    double *least, *greatest; /* in units of the view's directions, from the eye */
    uint64_t capacity;        /* squares that there is room for, of all threads together */
    uint32_t columns, rows, first_row;
} df_bounds;

/* Collects the boxes of a scene, mode DF_BOUNDS_BRICKS, DF_BOUNDS_VOXELS or DF_BOUNDS_GL. `bounds` must be zero; free
 * it also after a failure. A uniform scene counts 8x8x8 voxels as a brick. */
df_status df_bounds_prepare(const df_scene *scene, int mode, df_bounds *bounds, df_error *err);
void df_bounds_free(df_bounds *bounds);
uint64_t df_bounds_bytes(const df_bounds *bounds);

/* Projects the boxes for the rows of a view. */
df_status df_bounds_project(df_bounds *bounds, const df_view *view, uint32_t first_row, uint32_t row_count,
                            uint32_t threads, df_error *err);

/* Whether any ray of a rectangle of pixels can hit. */
bool df_bounds_touch(const df_bounds *bounds, uint32_t x, uint32_t y, uint32_t width, uint32_t height);

/* The interval of the ray of a pixel; *first > *last where it cannot hit. t_base: of the ray. */
static inline void df_bounds_ray(const df_bounds *bounds, uint32_t x, uint32_t y, double t_base, float *first,
                                 float *last) {
    const uint64_t square =
        x / DF_BOUNDS_SQUARE + (uint64_t)bounds->columns * ((y - bounds->first_row) / DF_BOUNDS_SQUARE);
    *first = (float)(bounds->least[square] - t_base);
    *last = (float)(bounds->greatest[square] - t_base);
}

#endif
