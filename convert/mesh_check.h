/* The diagnosis that df-convert --check prints. */
#ifndef DF_MESH_CHECK_H
#define DF_MESH_CHECK_H

#include "convert/mesh.h"

#include <stdbool.h>

typedef struct df_mesh_diagnosis {
    df_mesh_cleaning cleaning;
    df_mesh_edges edges; /* borders not kept */
    uint32_t vertices, faces;
    uint32_t holes;                 /* connected pieces of border */
    uint32_t non_manifold_vertices; /* whose faces form more than one fan */
    uint32_t components;
    uint32_t cavities; /* closed components turned inwards that lie in another */
    uint32_t inverted; /* closed components turned inwards that lie in no other, and what they hold */
    uint32_t flips;    /* faces to flip so that neighbours agree */
    uint32_t unorientable_edges;
    uint64_t intersections; /* pairs of faces that cross */
} df_mesh_diagnosis;

/* Examines a cleaned mesh. */
df_status df_mesh_check(const df_mesh *mesh, const df_mesh_cleaning *cleaning, df_mesh_diagnosis *diagnosis,
                        df_error *err);

/* Lines, or one JSON object, on stdout. */
void df_mesh_print_diagnosis(const char *name, const df_mesh_diagnosis *diagnosis, bool json);

#endif
