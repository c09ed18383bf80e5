/*
 * Adaptively sampled distance fields (Frisken et al. 2000): an octree whose cells are only as small as the error bound asks.
 *
 * Top down: a cell that the surface may cross is divided while the trilinear interpolation of its corners misses the distance by more than
 * a share of the bound, at the 19 other samples of its would-be children or at points of the faces inside it. Elsewhere only the side counts.
 * Then levels are made continuous by impose or split: a sample on the border of a larger leaf takes the value that leaf has there;
 * where that would move a corner of a cell with surface by more than another share of the bound, the larger leaf is divided.
 */
#ifndef DF_ADF_H
#define DF_ADF_H

#include "common/field.h"
#include "convert/distance.h"
#include "convert/sign.h"

typedef struct df_adf_input {
    const char *name; /* for messages */
    const df_lattice *lattice; /* of the finest level */
    const df_distance_source *source;
    const df_mesh *mesh; /* whose faces cross cells; NULL: cells are judged by the source's distance at their centre */
    df_sign *sign;       /* as for df_build */
    double max_error;    /* world units, >= 0 */
    bool quiet;
} df_adf_input;

typedef struct df_adf_report {
    uint64_t samples_computed;
    uint64_t divided_for_continuity; /* leaves */
    uint64_t leaves;
    double sign_ms, divide_ms, continuity_ms, structure_ms;
} df_adf_report;

/* Builds a finished ADF field, provenance still empty. On failure *field is empty. */
df_status df_adf_build(const df_adf_input *input, df_field *field, df_adf_report *report, df_error *err);

#endif
