/*
 * OpenVDB's files: level sets in, fields out. The value of voxel (i,j,k) of a grid is our sample (i,j,k).
 *
 * A level set holds distances in a band around the surface; beyond it only the side is known, and the values stand at
 * the band's half width. A field that is made of one is truncated there in the same way.
 */
#ifndef DF_VDB_H
#define DF_VDB_H

#include "common/field.h"
#include "convert/distance.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct df_vdb df_vdb; /* a level set in memory */

typedef struct df_vdb_info {
    const char *grid;   /* its name; lives as long as the level set */
    df_lattice lattice; /* voxel_size that of the x axis */
    double voxel_size[3];
    double band;      /* half width, voxels of the x axis */
    float background; /* the same in world units: no value lies beyond */
    uint64_t active_voxels;
    bool half;                       /* stored as 16-bit floats */
    uint32_t version, known_version; /* of the format, in the file, and the newest that OpenVDB knows */
} df_vdb_info;

/* Reads the level set called `grid`, or with NULL the only one in the file. Its lattice, for bricks of brick_size
 * voxels, is the box of the active voxels, or for a file of ours that of the field. DF_ERROR_FORMAT for a file that is
 * damaged or truncated, DF_ERROR_INPUT for one without a level set of floats, or with one that is turned, sheared or
 * mirrored. On failure *vdb is NULL. */
df_status df_vdb_read(const char *path, const char *grid, uint32_t brick_size, df_vdb **vdb, df_vdb_info *info,
                      df_error *err);

/* The same without the process that reads the file first, to see what it does: OpenVDB trusts the numbers in a file, so
 * that a damaged one may end the program. */
df_status df_vdb_read_trusted(const char *path, const char *grid, uint32_t brick_size, df_vdb **vdb, df_vdb_info *info,
                              df_error *err);
void df_vdb_free(df_vdb *vdb);

/* The values as a signed source for df_build (does not own the level set), and the cells it must look at. */
void df_vdb_source(df_vdb *vdb, df_distance_source *source);
bool df_vdb_keeps_cell(const void *vdb, const uint32_t cell[3]);

/* Writes a field (dense or bricks) as a level set called "surface". Active are the samples that are stored and nearer
 * than `band` voxels; the others stand at the band. A band of 0 means all stored samples of bricks, 3 voxels of a dense
 * field. The target is replaced when the file is complete, as by df_output_commit. */
df_status df_vdb_write(const df_field *field, double band, const char *path, df_error *err);

#ifdef __cplusplus
}
#endif
#endif
