/*
 * Which coarse cells of a lattice get a brick.
 *
 * A brick must exist where a voxel straddles the surface, and in the cells around that hold samples of the voxel's
 * gradient stencils: all samples from one before the voxel to one after it. The cells of the voxel and its 26
 * neighbours hold these, so every surface voxel within one voxel of a cell needs that cell. Before distances are known,
 * the cells that a face passes within DF_CELL_REACH are taken; those that turn out not to be needed are dropped later.
 */
#ifndef DF_CELLS_H
#define DF_CELLS_H

#include "convert/lattice.h"
#include "convert/mesh.h"

#include <stdbool.h>

#define DF_NO_BRICK UINT32_MAX
#define DF_CELL_REACH 1.00001 /* voxels: one, and room for rounding */

typedef struct df_cells {
    uint32_t *bricks;  /* by coarse cell (x fastest): the number of its brick, or DF_NO_BRICK */
    uint32_t *indices; /* by brick: the linear index of its cell, ascending but for appended ones */
    uint32_t brick_count, capacity;
} df_cells;

/* Cells that a face passes within reach_voxels of (negative: that it enters by so much). */
df_status df_cells_find(const df_mesh *mesh, const df_lattice *lattice, double reach_voxels, df_cells *cells,
                        df_error *err);

/* Cells for which keep(context, cell's coordinates) says so; it is called from several threads. */
df_status df_cells_select(const df_lattice *lattice, bool (*keep)(const void *context, const uint32_t cell[3]),
                          const void *context, df_cells *cells, df_error *err);

/* Gives the cell the next brick, out of order. */
df_status df_cells_append(df_cells *cells, uint32_t index, df_error *err);

/* Numbers the bricks by their cells again: (*from)[brick] is the number that it had. The caller frees *from. */
df_status df_cells_sort(const df_lattice *lattice, df_cells *cells, uint32_t **from, df_error *err);

void df_cells_free(df_cells *cells);

/* The coordinates of a cell. */
static inline void df_cell_position(const df_lattice *lattice, uint32_t index, uint32_t cell[3]) {
    cell[0] = index % lattice->cell_count[0];
    cell[1] = index / lattice->cell_count[0] % lattice->cell_count[1];
    cell[2] = index / lattice->cell_count[0] / lattice->cell_count[1];
}

#endif
