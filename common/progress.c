#include "common/progress.h"

#include <math.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

enum { BAR_WIDTH = 30 };

double df_now_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec * 1e3 + (double)now.tv_nsec * 1e-6;
}

void df_progress_begin(df_progress *progress, const char *label, uint64_t total, bool quiet) {
    *progress = (df_progress){.label = label, .total = total ? total : 1, .start_ms = df_now_ms()};
    progress->enabled = !quiet && isatty(STDERR_FILENO);
}

static void draw(df_progress *progress, uint64_t done, double now_ms) {
    double part = fmin((double)done / (double)progress->total, 1.0);
    double elapsed_s = (now_ms - progress->start_ms) * 1e-3;
    int filled = (int)(part * BAR_WIDTH);
    char bar[BAR_WIDTH + 1];
    for (int i = 0; i < BAR_WIDTH; i++) bar[i] = i < filled ? '=' : ' ';
    bar[BAR_WIDTH] = 0;
    fprintf(stderr, "\r%-12s [%s] %3.0f %%  %.0f s left ", progress->label, bar, part * 100,
            part > 0 ? ceil(elapsed_s * (1 - part) / part) : 0.0);
    fflush(stderr);
    progress->drawn = true;
}

void df_progress_add(df_progress *progress, uint64_t count) {
    if (!progress || !progress->enabled) return;
    uint64_t done = __atomic_add_fetch(&progress->done, count, __ATOMIC_RELAXED);
    double now_ms = df_now_ms(), last_ms;
    if (now_ms - progress->start_ms < 500) return;
    __atomic_load(&progress->last_draw_ms, &last_ms, __ATOMIC_RELAXED);
    if (now_ms - last_ms < 100) return;
    /* Whoever moves the time forward draws. */
    if (__atomic_compare_exchange(&progress->last_draw_ms, &last_ms, &now_ms, false, __ATOMIC_RELAXED,
                                  __ATOMIC_RELAXED)) {
        draw(progress, done, now_ms);
    }
}

void df_progress_end(df_progress *progress) {
    if (progress->drawn) {
        fputs("\r\033[K", stderr);
        fflush(stderr);
    }
    progress->enabled = false;
    progress->drawn = false;
}
