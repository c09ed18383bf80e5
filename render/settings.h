/*
 * What a picture depends on besides the field: camera, size and methods. Settings can be written as command-line
 * arguments and read back, so that a picture carries all that is needed to make it again.
 */
#ifndef DF_SETTINGS_H
#define DF_SETTINGS_H

#include "render/frame.h"

typedef struct df_settings {
    uint32_t width, height;
    double iso;
    df_scene_options scene;
    const df_tracer *tracer; /* NULL: auto */
    int solve, steps, precision, gradient;
    int filter;        /* not trilinear: df_tracer_tricubic draws */
    bool quality_auto; /* choose them by quality.h: contradicts what is given of them */
    bool has_solve;    /* intersection, steps or precision are given */
    bool has_gradient;
    df_walk_options walk;
    double orbit[3]; /* degrees, degrees, multiples of the longest side: used when there is no eye */
    bool has_orbit, has_eye, has_look_at, has_up;
    df_camera camera; /* what has_... says is given; fov_y is unused */
    double fov;       /* degrees, vertical */
} df_settings;

void df_settings_defaults(df_settings *settings);

/* One option by its long name without the dashes ("size", "eye"); *known is false when settings have no such option. */
df_status df_settings_set(df_settings *settings, const char *name, const char *value, bool *known, df_error *err);

/* The camera with all that was left open filled in from the field. Fails for contradictions: --orbit with --eye. */
df_status df_settings_camera(const df_settings *settings, const df_field *field, df_camera *camera, df_error *err);

/* The settings with a resolved camera as lines of "name=value". NULL when memory is short. free() it. */
char *df_settings_text(const df_settings *settings, const df_camera *camera);

/* Settings from such lines. `name` stands for the source in messages. */
df_status df_settings_parse(df_settings *settings, const char *text, const char *name, df_error *err);

#endif
