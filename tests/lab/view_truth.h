/*
 * Pictures against the truth: what is really to be seen in each pixel of a view.
 */
#ifndef DF_TESTS_VIEW_TRUTH_H
#define DF_TESTS_VIEW_TRUTH_H

#include "measure.h"
#include "render/view.h"

/* A camera that looks at a random point of the field: every other one from inside the solid, the others from anywhere
 * half a side to almost three sides away. False: no point inside was found. */
bool lab_random_camera(const df_field *field, uint64_t seed, uint64_t index, df_camera *camera);

/* The rays of a view's pixels, by rows, and their truths against the trilinear field. */
df_status lab_view_truths(const df_scene *scene, const df_view *view, lab_known *pixels, df_error *err);

/* How far away the hit of a pixel is in world units, as pictures have it; INFINITY: there is none. */
double lab_known_depth(const df_field *field, const lab_known *pixel);

/* The depths of a picture against the truths of its pixels, which are numbered from `first`. Adds to *score. */
void lab_score_depths(const df_field *field, const lab_known *pixels, uint64_t count, uint64_t first,
                      const float *depth, lab_score *score);

#endif
