/* The boxes of a block's records, DF_LANES at a time. */
#include "render/cpu/fetch.h"
#include "render/cpu/kernel.h"
#include "render/methods/surface_box.h"

void DF_KERNEL(df_kernel_surface_boxes)(const df_scene *scene, const df_surface *surface, uint32_t block,
                                        float margin) {
    const uint32_t end = surface->first[block + 1];
    for (uint32_t first = surface->first[block]; first < end; first += DF_LANES) {
        int32_t record[DF_LANES], blocks[DF_LANES], lows[3][DF_LANES], highs[3][DF_LANES];
        const uint32_t lanes = end - first < DF_LANES ? end - first : DF_LANES;
        lf corner[8];
        li low[3], high[3];
        for (uint32_t i = 0; i < DF_LANES; i++) {
            record[i] = (int32_t)(i < lanes ? first + i : first);
            blocks[i] = (int32_t)block;
        }
        DF_FETCH_BY_TYPE(surface->sample_type, df_fetch_records, scene, surface, record, blocks, corner);
        df_surface_eighths(corner, lf_set(margin), low, high);
        for (int a = 0; a < 3; a++) {
            li_store(lows[a], low[a]);
            li_store(highs[a], high[a]);
        }
        for (uint32_t i = 0; i < lanes; i++) {
            for (int a = 0; a < 3; a++) {
                surface->voxels[first + i] |= (uint32_t)lows[a][i] << (DF_SURFACE_LOW + 3 * a) |
                                              (uint32_t)highs[a][i] << (DF_SURFACE_HIGH + 3 * a);
            }
        }
    }
}
