/* The table of kernels of one instruction set. */
#include "render/cpu/kernel.h"

const df_kernels DF_KERNEL(df_kernels) = {
#if DF_LANES == 4
    .isa = "sse4.1",
#elif DF_LANES == 8
    .isa = "avx2",
#elif DF_LANES == 16
    .isa = "avx512",
#else
    .isa = "scalar",
#endif
    .lanes = DF_LANES,
    .view_rays = DF_KERNEL(df_kernel_view_rays),
    .solve = DF_KERNEL(df_kernel_solve),
    .adf = DF_KERNEL(df_kernel_adf),
    .cgt = DF_KERNEL(df_kernel_cgt),
    .packet = DF_KERNEL(df_kernel_packet),
    .surface_boxes = DF_KERNEL(df_kernel_surface_boxes),
    .block_rects = DF_KERNEL(df_kernel_block_rects),
    .splat = DF_KERNEL(df_kernel_splat),
    .splat_solve = DF_KERNEL(df_kernel_splat_solve),
    .shade = DF_KERNEL(df_kernel_shade),
};
