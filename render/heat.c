#include "render/heat.h"
#include "common/memory.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

enum { REPEATS = 5 };

const char *const df_heat_names[] = {"none", "steps", "time", NULL};

uint32_t df_heat_square(const df_tracer *tracer) {
    const bool ray_by_ray = tracer == &df_tracer_dda || tracer == &df_tracer_adf || tracer == &df_tracer_tricubic;
    return ray_by_ray ? 1 : 8;
}

df_status df_heat_measure(df_devices *devices, const df_view *view, const df_picture *picture, df_frame_stats *stats,
                          df_error *err) {
    const uint64_t pixels = (uint64_t)picture->width * picture->height;
    float *least;
    assert(picture->heat);
    df_status status = df_devices_frame(devices, view, picture, stats, err);
    if (status != DF_OK || picture->heat_mode != DF_HEAT_TIME) return status;
    status = df_alloc_raw((void **)&least, pixels, sizeof *least, "heat", err);
    if (status != DF_OK) return status;
    memcpy(least, picture->heat, pixels * sizeof *least);
    for (int repeat = 1; repeat < REPEATS && status == DF_OK; repeat++) {
        status = df_devices_frame(devices, view, picture, stats, err);
        for (uint64_t i = 0; i < pixels; i++) least[i] = picture->heat[i] < least[i] ? picture->heat[i] : least[i];
    }
    memcpy(picture->heat, least, pixels * sizeof *least);
    free(least);
    return status;
}

static int by_value(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

df_status df_heat_colour(const df_picture *picture, float *white, df_error *err) {
    const uint64_t pixels = (uint64_t)picture->width * picture->height;
    float *sorted;
    df_status status = df_alloc_raw((void **)&sorted, pixels, sizeof *sorted, "heat", err);
    if (status != DF_OK) return status;
    memcpy(sorted, picture->heat, pixels * sizeof *sorted);
    qsort(sorted, pixels, sizeof *sorted, by_value);
    *white = sorted[picture->heat_mode == DF_HEAT_TIME ? (pixels - 1) - (pixels - 1) / 1000 : pixels - 1];
    free(sorted);
    for (uint64_t i = 0; i < pixels; i++) {
        const float part = *white > 0 ? picture->heat[i] / *white : 0;
        for (int c = 0; c < 3; c++) { /* red rises first, then green, then blue */
            const float rise = 3 * part - (float)c;
            picture->rgb[3 * i + (uint64_t)c] = (uint8_t)(255 * (rise < 0 ? 0 : rise > 1 ? 1 : rise) + 0.5f);
        }
    }
    return DF_OK;
}
