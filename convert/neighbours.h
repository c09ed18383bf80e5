/*
 * Which families of an octree lie side by side, and share samples.
 */
#ifndef DF_NEIGHBOURS_H
#define DF_NEIGHBOURS_H

#include "common/field.h"

/* In df_neighbours.around: the cell is a leaf or a part of one, or beyond the root. */
#define DF_NEIGHBOUR_LEAF 0xFFFFFFFEu
#define DF_NEIGHBOUR_BEYOND 0xFFFFFFFFu

/* The cells of a family's size around one of its samples, the family's own among them. */
typedef struct df_sample_cells {
    uint32_t mask; /* of the directions */
    uint8_t count;
    uint8_t directions[8]; /* into df_neighbours.around, in the order of their places: the same for all that share it */
    uint8_t samples[8];    /* which of their 27 samples it is there */
} df_sample_cells;

typedef struct df_neighbours {
    uint32_t (
        *around)[27]; /* by family: those of the cells of the same size around, x + 3 * (y + 3 * z); 13 is itself */
    uint32_t starts[DF_LEVEL_COUNT_MAX + 1]; /* where the levels begin among the families */
    uint32_t level_count;                    /* that have families */
    df_sample_cells cells[27];               /* by sample */
} df_neighbours;

/* Families as df_field_finish wants them and leaves them; links are needed. */
df_status df_neighbours_find(const df_family *families, uint32_t count, df_neighbours *neighbours, df_error *err);
/* Sets `cells` alone, which are the same for all octrees. */
void df_neighbours_list_cells(df_neighbours *neighbours);
void df_neighbours_free(df_neighbours *neighbours);

/* Which of a family's samples hang, by bit: a cell around them is a part of a leaf. The leaf's interpolation there is
 * the mean of the corners around the sample (df_family_predict), however much larger it is. */
uint32_t df_hanging_samples(const df_neighbours *neighbours, uint32_t family);

#endif
