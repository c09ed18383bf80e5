/*
 * Adaptively sampled distance fields (Frisken et al. 2000): an octree whose cells are only as small as the error asks.
 *
 * Top down: a cell that the surface may cross is divided while the trilinear function that fits its 27 samples best
 * misses them, or a point of a face inside it, by more than a share of the largest error allowed, or in the root mean
 * square by more than a slope over its side. The latter is the rule that makes the error over the whole surface
 * smallest for a number of cells: the cells on a piece of surface grow by its area over the side's square, their error
 * counts by that area, so dividing pays alike everywhere where error times side is alike.
 *
 * Then the samples are fitted: each moves to the mean of what the leaves around it would like best, weighted by their
 * areas, but not far; that leaves about half of the error of exact samples. Which side a sample lies on never changes.
 * Samples on the border of a larger leaf take its interpolated value, so that the field is continuous; for leaves that
 * this spoils the larger leaf is divided. Last, leaves whose samples show that a ridge of the distance lies between
 * them are tried at more points. With max_error = 0 all samples are exact: the classic octree of full depth.
 */
#ifndef DF_ADF_H
#define DF_ADF_H

#include "common/field.h"
#include "convert/distance.h"
#include "convert/face_tree.h"
#include "convert/sign.h"

typedef struct df_adf_input {
    const char *name;                 /* for messages */
    const df_lattice *lattice;        /* of the finest level */
    const df_distance_source *source; /* of distances; unsigned ones need a tree */
    const df_face_tree *tree;         /* the faces of the surface; NULL: see crosses */
    bool tree_is_source;              /* distances are those of the tree: quicker */
    /* Without a tree: false only where the surface does not cross a cell, given by its corner and side in voxels. */
    bool (*crosses)(const void *context, const uint32_t corner[3], uint32_t side);
    const void *crosses_context;
    df_sign *sign;       /* as for df_build */
    const df_mesh *mesh; /* the input, which sign->mesh may be */
    double max_error;    /* world units, >= 0 */
    double rms_error;    /* the same for the root mean square over the surface; INFINITY: any */
    double rms_slope;    /* world units * voxels: cells are divided while their rms error * side is larger; 0: estimated
                            from rms_error by dividing a part of the octree */
    bool quiet;
} df_adf_input;

typedef struct df_adf_report {
    uint64_t samples_computed;
    uint64_t divided_for_continuity; /* leaves */
    uint64_t leaves;
    uint64_t wall_count;  /* leaves whose sign changes along an edge where no surface can lie; 0 for signed sources */
    double wall_place[3]; /* the corner of the first, world units */
    double rms_slope;     /* that was used */
    double sign_ms, divide_ms, continuity_ms, structure_ms;
} df_adf_report;

/* An octree that may be divided further after a field was made of it. */
typedef struct df_adf df_adf;

/* Builds a finished ADF field, provenance still empty, and keeps the octree; *adf is the caller's on failure, too. What
 * the input points to must outlive it. The bytes do not depend on the number of threads. On failure *field is empty. */
df_status df_adf_start(const df_adf_input *input, df_adf **adf, df_field *field, df_adf_report *report, df_error *err);

/* Makes another field, divided for a lower rms_slope. The report goes on from the last. */
df_status df_adf_refine(df_adf *adf, double rms_slope, df_field *field, df_adf_report *report, df_error *err);

void df_adf_free(df_adf *adf);

#endif
