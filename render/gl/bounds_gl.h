/*
 * The interval pre-pass by a rasteriser, as the seed's DFRRT had it: the boxes around the surface are drawn as solids,
 * and of all their faces over a pixel the least and the greatest t stay (two depth buffers in one target, by blending
 * with the minimum).
 */
#ifndef DF_BOUNDS_GL_H
#define DF_BOUNDS_GL_H

#include "render/view.h"

/* Voxels low to last: six u16 a box, low first. */
typedef struct df_bounds_gl df_bounds_gl;

/* Uploads the boxes. */
df_status df_bounds_gl_open(const uint16_t (*boxes)[6], uint64_t box_count, df_bounds_gl **out, df_error *err);
void df_bounds_gl_close(df_bounds_gl *gl);

/* Draws the boxes, widened by `pad` voxels and by what the rasteriser may move a corner, and takes the least and
 * greatest t of every square of edge^2 pixels into least and greatest, by square, rows first. Boxes that reach behind
 * the eye are drawn in part only. */
df_status df_bounds_gl_draw(df_bounds_gl *gl, const df_view *view, uint32_t first_row, uint32_t row_count, double pad,
                            uint32_t edge, double *least, double *greatest, df_error *err);

#endif
