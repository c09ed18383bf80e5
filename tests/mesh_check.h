/* What an indexed triangle mesh is, combinatorially, and the Euler characteristic that a field's surface should have:
 * both share no code with the extraction. */
#ifndef DF_TESTS_MESH_CHECK_H
#define DF_TESTS_MESH_CHECK_H

#include "common/field.h"
#include "render/mesh/marching_cubes.h"

typedef struct mesh_check {
    uint64_t border_edges;   /* half edges without an opposite */
    uint64_t crowded_edges;  /* half edges that occur twice: more than two triangles, or a flipped one */
    uint64_t split_vertices; /* vertices whose triangles do not form one fan */
    uint64_t unused_vertices;
    uint64_t degenerate; /* triangles that name a vertex twice */
    int64_t euler;       /* V - E + F */
} mesh_check;

mesh_check check_mesh(const df_mc_mesh *mesh);

/* The Euler characteristic of the surface 0 of a dense or ADF field whose outermost samples are outside. Subdivide and
 * count: the field is cut into open voxels, squares, edges and samples, each of them until f has one sign in a piece or
 * rises or falls along an axis, where its part below 0 is known; the parts add up. Exact but for the rounding of the
 * values. The boundary of a solid has twice its characteristic. */
int64_t subdivided_euler(const df_field *field);

#endif
