#include "peers.h"
#include "opencl_tracer.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"
#include "times.h"
#include "view_truth.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Smaller ones are mostly overhead to a device and to OpenGL. */
static uint32_t peer_picture_size(const lab_session *session) { return session->quick ? 512 : LAB_CHOICE_ROWS; }

/* Any rays of the camera's family, in double. */
static df_status score_rays(const lab_subject *s, const df_tracer *tracer, uint64_t rays, lab_score *score,
                            df_error *err) {
    const lab_run run = {.tracer = tracer,
                         .scene = &s->scene,
                         .solve = DF_SOLVE_ROBUST,
                         .family = LAB_CAMERA,
                         .seed = LAB_SEED,
                         .count = rays};
    return lab_measure(&run, score, err);
}

static df_status score_picture(const lab_session *session, const lab_subject *s, const lab_timing *t, lab_score *score,
                               df_error *err) {
    const uint32_t size = lab_picture_size(session);
    const uint64_t count = (uint64_t)size * size;
    float *depth = malloc(count * sizeof *depth);
    lab_known *pixels = calloc(count, sizeof *pixels);
    const df_picture picture = {.width = size, .height = size, .depth = depth};
    df_renderer *renderer = NULL;
    df_camera camera;
    df_view view;
    df_status status = depth && pixels ? DF_OK : df_fail(err, DF_ERROR_MEMORY, "no memory for a picture");
    lab_camera(&s->field, LAB_CHART_DISTANCE, &camera);
    if (status == DF_OK) status = df_view_make(&camera, &s->field, size, size, &view, err);
    if (status == DF_OK) status = lab_view_truths(&s->scene, &view, pixels, err);
    if (status == DF_OK) status = df_renderer_open(&s->scene, &t->options, size, size, &renderer, err);
    if (status == DF_OK) status = df_renderer_frame(renderer, &view, &picture, NULL, err);
    if (status == DF_OK) lab_score_depths(&s->field, pixels, count, 0, depth, score);
    df_renderer_close(renderer);
    free(pixels);
    free(depth);
    return status;
}

static df_status score_peer(const lab_session *session, const lab_subject *s, const lab_timing *t, lab_score *score,
                            df_error *err) {
    const df_tracer *tracer = t->on_device ? &lab_tracer_opencl : t->options.tracer;
    const bool any_ray = !tracer->own_methods || !tracer->suits || tracer->suits(&s->scene, NULL);
    /* the default is found by a tracer of views; its hits are those of every walk */
    if (!tracer->own_methods && !t->on_device) tracer = s->scene.levels ? &df_tracer_dda : &df_tracer_adf;
    if (any_ray) return score_rays(s, tracer, session->quick ? 8000 : 250000, score, err);
    return score_picture(session, s, t, score, err);
}

static lab_timing make_peer(const lab_session *session, const df_tracer *tracer, bool on_device) {
    const lab_method standard = {DF_SOLVE_ROBUST, 0, DF_PRECISION_F64};
    const uint32_t size = peer_picture_size(session);
    lab_timing t = lab_timing_make(session, "peer", tracer, standard, DF_GRADIENT_CORNER_CENTRAL);
    t.on_device = on_device;
    t.row.truth = "field";
    t.row.rays = (uint64_t)size * size;
    if (on_device) t.row.tracer = "opencl";
    if (tracer->own_methods) t.row.intersect = t.row.gradient = "", t.row.precision = "f32";
    return t;
}

df_status lab_measure_peers(lab_session *session, const lab_subject *s) {
    lab_timing timings[8];
    lab_score *scores = calloc(8, sizeof *scores);
    int count = 0;
    df_camera camera;
    df_view view;
    df_status status = scores ? DF_OK : df_fail(session->err, DF_ERROR_MEMORY, "no memory for scores");
    lab_camera(&s->field, LAB_CHART_DISTANCE, &camera);
    if (status == DF_OK) status = df_view_make(&camera, &s->field, 64, 64, &view, session->err);
    if (status != DF_OK) {
        free(scores);
        return status;
    }
    lab_timing wanted[8] = {make_peer(session, df_tracer_choose(&s->scene, &view, NULL), false),
                            make_peer(session, &df_tracer_dda, true)};
    int wanted_count = 2;
    for (const df_tracer *const *tracer = df_mc_tracers; *tracer; tracer++)
        wanted[wanted_count++] = make_peer(session, *tracer, false);
    const bool done = lab_all_timed(session, s, wanted, wanted_count, wanted[0].row.rays);
    for (int i = 0; i < wanted_count && status == DF_OK && !done; i++) {
        df_error error;
        timings[count] = wanted[i];
        timings[count].row.score = &scores[count];
        status = score_peer(session, s, &wanted[i], &scores[count], &error);
        if (status == DF_OK) count++;
        else if (status == DF_ERROR_UNSUPPORTED && i > 0) {
            fprintf(stderr, "df-lab: %s is not measured: %s\n", wanted[i].row.tracer, error.text);
            status = DF_OK;
        } else if (session->err) *session->err = error;
    }
    if (status == DF_OK && !done)
        status = lab_time_all(session, s, LAB_CHART_DISTANCE, peer_picture_size(session), timings, count);
    free(scores);
    return status;
}
