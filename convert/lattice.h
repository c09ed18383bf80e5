/* Where the samples of a field lie: the part of a df_field that is known before there are values. */
#ifndef DF_LATTICE_H
#define DF_LATTICE_H

#include "common/status.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct df_lattice {
    uint32_t voxel_count[3];
    double voxel_size;      /* world units, the same on all axes */
    double origin[3];       /* of sample (0,0,0) */
    uint32_t brick_size;    /* k: voxels along a coarse cell */
    uint32_t cell_count[3]; /* ceil(voxel_count / k) */
} df_lattice;

/* A box of samples: first[a] <= i < first[a] + count[a]. */
typedef struct df_sample_box {
    uint32_t first[3];
    uint32_t count[3];
} df_sample_box;

/* How fine a field is to be. */
typedef struct df_lattice_request {
    uint32_t resolution; /* voxels along the longest side, padding included; 0: voxel_size counts */
    double voxel_size;
    double padding; /* voxels between the surface's box and the field's, on each side */
    uint32_t brick_size;
} df_lattice_request;

/* Lays a lattice around the box low..high of a surface. The longest side gets `resolution` voxels (or as many as
 * voxel_size asks), the others as many as they need; the surface is centred. `name` stands for the surface in messages.
 */
df_status df_lattice_make(const df_lattice_request *request, const double low[3], const double high[3],
                          const char *name, df_lattice *lattice, df_error *err);

/* World coordinate of sample index i along an axis: the one place where it is computed. */
static inline double df_lattice_at(const df_lattice *lattice, int axis, uint32_t i) {
    return lattice->origin[axis] + (double)i * lattice->voxel_size;
}

static inline uint64_t df_lattice_cell_total(const df_lattice *lattice) {
    return (uint64_t)lattice->cell_count[0] * lattice->cell_count[1] * lattice->cell_count[2];
}

#ifdef __cplusplus
}
#endif
#endif
