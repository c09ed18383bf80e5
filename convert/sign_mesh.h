/*
 * The mesh that decides the sign: oriented alike, inverted bodies turned round, and holes capped.
 *
 * Faces are flipped so that neighbours across edges of two faces agree (the minority of a patch is flipped). A body
 * that is closed, bounds a negative volume and lies in no other is inside out: it is turned round with all that lies in
 * it, so that cavities stay cavities. Where the oriented faces have a border, each connected piece of border is closed
 * by a fan to its centre; the winding number of mesh and fans is a whole number everywhere, and less the fans' solid
 * angles it is the generalised winding number of the mesh (Jacobson et al. 2013), exactly and without a hierarchy.
 */
#ifndef DF_SIGN_MESH_H
#define DF_SIGN_MESH_H

#include "convert/mesh.h"

#include <stdbool.h>

/* A fan over one connected piece of border. */
typedef struct df_cap {
    double centre[3];
    double radius; /* of the ball around the centre that holds the fan */
    double area;
    uint32_t first_face, face_count; /* in the sign mesh */
    uint32_t edge_count;
} df_cap;

typedef struct df_sign_mesh {
    df_mesh mesh;             /* the faces, oriented, then the fans */
    uint32_t real_face_count; /* faces from here on are fans */
    df_cap *caps;
    uint32_t cap_count;
    uint32_t component_count;     /* pieces connected by edges */
    uint32_t flipped_faces;       /* to agree with their neighbours */
    uint32_t inverted_components; /* turned round with all their faces */
    uint32_t cavities;            /* closed components turned inwards in another */
    uint32_t unorientable_edges;  /* where flipping could not make two faces agree */
    uint32_t border_edges;        /* closed by fans */
} df_sign_mesh;

/* Makes the sign mesh of a cleaned mesh. */
df_status df_sign_mesh_make(const df_mesh *mesh, df_sign_mesh *sign, df_error *err);
void df_sign_mesh_free(df_sign_mesh *sign);

/* What must be taken from the winding numbers at 8 points (x of all, then y, then z), which count the fans, to get
 * those of the mesh alone: the solid angles of the fans listed, over 4 pi. */
void df_sign_mesh_corrections(const df_sign_mesh *sign, const uint32_t *active, uint32_t active_count,
                              const double points[3][8], double out[8]);

/* Lists the fans that matter to points within `radius` of p, leaving out those that together cover less than 0.001;
 * active has room for cap_count. Returns their number. */
uint32_t df_sign_mesh_near(const df_sign_mesh *sign, const double p[3], double radius, uint32_t *active);

#endif
