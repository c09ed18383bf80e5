/*
 * Octrees with faces that do not fit: cells near the surface are left undivided at random, so that leaves of different
 * levels meet where the surface is, and interpolate different values on their common face. Harsher than what a
 * converter makes.
 */
#ifndef DF_TESTS_OCTREE_H
#define DF_TESTS_OCTREE_H

#include "surface.h"

/* A finished ADF field of 2^level_count voxels along each side with unit voxels. `keep` is the part of the cells that
 * are left undivided though the surface crosses them, of those with up to 8 voxels a side. */
df_status lab_octree_make(const lab_surface *surface, uint32_t level_count, double keep, uint64_t seed, df_field *field,
                          df_error *err);

#endif
