#include "contender.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int lab_compare_doubles(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

void lab_camera(const df_field *field, double distance, df_camera *camera) {
    df_camera_orbit(field, 40, 20, distance, camera);
    camera->fov_y = 1;
}

/* The timings that are open are all[0] .. all[at - 1]. */
static df_status open_timing(const lab_subject *s, const df_view *view, lab_timing *all, int at, df_error *err) {
    lab_timing *t = &all[at];
    df_devices_options options = {0};
    for (int i = 0; i < at && !t->on_device && !t->renderer; i++) {
        if (all[i].options.tracer == t->options.tracer) t->renderer = all[i].renderer;
    }
    if (t->renderer) return DF_OK;
    t->owner = true;
    if (!t->on_device) return df_renderer_open(&s->scene, &t->options, view->width, view->height, &t->renderer, err);
    df_status status = df_devices_parse("opencl", &options.choice, err);
    if (status != DF_OK) return status;
    return df_devices_open(&options, &s->scene, &t->options, view->width, view->height, &t->devices, err);
}

/* What a timing says of itself once it has drawn. */
static void describe_timing(lab_timing *t) {
    df_device_report reports[DF_DEVICE_MAX];
    double ms;
    if (t->on_device && df_devices_report(t->devices, reports) > 0) {
        snprintf(t->device, sizeof t->device, "%.150s", reports[0].name);
        for (char *c = t->device; *c; c++) *c = *c == ',' ? ' ' : *c;
    }
    if (t->options.tracer->own_methods) df_renderer_precomputation(t->renderer, &ms, &ms, &t->row.bytes);
}

static void close_timing(lab_timing *t) {
    if (t->owner) df_renderer_close(t->renderer);
    df_devices_close(t->devices);
}

df_status lab_draw_frame(const lab_timing *t, const df_view *view, const df_picture *picture, df_frame_stats *stats,
                         df_error *err) {
    df_status status = df_renderer_set_method(t->renderer, &t->options, err);
    return status == DF_OK ? df_renderer_frame(t->renderer, view, picture, stats, err) : status;
}

static df_status draw_timing(lab_timing *t, const df_view *view, const df_picture *picture, df_error *err) {
    memset(&t->stats, 0, sizeof t->stats);
    if (t->on_device) return df_devices_frame(t->devices, view, picture, &t->stats, err);
    return lab_draw_frame(t, view, picture, &t->stats, err);
}

/* What the instructions of a frame are known by: the same for all rows of the same frame. */
static void count_label(const lab_subject *s, const lab_timing *t, double distance, char *label, size_t size) {
    const int steps = t->options.steps ? t->options.steps : df_solve_steps(t->options.solve);
    snprintf(label, size, "%s %u: %s %s %d %s %s from %g", s->name, lab_subject_size(s), t->options.tracer->name,
             df_solve_names[t->options.solve], steps, df_precision_names[t->options.precision],
             df_gradient_names[t->options.gradient], distance);
}

/* The child: draws once what was not drawn yet. Only the frames themselves are counted, and run at callgrind's pace. */
static df_status count_all(lab_session *session, const lab_subject *s, const df_view *view, const df_picture *picture,
                           double distance, lab_timing *timings, int count) {
    df_status status = DF_OK;
    lab_counting_on();
    for (int i = 0; i < count && status == DF_OK; i++) {
        char label[LAB_KEY_SIZE];
        count_label(s, &timings[i], distance, label, sizeof label);
        if (lab_counts_find(&session->counts, label)) continue;
        status = df_renderer_set_method(timings[i].renderer, &timings[i].options, session->err);
        lab_count_begin();
        if (status == DF_OK) status = df_renderer_frame(timings[i].renderer, view, picture, NULL, session->err);
        lab_count_end(label);
        if (status == DF_OK) status = lab_counts_add(&session->counts, label, 1, session->err);
    }
    lab_counting_off();
    return status;
}

/* Draws all in turns. The first round warms up. */
static df_status time_rounds(lab_session *session, const df_view *view, const df_picture *picture, lab_timing *timings,
                             int count, int repeats) {
    df_status status = DF_OK;
    for (int n = -1; n < repeats && status == DF_OK; n++) {
        for (int i = 0; i < count && status == DF_OK; i++) {
            const uint64_t before = session->counter >= 0 ? lab_counter_read(session->counter) : 0;
            status = draw_timing(&timings[i], view, picture, session->err);
            if (session->counter >= 0) timings[i].instructions = lab_counter_read(session->counter) - before;
            if (n >= 0) timings[i].ms[n] = timings[i].stats.frame_ms;
        }
    }
    for (int i = 0; i < count; i++) qsort(timings[i].ms, (size_t)repeats, sizeof(double), lab_compare_doubles);
    return status;
}

static df_status write_timing(lab_session *session, const lab_subject *s, lab_timing *t, double distance, double rays,
                              int repeats) {
    lab_row *r = &t->row;
    char label[LAB_KEY_SIZE];
    const double ns = 1e6 * t->ms[repeats / 2];
    r->ns_per_ray = ns / rays;
    r->ns_per_hit = t->stats.rays_hitting ? ns / (double)t->stats.rays_hitting : -1;
    r->repeats = repeats;
    r->rays = (uint64_t)rays;
    r->isa = t->on_device ? t->device : t->options.kernels->isa;
    if (lab_row_have(session, s, r)) return DF_OK;
    count_label(s, t, distance, label, sizeof label);
    if (t->on_device) t->instructions = 0;
    else if (session->counter < 0) t->instructions = lab_counts_find(&session->counts, label);
    r->instructions_per_ray = (double)t->instructions / rays;
    session->counted |= t->instructions > 0;
    return lab_row_write(session, s, r);
}

bool lab_all_timed(const lab_session *session, const lab_subject *s, lab_timing *timings, int count, uint64_t rays) {
    bool all = true;
    for (int i = 0; i < count && all; i++) {
        timings[i].row.rays = rays;
        all = lab_row_have(session, s, &timings[i].row);
    }
    return all;
}

uint32_t lab_picture_size(const lab_session *session) { return session->quick ? 128 : 512; }

static df_status measure_frames(lab_session *session, const lab_subject *s, const df_view *view, double distance,
                                const df_picture *picture, lab_timing *timings, int count) {
    const int repeats = session->quick ? 7 : 9;
    df_status status = time_rounds(session, view, picture, timings, count, repeats);
    if (status == DF_OK && count > 0 && timings[0].contested)
        status = lab_find_contender(view, picture, timings, count, repeats, session->err);
    for (int i = 0; i < count && status == DF_OK; i++) {
        describe_timing(&timings[i]);
        status = write_timing(session, s, &timings[i], distance, (double)view->width * view->height, repeats);
    }
    return status;
}

/* What there is to know of the frames of a view: instructions in the child, otherwise times. */
static df_status draw_all(lab_session *session, const lab_subject *s, const df_view *view, double distance,
                          const df_picture *picture, lab_timing *timings, int count) {
    df_status status = DF_OK;
    for (int i = 0; i < count && status == DF_OK; i++) {
        status = open_timing(s, view, timings, i, session->err);
    }
    if (status == DF_OK && session->stage == LAB_COUNTING)
        status = count_all(session, s, view, picture, distance, timings, count);
    else if (status == DF_OK) status = measure_frames(session, s, view, distance, picture, timings, count);
    for (int i = 0; i < count; i++) close_timing(&timings[i]);
    return status;
}

df_status lab_time_all(lab_session *session, const lab_subject *s, double distance, uint32_t size, lab_timing *timings,
                       int count) {
    df_camera camera;
    df_view view;
    if (session->stage != LAB_COUNTING && lab_all_timed(session, s, timings, count, (uint64_t)size * size))
        return DF_OK;
    session->missing = true;
    if (session->stage == LAB_PLANNING) return DF_OK;
    uint8_t *rgb = malloc(3 * (size_t)size * size);
    const df_picture picture = {.width = size, .height = size, .rgb = rgb};
    df_status status = rgb ? DF_OK : df_fail(session->err, DF_ERROR_MEMORY, "no memory for a picture");
    lab_camera(&s->field, distance, &camera);
    if (status == DF_OK) status = df_view_make(&camera, &s->field, size, size, &view, session->err);
    if (status == DF_OK) status = lab_session_finish_counting(session);
    if (status == DF_OK) status = draw_all(session, s, &view, distance, &picture, timings, count);
    free(rgb);
    return status;
}

lab_timing lab_timing_make(const lab_session *session, const char *kind, const df_tracer *tracer, lab_method m,
                           int gradient) {
    return (lab_timing){.options = {.tracer = tracer,
                                    .solve = m.solve,
                                    .steps = m.steps,
                                    .precision = m.precision,
                                    .gradient = gradient,
                                    .tile = 64,
                                    .threads = 1,
                                    .kernels = session->kernels},
                        .row = {.kind = kind,
                                .tracer = tracer->name,
                                .intersect = df_solve_names[m.solve],
                                .steps = m.steps,
                                .precision = df_precision_names[m.precision],
                                .gradient = df_gradient_names[gradient],
                                .truth = "",
                                .family = "camera"}};
}

df_status lab_measure_times(lab_session *session, const lab_subject *s) {
    lab_timing solves[LAB_METHOD_COUNT], others[32];
    int count = 0;
    df_camera camera;
    df_view view;
    lab_camera(&s->field, LAB_CHART_DISTANCE, &camera);
    df_status status = df_view_make(&camera, &s->field, 64, 64, &view, session->err);
    if (status != DF_OK) return status;
    const df_tracer *chosen = df_tracer_choose(&s->scene, &view, NULL);
    const lab_method standard = {DF_SOLVE_ROBUST, 0, DF_PRECISION_F64};
    for (int m = 0; m < LAB_METHOD_COUNT; m++) {
        solves[m] = lab_timing_make(session, "solve-time", chosen, lab_methods[m], DF_GRADIENT_CORNER_CENTRAL);
    }
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if ((*tracer)->suits && !(*tracer)->suits(&s->scene, &view)) continue;
        others[count++] = lab_timing_make(session, "tracer-time", *tracer, standard, DF_GRADIENT_CORNER_CENTRAL);
    }
    for (int g = 0; g < DF_GRADIENT_COUNT; g++)
        others[count++] = lab_timing_make(session, "gradient-time", chosen, standard, g);
    status = lab_time_all(session, s, LAB_CHART_DISTANCE, lab_picture_size(session), solves, LAB_METHOD_COUNT);
    return status == DF_OK ? lab_time_all(session, s, LAB_CHART_DISTANCE, lab_picture_size(session), others, count)
                           : status;
}
