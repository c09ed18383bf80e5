/*
 * What the files of the module build.h share: build.c drives and makes dense fields, build_bricks.c makes bricks,
 * build_signs.c gives the samples of both their signs.
 */
#ifndef DF_BUILD_PRIVATE_H
#define DF_BUILD_PRIVATE_H

#include "common/progress.h"
#include "convert/build.h"
#include "convert/winding.h"

enum { SIDE_MAX = 9, BRICK_SAMPLES_MAX = SIDE_MAX * SIDE_MAX * SIDE_MAX }; /* samples along a brick, at most */

/* A build in progress. */
typedef struct builder {
    const df_build_input *input;
    const df_lattice *lattice;
    df_cells cells;
    uint32_t side;        /* samples along a brick: k + 1 */
    size_t brick_samples; /* side^3 */
    float *samples;       /* bricks: by brick, room for `capacity`; dense: all */
    uint32_t capacity;
    uint32_t signed_count; /* while bricks are added at holes: those below this number have their signs; 0 before */
    uint8_t *waiting;      /* meanwhile, by layer of cells: 1 where bricks wait for signs; NULL before */
    df_progress progress;
} builder;

df_status df_build_dense(builder *b, df_field *field, df_build_report *report, df_error *err);
df_status df_build_bricks(builder *b, df_field *field, df_build_report *report, df_error *err);

/* Sets the signs of all samples of a dense field. */
df_status df_build_sign_dense(builder *b, df_error *err);

/* Sets the signs of all bricks from number signed_count on, and in the first round the `tokens`, by coarse cell, of the
 * cells without a brick. */
df_status df_build_sign_bricks(builder *b, uint32_t *tokens, df_error *err);

/* What a cell without a brick holds. */
static inline uint32_t df_build_token(bool inside) { return inside ? DF_CELL_INSIDE : DF_CELL_OUTSIDE; }

/* The field's kind, voxels and place, as the lattice has them. */
void df_build_set_dimensions(const builder *b, df_field *field);

uint32_t df_build_longest_side(const df_lattice *l);

#endif
