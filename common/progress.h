/* A progress bar with the remaining time on stderr, when that is a terminal and the work takes over half a second. */
#ifndef DF_PROGRESS_H
#define DF_PROGRESS_H

#include <stdbool.h>
#include <stdint.h>

typedef struct df_progress {
    const char *label;
    uint64_t total;
    uint64_t done; /* updated atomically */
    double start_ms;
    double last_draw_ms;
    bool enabled;
    bool drawn;
} df_progress;

/* Starts a bar over `total` units. quiet suppresses it, as does a stderr that is not a terminal. */
void df_progress_begin(df_progress *progress, const char *label, uint64_t total, bool quiet);

/* Adds finished units; cheap, callable from any OpenMP thread. NULL is accepted. */
void df_progress_add(df_progress *progress, uint64_t count);

/* Removes the bar. */
void df_progress_end(df_progress *progress);

/* Wall clock in milliseconds from an arbitrary start. */
double df_now_ms(void);

#endif
