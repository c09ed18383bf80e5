/*
 * The side of a point by the pseudonormal of the nearest feature of a mesh: the face's normal, the sum of both faces'
 * at an edge, the sum weighted by angles at a vertex (Bærentzen, Aanæs 2005). Right for closed meshes without overlaps
 * that are oriented alike; elsewhere it says on which side of the nearest face a point lies, and no more.
 */
#ifndef DF_SIGN_NORMAL_H
#define DF_SIGN_NORMAL_H

#include "convert/face_tree.h"

#include <stdbool.h>

/* Zeroed is empty. The mesh is borrowed and must stay. */
typedef struct df_sign_normals {
    const df_mesh *mesh;
    df_face_tree tree;
    double (*of_vertex)[3]; /* by vertex */
    double (*of_edge)[3];   /* by face * 3 + side; side s runs from corner s to the next */
} df_sign_normals;

/* Prepares the first face_count faces of a mesh. */
df_status df_sign_normals_make(const df_mesh *mesh, uint32_t face_count, df_sign_normals *normals, df_error *err);
void df_sign_normals_free(df_sign_normals *normals);

/* True where p lies on the inner side. *nearest must hold a face of the tree to start from; one that is near saves
 * time. */
bool df_sign_normals_inside(const df_sign_normals *normals, const double p[3], uint32_t *nearest);

#endif
