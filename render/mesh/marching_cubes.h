/*
 * Marching cubes: the surface of a field as an indexed triangle mesh, from dense, brick and ADF fields.
 *
 * Vertices are shared: one on each edge of the grid that the surface crosses (for an ADF, of the finest leaves there),
 * and a few within ambiguous voxels. The mesh is a closed 2-manifold unless the surface leaves the field's box, where
 * it has a border. The same field gives the same bytes for any number of threads. mc_cell.h tells how a voxel's surface
 * is found.
 */
#ifndef DF_MARCHING_CUBES_H
#define DF_MARCHING_CUBES_H

#include "common/field.h"
#include "common/progress.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum df_mc_method {
    DF_MC_CORRECT = 0, /* the topology of the trilinear surface: asymptotic decider on faces, exact test for tunnels */
    DF_MC_CLASSIC,     /* by the signs of the corners alone, with consistent faces; not for ADF */
} df_mc_method;

typedef struct df_mc_params {
    float iso; /* inside means value < iso; 0 for ADF */
    df_mc_method method;
    uint32_t thread_count; /* 0: OpenMP's default */
    bool skip_normals;     /* leave normals NULL */
    df_progress *progress; /* NULL: none; gets df_mc_mesh_work units */
} df_mc_params;

/* Zero-initialised = empty; df_mc_mesh_free releases it. */
typedef struct df_mc_mesh {
    uint32_t vertex_count, triangle_count;
    double *positions; /* vertex_count * 3, grid space */
    float *normals; /* vertex_count * 3: unit length, world directions, towards larger values: the central differences
                       at the ends of a vertex's edge, interpolated. NULL when skipped */
    uint32_t *triangles; /* triangle_count * 3 vertices, counter-clockwise seen from outside */
} df_mc_mesh;

#define DF_MESH_INDEX_MAX 0x7FFFFFFFu /* vertex numbers in all triangles together */

void df_mc_mesh_free(df_mc_mesh *mesh);

/* Extracts the surface. DF_ERROR_INPUT, naming the range, when iso is out of what the field stores or there is no
 * surface; and when the mesh would have more than DF_MESH_INDEX_MAX indices. `name` stands for the field in messages.
 * The mesh is empty after a failure. Needs little more memory than the mesh: about 300 bytes for each brick at the
 * surface, and some KiB a thread. */
df_status df_mc_extract(const df_field *field, const char *name, const df_mc_params *params, df_mc_mesh *mesh,
                        df_error *err);

/* The units of progress that an extraction makes. */
uint64_t df_mc_mesh_work(const df_field *field);

/* Bytes of the mesh's arrays. */
uint64_t df_mc_mesh_bytes(const df_mc_mesh *mesh);

#ifdef __cplusplus
}
#endif
#endif
