/* The error of a finished field against what it was made of: at random points inside cells that a ray can hit (surface
 * voxels or leaves), the trilinear value against the signed distance. Cells in walls across holes, where the sign
 * changes without a surface, are left out: they are counted as what they are (df_build_report). */
#ifndef DF_MEASURE_H
#define DF_MEASURE_H

#include "common/field.h"
#include "convert/distance.h"
#include "convert/face_tree.h"
#include "convert/sign.h"

/* What is true. */
typedef struct df_truth {
    const df_distance_source *source; /* must have `at` */
    const df_sign *sign;              /* where the source is not signed */
    const df_face_tree *tree;         /* of sign->mesh; NULL: made for the purpose */
} df_truth;

/* Measures at point_count points spread evenly over all surface cells and sets error_max and error_rms (world units).
 * The mean is one over the surface: leaves of different size count by the area of their sides. For the maximum half as
 * many points more lie in the cells whose interpolated gradients are least like a distance's, where it is to be found.
 * The points depend on the field alone. A field without surface cells gets 0. */
df_status df_measure_error(const df_truth *truth, uint32_t point_count, df_field *field, df_error *err);

#endif
