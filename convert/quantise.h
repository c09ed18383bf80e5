/*
 * Fewer bytes: samples of 16 or 8 bits.
 *
 * A sample decodes as q * 2^exponent (less the middle of q's range), with one exponent for a dense field and one for each brick or family: the smallest that
 * holds its values. A sample that several bricks hold is rounded to the coarsest of their steps, so that all decode to the same value and the
 * surface has no tears. Signs are kept: zero stays zero, a value below zero never becomes zero.
 *
 * In an ADF the corners of leaves agree in the same way, whatever the level of their families. The corners of divided cells, which serve to stop
 * early, agree among the families of one level. Samples that hang on a coarser leaf are taken from its rounded corners, so that they miss its
 * interpolated value by no more than half of their own step.
 */
#ifndef DF_QUANTISE_H
#define DF_QUANTISE_H

#include "common/field.h"

/* Makes a field with u16 or u8 samples of a finished f32 field, which stays as it is; provenance is not copied. The measured error is, and
 * should be measured again. On failure *to is empty. */
df_status df_quantise(const df_field *from, df_sample_type type, df_field *to, df_error *err);

#endif
