/*
 * Times and instructions of frames, drawn in turns.
 */
#ifndef DF_TESTS_TIMES_H
#define DF_TESTS_TIMES_H

#include "render/devices.h"
#include "rows.h"

#define LAB_CHOICE_ROWS 1024u /* what --quality auto chooses for, whatever the size of the pictures that are timed */

/* A way to draw, and the row that it becomes. */
typedef struct lab_timing {
    df_frame_options options;
    bool on_device;        /* the first OpenCL device draws it, by its own walk, and not the CPU */
    bool contested;        /* the first of all, which have scores: find its contender among the others */
    df_renderer *renderer; /* one of all timings that differ in method only */
    bool owner;            /* the first of them, which closes it */
    df_devices *devices;   /* on_device */
    char device[160];      /* and its name */
    double ms[16];
    df_frame_stats stats;
    uint64_t instructions; /* of the last frame; 0: not counted */
    lab_row row;
} lab_timing;

lab_timing lab_timing_make(const lab_session *session, const char *kind, const df_tracer *tracer, lab_method m,
                           int gradient);

/* The camera of all pictures: an eye so many longest sides away. */
void lab_camera(const df_field *field, double distance, df_camera *camera);
#define LAB_CHART_DISTANCE 1.6

/* Draws a frame on the CPU by the timing's method. */
df_status lab_draw_frame(const lab_timing *t, const df_view *view, const df_picture *picture, df_frame_stats *stats,
                         df_error *err);

int lab_compare_doubles(const void *a, const void *b);

/* Rows and columns of the pictures that are timed. */
uint32_t lab_picture_size(const lab_session *session);

/* Whether the table has all their rows, of pictures of so many rays. */
bool lab_all_timed(const lab_session *session, const lab_subject *s, lab_timing *timings, int count, uint64_t rays);

/* Draws all, size x size pixels, from an eye so many longest sides away, and writes their rows. In the child under
 * callgrind: draws each once, under its row's key. */
df_status lab_time_all(lab_session *session, const lab_subject *s, double distance, uint32_t size, lab_timing *timings,
                       int count);

/* Every method, tracer and gradient at 1.6 longest sides: the chart. */
df_status lab_measure_times(lab_session *session, const lab_subject *s);

#endif
