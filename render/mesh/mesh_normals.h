/* Normals of a mesh by any of the gradients that shade rays. */
#ifndef DF_MESH_NORMALS_H
#define DF_MESH_NORMALS_H

#include "render/mesh/marching_cubes.h"
#include "render/scene.h"

/* Replaces the normals of an extracted mesh by those of another gradient (DF_GRADIENT_..., methods/gradient.h), as a
 * ray that ends at the vertex would get it. Vertices lie on the faces between voxels or leaves: the one is read that
 * begins there. Where the gradient vanishes the normal stays. */
df_status df_mc_mesh_renew_normals(df_mc_mesh *mesh, const df_field *field, const df_mc_params *params, int gradient,
                                   df_error *err);

#endif
