#include "choices.h"
#include "errors.h"
#include "render/quality.h"

#include <stdlib.h>

/* What --quality auto chooses at a distance, beside the first methods of the table with the same gradient. */
static df_status measure_choice(lab_session *session, const lab_subject *s, double distance, const char *family,
                                int method_count) {
    lab_timing timings[LAB_METHOD_COUNT + 1];
    int count = 0;
    df_camera camera;
    df_quality quality;
    df_view view;
    const uint32_t size = lab_picture_size(session);
    lab_camera(&s->field, distance, &camera);
    df_quality_choose(&s->field, &camera, LAB_CHOICE_ROWS, true, &quality);
    df_status status = df_view_make(&camera, &s->field, size, size, &view, session->err);
    if (status != DF_OK) return status;
    const df_tracer *tracer = df_tracer_choose(&s->scene, &view, NULL);
    timings[count++] = lab_timing_make(session, "auto", tracer,
                                       (lab_method){quality.solve, quality.steps, quality.precision}, quality.gradient);
    timings[0].row.bound = quality.bound;
    timings[0].contested = method_count > 0;
    for (int m = 0; m < method_count; m++)
        timings[count++] = lab_timing_make(session, "front", tracer, lab_methods[m], quality.gradient);
    lab_score *scores = calloc((size_t)count, sizeof *scores);
    if (!scores) return df_fail(session->err, DF_ERROR_MEMORY, "no memory for scores");
    for (int i = 0; i < count; i++) {
        timings[i].row.family = family;
        timings[i].row.truth = "field";
    }
    if (session->stage == LAB_MEASURING && !lab_all_timed(session, s, timings, count, (uint64_t)size * size))
        status = lab_score_view(session, s, &camera, timings, scores, count);
    if (status == DF_OK) status = lab_time_all(session, s, distance, size, timings, count);
    free(scores);
    return status;
}

df_status lab_measure_auto(lab_session *session, const lab_subject *s) {
    static const struct {
        double distance;
        const char *family;
        int method_count;
    } places[] = {{0.9, "distance 0.9", LAB_METHOD_COUNT},
                  {LAB_CHART_DISTANCE, "distance 1.6", 0}, /* that of the chart, which has the methods already */
                  {6, "distance 6", LAB_METHOD_COUNT},
                  {40, "distance 40", LAB_METHOD_COUNT}};
    df_status status = DF_OK;
    for (int i = 0; i < 4 && status == DF_OK; i++)
        status = measure_choice(session, s, places[i].distance, places[i].family, places[i].method_count);
    return status;
}
