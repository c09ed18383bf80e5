/* What CGAL can say about a mesh, and do for it. */
#ifndef DF_MESH_REPAIR_H
#define DF_MESH_REPAIR_H

#include "convert/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Counts pairs of faces that cross each other away from shared corners, through CGAL's exact test. Slow: it costs more
 * than a conversion. */
df_status df_mesh_count_intersections(const df_mesh *mesh, uint64_t *pairs, df_error *err);

typedef struct df_mesh_repairs {
    uint32_t split_vertices; /* copies made where the mesh is not manifold */
    uint32_t stitched;       /* pairs of border edges joined */
    uint32_t holes_filled, holes_left;
    uint32_t faces_added;
} df_mesh_repairs;

/* Stitches borders and fills holes of a mesh whose faces are oriented alike as far as they can be; replaces *mesh. */
df_status df_mesh_repair(df_mesh *mesh, const char *name, df_mesh_repairs *repairs, df_error *err);

/* The alpha wrap: a closed, oriented surface around the faces, at a distance of about `offset`, which no ball of radius
 * alpha gets behind, however open the mesh is. Lengths in world units. Its time grows with 1 / alpha^2. */
df_status df_mesh_wrap(const df_mesh *mesh, double alpha, double offset, df_mesh *wrap, df_error *err);

#ifdef __cplusplus
}
#endif
#endif
