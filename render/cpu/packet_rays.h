/* The rays of a SIMD packet. C only, with DF_LANES set. */
#ifndef DF_PACKET_RAYS_H
#define DF_PACKET_RAYS_H

#include "render/cpu/kernels.h"
#include "render/methods/lane.h"

/* The pixels of a packet: a block as square as may be. Lanes beyond the tile repeat its first ray; the bits of the
 * others are returned. */
static inline uint32_t df_packet_rays(const df_tile *tile, uint32_t x0, uint32_t y0, uint32_t width,
                                      int32_t ray[DF_LANES]) {
    uint32_t valid = 0;
    for (uint32_t i = 0; i < DF_LANES; i++) {
        const uint32_t x = x0 + i % width, y = y0 + i / width;
        const bool within = x < tile->width && y < tile->height;
        ray[i] = (int32_t)(within ? y * tile->width + x : y0 * tile->width + x0);
        valid |= (uint32_t)within << i;
    }
    return valid;
}

/* How many rays of a packet are side by side: of arbitrary rays, which have one row, all. */
static inline uint32_t df_packet_width(const df_tile *tile) {
    if (tile->height == 1) return DF_LANES;
    return DF_LANES == 16 ? 4 : DF_LANES == 8 ? 4 : DF_LANES == 4 ? 2 : 1;
}

static inline void df_packet_load(const df_rays *rays, const int32_t ray[DF_LANES], lf origin[3], lf direction[3],
                                  lf inverse[3]) {
    const li index = li_load(ray);
    for (int a = 0; a < 3; a++) {
        origin[a] = rays->shared_origin ? lf_set(rays->origin[a][0]) : lf_gather(rays->origin[a], index);
        direction[a] = lf_gather(rays->direction[a], index);
        inverse[a] = lf_gather(rays->inverse[a], index);
    }
}

#endif
