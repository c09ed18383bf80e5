/*
 * A triangle mesh in memory, its cleaning and its edges.
 *
 * The mesh owns its arrays (malloc); a zeroed struct is an empty mesh. Faces are oriented: seen from outside, the
 * corners run counter-clockwise.
 */
#ifndef DF_MESH_H
#define DF_MESH_H

#include "common/status.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct df_mesh {
    double *positions; /* vertex_count * 3, world units */
    uint32_t *faces;   /* face_count * 3 vertex indices */
    uint32_t vertex_count;
    uint32_t face_count;
} df_mesh;

/* The most vertices or faces that a mesh may have. */
#define DF_MESH_COUNT_MAX 0x3FFFFFFFu

void df_mesh_free(df_mesh *mesh);

/* Adds up what df_mesh_clean did. */
typedef struct df_mesh_cleaning {
    uint32_t vertices_read, faces_read; /* faces after triangulation */
    uint32_t welded;                    /* vertices that equalled an earlier one and were replaced by it */
    uint32_t unreferenced;              /* vertices that no face uses; removed */
    uint32_t degenerate;                /* faces with a repeated corner; removed */
    uint32_t duplicate; /* faces with the same corners, in the same orientation, as an earlier one; removed */
    uint32_t reversed;  /* of a mesh that has (nearly) every face in both orientations: the second ones; removed */
    uint32_t zero_area; /* faces whose corners lie on a line: kept, because their edges close the mesh */
} df_mesh_cleaning;

/* Welds vertices of equal position, and removes faces that add nothing and vertices without a face. The order of what
 * stays is kept. Fails with DF_ERROR_INPUT for coordinates that are not finite (or beyond 1e100, whose squares
 * overflow), and when no face is left. `name` stands for the mesh in messages. */
df_status df_mesh_clean(df_mesh *mesh, const char *name, df_mesh_cleaning *cleaning, df_error *err);

/* The smallest box around all vertices. */
void df_mesh_bounds(const df_mesh *mesh, double low[3], double high[3]);

/* An edge at which more faces run one way than the other: where the mesh, as an oriented chain, has a boundary. */
typedef struct df_mesh_border {
    uint32_t from, to; /* the surplus faces run from -> to */
    uint32_t count;    /* of surplus faces, >= 1 */
} df_mesh_border;

typedef struct df_mesh_edges {
    uint32_t edge_count;
    uint32_t boundary;       /* edges of one face */
    uint32_t non_manifold;   /* edges of three faces or more */
    uint32_t misoriented;    /* edges of two faces that run the same way */
    df_mesh_border *borders; /* border_count entries, in order of their lower vertex; free() it */
    uint32_t border_count;   /* 0: the winding number is a whole number everywhere off the mesh */
} df_mesh_edges;

/* Looks at every edge of a cleaned mesh. */
df_status df_mesh_find_edges(const df_mesh *mesh, df_mesh_edges *edges, df_error *err);

#ifdef __cplusplus
}
#endif
#endif
