/*
 * Collects vertices and polygons as a reader finds them, and makes a triangle mesh of them. What the readers share.
 *
 * A zeroed builder is empty. Functions return false when memory is short or the mesh is too large; the builder
 * remembers that, so that a reader may look only at the end.
 */
#ifndef DF_MESH_BUILDER_H
#define DF_MESH_BUILDER_H

#include "convert/mesh.h"

#include <stdbool.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct df_mesh_builder {
    double *positions;
    size_t vertex_count, vertex_capacity;
    uint32_t *corners; /* of all polygons, one after the other */
    size_t corner_count, corner_capacity;
    uint32_t *sizes; /* of the polygons */
    size_t polygon_count, polygon_capacity;
    uint64_t skipped; /* polygons with fewer than three corners */
    bool failed;
} df_mesh_builder;

bool df_mesh_builder_vertex(df_mesh_builder *builder, double x, double y, double z);

/* Corners count from 0 and may name vertices that come later. Fewer than three are skipped and counted. */
bool df_mesh_builder_polygon(df_mesh_builder *builder, const uint32_t *corners, size_t corner_count);

/* Cuts polygons into triangles and moves all into *mesh; the builder ends up empty, whatever the outcome. A corner out
 * of range is DF_ERROR_FORMAT; `name` stands for the file. */
df_status df_mesh_builder_finish(df_mesh_builder *builder, const char *name, df_mesh *mesh, df_error *err);

void df_mesh_builder_free(df_mesh_builder *builder);

/* Cuts a polygon into corner_count - 2 triangles of the same orientation: quadrilaterals along the diagonal that keeps
 * both halves facing one way (the shorter where both do), larger ones by clipping ears in the plane of their mean
 * normal. corners: indices into positions; triangles: room for (corner_count - 2) * 3 indices. */
void df_polygon_triangulate(const double *positions, const uint32_t *corners, size_t corner_count, uint32_t *triangles);

#ifdef __cplusplus
}
#endif
#endif
