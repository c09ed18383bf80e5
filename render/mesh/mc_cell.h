/*
 * Marching cubes inside one cell: from the values at its corners to triangles.
 *
 * Corner c in 0..7 lies at (c & 1, c >> 1 & 1, c >> 2). Edge 4*axis + u + 2*v runs along `axis` from the corner whose
 * bits on the other two axes, in ascending order, are u and v. Inside means value < 0 (iso is subtracted before).
 * Triangles run counter-clockwise seen from outside the solid.
 *
 * The surface of a cell is found in two steps. On the faces, which both neighbours see alike, crossings are joined to
 * segments; where the corners alternate the sign of the face's bilinear saddle decides (Nielson and Hamann, "The
 * asymptotic decider", 1991), computed from products that commute, so that both sides get the same bits. The segments
 * close to loops. Each loop bounds a disc, except where two are joined by a tunnel (Chernyaev, "Marching Cubes 33",
 * 1995).
 *
 * The tunnel is decided exactly, without a case table. A surface f = 0 of the trilinear f contains six straight lines
 * parallel to the axes, two for each, where slices across an axis have their saddle on the surface; they close to a
 * hexagon. When all six lie in the cell, and the slices between the two of an axis have proper saddles (the coefficient
 * of the bilinear term keeps its sign), the hexagon is a waist of the surface that no disc can fill; otherwise the
 * surface in the cell consists of discs. The waist's corners become vertices.
 *
 * No triangle edge but the segments lies in a face of the cell (such edges could meet the neighbour's, and four
 * triangles would share one); loops that cannot be filled so get a vertex in the cell's interior, on the surface where
 * Newton's method finds it.
 */
#ifndef DF_MC_CELL_H
#define DF_MC_CELL_H

#include "common/status.h"

#include <stdbool.h>
#include <stdint.h>

#define DF_MC_EDGE_COUNT 12
#define DF_MC_TABLE_MAX 10    /* triangles of a cell from the table: 12 crossings, at least one loop */
#define DF_MC_BY_VALUES 0xFFu /* triangle_count of cells whose corner values are needed */

/* Triangles by the signs of the corners (bit c set: corner c is inside), derived by df_mc_tables_make, not typed in. */
typedef struct df_mc_tables {
    uint8_t triangle_count[256];                /* or DF_MC_BY_VALUES */
    uint8_t triangles[256][DF_MC_TABLE_MAX][3]; /* edges */
} df_mc_tables;

/* correct: cells with an ambiguous face or more than one loop are left to df_mc_cell_fill. Otherwise the classic tables
 * of Lorensen and Cline (1987), where on each ambiguous face the inside corners are separated. */
void df_mc_tables_make(df_mc_tables *tables, bool correct);

/* The surface within one cell. Zero-initialised = empty; reused from cell to cell; df_mc_patch_free releases it. */
typedef struct df_mc_patch {
    double (*positions)[3]; /* of the boundary vertices, set by the caller, then of those in the interior; cell
                               coordinates in [0,1] */
    uint32_t boundary_count;
    uint32_t position_count, position_capacity;
    uint32_t *loops; /* boundary vertices, loop after loop, in the direction of the triangles */
    uint32_t loop_size, loop_capacity;
    uint32_t *loop_ends; /* by loop: where it ends in `loops` */
    uint32_t loop_count, loop_end_capacity;
    uint32_t (*triangles)[3]; /* vertices of this patch */
    uint32_t triangle_count, triangle_capacity;
} df_mc_patch;

void df_mc_patch_free(df_mc_patch *patch);

/* Empties the patch and makes room for boundary_count boundary vertices, whose positions and loops the caller sets
 * then. */
df_status df_mc_patch_begin(df_mc_patch *patch, uint32_t boundary_count, df_error *err);

/* Fills the loops of a patch with triangles: each a fan around a new vertex, two of them joined where there is a
 * tunnel. values: at the corners, minus iso. */
void df_mc_patch_fill(df_mc_patch *patch, const double values[8]);

/* The surface in a cell whose boundary vertices are its edges 0..11: begins the patch, sets positions and loops, and
 * fills them. After one call it cannot fail any more. */
df_status df_mc_cell_fill(df_mc_patch *patch, const double values[8], df_error *err);

/* True when the bilinear interpolation of a face joins its inside corners; a, c and b, d lie diagonally, a and c are
 * inside, b and d are not. */
static inline bool df_mc_face_joins(double a, double b, double c, double d) { return a * c > b * d; }

/* The two corners of an edge: first < second. */
void df_mc_edge_corners(uint32_t edge, uint32_t corners[2]);

/* The corners of face 2*axis + upper, counter-clockwise seen from outside the cell, and the edges from each to the
 * next. */
void df_mc_face(uint32_t face, uint32_t corners[4], uint32_t edges[4]);

#endif
