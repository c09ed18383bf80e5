/*
 * Pictures: tiles of rays through a tracer, then gradients and shading over the hits, on as many threads as asked for.
 * The bytes of a picture do not depend on threads or tiles.
 */
#ifndef DF_FRAME_H
#define DF_FRAME_H

#include "render/cpu/kernels.h"

#define DF_HEAT_NONE 0
#define DF_HEAT_STEPS 1
#define DF_HEAT_TIME 2

/* What a picture consists of; arrays that are NULL are not wanted. Rows from top to bottom. */
typedef struct df_picture {
    uint32_t width, height;
    uint8_t *rgb;   /* width * height * 3, sRGB */
    float *depth;   /* width * height: distance from the eye in world units, INFINITY where nothing is hit */
    float *normals; /* width * height * 3: unit vectors in world space, towards the outside; 0 where nothing is hit */
    float *heat;    /* width * height: what a ray of the pixel's tile cost on average, by heat_mode */
    int heat_mode;  /* DF_HEAT_STEPS: cells visited; DF_HEAT_TIME: ns of a thread */
} df_picture;

typedef struct df_frame_options {
    const df_tracer *tracer;
    int solve, steps; /* of the cell solve; steps 0: its default */
    int precision;    /* DF_PRECISION_... */
    int gradient;     /* DF_GRADIENT_... */
    int filter;       /* as in df_trace_options */
    uint32_t tile;    /* edge of a tile in pixels */
    uint32_t threads;
    const df_kernels *kernels; /* NULL: scalar */
    df_walk_options walk;
} df_frame_options;

/* Of one picture. Phases are summed over threads. */
typedef struct df_frame_stats {
    uint64_t rays_cast, rays_entering, rays_hitting;
    df_counters counters;
    double frame_ms;                    /* wall clock, from the view to the complete picture */
    double begin_ms;                    /* what the tracer does before the tiles, wall clock */
    double rays_ms, trace_ms, shade_ms; /* making rays; traversal and solves; gradients, shading and writing */
} df_frame_stats;

typedef struct df_renderer df_renderer;

/* Prepares the tracer for a scene, which must outlive the renderer, and allocates all that frames need. Pictures may be
 * at most width x height. */
df_status df_renderer_open(const df_scene *scene, const df_frame_options *options, uint32_t width, uint32_t height,
                           df_renderer **out, df_error *err);
void df_renderer_close(df_renderer *renderer);

/* Another solve, steps, precision and gradient for the pictures that follow, taken from options, which must be the
 * renderer's in all else. What does not depend on them is not prepared again. */
df_status df_renderer_set_method(df_renderer *renderer, const df_frame_options *options, df_error *err);

/* What preparing the tracer took: once per field and options. */
void df_renderer_precomputation(const df_renderer *renderer, double *ms, double *extract_ms, uint64_t *bytes);

/* Renders one picture of the view's size. stats may be NULL. */
df_status df_renderer_frame(df_renderer *renderer, const df_view *view, const df_picture *picture,
                            df_frame_stats *stats, df_error *err);

/* Only the rows first_row <= y < first_row + row_count of it; not with tracers that want whole pictures. */
df_status df_renderer_rows(df_renderer *renderer, const df_view *view, uint32_t first_row, uint32_t row_count,
                           const df_picture *picture, df_frame_stats *stats, df_error *err);

/* Adds the counts and the times of phases of a part to those of a picture. */
void df_frame_stats_add(df_frame_stats *sum, const df_frame_stats *part);

/* Counts the rays of a view that meet the field's box: a figure for reports, outside all timing. */
df_status df_count_entering(const df_view *view, uint64_t *entering, df_error *err);

/* Bytes that turn linear light 0..1 in DF_SHADE_LEVELS levels into sRGB. */
void df_shade_table(uint8_t table[]);

#endif
