/*
 * Times and instructions of frames, drawn in turns.
 */
#ifndef DF_TESTS_TIMES_H
#define DF_TESTS_TIMES_H

#include "render/frame.h"
#include "rows.h"

#define LAB_CHOICE_ROWS 1024u /* what --quality auto chooses for, whatever the size of the pictures that are timed */

/* A way to draw, and the row that it becomes. */
typedef struct lab_timing {
    df_frame_options options;
    df_renderer *renderer;
    double ms[16];
    df_frame_stats stats;
    uint64_t instructions; /* of the last frame; 0: not counted */
    lab_row row;
} lab_timing;

lab_timing lab_timing_make(const lab_session *session, const char *kind, const df_tracer *tracer, lab_method m,
                           int gradient);

/* Rows and columns of the pictures that are timed. */
uint32_t lab_picture_size(const lab_session *session);

/* Whether the table has all their rows, of pictures of so many rays. */
bool lab_all_timed(const lab_session *session, const lab_subject *s, lab_timing *timings, int count, uint64_t rays);

/* Draws all from an eye so many longest sides away, and writes their rows. In the child under callgrind: draws each
 * once, under its row's key. */
df_status lab_time_all(lab_session *session, const lab_subject *s, double distance, lab_timing *timings, int count);

/* Every method, tracer and gradient at 1.6 longest sides: the chart. */
df_status lab_measure_times(lab_session *session, const lab_subject *s);

#endif
