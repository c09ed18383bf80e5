/* Fields from distances: which samples are computed, their signs, and the structure they are stored in. */
#ifndef DF_BUILD_H
#define DF_BUILD_H

#include "common/field.h"
#include "convert/cells.h"
#include "convert/distance.h"
#include "convert/sign.h"

/* What a field is made of. */
typedef struct df_build_input {
    const char *name;   /* for messages */
    df_field_kind kind; /* DF_FIELD_DENSE or DF_FIELD_BRICKS */
    const df_lattice *lattice;
    const df_distance_source *source;
    const df_mesh *mesh; /* gives the cells; NULL for a signed source without mesh */
    df_sign *sign;       /* gives the sign where the source has none; sign->mesh may be `mesh`, and is replaced by an
                            oriented one where a body turns out to be inside out */
    bool (*keep)(const void *context,
                 const uint32_t cell[3]); /* without a mesh: the cells to compute; see df_cells_select */
    const void *keep_context;
    bool quiet; /* no progress bar */
} df_build_input;

typedef struct df_build_report {
    uint64_t samples_computed;
    uint32_t cells_computed; /* bricks before those that the surface does not need were dropped */
    uint64_t wall_count;  /* neighbouring samples of opposite sign further apart than their distances allow: no surface
                             lies between; in octrees leaves with two such corners */
    double wall_place[3]; /* the first of them, world units */
    uint64_t lost_features; /* coarse cells that a face crosses without a change of sign; 0 for dense fields */
    double cells_ms, distance_ms, sign_ms, structure_ms;
} df_build_report;

/* Builds a field, finished, with `provenance` still empty. *field must be empty; on failure it is. Memory is estimated
 * before it is allocated: DF_ERROR_MEMORY names the resolution that would fit. */
df_status df_build(const df_build_input *input, df_field *field, df_build_report *report, df_error *err);

/* Fails with DF_ERROR_MEMORY when `bytes` are not available. `exponent`: how bytes grow with the resolution, `longest`
 * voxels now. */
df_status df_build_check_memory(const char *name, double bytes, uint32_t longest, double exponent, df_error *err);

/* Bytes that this process may still use: the memory the system has available, or less where a limit (ulimit -v) is set.
 */
double df_available_memory(void);

#endif
