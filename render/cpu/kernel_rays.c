/* Rays of a view, a vector at a time: directions in double, rounded once. */
#include "render/cpu/kernel.h"

#include <string.h>

enum { PARTS = DF_LANES / DF_DOUBLE_LANES };

/* df_ray_direction's. */
static lf away_from_zero(lf d) {
    const lf least = lf_set(DF_DIRECTION_MIN), minus = lf_set(-DF_DIRECTION_MIN);
    lm tiny = lm_and(lf_lt(d, least), lf_lt(minus, d));
    return lf_select(tiny, lf_select(lf_lt(d, lf_set(0)), minus, least), d);
}

void DF_KERNEL(df_kernel_view_rays)(const df_view *view, uint32_t x0, uint32_t y0, uint32_t width, uint32_t height,
                                    df_rays *rays) {
    double column[DF_DOUBLE_LANES];
    for (int i = 0; i < DF_DOUBLE_LANES; i++) column[i] = x0 + (double)i;
    const ld first = ld_load(column), next = ld_set(DF_DOUBLE_LANES);
    for (int a = 0; a < 3; a++) {
        rays->origin[a][0] = (float)view->eye[a];
        const ld right = ld_set(view->right[a]);
        for (uint32_t y = 0; y < height; y++) {
            const ld row = ld_set(view->corner[a] + (y0 + y) * view->down[a]);
            float *direction = rays->direction[a] + (size_t)y * width, *inverse = rays->inverse[a] + (size_t)y * width;
            ld at = first;
            for (uint32_t x = 0; x < width; x += DF_LANES) {
                float d[DF_LANES], inv[DF_LANES];
                ld exact[PARTS];
                for (int i = 0; i < PARTS; i++, at = at + next) exact[i] = row + at * right;
                const lf rounded = away_from_zero(lf_from_ld(exact)), inverted = lf_set(1) / rounded;
                if (x + DF_LANES <= width) {
                    lf_store(direction + x, rounded);
                    lf_store(inverse + x, inverted);
                } else {
                    lf_store(d, rounded);
                    lf_store(inv, inverted);
                    memcpy(direction + x, d, (width - x) * sizeof *d);
                    memcpy(inverse + x, inv, (width - x) * sizeof *inv);
                }
            }
        }
    }
}
