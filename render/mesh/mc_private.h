/* What marching_cubes.c, mc_blocks.c and mc_octree.c share. */
#ifndef DF_MC_PRIVATE_H
#define DF_MC_PRIVATE_H

#include "render/mesh/marching_cubes.h"

#define DF_MC_NONE 0xFFFFFFFFu
#define DF_MC_DENSE_BLOCK 8u /* voxels along each axis of what is one block of a dense field */

/* Allocates the arrays of a mesh; refuses too many indices. */
df_status df_mc_mesh_allocate(df_mc_mesh *mesh, const char *name, uint64_t vertex_count, uint64_t triangle_count,
                              bool normals, df_error *err);

/* The normal from a gradient per voxel; where that vanishes, `fallback`'s direction, which is not zero. */
void df_mc_normal(const df_field *field, const double gradient[3], const double fallback[3], float normal[3]);

/* The threads that params ask for. */
int df_mc_threads(const df_mc_params *params);

/* df_mc_extract for dense and brick fields. */
df_status df_mc_extract_blocks(const df_field *field, const char *name, const df_mc_params *params, df_mc_mesh *mesh,
                               df_error *err);

/* df_mc_extract for ADF fields. */
df_status df_mc_extract_octree(const df_field *field, const char *name, const df_mc_params *params, df_mc_mesh *mesh,
                               df_error *err);

#endif
