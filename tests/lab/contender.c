#include "contender.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { PAIR_COUNT = 31, CONTENDER_MAX = 3 };

static double thread_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static df_status draw(const lab_timing *t, const df_view *view, const df_picture *picture, double *ns, df_error *err) {
    const double start = thread_ns();
    df_status status = lab_draw_frame(t, view, picture, NULL, err);
    *ns = thread_ns() - start;
    return status;
}

/* The median of a's time to b's over pairs of frames, each of them first in every other pair. */
static df_status compare(const lab_timing *a, const lab_timing *b, const df_view *view, const df_picture *picture,
                         double *ratio, df_error *err) {
    double ratios[PAIR_COUNT];
    df_status status = DF_OK;
    for (int i = 0; i < PAIR_COUNT && status == DF_OK; i++) {
        double ns[2];
        status = draw(i % 2 ? b : a, view, picture, &ns[i % 2], err);
        if (status == DF_OK) status = draw(i % 2 ? a : b, view, picture, &ns[1 - i % 2], err);
        ratios[i] = ns[0] / ns[1];
    }
    if (status != DF_OK) return status;
    qsort(ratios, PAIR_COUNT, sizeof *ratios, lab_compare_doubles);
    *ratio = ratios[PAIR_COUNT / 2];
    return DF_OK;
}

static bool is_contender(const lab_timing *choice, const lab_timing *t) {
    return lab_score_errors(t->row.score) == 0 && lab_histogram_quantile(&t->row.score->depth, 0.99) <=
                                                      lab_histogram_quantile(&choice->row.score->depth, 0.99);
}

df_status lab_find_contender(const df_view *view, const df_picture *picture, lab_timing *timings, int count,
                             int repeats, df_error *err) {
    const lab_timing *fastest[CONTENDER_MAX + 1];
    int found = 0;
    df_status status = DF_OK;
    for (int i = 1; i < count; i++) {
        if (!is_contender(&timings[0], &timings[i])) continue;
        int at = found < CONTENDER_MAX ? found++ : CONTENDER_MAX;
        for (; at > 0 && fastest[at - 1]->ms[repeats / 2] > timings[i].ms[repeats / 2]; at--)
            fastest[at] = fastest[at - 1];
        fastest[at] = &timings[i];
    }
    lab_row *row = &timings[0].row;
    for (int i = 0; i < found && status == DF_OK; i++) {
        const lab_row *other = &fastest[i]->row;
        double ratio;
        status = compare(&timings[0], fastest[i], view, picture, &ratio, err);
        if (status != DF_OK || ratio <= row->contender_ratio) continue;
        row->contender_ratio = ratio;
        snprintf(row->contender, sizeof row->contender, "%s %d %s", other->intersect, other->steps, other->precision);
    }
    return status;
}
