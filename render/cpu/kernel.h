/* What the kernel sources share: the name of a kernel for the instruction set that it is compiled for. C only, with
 * DF_LANES set. */
#ifndef DF_KERNEL_H
#define DF_KERNEL_H

#include "render/cpu/kernels.h"
#include "render/methods/lane.h"

#if DF_LANES == 4
#define DF_KERNEL(name) name##_sse41
#elif DF_LANES == 8
#define DF_KERNEL(name) name##_avx2
#elif DF_LANES == 16
#define DF_KERNEL(name) name##_avx512
#else
#define DF_KERNEL(name) name##_scalar
#endif

uint32_t DF_KERNEL(df_kernel_adf)(const df_packet_job *job, df_candidate *candidates, df_counters *counters);
uint32_t DF_KERNEL(df_kernel_cgt)(const df_packet_job *job, df_candidate *candidates, df_counters *counters);
uint32_t DF_KERNEL(df_kernel_packet)(const df_packet_job *job, df_candidate *candidates, df_counters *counters);
void DF_KERNEL(df_kernel_surface_boxes)(const df_scene *scene, const df_surface *surface, uint32_t block, float margin);
void DF_KERNEL(df_kernel_block_rects)(const df_surface *surface, const df_projection *projection,
                                      const df_tile *picture, uint32_t first, uint32_t count, df_block_rect *rects);
void DF_KERNEL(df_kernel_splat)(const df_splat_job *job, df_counters *counters);
void DF_KERNEL(df_kernel_splat_solve)(const df_splat_job *job, const df_trace_options *options, df_hits *hits);
void DF_KERNEL(df_kernel_view_rays)(const df_view *view, uint32_t x, uint32_t y, uint32_t width, uint32_t height,
                                    df_rays *rays);
void DF_KERNEL(df_kernel_solve)(const df_scene *scene, const df_trace_options *options, const df_rays *rays,
                                const df_candidate *candidates, uint32_t count, df_hits *hits);
void DF_KERNEL(df_kernel_shade)(const df_shade_job *job, const df_hits *hits);

#endif
