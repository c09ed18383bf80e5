/* Dense fields as arrays of other programs: NumPy's .npy and NRRD (.nrrd). */
#ifndef DF_ARRAY_FILE_H
#define DF_ARRAY_FILE_H

#include "common/field.h"

typedef enum df_array_format { DF_ARRAY_NONE, DF_ARRAY_NPY, DF_ARRAY_NRRD } df_array_format;

/* By the extension, in any case. */
df_array_format df_array_format_of(const char *path);

/* Reads a finished dense field of floats. .npy: 3 axes [z, y, x] (or in Fortran's order), float32 or float64 of either
 * byte order; the file knows no place and no size: sample (0,0,0) lies at 0, and a voxel is voxel_size wide (0: 1).
 * .nrrd: 3 axes, x fastest, float or double, raw and attached; place and size are the file's: space directions or
 * spacings, space origin; voxel_size must be 0. Values become floats, rounded once. DF_ERROR_FORMAT where the file is
 * damaged or of another kind. */
df_status df_array_read(const char *path, double voxel_size, df_field *field, df_error *err);

/* Writes a dense field as little-endian float32; .nrrd with its place, size and provenance. The target is replaced when
 * the file is complete. */
df_status df_array_write(const df_field *field, const char *path, df_error *err);

#endif
