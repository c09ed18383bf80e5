/*
 * Holes in pictures: for tracers that draw views only, and against which no family of rays can be held.
 */
#ifndef DF_TESTS_VIEW_ESCAPES_H
#define DF_TESTS_VIEW_ESCAPES_H

#include "measure.h"

/* Draws pictures of at least rays pixels in all, of a closed field, with a tracer that suits views: every other one
 * from an eye inside, where each pixel must hit, the others from eyes around the field, where each pixel must hit that
 * hits when each ray walks alone. The truth is asked about the others, which are the escapes; *escapes counts them like
 * lab_count_escapes, pixels numbered through all pictures. */
df_status lab_count_view_escapes(const df_tracer *tracer, const df_scene *scene, uint64_t seed, uint64_t rays,
                                 lab_escapes *escapes, df_error *err);

#endif
