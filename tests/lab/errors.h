/* Errors of solves and of gradients, measured into the table. */
#ifndef DF_TESTS_ERRORS_H
#define DF_TESTS_ERRORS_H

#include "times.h"

/* Every method over rays of a family: against a surface, a mesh, or, where both are NULL, the trilinear field. */
df_status lab_measure_errors(lab_session *session, const lab_subject *s, lab_family family, const lab_surface *surface,
                             const lab_mesh *mesh, uint64_t rays);

/* The errors of each timing's method over the rays from an eye, into scores, one a timing, which start zeroed. */
df_status lab_score_view(lab_session *session, const lab_subject *s, const df_camera *camera, lab_timing *timings,
                         lab_score *scores, int count);

/* The angle in degrees between the normal of each gradient at the true hit and that of the exact surface there. */
df_status lab_measure_normals(lab_session *session, const lab_subject *s, uint64_t rays);

#endif
