/*
 * The triangles of a mesh prepared for exact distances: in Morton order, under an implicit tree of boxes with eight
 * children a node.
 *
 * Distances are computed in double by one formula (face_distance), the same to the bit for every SIMD width and however
 * a face was found; lists of faces only ever leave out what is further away by more than any rounding.
 */
#ifndef DF_FACE_TREE_H
#define DF_FACE_TREE_H

#include "convert/mesh.h"

/*
 * A triangle a, b, c with ab its longest side: the foot of c on ab is a + foot * ab, and h leads from there to c.
 * Coordinates along ab and h are well-conditioned for needles and slivers too, and every point found with them lies on
 * the triangle.
 */
typedef struct df_face {
    double a[3], ab[3], h[3], ac[3];
    double normal[3]; /* unit length, across ab and h, so well-conditioned as well; 0 for a face without area */
    double inverse_ab, inverse_h, inverse_ac, inverse_bc; /* 1 over the squared lengths; 0 for 0 */
    double foot;                                          /* in [0, 1] */
} df_face;

/* The boxes of eight children, relative to the tree's origin and in its units, rounded outwards; missing children have
 * an empty box. */
typedef struct df_face_node {
    float low[3][8], high[3][8];
} df_face_node;

/* A sphere around a face, relative to the tree's origin and in its units; its centre is a point of the face. */
typedef struct df_face_sphere {
    float centre[3], radius;
} df_face_sphere;

#define DF_FACE_LEVEL_MAX 12

typedef struct df_face_tree {
    df_face *faces;          /* in Morton order */
    df_face_sphere *spheres; /* by face */
    uint32_t *order;         /* by face: its number in the mesh */
    uint32_t face_count;
    df_face_node *levels[DF_FACE_LEVEL_MAX]; /* levels[0][n]: boxes of faces 8n to 8n+7; levels[l][n]: of nodes 8n to
                                                8n+7 below */
    uint32_t node_counts[DF_FACE_LEVEL_MAX];
    uint32_t level_count;
    double origin[3];
    double scale; /* of world units to those of the tree, a power of two: its longest side is 1 to 2, so that squares in
                     float stay in range however large or small the mesh is */
    double slack; /* what a distance computed from boxes or spheres may be too large, units of the tree */
} df_face_tree;

/* Builds the tree; the mesh is not needed afterwards. */
df_status df_face_tree_make(const df_mesh *mesh, df_face_tree *tree, df_error *err);
void df_face_tree_free(df_face_tree *tree);

/* The squared distance of p to the nearest face, whose index in tree->faces goes to *nearest. *nearest must hold a face
 * to start from on entry; one that is near saves time. */
double df_face_tree_nearest(const df_face_tree *tree, const double p[3], uint32_t *nearest);

/* Lists all faces within `distance` of p and some more. Returns their number, or capacity + 1 where they do not fit. */
uint32_t df_face_tree_list(const df_face_tree *tree, const double p[3], double distance, uint32_t *list,
                           uint32_t capacity);

/* The winding number of p: the crossings of the row along x that ends there. For points in general position; see
 * winding.h for lattices. */
int32_t df_face_tree_winding(const df_face_tree *tree, const double p[3]);

/* Squared distances of 8 points to each of `count` faces: out[i * 8 + point] for the i-th in the list. points: x of all
 * 8, then y, then z. `least` gets the smallest of each point. out may be NULL. */
void df_face_distances(const df_face *faces, const uint32_t *list, uint32_t count, const double points[3][8],
                       double *out, double least[8]);

/* The same without `out`, of a tree: exact distances only to faces that spheres around them show to be near enough to
 * one of the points. distances: room for count * 8; kept: for count. */
void df_face_distances_of_near(const df_face_tree *tree, const uint32_t *list, uint32_t count,
                               const double points[3][8], float *distances, uint32_t *kept, double least[8]);

/* Eight boxes of points, by their centres and half sides. */
typedef struct df_face_boxes {
    double centre[3][8];
    double half[3][8];
} df_face_boxes;

/* For each face of a list, which of eight boxes it may be the nearest to a point of: bit b of masks[i]. Judged in float
 * by the spheres around the faces: a face is left out where some face's centre is nearer to all points of the box than
 * its sphere. The comparison of squared distances to two centres is linear in the point, so the corners of the box
 * decide. distances: room for count * 8; gets the squares to the centres of the spheres, units of the tree. */
void df_face_select(const df_face_tree *tree, const uint32_t *list, uint32_t count, const df_face_boxes *boxes,
                    float *distances, uint8_t *masks);

#endif
