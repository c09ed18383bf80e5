/*
 * Where distances come from: the interface between the ways to compute them (exact, CGAL, OpenVDB, analytic shapes)
 * and the structures that store them.
 */
#ifndef DF_DISTANCE_H
#define DF_DISTANCE_H

#include "convert/lattice.h"
#include "convert/mesh.h"

#include <stdbool.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A distance field that can be asked for boxes of samples. Created by one of the functions below and released by
 * `free`; a zeroed source is none. */
typedef struct df_distance_source {
    void *context;
    bool is_signed; /* values are negative inside; otherwise they are distances >= 0, and the sign comes from elsewhere
                     */

    /* Writes the distances of all samples of a box, x fastest, world units, each rounded once. Called from several
     * threads at once, with at most k+1 samples a side. */
    void (*fill)(const void *context, const df_lattice *lattice, const df_sample_box *box, float *out);
    /* The distance of any point, in double, signed where is_signed; from several threads at once. NULL where the source
     * knows lattice samples only. */
    double (*at)(const void *context, const double p[3]);
    void (*free)(void *context);
} df_distance_source;

static inline void df_distance_source_free(df_distance_source *source) {
    if (source->free) source->free(source->context);
    memset(source, 0, sizeof *source);
}

/* The exact distance, fast: lists of the faces that matter, shrunk as a box of samples is divided. The mesh is not
 * needed afterwards; the threads that ask must not be more than OpenMP's maximum when the source was made. */
df_status df_distance_exact(const df_mesh *mesh, df_distance_source *source, df_error *err);

/* The tree of a source that df_distance_exact made. */
struct df_face_tree;
const struct df_face_tree *df_distance_exact_tree(const df_distance_source *source);

/* The exact distance by CGAL's AABB tree, asked once a sample. The mesh must stay as it is while the source lives. */
df_status df_distance_cgal(const df_mesh *mesh, df_distance_source *source, df_error *err);

/* OpenVDB's meshToVolume on this lattice: signed, approximate beyond one voxel from the surface. Exact about neither
 * thin walls nor cavities. Values end at band_voxels on both sides. */
df_status df_distance_openvdb(const df_mesh *mesh, const df_lattice *lattice, float band_voxels,
                              df_distance_source *source, df_error *err);

/* A distance as a float: rounded once; what is not zero does not become zero. */
static inline float df_distance_round(double distance) {
    float rounded = (float)distance;
    return rounded == 0 && distance > 0 ? 1.40129846e-45f : rounded;
}

/* Asks CGAL's exact-predicates inside test (Side_of_triangle_mesh) about points: 1 inside, -1 outside, 0 on the
 * surface. For closed meshes without faces of zero area only. points: count * 3 doubles. */
df_status df_cgal_side(const df_mesh *mesh, const double *points, uint64_t count, int8_t *sides, df_error *err);

#ifdef __cplusplus
}
#endif
#endif
