/* The rays of a SIMD packet. C only, with DF_LANES set. */
#ifndef DF_PACKET_RAYS_H
#define DF_PACKET_RAYS_H

#include "render/cpu/kernels.h"
#include "render/methods/lane.h"

/* How many rays of a packet are side by side: of arbitrary rays, which have one row, all; of pixels a block as square
 * as may be. */
static inline uint32_t df_packet_width(const df_tile *tile) { return tile->height == 1 ? DF_LANES : DF_SQUARE_WIDTH; }

/* The ray of a lane of the packet at pixel (x,y) of a tile. Lanes beyond the tile repeat the first. */
static inline uint32_t df_packet_ray(const df_tile *tile, uint32_t x, uint32_t y, uint32_t width, uint32_t lane) {
    const uint32_t column = x + lane % width, row = y + lane / width;
    return column < tile->width && row < tile->height ? row * tile->width + column : y * tile->width + x;
}

/* Loads the rays of a packet; returns the bits of the lanes that lie in the tile. */
static inline uint32_t df_packet_load(const df_tile *tile, uint32_t x, uint32_t y, uint32_t width, lf origin[3],
                                      lf direction[3], lf inverse[3]) {
    const df_rays *rays = &tile->rays;
    const uint32_t first = y * tile->width + x, height = DF_LANES / width;
    const bool whole = x + width <= tile->width && y + height <= tile->height;
    int32_t ray[DF_LANES];
    uint32_t valid = 0;
    for (uint32_t i = 0; i < DF_LANES && !whole; i++) {
        ray[i] = (int32_t)df_packet_ray(tile, x, y, width, i);
        valid |= (uint32_t)(x + i % width < tile->width && y + i / width < tile->height) << i;
    }
    for (int a = 0; a < 3; a++) {
        const float *const from[3] = {rays->origin[a], rays->direction[a], rays->inverse[a]};
        lf *const to[3] = {&origin[a], &direction[a], &inverse[a]};
        for (int i = 0; i < 3; i++) {
            if (i == 0 && rays->shared_origin) *to[i] = lf_set(from[i][0]);
            else if (!whole) *to[i] = lf_gather(from[i], li_load(ray));
            else if (height == 1) *to[i] = lf_load(from[i] + first);
            else *to[i] = lf_load_square(from[i] + first, tile->width);
        }
    }
    return whole ? (uint32_t)((1ull << DF_LANES) - 1) : valid;
}

#endif
