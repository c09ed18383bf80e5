/*
 * Fewer bytes: samples of 16 or 8 bits.
 *
 * A sample decodes as q * 2^exponent (less the middle of q's range), with one exponent for a dense field and one for
 * each brick: the smallest that holds its values. A sample that several bricks hold is rounded to the coarsest of their
 * steps, so that all decode to the same value and the surface has no tears. Signs are kept: zero stays zero, a value
 * below zero never becomes zero. Values of bricks end at 4 voxels from the surface, so that those far away do not set
 * the step.
 *
 * An ADF stores what samples differ from the means of their cell's corners (octree.h), with one exponent a family; the
 * families of its first levels, about one in 128, stay floats, as their differences are large and few. Each level
 * starts from the decoded values of the one above, so errors do not add up. Samples that hang on a larger leaf differ
 * by 0, which keeps the field continuous.
 */
#ifndef DF_QUANTISE_H
#define DF_QUANTISE_H

#include "common/field.h"

/* Makes a field with u16 or u8 samples of a finished f32 field, which stays as it is; provenance is not copied. The
 * measured error is, and should be measured again. On failure *to is empty. */
df_status df_quantise(const df_field *from, df_sample_type type, df_field *to, df_error *err);

#endif
