#include "choices.h"
#include "commands.h"
#include "errors.h"
#include "peers.h"
#include "storage.h"
#include "times.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* All frames of a subject; the choices' errors come first, beside the child that counts. */
static df_status measure_frames(lab_session *session, const lab_subject *s, bool choices_only) {
    df_status status = lab_measure_auto(session, s);
    return status == DF_OK && !choices_only ? lab_measure_times(session, s) : status;
}

df_status lab_command_count(int argc, char **argv, df_error *err) {
    lab_session session = {.err = err, .counter = -1, .stage = LAB_COUNTING};
    lab_subject s;
    session.quick = strcmp(argv[2], "--quick") == 0;
    df_status status = df_kernels_select("auto", &session.kernels, err);
    if (status == DF_OK) status = lab_subject_open(&s, argv[0], (uint32_t)atoi(argv[1]), err);
    if (status == DF_OK) status = measure_frames(&session, &s, argc > 3);
    lab_subject_close(&s);
    lab_counts_free(&session.counts);
    return status;
}

/* Starts the child that counts, where the processor cannot and a frame is missing. */
static df_status start_counting(lab_session *session, const lab_subject *s, const char *name, uint32_t size,
                                bool choices_only) {
    char text[16], folder[512];
    snprintf(text, sizeof text, "%u", size);
    const char *const arguments[] = {
        "count", name, text, session->quick ? "--quick" : "--full", choices_only ? "--choices" : NULL, NULL};
    lab_counts_free(&session->counts);
    if (session->uncounted || session->counter >= 0) return DF_OK;
    session->stage = LAB_PLANNING;
    session->missing = false;
    df_status status = measure_frames(session, s, choices_only);
    session->stage = LAB_MEASURING;
    if (status != DF_OK || !session->missing) return status;
    session->asked = true;
    snprintf(folder, sizeof folder, "%.500s.counts", session->path);
    return lab_count_start(arguments, folder, &session->counting, session->err);
}

/* Only what --quality auto chooses, beside the methods that it might have chosen. */
static df_status measure_choices(lab_session *session, const char *name, uint32_t size) {
    lab_subject s;
    df_status status = lab_subject_open(&s, name, size, session->err);
    if (status == DF_OK) status = start_counting(session, &s, name, size, true);
    if (status == DF_OK) status = measure_frames(session, &s, true);
    lab_subject_close(&s);
    return status;
}

/* All errors of a subject; rays: of its camera against the surface, the scale of all other numbers. */
static df_status measure_all_errors(lab_session *session, const lab_subject *s, uint64_t rays) {
    df_status status = DF_OK;
    for (int f = 0; f < LAB_FAMILY_COUNT && status == DF_OK; f++) {
        status = lab_measure_errors(session, s, (lab_family)f, NULL, NULL, f == LAB_CAMERA ? 2 * rays : rays / 2);
    }
    if (status == DF_OK && s->exact) status = lab_measure_errors(session, s, LAB_CAMERA, &s->surface, NULL, rays);
    if (status == DF_OK && s->mesh) status = lab_measure_errors(session, s, LAB_CAMERA, NULL, s->mesh, rays);
    if (status == DF_OK && s->mesh) status = lab_measure_errors(session, s, LAB_RANDOM, NULL, s->mesh, rays);
    if (status == DF_OK && s->exact) status = lab_measure_normals(session, s, rays);
    return status;
}

/* Frames last: then nothing runs beside them. */
static df_status measure_subject(lab_session *session, const char *name, uint32_t size) {
    lab_subject s;
    const uint64_t rays = session->quick ? 4000 : 1000000;
    df_status status = lab_subject_open(&s, name, size, session->err);
    if (status == DF_OK) status = lab_subject_find_floor(&s, session->quick ? 4000 : 40000, session->err);
    if (status == DF_OK && !s.exact && !s.mesh) {
        fprintf(stderr, "df-lab: %s: its surface has no formula: errors of solvers only, none of the field\n", s.name);
    }
    if (status == DF_OK) status = start_counting(session, &s, name, size, false);
    if (status == DF_OK) status = measure_all_errors(session, &s, rays);
    if (status == DF_OK && s.exact) status = lab_measure_structures(session, name, size, rays);
    if (status == DF_OK) status = measure_frames(session, &s, false);
    if (status == DF_OK) status = lab_measure_peers(session, &s);
    lab_subject_close(&s);
    return status;
}

df_status lab_command_choices(int argc, char **argv, df_error *err) {
    lab_session session;
    df_status status = lab_session_open(&session, argv[0], argc, argv, err);
    for (int i = 1; i < argc && status == DF_OK; i++) {
        if (argv[i][0] != '-') status = measure_choices(&session, argv[i], 45);
    }
    lab_session_close(&session);
    return status;
}

df_status lab_command_measure(int argc, char **argv, df_error *err) {
    lab_session session;
    int named = 0;
    df_status status = lab_session_open(&session, argv[0], argc, argv, err);
    for (int i = 1; i < argc && status == DF_OK; i++) {
        if (argv[i][0] == '-') continue;
        named++;
        status = measure_subject(&session, argv[i], 64);
    }
    const uint32_t sizes[] = {64, 128};
    for (int n = 0; n < (session.quick ? 1 : 2) && named == 0; n++) {
        for (int i = 0; i < LAB_SHAPE_COUNT && status == DF_OK; i++)
            status = measure_subject(&session, lab_shape_names[i], sizes[n]);
    }
    lab_session_close(&session);
    return status;
}
