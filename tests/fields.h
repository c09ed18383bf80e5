/* Small fields for tests, made by formula. */
#ifndef DF_TESTS_FIELDS_H
#define DF_TESTS_FIELDS_H

#include "common/field.h"

/* The value at a grid position; `context` is the caller's. */
typedef double (*test_function)(const double grid[3], const void *context);

/* A finished field of unit voxels at origin 0 that samples `function`, rounded to float. kind: dense; bricks of
 * brick_size with every coarse cell stored that holds a sample of the 4x4x4 neighbourhood of a surface voxel; or a full
 * octree, divided down to voxels wherever the voxel samples of a cell lie on both sides (the samples are not clamped to
 * voxel_count then). */
df_status test_field_from_function(df_field *field, df_field_kind kind, uint32_t brick_size,
                                   const uint32_t voxel_count[3], test_function function, const void *context,
                                   df_error *err);

/* A sphere of `radius` voxels about the middle of the field. */
df_status test_field_sphere(df_field *field, df_field_kind kind, uint32_t brick_size, const uint32_t voxel_count[3],
                            double radius, df_error *err);

/* The samples of an f32 field, or all but those of an ADF's first family, as u16 or u8 with a step of 1/8, and the
 * field finished again. A value below zero stays there. */
df_status test_field_quantise(df_field *field, df_sample_type type, df_error *err);

#endif
