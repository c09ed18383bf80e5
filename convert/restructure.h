/*
 * Fields from fields: another structure for the samples that a field holds.
 *
 * Nothing is made up. Bricks hold a part of the samples only: what they do not hold is known to lie inside or outside,
 * and at least as far from the surface as the nearest samples that are stored (df_restructure_band). So bricks become
 * dense only where every cell has a brick, or when the caller asks to fill the rest with that least distance; larger
 * bricks are made of smaller ones only where these hold the samples. An ADF is interpolated: that is what its samples
 * mean. An ADF is made of voxels that the surface crosses, from the top down like one of a mesh; where bricks hold no
 * samples it takes the least distance they can have.
 */
#ifndef DF_RESTRUCTURE_H
#define DF_RESTRUCTURE_H

#include "common/field.h"
#include "convert/distance.h"

typedef struct df_restructure_request {
    const char *name;    /* of the field, for messages */
    df_field_kind kind;  /* wanted; an ADF of an ADF is not made */
    uint32_t brick_size; /* of bricks: 4 or 8 */
    double band; /* voxels: distances beyond are cut to it, on both sides; at least 2, so that voxels at the surface
                    stay whole; 0: none are */
    bool fill;   /* dense of bricks: samples that are not stored get their side and the least distance they can have */
    double max_error;   /* of an ADF against the field, world units: see df_adf_input */
    double rms_error;   /* the same; INFINITY: any */
    bool allow_partial; /* an ADF that misses by more is made all the same */
    bool quiet;
} df_restructure_request;

/* Builds *to, f32, finished, with verdict and measured error of `from` where they still hold, and no provenance. *to
 * must be empty; on failure it is. DF_ERROR_INPUT where samples are needed that the field does not hold; the message
 * says how many cells lack them. */
df_status df_restructure(const df_field *from, const df_restructure_request *request, df_field *to, df_error *err);

/* The samples of a field in another type, with the error that adds, measured at random points of surface cells, in
 * *added (world units, the largest); the field's own measured error grows by it. DF_ERROR_INPUT for a quantised ADF. */
df_status df_restructure_samples(const df_field *from, const char *name, df_sample_type type, double *added,
                                 df_field *to, df_error *err);

/* Up to what distance from the surface, in voxels, a field holds all samples; INFINITY for dense fields and ADF. */
double df_restructure_band(const df_field *field);

/* The lattice of a field, for bricks of brick_size voxels. Its voxel_size is that of the x axis. */
void df_restructure_lattice(const df_field *field, uint32_t brick_size, df_lattice *lattice);

#endif
