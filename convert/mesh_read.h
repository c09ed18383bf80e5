/* Meshes from files: .obj through tinyobjloader, .off and .stl through CGAL, .ply by our own reader. */
#ifndef DF_MESH_READ_H
#define DF_MESH_READ_H

#include "convert/mesh.h"

#include <stdbool.h>
#include <stddef.h>

/* True when the extension (in any case) is one that df_mesh_read knows. */
bool df_mesh_is_mesh_path(const char *path);

/* Reads a mesh as it is in the file, polygons cut into triangles; the format follows the extension. On failure *mesh is
 * empty, and the error names the file and the place. */
df_status df_mesh_read(const char *path, df_mesh *mesh, df_error *err);

#endif
