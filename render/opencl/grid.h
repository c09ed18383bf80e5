/*
 * What a device is told about a field besides its arrays. C, C++ and OpenCL C: 32-bit scalars and arrays of them only.
 * Structure, levels, coarse size and sample type are constants of a build (DF_KIND, DF_LEVELS, DF_K, DF_SAMPLE).
 */
#ifndef DF_GRID_H
#define DF_GRID_H

#include "common/dialect.h"

typedef struct df_grid {
    uint32_t voxel_count[3], coarse_count[3];
    uint32_t row_words;                /* of the uniform walk */
    int32_t step_exponent;             /* of dense u16 and u8 samples */
    uint32_t level_count, exact_count; /* of an octree */
    float iso;
} df_grid;
typedef char df_grid_has_the_same_size_everywhere[sizeof(df_grid) == 44 ? 1 : -1];

/* What the trace kernels leave for each ray: found 0 where nothing is hit, else DF_FOUND with DF_HIT_BACK's bit shifted
 * by 1; and the candidate in 4 words, written only where something is found: cell x + 65536 y, cell z, block, logarithm
 * of the cell's size. */
#define DF_FOUND 1u
#define DF_FOUND_BACK 2u

#endif
