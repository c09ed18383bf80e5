/* The boxes of a block's records, DF_LANES at a time. */
#include "render/cpu/fetch.h"
#include "render/cpu/kernel.h"
#include "render/cpu/surface_box.h"

void DF_KERNEL(df_kernel_surface_boxes)(const df_scene *scene, const df_surface *surface, uint32_t block,
                                        float margin) {
    const uint32_t end = surface->first[block + 1];
    for (uint32_t first = surface->first[block]; first < end; first += DF_LANES) {
        int32_t record[DF_LANES], blocks[DF_LANES], boxes[DF_LANES];
        const uint32_t lanes = end - first < DF_LANES ? end - first : DF_LANES;
        lf corner[8];
        for (uint32_t i = 0; i < DF_LANES; i++) {
            record[i] = (int32_t)(i < lanes ? first + i : first);
            blocks[i] = (int32_t)block;
        }
        DF_FETCH_BY_TYPE(surface->sample_type, df_fetch_records, scene, surface, record, blocks, corner);
        li_store(boxes, df_surface_box_bits(corner, lf_set(margin)));
        for (uint32_t i = 0; i < lanes; i++) surface->voxels[first + i] |= (uint32_t)boxes[i];
    }
}
