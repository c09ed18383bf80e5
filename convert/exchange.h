/*
 * df-convert where its input is a field already (.dfield, .vdb, .npy, .nrrd), or its output is a file of other programs
 * (.vdb, .npy, .nrrd).
 */
#ifndef DF_EXCHANGE_H
#define DF_EXCHANGE_H

#include "common/field.h"

typedef struct df_exchange_request {
    const char *input, *output;
    df_field_kind structure; /* wanted; 0: that of a .dfield, or the best for the output */
    const char *samples;     /* wanted: "f32", "u16", "u8" or "auto"; NULL: those of a .dfield, or f32 */
    double max_error;        /* of an ADF against the input, voxels, or world units with max_in_world */
    double rms_error;        /* the same; INFINITY: any */
    bool max_in_world, rms_in_world, allow_partial;
    uint32_t brick_size; /* 0: that of the input, or 8 */
    const char *grid;    /* of a .vdb; NULL: the only level set */
    double band;         /* voxels: see df_restructure_request and df_vdb_write; 0: not given */
    bool fill;           /* see df_restructure_request */
    double voxel_size;   /* of a .npy; 0: 1 */
    bool json, quiet;
} df_exchange_request;

/* True for files that hold a field, by their extension: as inputs, and as outputs other than .dfield. */
bool df_exchange_is_input(const char *path);
bool df_exchange_is_output(const char *path);

/* True for outputs that are arrays of all samples. */
bool df_exchange_needs_dense(const char *path);

/* Reads a field, brings it into the structure that is wanted, writes it and reports. */
df_status df_exchange_convert(const df_exchange_request *request, df_error *err);

/* Writes a finished field in the format that the extension names; anything unknown is a .dfield. A field of another
 * structure than the format takes is converted first, where that is possible (restructure.h). `band` as in the request.
 */
df_status df_exchange_write(df_field *field, const char *path, double band, df_error *err);

#endif
