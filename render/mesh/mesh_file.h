/* Triangle meshes to files: .ply (binary, little endian, double positions, float normals), .obj, .stl (binary). World
 * coordinates. Files are written through common/output_file.h. */
#ifndef DF_MESH_FILE_H
#define DF_MESH_FILE_H

#include "common/progress.h"
#include "render/mesh/marching_cubes.h"

/* DF_ERROR_USAGE unless the name ends in .ply, .obj or .stl: to refuse a wrong one before the work. */
df_status df_mc_mesh_check_path(const char *path, df_error *err);

/* Writes a mesh of `field` in the format that the extension names. PLY and OBJ carry the normals when there are some;
 * STL has those of the triangles, and its positions are relative to the world's origin in float, as the format has it.
 * progress: NULL, or gets df_mc_mesh_write_work units. */
df_status df_mc_mesh_write(const df_mc_mesh *mesh, const df_field *field, const char *path, df_progress *progress,
                           df_error *err);
uint64_t df_mc_mesh_write_work(const df_mc_mesh *mesh);

#endif
