/*
 * The truth about a ray in a field: its first crossing of the piecewise trilinear surface, in quad precision.
 *
 * The field along a ray is a cubic in every voxel (ADF: leaf). Each cubic is split at the roots of its derivative, so
 * that every part is monotone; a part whose ends lie on different sides holds exactly one crossing, which bisection and
 * Newton find to the last bits. Slow, clear, and without a tolerance that a fast tracer could share. Checked against
 * MPFR in test_truth.c.
 *
 * Conventions (those of the renderer): inside means f < iso. From outside, a touch and a plateau at iso are misses. A
 * ray that starts inside hits where it leaves, flagged as a back face. Where two cells differ on their common face (ADF
 * levels), a jump to the other side is a hit on the face. A ray ends where it leaves the field's box.
 *
 * Ill-posed rays are told apart, not judged: `tangent` is set when moving the surface by the tangent band of the
 * renderer (1e-6 voxel + 2 float ulp of the walk's largest coordinate) could turn a hit into a miss or move it far
 * away: the ray starts or ends in the band, turns around in it, or runs along it for more than DF_TRUTH_RUN_MAX voxels;
 * or it starts within the band of a face where two leaves differ in the side of its origin.
 */
#ifndef DF_TESTS_TRUTH_H
#define DF_TESTS_TRUTH_H

#include "common/field.h"

#ifdef __cplusplus
extern "C" {
#endif

__extension__ typedef __float128 df_quad;

#define DF_TRUTH_RUN_MAX 0.01

typedef struct df_truth {
    bool hit;
    bool back;         /* the ray came from inside */
    bool tangent;      /* do not judge: see above */
    df_quad t;         /* of the first crossing, in units of the direction; valid with hit */
    double band;       /* the tangent band of this ray, voxels */
    uint32_t triangle; /* of a mesh; valid with hit */
} df_truth;

/* Origin and direction in grid space are taken as exact; the direction need not be normalised, components may be 0.
 * The ray must be finite and must have a direction. */
void df_truth_trace(const df_field *field, float iso, const double origin[3], const double direction[3], df_truth *out);

/* The same in a single voxel [0,1]^3 with these corners. */
void df_truth_trace_voxel(const float corners[8], const double origin[3], const double direction[3], df_truth *out);

/* How far (origin + t * direction) lies from the surface, to first order: |f| / |gradient|, voxels. Where the field
 * stores no samples or the gradient vanishes: INFINITY unless f is 0. */
double df_truth_residual(const df_field *field, float iso, const double origin[3], const double direction[3], double t);

#ifdef __cplusplus
}
#endif
#endif
