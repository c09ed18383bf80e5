/*
 * The cells of a scene that rays can hit, as records (df_surface in kernels.h): made once for a scene, whatever the
 * view.
 */
#ifndef DF_SURFACE_H
#define DF_SURFACE_H

#include "render/cpu/kernels.h"

/* Fills an empty surface, by `threads` threads with some instruction set's kernels; release with df_surface_free, also
 * where it fails. scene->levels: 2, or 0 with iso 0. */
df_status df_surface_make(const df_scene *scene, const df_kernels *kernels, uint32_t threads, df_surface *surface,
                          df_error *err);
void df_surface_free(df_surface *surface);
uint64_t df_surface_bytes(const df_surface *surface);

/* df_surface_make for an octree. */
df_status df_surface_make_octree(const df_scene *scene, uint32_t threads, df_surface *surface, df_error *err);

/* Room for the blocks; later for the records, all but leaves and block_log2. block_count and sample_type are set. */
df_status df_surface_alloc_blocks(df_surface *surface, df_error *err);
df_status df_surface_alloc_records(df_surface *surface, uint64_t count, df_error *err);

/* A record's box (surface_box.h); `margin` in parts of the cell. */
uint32_t df_surface_box(const float corner[8], float margin);
#define DF_SURFACE_WHOLE (0x1FFu << DF_SURFACE_HIGH) /* the box that is the cell */

/* `margin` in voxels. */
float df_surface_margin(const df_scene *scene);

#endif
