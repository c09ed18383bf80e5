/*
 * Pictures of what rays cost, for looking: black is nothing, then red, yellow and white.
 */
#ifndef DF_HEAT_H
#define DF_HEAT_H

#include "render/devices.h"

/* Names of DF_HEAT_... by number, ended by NULL. */
extern const char *const df_heat_names[];

/* Edge of the squares of pixels that a tracer's cost is measured for: 1 where it walks ray by ray, otherwise that of
 * the tracer's packets at least. */
uint32_t df_heat_square(const df_tracer *tracer);

/* Makes the picture with what it costs, picture->heat by DF_HEAT_...: steps once, times as the least of several. */
df_status df_heat_measure(df_devices *devices, const df_view *view, const df_picture *picture, df_frame_stats *stats,
                          df_error *err);

/* Colours of the picture's heat into its rgb. *white is the value that is white: the largest, or for times, which have
 * stray ones, one that a thousandth of the pixels exceeds. */
df_status df_heat_colour(const df_picture *picture, float *white, df_error *err);

#endif
