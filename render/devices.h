/*
 * Pictures by the CPU, by OpenCL devices, or by several of them at once: the rows of a picture are divided between
 * them, and the division follows the measured times from picture to picture until all need the same; or of several
 * pictures each makes the next one that waits.
 */
#ifndef DF_DEVICES_H
#define DF_DEVICES_H

#include "render/frame.h"
#include "render/opencl/opencl_frame.h"

#define DF_DEVICE_MAX 8u

/* --device: one or more of them. */
typedef struct df_device_choice {
    bool automatic; /* a GPU where there is one, else the CPU, which also takes over where the GPU fails */
    uint32_t count; /* parts of a picture, from top to bottom */
    uint32_t numbers[DF_DEVICE_MAX]; /* an OpenCL device, DF_OPENCL_ANY or DF_DEVICE_CPU */
} df_device_choice;
#define DF_DEVICE_CPU 0xFFFFFFFEu

/* "cpu", "opencl", "opencl:N", "both" (cpu and opencl), "auto", or several of the first three, separated by commas.
 * Empty lists and the CPU twice are DF_ERROR_USAGE. */
df_status df_devices_parse(const char *text, df_device_choice *choice, df_error *err);

typedef struct df_devices df_devices;

typedef struct df_devices_options {
    df_device_choice choice;
    bool tracer_given; /* the tracer of the frame options was asked for by name: all devices use it, or refuse what they
                          lack; otherwise each takes its own */
    uint32_t group[2]; /* of OpenCL devices: df_opencl_options */
    bool images;
    bool deal_frames;    /* for df_devices_frames: parts make whole pictures, so that any tracer may share */
    FILE *messages;      /* where the log of a failed build goes and what "auto" has to say; NULL: nowhere */
    const char *program; /* stands before messages */
} df_devices_options;

/* Like df_renderer_open. */
df_status df_devices_open(const df_devices_options *options, const df_scene *scene, const df_frame_options *frame,
                          uint32_t width, uint32_t height, df_devices **out, df_error *err);
void df_devices_close(df_devices *devices);

/* Like df_renderer_frame; where an OpenCL device took part, hits and steps are not counted (df_devices_count). */
df_status df_devices_frame(df_devices *devices, const df_view *view, const df_picture *picture, df_frame_stats *stats,
                           df_error *err);

/* Renders `count` views of the same size, each by one part: who is free takes the next. pictures: one for each part
 * (df_devices_parts), which holds the last that it made. makers: by view, the part that made it; NULL: not asked for.
 * stats are summed over views; their frame_ms is the time of them all. */
df_status df_devices_frames(df_devices *devices, const df_view views[], uint32_t count, const df_picture pictures[],
                            uint32_t makers[], df_frame_stats *stats, df_error *err);
uint32_t df_devices_parts(const df_devices *devices);

/* Whether the CPU has taken over from a device that "auto" chose, or had none to choose: who opens the same devices
 * again names the CPU, or the reason is told again. */
bool df_devices_taken_over(const df_devices *devices);

/* What preparing the field took besides reading it: the CPU's precomputation, or the upload. extract_ms: the part of it
 * that made a mesh. */
void df_devices_precomputation(const df_devices *devices, double *ms, double *extract_ms, uint64_t *bytes);

/* Completes the counts of hits and steps of a picture: a figure for reports, outside all timing. */
df_status df_devices_count(df_devices *devices, const df_view *view, df_frame_stats *stats, df_error *err);

/* The division: shares (their sum is 1) to rows, in groups of 8 but for the last. No part goes without a group while
 * there are enough, or it could never show its speed. */
void df_devices_divide(const double shares[], uint32_t count, uint32_t height, uint32_t rows[]);

/* New shares from what the parts took: half the way to equal times, as times are noisy and rows do not cost the same.
 */
void df_devices_learn(const uint32_t rows[], const double ms[], uint32_t count, double shares[]);

/* Of the last picture, by part. */
typedef struct df_device_report {
    char name[160];     /* "cpu" or "opencl:0 NAME" */
    const char *tracer; /* its name */
    uint32_t rows;
    double ms;                  /* from the first command to the last row */
    double build_ms, upload_ms; /* once, when it was opened; 0 for the CPU, as the following */
    double trace_ms, shade_ms, download_ms;
} df_device_report;
uint32_t df_devices_report(const df_devices *devices, df_device_report reports[DF_DEVICE_MAX]);

/* The part of the shortest part's time in which all parts of the last picture were at work: 1 is full overlap; 1 for a
 * single part. */
double df_devices_overlap(const df_devices *devices);

#endif
