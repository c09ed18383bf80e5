#include "choices.h"
#include "commands.h"
#include "errors.h"
#include "peers.h"
#include "storage.h"
#include "times.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHOICES "choices" /* to a child: count no other frames */

/* All frames of a subject; the choices' errors come first, beside the child that counts. */
static df_status measure_frames(lab_session *session, const lab_subject *s, bool choices_only) {
    df_status status = lab_measure_auto(session, s);
    return status == DF_OK && !choices_only ? lab_measure_times(session, s) : status;
}

df_status lab_command_count(int argc, char **argv, df_error *err) {
    lab_session session = {.err = err, .counter = -1, .stage = LAB_COUNTING};
    session.quick = strcmp(argv[0], "--quick") == 0;
    df_status status = df_kernels_select("auto", &session.kernels, err);
    for (int i = 1; i + 2 < argc && status == DF_OK; i += 3) {
        lab_subject s;
        status = lab_subject_open(&s, argv[i], (uint32_t)atoi(argv[i + 1]), err);
        if (status == DF_OK) status = measure_frames(&session, &s, strcmp(argv[i + 2], CHOICES) == 0);
        lab_subject_close(&s);
    }
    lab_counts_free(&session.counts);
    return status;
}

/* A subject to measure. */
typedef struct task {
    const char *name;
    char size[16]; /* of a shape, voxels, in decimals */
    bool choices_only;
} task;
#define TASKS_MAX 40

static df_status open_task(const lab_session *session, const task *t, lab_subject *s) {
    return lab_subject_open(s, t->name, (uint32_t)atoi(t->size), session->err);
}

/* Whether a frame of a subject is missing in the table. */
static df_status plan_task(lab_session *session, const task *t) {
    lab_subject s;
    session->stage = LAB_PLANNING;
    session->missing = false;
    df_status status = open_task(session, t, &s);
    if (status == DF_OK) status = measure_frames(session, &s, t->choices_only);
    lab_subject_close(&s);
    session->stage = LAB_MEASURING;
    return status;
}

/* Starts the children that count, where the processor cannot: every other subject that lacks a frame goes to each. */
static df_status start_counting(lab_session *session, const task *tasks, int task_count) {
    const char *arguments[LAB_COUNTING_CHILDREN][LAB_COUNT_ARGUMENTS_MAX + 1];
    int counts[LAB_COUNTING_CHILDREN], given = 0;
    df_status status = DF_OK;
    if (session->uncounted || session->counter >= 0) return DF_OK;
    for (int c = 0; c < LAB_COUNTING_CHILDREN; c++) {
        arguments[c][0] = "count";
        arguments[c][1] = session->quick ? "--quick" : "--full";
        counts[c] = 2;
    }
    for (int i = 0; i < task_count && status == DF_OK; i++) {
        status = plan_task(session, &tasks[i]);
        if (status != DF_OK || !session->missing) continue;
        const int c = given++ % LAB_COUNTING_CHILDREN;
        const char **next = &arguments[c][counts[c]];
        next[0] = tasks[i].name;
        next[1] = tasks[i].size;
        next[2] = tasks[i].choices_only ? CHOICES : "all";
        counts[c] += 3;
    }
    session->asked = given > 0;
    for (int c = 0; c < LAB_COUNTING_CHILDREN && c < given && status == DF_OK; c++) {
        char folder[512];
        arguments[c][counts[c]] = NULL;
        snprintf(folder, sizeof folder, "%.490s.counts%d", session->path, c);
        status = lab_count_start(arguments[c], folder, &session->counting[c], session->err);
    }
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

static uint64_t ray_scale(const lab_session *session) { return session->quick ? 4000 : 250000; }

static df_status find_floor(const lab_session *session, lab_subject *s) {
    return lab_subject_find_floor(s, session->quick ? 4000 : 40000, session->err);
}

/* What may run beside the children: all but frames. */
static df_status measure_task_errors(lab_session *session, const task *t) {
    lab_subject s;
    if (t->choices_only) return DF_OK;
    df_status status = open_task(session, t, &s);
    if (status == DF_OK) status = find_floor(session, &s);
    if (status == DF_OK && !s.exact && !s.mesh) {
        fprintf(stderr, "df-lab: %s: its surface has no formula: errors of solvers only, none of the field\n", s.name);
    }
    if (status == DF_OK) status = measure_all_errors(session, &s, ray_scale(session));
    if (status == DF_OK && s.exact)
        status = lab_measure_structures(session, t->name, lab_subject_size(&s), ray_scale(session));
    lab_subject_close(&s);
    return status;
}

static df_status measure_task_frames(lab_session *session, const task *t) {
    lab_subject s;
    df_status status = open_task(session, t, &s);
    if (status == DF_OK && !t->choices_only) status = find_floor(session, &s);
    if (status == DF_OK) status = measure_frames(session, &s, t->choices_only);
    if (status == DF_OK && !t->choices_only) status = lab_measure_peers(session, &s);
    lab_subject_close(&s);
    return status;
}

/* Frames last, when the children have ended: nothing runs beside them. */
static df_status measure_tasks(int argc, char **argv, const task *tasks, int count, df_error *err) {
    lab_session session;
    df_status status = lab_session_open(&session, argv[0], argc, argv, err);
    if (status == DF_OK) status = start_counting(&session, tasks, count);
    for (int i = 0; i < count && status == DF_OK; i++) status = measure_task_errors(&session, &tasks[i]);
    if (status == DF_OK) status = lab_session_finish_counting(&session);
    for (int i = 0; i < count && status == DF_OK; i++) status = measure_task_frames(&session, &tasks[i]);
    lab_session_close(&session);
    return status;
}

static df_status add_task(task *tasks, int *count, const char *name, uint32_t size, bool choices_only, df_error *err) {
    if (*count == TASKS_MAX) return df_fail(err, DF_ERROR_USAGE, "more than %d fields", TASKS_MAX);
    tasks[*count] = (task){.name = name, .choices_only = choices_only};
    snprintf(tasks[*count].size, sizeof tasks[*count].size, "%u", size);
    ++*count;
    return DF_OK;
}

/* All shapes at each size. */
static df_status add_shapes(task *tasks, int *count, bool quick, df_error *err) {
    df_status status = DF_OK;
    for (uint32_t size = 64; size <= (quick ? 64 : 128); size *= 2) {
        for (int i = 0; i < LAB_SHAPE_COUNT && status == DF_OK; i++)
            status = add_task(tasks, count, lab_shape_names[i], size, false, err);
    }
    return status;
}

df_status lab_command_measure(int argc, char **argv, df_error *err) {
    task tasks[TASKS_MAX];
    int count = 0;
    bool choices_only = false, quick = false;
    df_status status = DF_OK;
    for (int i = 1; i < argc; i++) quick |= strcmp(argv[i], "--quick") == 0;
    for (int i = 1; i < argc && status == DF_OK; i++) {
        choices_only |= strcmp(argv[i], "--choices") == 0;
        if (strcmp(argv[i], "shapes") == 0) status = add_shapes(tasks, &count, quick, err);
        else if (argv[i][0] != '-')
            status = add_task(tasks, &count, argv[i], choices_only ? 45 : 64, choices_only, err);
    }
    if (status == DF_OK && count == 0) status = add_shapes(tasks, &count, quick, err);
    return status == DF_OK ? measure_tasks(argc, argv, tasks, count, err) : status;
}
