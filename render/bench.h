/* The bench protocol: frames of a camera that turns around the field in even steps, repeated, as one line of CSV. */
#ifndef DF_BENCH_H
#define DF_BENCH_H

#include "render/report.h"

#include <stdio.h>

typedef struct df_bench {
    uint32_t frames, repeats;
    bool deal_frames; /* devices make whole frames, each the next one that waits, not rows of every frame */
    const char *command;
    double *repeat_ms;     /* by repeat: the mean time of its frames; sorted by df_bench_print */
    double *edit_ms;       /* by repeat, for the caller to fill: from an edited field to its picture */
    double first_frame_ms; /* the frame before all others, with what is made at the first use: shaders' code, pages */
    df_frame_stats stats;  /* summed over the frames of the last repeat */
} df_bench;

/* Renders frames * repeats pictures on open devices; the first azimuth, the elevation and the distance are those of the
 * settings' orbit. One frame is rendered before, which counts as first_frame_ms alone. Free with df_bench_free. */
df_status df_bench_run(df_bench *bench, df_devices *devices, const df_settings *settings, const df_field *field,
                       const df_picture *picture, df_error *err);
void df_bench_free(df_bench *bench);

/* The names of the columns, and the line. `report` describes what ran; its stats are ignored. */
void df_bench_print_header(FILE *out);
df_status df_bench_print(FILE *out, const df_bench *bench, const df_report *report, df_error *err);

#endif
