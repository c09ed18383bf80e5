/*
 * How a choice compares by the clock: frames in pairs, in turns, by the CPU time of the thread that draws. That is the
 * clock of a machine that does nothing else, and it stays so on one that does.
 */
#ifndef DF_TESTS_CONTENDER_H
#define DF_TESTS_CONTENDER_H

#include "times.h"

/* Among timings[1..count) those that make no error and are no less exact than timings[0] are contenders; the three that
 * were fastest are drawn again, each frame next to one of timings[0]. Sets contender and contender_ratio of
 * timings[0].row: the one that is the cheapest beside it, and the median over pairs of its own time to that. All are
 * open, timed (ms sorted) and have a score. No contender: nothing is set. */
df_status lab_find_contender(const df_view *view, const df_picture *picture, lab_timing *timings, int count,
                             int repeats, df_error *err);

#endif
