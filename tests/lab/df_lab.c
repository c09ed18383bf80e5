/*
 * df-lab: measures every method of the renderer against the truth. Built with the tests; not installed.
 *
 *   df-lab measure FILE.csv [--quick] [--uncounted] [FIELD...]
 *       measures what is not yet in FILE.csv; FIELD: a shape's name, a .dfield file, or FIELD.dfield:MESH.obj with the
 *       mesh that it was made from; --uncounted: counts no instructions
 *
 *   df-lab choices FILE.csv [--quick] [--uncounted] FIELD...
 *       measures only what --quality auto chooses and might have chosen; shapes are made at 45 voxels
 *
 *   df-lab count FIELD SIZE --quick|--full [--choices]
 *       draws once what measure (or choices) times: it starts this under callgrind to count instructions
 *   df-lab escape [RAYS]
 *       rays from inside closed fields, with every tracer: none may escape; those without a hit are printed, tangents
 *       apart
 *   df-lab filters [FIELD.dfield:MESH.obj...]
 *       depth and normal errors by reconstruction filter
 *   df-lab field SHAPE SIZE FILE.dfield [PARAMETER]
 *       writes a field of the laboratory
 *   df-lab map SHAPE SIZE SOLVE FILE.png [PARAMETER]
 *       a picture of a solve's depth error
 *   df-lab depth FIELD.dfield MESH.obj WIDTH HEIGHT FILE.pfm
 *       the depths of the mesh itself, as df-render --depth has them of its field, seen by its default camera
 */
#include "common/field_file.h"
#include "common/image.h"
#include "common/memory.h"
#include "common/options.h"
#include "common/output_file.h"
#include "common/version.h"
#include "fields.h"
#include "filters.h"
#include "instructions.h"
#include "measure.h"
#include "mesh_truth.h"
#include "render/frame.h"
#include "render/methods/gradient.h"
#include "render/methods/shade.h"
#include "render/methods/solve_methods.h"
#include "render/quality.h"
#include "render/settings.h"
#include "table.h"

#include <inttypes.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* The format of the table counts as a part of the version. */
#define LAB_VERSION DF_VERSION "-3"
#define KEY_COLUMNS 13
static const char columns[] =
    "kind,field,size,structure,samples,tracer,intersect,steps,precision,gradient,truth,family,rays,bytes,"
    "tangent,true_positive,false_positive,false_negative,true_negative,leaks,wrong_face,"
    "depth_p50,depth_p99,depth_p999,depth_max,residual_p99,residual_max,normal_p50,normal_p99,normal_max,"
    "ns_per_ray,ns_per_hit,repeats,isa,instructions_per_ray,counted,bound,field_floor,seed,machine,compiler";

typedef struct method {
    int solve, steps; /* steps as for --steps; 0: there is nothing to choose */
    int precision;
} method;
static const method methods[] = {{DF_SOLVE_MIDPOINT, 0, DF_PRECISION_F64}, {DF_SOLVE_LINEAR, 0, DF_PRECISION_F64},
                                 {DF_SOLVE_REPEATED, 1, DF_PRECISION_F64}, {DF_SOLVE_REPEATED, 2, DF_PRECISION_F64},
                                 {DF_SOLVE_REPEATED, 3, DF_PRECISION_F64}, {DF_SOLVE_REPEATED, 5, DF_PRECISION_F64},
                                 {DF_SOLVE_MARMITT, 1, DF_PRECISION_F64},  {DF_SOLVE_MARMITT, 2, DF_PRECISION_F64},
                                 {DF_SOLVE_MARMITT, 3, DF_PRECISION_F64},  {DF_SOLVE_MARMITT, 5, DF_PRECISION_F64},
                                 {DF_SOLVE_ANALYTIC, 0, DF_PRECISION_F64}, {DF_SOLVE_ROBUST, 1, DF_PRECISION_F64},
                                 {DF_SOLVE_ROBUST, 2, DF_PRECISION_F64},   {DF_SOLVE_ROBUST, 3, DF_PRECISION_F64},
                                 {DF_SOLVE_ROBUST, 4, DF_PRECISION_F64},   {DF_SOLVE_ROBUST, 6, DF_PRECISION_F64},
                                 {DF_SOLVE_ROBUST, 16, DF_PRECISION_F64},  {DF_SOLVE_LINEAR, 0, DF_PRECISION_F32},
                                 {DF_SOLVE_REPEATED, 3, DF_PRECISION_F32}, {DF_SOLVE_MARMITT, 1, DF_PRECISION_F32},
                                 {DF_SOLVE_MARMITT, 3, DF_PRECISION_F32},  {DF_SOLVE_MARMITT, 5, DF_PRECISION_F32},
                                 {DF_SOLVE_ROBUST, 1, DF_PRECISION_F32},   {DF_SOLVE_ROBUST, 2, DF_PRECISION_F32},
                                 {DF_SOLVE_ROBUST, 3, DF_PRECISION_F32},   {DF_SOLVE_ROBUST, 4, DF_PRECISION_F32},
                                 {DF_SOLVE_ROBUST, 6, DF_PRECISION_F32},   {DF_SOLVE_ROBUST, 16, DF_PRECISION_F32}};
enum { METHOD_COUNT = sizeof methods / sizeof methods[0] };

/* A field under measurement. */
typedef struct subject {
    char name[64];
    lab_surface surface;
    bool exact;     /* the surface's truth is known */
    lab_mesh *mesh; /* NULL: not made from one, or that is not known */
    df_field field;
    df_scene scene;
    double field_floor; /* voxels; 0: unknown */
} subject;

typedef struct lab_session {
    lab_table table;
    bool quick;
    const df_kernels *kernels;
    char machine[128];
    int counter;      /* the processor's own of instructions; negative: none */
    bool counting;    /* this is the child under callgrind: frames are counted, nothing is written */
    const char *name; /* the subject as it was named, at this size: for the child */
    uint32_t size;
    bool choices_only;
    bool counted; /* or not to be */
    bool uncounted;
    lab_counts counts; /* what the child for the subject under measurement counted */
    df_error *err;
} lab_session;

/* ---- fields ---- */

static uint64_t model_bytes(const df_field *field) {
    uint64_t bytes = field->sample_count * df_sample_size(field->sample_type);
    if (field->kind == DF_FIELD_BRICKS) {
        uint64_t cells = (uint64_t)field->cell_count[0] * field->cell_count[1] * field->cell_count[2];
        bytes += 4 * cells + field->brick_count * (uint64_t)(4 + 8 + 8 * df_brick_mask_words(field->brick_size));
    }
    if (field->kind == DF_FIELD_ADF) bytes = df_adf_sample_bytes(field) + field->family_count * sizeof(df_family);
    return bytes;
}

static int find_name(const char *const *names, const char *name) {
    for (int i = 0; names[i]; i++) {
        if (strcmp(names[i], name) == 0) return i;
    }
    return -1;
}

static df_status make_field(const char *shape, uint32_t size, double parameter, df_field_kind kind,
                            lab_surface *surface, df_field *field, df_error *err) {
    const uint32_t count[3] = {size, size, size};
    const int index = find_name(lab_shape_names, shape);
    if (index < 0) return df_fail(err, DF_ERROR_USAGE, "%s: not a shape of the laboratory", shape);
    *surface = lab_surface_make((lab_shape)index, size, parameter);
    return test_field_from_function(field, kind, 8, count, surface->value, surface, err);
}

static df_status subject_open(subject *s, const char *name, uint32_t size, df_error *err) {
    const df_scene_options options = {0};
    const char *base = strrchr(name, '/') ? strrchr(name, '/') + 1 : name;
    df_status status;
    memset(s, 0, sizeof *s);
    snprintf(s->name, sizeof s->name, "%.60s", base);
    if (strstr(name, ".dfield")) {
        char path[1024];
        const char *mesh = strchr(name, ':');
        snprintf(path, sizeof path, "%.*s", mesh ? (int)(mesh - name) : (int)strlen(name), name);
        base = strrchr(path, '/') ? strrchr(path, '/') + 1 : path;
        snprintf(s->name, sizeof s->name, "%.60s", base);
        status = df_field_read(path, DF_READ_COPY, &s->field, err);
        if (status == DF_OK && mesh) status = lab_mesh_read(mesh + 1, &s->field, &s->mesh, err);
    } else {
        status = make_field(name, size, 0, DF_FIELD_BRICKS, &s->surface, &s->field, err);
        s->exact = s->surface.lipschitz > 0;
    }
    if (status == DF_OK) status = df_scene_prepare(&s->field, 0, &options, &s->scene, err);
    return status;
}

static void subject_close(subject *s) {
    lab_mesh_free(s->mesh);
    df_scene_free(&s->scene);
    df_field_free(&s->field);
}

static uint32_t subject_size(const subject *s) {
    uint32_t longest = 0;
    for (int a = 0; a < 3; a++) longest = s->field.voxel_count[a] > longest ? s->field.voxel_count[a] : longest;
    return longest;
}

/* ---- rows ---- */

typedef struct row {
    const char *kind, *tracer, *intersect, *precision, *gradient, *truth, *family;
    int steps;
    uint64_t rays;
    const lab_score *score;        /* NULL: no errors measured */
    const lab_histogram *normal;   /* degrees; NULL: not measured */
    double ns_per_ray, ns_per_hit; /* negative: not measured */
    int repeats;
    const char *isa;             /* of the times */
    double instructions_per_ray; /* 0: not counted */
    double bound;                /* what --quality auto allows, voxels; 0: does not apply */
} row;

static void row_key(const lab_session *session, const subject *s, const row *r, char *key, size_t size) {
    (void)session;
    snprintf(key, size, "%s,%s,%u,%s,%s,%s,%s,%d,%s,%s,%s,%s,%" PRIu64, r->kind, s->name, subject_size(s),
             df_field_kind_name(s->field.kind), df_sample_type_name(s->field.sample_type), r->tracer, r->intersect,
             r->steps, r->precision, r->gradient, r->truth, r->family, r->rays);
}

/* How the instructions of a frame are counted: callgrind knows nothing above AVX2. */
static const char *counting_way(const lab_session *session) {
    if (session->counter >= 0) return "counter";
    return session->counts.count ? "callgrind" : "";
}

static int print_counts(const lab_session *session, char *out, size_t size, const row *r) {
    int n = snprintf(out, size, ",%s,", r->isa ? r->isa : "");
    if (r->instructions_per_ray > 0)
        n += snprintf(out + n, size - (size_t)n, "%.3f,%s,", r->instructions_per_ray, counting_way(session));
    else n += snprintf(out + n, size - (size_t)n, ",,");
    if (r->bound > 0) n += snprintf(out + n, size - (size_t)n, "%.3g", r->bound);
    return n;
}

static int print_times(char *out, size_t size, const row *r) {
    int n = r->ns_per_ray >= 0 ? snprintf(out, size, "%.3f", r->ns_per_ray) : 0;
    n += snprintf(out + n, size - (size_t)n, ",");
    if (r->ns_per_hit >= 0) n += snprintf(out + n, size - (size_t)n, "%.3f", r->ns_per_hit);
    return n + snprintf(out + n, size - (size_t)n, ",%d", r->repeats);
}

static df_status write_row(lab_session *session, const subject *s, const row *r) {
    char key[512], results[1024];
    const lab_histogram *n = r->normal;
    const size_t size = sizeof results;
    int at = snprintf(results, size, "%" PRIu64, model_bytes(&s->field));
    row_key(session, s, r, key, sizeof key);
    if (r->score) {
        const lab_score *c = r->score;
        at += snprintf(results + at, size - (size_t)at,
                       ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64
                       ",%.3g,%.3g,%.3g,%.3g,%.3g,%.3g",
                       c->tangent, c->true_positive, c->false_positive, c->false_negative, c->true_negative, c->leaks,
                       c->wrong_face, lab_histogram_quantile(&c->depth, 0.5), lab_histogram_quantile(&c->depth, 0.99),
                       lab_histogram_quantile(&c->depth, 0.999), c->depth.max,
                       lab_histogram_quantile(&c->residual, 0.99), c->residual.max);
    } else {
        at += snprintf(results + at, size - (size_t)at, ",,,,,,,,,,,,,");
    }
    if (n) {
        at += snprintf(results + at, size - (size_t)at, ",%.3g,%.3g,%.3g,", lab_histogram_quantile(n, 0.5),
                       lab_histogram_quantile(n, 0.99), n->max);
    } else {
        at += snprintf(results + at, size - (size_t)at, ",,,,");
    }
    at += print_times(results + at, size - (size_t)at, r);
    at += print_counts(session, results + at, size - (size_t)at, r);
    snprintf(results + at, size - (size_t)at, ",%.3g,%u,%s,%s", s->field_floor, LAB_SEED, session->machine,
             "gcc " __VERSION__);
    return lab_table_add(&session->table, LAB_VERSION, key, results, session->err);
}

static bool have_row(const lab_session *session, const subject *s, const row *r) {
    char key[512];
    row_key(session, s, r, key, sizeof key);
    return lab_table_has(&session->table, key);
}

/* ---- errors of solves ---- */

static df_status measure_errors(lab_session *session, const subject *s, lab_family family, const lab_surface *surface,
                                const lab_mesh *mesh, uint64_t rays) {
    const bool outer = surface || mesh;
    lab_run run = {.tracer = &df_tracer_dda,
                   .scene = &s->scene,
                   .surface = surface,
                   .mesh = mesh,
                   .family = family,
                   .seed = LAB_SEED,
                   .count = rays};
    df_status status = DF_OK;
    run.truths = calloc(rays, sizeof *run.truths);
    if (!run.truths) return df_fail(session->err, DF_ERROR_MEMORY, "no memory for %" PRIu64 " truths", rays);
    for (int m = 0; m < METHOD_COUNT && status == DF_OK; m++) {
        lab_score score = {0};
        run.solve = methods[m].solve;
        run.steps = methods[m].steps;
        run.precision = methods[m].precision;
        if (outer && run.solve != DF_SOLVE_ROBUST && run.steps > 1) continue; /* the field's error hides them */
        const row r = {.kind = "solve",
                       .tracer = "dda",
                       .intersect = df_solve_names[run.solve],
                       .precision = df_precision_names[run.precision],
                       .gradient = "",
                       .steps = run.steps,
                       .truth = mesh      ? "mesh"
                                : surface ? "surface"
                                          : "field",
                       .family = lab_family_names[family],
                       .rays = rays,
                       .score = &score,
                       .ns_per_ray = -1,
                       .ns_per_hit = -1};
        if (have_row(session, s, &r)) continue;
        status = lab_measure(&run, &score, session->err);
        run.truths_known = true;
        if (status == DF_OK) status = write_row(session, s, &r);
    }
    free(run.truths);
    return status;
}

/* ---- times ---- */

typedef struct timing {
    df_frame_options options;
    df_renderer *renderer;
    double ms[16];
    df_frame_stats stats;
    uint64_t instructions; /* of the last frame; 0: not counted */
    row row;
} timing;

static int compare_doubles(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Draws all once, each under its row's key. */
static df_status count_all(lab_session *session, const subject *s, const df_view *view, const df_picture *picture,
                           timing *timings, int count) {
    df_status status = DF_OK;
    for (int i = 0; i < count && status == DF_OK; i++) {
        char key[512];
        timings[i].row.rays = (uint64_t)picture->width * picture->height;
        row_key(session, s, &timings[i].row, key, sizeof key);
        status = df_renderer_open(&s->scene, &timings[i].options, picture->width, picture->height, &timings[i].renderer,
                                  session->err);
        if (status != DF_OK) return status;
        lab_count_begin();
        status = df_renderer_frame(timings[i].renderer, view, picture, NULL, session->err);
        lab_count_end(key);
        df_renderer_close(timings[i].renderer);
    }
    return status;
}

/* Draws all in turns. The first round warms up. */
static df_status time_rounds(lab_session *session, const df_view *view, const df_picture *picture, timing *timings,
                             int count, int repeats) {
    df_status status = DF_OK;
    for (int n = -1; n < repeats && status == DF_OK; n++) {
        for (int i = 0; i < count && status == DF_OK; i++) {
            memset(&timings[i].stats, 0, sizeof timings[i].stats);
            const uint64_t before = session->counter >= 0 ? lab_counter_read(session->counter) : 0;
            status = df_renderer_frame(timings[i].renderer, view, picture, &timings[i].stats, session->err);
            if (session->counter >= 0) timings[i].instructions = lab_counter_read(session->counter) - before;
            if (n >= 0) timings[i].ms[n] = timings[i].stats.frame_ms;
        }
    }
    return status;
}

static df_status write_timing(lab_session *session, const subject *s, timing *t, double rays, int repeats) {
    row *r = &t->row;
    char key[512];
    qsort(t->ms, (size_t)repeats, sizeof(double), compare_doubles);
    const double ns = 1e6 * t->ms[repeats / 2];
    r->ns_per_ray = ns / rays;
    r->ns_per_hit = t->stats.rays_hitting ? ns / (double)t->stats.rays_hitting : -1;
    r->repeats = repeats;
    r->rays = (uint64_t)rays;
    r->isa = t->options.kernels->isa;
    row_key(session, s, r, key, sizeof key);
    if (lab_table_has(&session->table, key)) return DF_OK;
    if (session->counter < 0) t->instructions = lab_counts_find(&session->counts, key);
    r->instructions_per_ray = (double)t->instructions / rays;
    return write_row(session, s, r);
}

/* Counts the frames of the subject in a child under callgrind, once, where the processor's counter cannot be read. */
static df_status count_subject(lab_session *session) {
    char text[16];
    snprintf(text, sizeof text, "%u", session->size);
    const char *const arguments[] = {
        "count", session->name, text, session->quick ? "--quick" : "--full", session->choices_only ? "--choices" : NULL,
        NULL};
    if (session->counted || session->counter >= 0) return DF_OK;
    session->counted = true;
    lab_counts_free(&session->counts);
    return lab_count_again(arguments, &session->counts, session->err);
}

static bool all_timed(const lab_session *session, const subject *s, timing *timings, int count, uint64_t rays) {
    bool all = !session->counting;
    for (int i = 0; i < count && all; i++) {
        timings[i].row.rays = rays;
        all = have_row(session, s, &timings[i].row);
    }
    return all;
}

#define CHOICE_ROWS 1024u /* what --quality auto chooses for, whatever the size of the pictures that are timed */
static uint32_t picture_size(const lab_session *session) { return session->quick ? 160 : CHOICE_ROWS; }

static df_status time_all(lab_session *session, const subject *s, double distance, timing *timings, int count) {
    const uint32_t size = picture_size(session);
    const int repeats = session->quick ? 7 : 9;
    df_camera camera;
    df_view view;
    if (all_timed(session, s, timings, count, (uint64_t)size * size)) return DF_OK;
    uint8_t *rgb = malloc(3 * (size_t)size * size);
    const df_picture picture = {.width = size, .height = size, .rgb = rgb};
    df_status status = rgb ? DF_OK : df_fail(session->err, DF_ERROR_MEMORY, "no memory for a picture");
    df_camera_orbit(&s->field, 40, 20, distance, &camera);
    camera.fov_y = 1;
    if (status == DF_OK) status = df_view_make(&camera, &s->field, size, size, &view, session->err);
    if (status == DF_OK && session->counting) {
        status = count_all(session, s, &view, &picture, timings, count);
        free(rgb);
        return status;
    }
    if (status == DF_OK) status = count_subject(session);
    for (int i = 0; i < count && status == DF_OK; i++) {
        status = df_renderer_open(&s->scene, &timings[i].options, size, size, &timings[i].renderer, session->err);
    }
    if (status == DF_OK) status = time_rounds(session, &view, &picture, timings, count, repeats);
    for (int i = 0; i < count; i++) {
        if (status == DF_OK) status = write_timing(session, s, &timings[i], (double)size * size, repeats);
        df_renderer_close(timings[i].renderer);
    }
    free(rgb);
    return status;
}

static timing make_timing(const lab_session *session, const char *kind, const df_tracer *tracer, method m,
                          int gradient) {
    return (timing){.options = {.tracer = tracer,
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

static df_status measure_times(lab_session *session, const subject *s) {
    timing solves[METHOD_COUNT], others[32];
    int count = 0;
    df_camera camera;
    df_view view;
    df_camera_orbit(&s->field, 40, 20, 1.6, &camera);
    camera.fov_y = 1;
    df_status status = df_view_make(&camera, &s->field, 64, 64, &view, session->err);
    if (status != DF_OK) return status;
    const df_tracer *chosen = df_tracer_choose(&s->scene, &view, NULL);
    const method standard = {DF_SOLVE_ROBUST, 0, DF_PRECISION_F64};
    for (int m = 0; m < METHOD_COUNT; m++) {
        solves[m] = make_timing(session, "solve-time", chosen, methods[m], DF_GRADIENT_CORNER_CENTRAL);
    }
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if ((*tracer)->suits && !(*tracer)->suits(&s->scene, &view)) continue;
        others[count++] = make_timing(session, "tracer-time", *tracer, standard, DF_GRADIENT_CORNER_CENTRAL);
    }
    for (int g = 0; g < DF_GRADIENT_COUNT; g++)
        others[count++] = make_timing(session, "gradient-time", chosen, standard, g);
    status = time_all(session, s, 1.6, solves, METHOD_COUNT);
    return status == DF_OK ? time_all(session, s, 1.6, others, count) : status;
}

/* The errors of each timing's method over the rays from an eye, into scores. */
static df_status score_view(lab_session *session, const subject *s, const df_camera *camera, timing *timings,
                            lab_score *scores, int count) {
    const uint64_t rays = session->quick ? 2000 : 100000;
    double eye[3];
    df_field_world_to_grid(&s->field, camera->eye, eye);
    lab_run run = {.tracer = &df_tracer_dda, .scene = &s->scene, .seed = LAB_SEED, .count = rays, .eye = eye};
    run.truths = calloc(rays, sizeof *run.truths);
    df_status status = run.truths ? DF_OK : df_fail(session->err, DF_ERROR_MEMORY, "no memory for truths");
    for (int i = 0; i < count && status == DF_OK; i++) {
        run.solve = timings[i].options.solve;
        run.steps = timings[i].options.steps;
        run.precision = timings[i].options.precision;
        status = lab_measure(&run, &scores[i], session->err);
        run.truths_known = true;
        timings[i].row.score = &scores[i];
    }
    free(run.truths);
    return status;
}

/* What --quality auto chooses at a distance, beside the first methods of the table with the same gradient. */
static df_status measure_choice(lab_session *session, const subject *s, double distance, const char *family,
                                int method_count) {
    timing timings[METHOD_COUNT + 1];
    int count = 0;
    df_camera camera;
    df_quality quality;
    df_view view;
    const uint32_t size = picture_size(session);
    df_camera_orbit(&s->field, 40, 20, distance, &camera);
    camera.fov_y = 1;
    df_quality_choose(&s->field, &camera, CHOICE_ROWS, true, &quality);
    df_status status = df_view_make(&camera, &s->field, size, size, &view, session->err);
    if (status != DF_OK) return status;
    const df_tracer *tracer = df_tracer_choose(&s->scene, &view, NULL);
    timings[count++] = make_timing(session, "auto", tracer, (method){quality.solve, quality.steps, quality.precision},
                                   quality.gradient);
    timings[0].row.bound = quality.bound;
    for (int m = 0; m < method_count; m++)
        timings[count++] = make_timing(session, "front", tracer, methods[m], quality.gradient);
    lab_score *scores = calloc((size_t)count, sizeof *scores);
    if (!scores) return df_fail(session->err, DF_ERROR_MEMORY, "no memory for scores");
    for (int i = 0; i < count; i++) {
        timings[i].row.family = family;
        timings[i].row.truth = "field";
    }
    if (!session->counting && !all_timed(session, s, timings, count, (uint64_t)size * size))
        status = score_view(session, s, &camera, timings, scores, count);
    if (status == DF_OK) status = time_all(session, s, distance, timings, count);
    free(scores);
    return status;
}

static df_status measure_auto(lab_session *session, const subject *s) {
    static const struct {
        double distance;
        const char *family;
        int method_count;
    } places[] = {{0.9, "distance 0.9", METHOD_COUNT},
                  {1.6, "distance 1.6", 0}, /* that of the chart, which has the methods already */
                  {6, "distance 6", METHOD_COUNT},
                  {40, "distance 40", METHOD_COUNT}};
    df_status status = DF_OK;
    for (int i = 0; i < 4 && status == DF_OK; i++)
        status = measure_choice(session, s, places[i].distance, places[i].family, places[i].method_count);
    return status;
}

/* ---- normals ---- */

/* The angle in degrees between the normal of each gradient at the default method's hit and that of the exact surface
 * there. */
static df_status measure_normals(lab_session *session, const subject *s, uint64_t rays) {
    lab_histogram *angles = calloc(DF_GRADIENT_COUNT, sizeof *angles);
    if (!angles) return df_fail(session->err, DF_ERROR_MEMORY, "no memory for angles");
    for (uint64_t i = 0; i < rays; i++) {
        double o[3], d[3], p[3], exact[3], length = 0;
        df_truth truth;
        uint32_t voxel[3];
        float local[3], stencil[64], gradient[3], normal[3];
        if (!lab_family_ray(&s->field, LAB_CAMERA, LAB_SEED, i, o, d)) continue;
        df_truth_trace(&s->field, 0, o, d, &truth);
        if (!truth.hit || truth.tangent) continue;
        for (int a = 0; a < 3; a++) {
            p[a] = o[a] + (double)truth.t * d[a];
            const double below = floor(p[a]);
            voxel[a] = (uint32_t)fmin(fmax(below, 0), s->field.voxel_count[a] - 1.0);
            local[a] = (float)(p[a] - voxel[a]);
        }
        const uint32_t block = df_scene_block(&s->scene, voxel[0], voxel[1], voxel[2]);
        if (block >= DF_CELL_INSIDE) continue;
        lab_surface_gradient(&s->surface, p, exact);
        for (int a = 0; a < 3; a++) length += exact[a] * exact[a];
        if (!(length > 0.5)) continue; /* a crease: no normal */
        df_scene_stencil(&s->scene, voxel, block, DF_REACH_ALL, stencil, 1);
        for (int g = 0; g < DF_GRADIENT_COUNT; g++) {
            double cross[3], cosine = 0, sine = 0;
            df_gradient(g, stencil, local, (const float[]){1, 1, 1}, gradient);
            df_shade_normal(gradient, (const float[]){1, 1, 1}, (const float[]){0, 0, 1}, normal);
            for (int a = 0; a < 3; a++) {
                const int u = (a + 1) % 3, v = (a + 2) % 3;
                cross[a] = (double)normal[u] * exact[v] - (double)normal[v] * exact[u];
                cosine += (double)normal[a] * exact[a];
                sine += cross[a] * cross[a];
            }
            lab_histogram_add(&angles[g], atan2(sqrt(sine), cosine) * 180 / M_PI);
        }
    }
    df_status status = DF_OK;
    for (int g = 0; g < DF_GRADIENT_COUNT && status == DF_OK; g++) {
        const row r = {.kind = "gradient",
                       .tracer = "",
                       .intersect = "",
                       .precision = "",
                       .gradient = df_gradient_names[g],
                       .truth = "surface",
                       .family = lab_family_names[LAB_CAMERA],
                       .rays = rays,
                       .normal = &angles[g],
                       .ns_per_ray = -1,
                       .ns_per_hit = -1};
        if (!have_row(session, s, &r)) status = write_row(session, s, &r);
    }
    free(angles);
    return status;
}

/* ---- fields in other structures ---- */

static df_status quantise(const df_field *dense, df_sample_type type, df_field *out, df_error *err) {
    const uint64_t count = dense->sample_count;
    const float *samples = dense->samples;
    const int zero = type == DF_SAMPLE_U8 ? 128 : 32768;
    const double largest = fmax(fabs((double)dense->value_min), fabs((double)dense->value_max));
    /* values beyond a few voxels are clamped: no surface voxel has any */
    const double range = fmin(largest, type == DF_SAMPLE_U8 ? 2.0 : 8.0);
    void *codes = malloc(count * df_sample_size(type));
    *out = (df_field){.kind = DF_FIELD_DENSE, .sample_type = type};
    if (!codes) return df_fail(err, DF_ERROR_MEMORY, "no memory for samples");
    df_field_own(out, codes);
    out->samples = codes;
    out->step_exponent = (int)ceil(log2(range / (zero - 1)));
    for (int a = 0; a < 3; a++) {
        out->voxel_count[a] = dense->voxel_count[a];
        out->voxel_size[a] = dense->voxel_size[a];
        out->origin[a] = dense->origin[a];
    }
    for (uint64_t i = 0; i < count; i++) {
        double q = fmin(zero - 1, fmax(-zero, rint(ldexp((double)samples[i], -out->step_exponent))));
        if (q == 0 && samples[i] < 0) q = -1;
        if (type == DF_SAMPLE_U8) ((uint8_t *)codes)[i] = (uint8_t)(q + zero);
        else ((uint16_t *)codes)[i] = (uint16_t)(q + zero);
    }
    return df_field_finish(out, "quantised", err);
}

/* The error of a stored field against its exact surface: truth against truth, no tracer. */
static df_status measure_storage(lab_session *session, const char *name, const lab_surface *surface,
                                 const df_field *field, uint64_t rays) {
    const double box[3] = {field->voxel_count[0], field->voxel_count[1], field->voxel_count[2]};
    lab_score score = {0};
    subject s = {.surface = *surface, .field = *field};
    snprintf(s.name, sizeof s.name, "%s", name);
    const row r = {.kind = "storage",
                   .tracer = "",
                   .intersect = "",
                   .precision = "",
                   .gradient = "",
                   .truth = "surface",
                   .family = "camera",
                   .rays = rays,
                   .score = &score,
                   .ns_per_ray = -1,
                   .ns_per_hit = -1};
    if (have_row(session, &s, &r)) return DF_OK;
#pragma omp parallel
    {
        lab_score mine = {0};
#pragma omp for
        for (uint64_t i = 0; i < rays; i++) {
            double o[3], d[3];
            df_truth stored, exact;
            if (!lab_family_ray(field, LAB_CAMERA, LAB_SEED, i, o, d)) continue;
            df_truth_trace(field, 0, o, d, &stored);
            lab_surface_trace(surface, box, o, d, &exact);
            mine.rays++;
            if (stored.tangent || exact.tangent) mine.tangent++;
            else if (stored.hit != exact.hit) mine.false_positive += stored.hit, mine.false_negative += exact.hit;
            else if (!stored.hit) mine.true_negative++;
            else {
                const double off = fabs((double)(stored.t - exact.t)) * sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
                mine.true_positive++;
                mine.leaks += off > LAB_LEAK_VOXELS;
                lab_histogram_add(&mine.depth, off);
            }
        }
#pragma omp critical
        lab_score_merge(&score, &mine);
    }
    return write_row(session, &s, &r);
}

static df_status measure_structures(lab_session *session, const char *name, uint32_t size, uint64_t rays) {
    df_status status = DF_OK;
    df_field dense = {0};
    const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_BRICKS, DF_FIELD_ADF};
    for (int k = 0; k < 3 && status == DF_OK; k++) {
        lab_surface surface;
        df_field field = {0};
        if (kinds[k] == DF_FIELD_ADF && size & (size - 1))
            continue; /* the test octree fills a cube of a power of two */
        status = make_field(name, size, 0, kinds[k], &surface, &field, session->err);
        if (status == DF_OK) status = measure_storage(session, name, &surface, &field, rays);
        for (int t = DF_SAMPLE_U16; t <= DF_SAMPLE_U8 && k == 0 && status == DF_OK; t++) {
            status = quantise(&field, (df_sample_type)t, &dense, session->err);
            if (status == DF_OK) status = measure_storage(session, name, &surface, &dense, rays);
            df_field_free(&dense);
        }
        df_field_free(&field);
    }
    return status;
}

/* ---- commands ---- */

/* What no solver can undo: the median error of the default method against the exact surface, in voxels along the ray;
 * or what the file says of its own error. */
static df_status find_floor(lab_session *session, subject *s, uint64_t rays) {
    lab_score score = {0};
    if (!s->exact && !s->mesh) {
        s->field_floor = s->field.error_rms > 0 ? s->field.error_rms / s->field.voxel_size[0] : 0;
        return DF_OK;
    }
    const lab_run run = {.tracer = &df_tracer_dda,
                         .scene = &s->scene,
                         .solve = DF_SOLVE_ROBUST,
                         .surface = s->exact ? &s->surface : NULL,
                         .mesh = s->mesh,
                         .family = LAB_CAMERA,
                         .seed = LAB_SEED,
                         .count = rays};
    df_status status = lab_measure(&run, &score, session->err);
    s->field_floor = lab_histogram_quantile(&score.depth, 0.5);
    return status;
}

/* The child: see count_subject. */
static df_status command_count(int argc, char **argv, df_error *err) {
    lab_session session = {.err = err, .counter = -1, .counting = true};
    subject s;
    session.quick = strcmp(argv[2], "--quick") == 0;
    df_status status = df_kernels_select("auto", &session.kernels, err);
    if (status == DF_OK) status = subject_open(&s, argv[0], (uint32_t)atoi(argv[1]), err);
    if (status != DF_OK) return status;
    if (argc < 4) status = measure_times(&session, &s);
    if (status == DF_OK) status = measure_auto(&session, &s);
    subject_close(&s);
    return status;
}

static void start_subject(lab_session *session, const char *name, uint32_t size, bool choices_only) {
    session->name = name;
    session->size = size;
    session->choices_only = choices_only;
    session->counted = session->uncounted;
}

/* Only what --quality auto chooses, beside the methods that it might have chosen. */
static df_status measure_subject_choices(lab_session *session, const char *name, uint32_t size) {
    subject s;
    start_subject(session, name, size, true);
    df_status status = subject_open(&s, name, size, session->err);
    if (status != DF_OK) return status;
    status = measure_auto(session, &s);
    subject_close(&s);
    return status;
}

static df_status measure_subject(lab_session *session, const char *name, uint32_t size) {
    subject s;
    const uint64_t rays = session->quick ? 4000 : 1000000;
    start_subject(session, name, size, false);
    df_status status = subject_open(&s, name, size, session->err);
    if (status == DF_OK) status = find_floor(session, &s, session->quick ? 4000 : 40000);
    if (status == DF_OK && !s.exact && !s.mesh) {
        fprintf(stderr, "df-lab: %s: its surface has no formula: errors of solvers only, none of the field\n", s.name);
    }
    if (status == DF_OK) status = measure_times(session, &s);
    if (status == DF_OK) status = measure_auto(session, &s);
    for (int f = 0; f < LAB_FAMILY_COUNT && status == DF_OK; f++) {
        status = measure_errors(session, &s, (lab_family)f, NULL, NULL, f == LAB_CAMERA ? 2 * rays : rays / 2);
    }
    if (status == DF_OK && s.exact) status = measure_errors(session, &s, LAB_CAMERA, &s.surface, NULL, rays);
    if (status == DF_OK && s.mesh) status = measure_errors(session, &s, LAB_CAMERA, NULL, s.mesh, rays);
    if (status == DF_OK && s.mesh) status = measure_errors(session, &s, LAB_RANDOM, NULL, s.mesh, rays);
    if (status == DF_OK && s.exact) status = measure_normals(session, &s, rays);
    subject_close(&s);
    if (status == DF_OK && s.exact) status = measure_structures(session, name, size, rays);
    return status;
}

static void read_machine(char *name, size_t size) {
    char line[256];
    FILE *file = fopen("/proc/cpuinfo", "r");
    snprintf(name, size, "unknown");
    while (file && fgets(line, sizeof line, file)) {
        char *value = strstr(line, ": ");
        if (strncmp(line, "model name", 10) != 0 || !value) continue;
        value[strcspn(value, "\n")] = 0;
        snprintf(name, size, "%s", value + 2);
        break;
    }
    for (char *c = name; *c; c++) *c = *c == ',' ? ' ' : *c;
    if (file) fclose(file);
}

static df_status session_open(lab_session *session, const char *path, int argc, char **argv, df_error *err) {
    *session = (lab_session){.err = err, .counter = lab_counter_open()};
    read_machine(session->machine, sizeof session->machine);
    for (int i = 0; i < argc; i++) {
        session->quick |= strcmp(argv[i], "--quick") == 0;
        session->uncounted |= strcmp(argv[i], "--uncounted") == 0;
    }
    if (session->uncounted && session->counter >= 0) close(session->counter);
    if (session->uncounted) session->counter = -1;
    df_status status = df_kernels_select("auto", &session->kernels, err);
    return status == DF_OK ? lab_table_open(path, LAB_VERSION, columns, KEY_COLUMNS, &session->table, err) : status;
}

static void session_close(lab_session *session) {
    if (session->counted && !session->uncounted && session->counts.count == 0)
        fprintf(stderr, "df-lab: no instructions were counted: no counter of the processor and no valgrind\n");
    lab_table_close(&session->table);
    lab_counts_free(&session->counts);
    if (session->counter >= 0) close(session->counter);
}

static df_status command_choices(int argc, char **argv, df_error *err) {
    lab_session session;
    df_status status = session_open(&session, argv[0], argc, argv, err);
    for (int i = 1; i < argc && status == DF_OK; i++) {
        if (argv[i][0] != '-') status = measure_subject_choices(&session, argv[i], 45);
    }
    session_close(&session);
    return status;
}

static df_status command_measure(int argc, char **argv, df_error *err) {
    lab_session session;
    int named = 0;
    df_status status = session_open(&session, argv[0], argc, argv, err);
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
    session_close(&session);
    return status;
}

static void print_escapes(const char *field, const df_tracer *tracer, const lab_escapes *escapes) {
    printf("%s, %s: %" PRIu64 " of %" PRIu64 " rays escape, %" PRIu64 " tangent ones end without a hit\n", field,
           tracer->name, escapes->count, escapes->rays, escapes->tangent);
    for (uint32_t i = 0; i < escapes->kept_count; i++) {
        const lab_escape *e = &escapes->kept[i];
        printf("  ray %" PRIu64 ", %s, from %.9g %.9g %.9g along %.9g %.9g %.9g: the truth ", e->ray,
               e->tangent ? "tangent" : "ESCAPED", e->origin[0], e->origin[1], e->origin[2], e->direction[0],
               e->direction[1], e->direction[2]);
        if (e->true_hit < 0) printf("does not hit\n");
        else printf("hits at t = %.9g\n", e->true_hit);
    }
    fflush(stdout);
}

static df_status command_escape(int argc, char **argv, df_error *err) {
    const uint64_t rays = argc > 0 ? strtoull(argv[0], NULL, 10) : 100000000;
    const char *const shapes[] = {"box", "gyroid", "noise", "pairs", "shell"};
    df_status status = DF_OK;
    uint64_t escaped = 0;
    if (rays < 5) return df_fail(err, DF_ERROR_USAGE, "%s: rays are a number of at least 5", argv[0]);
    for (int i = 0; i < 5 && status == DF_OK; i++) {
        subject s;
        status = subject_open(&s, shapes[i], 64, err);
        for (const df_tracer *const *tracer = df_tracers; *tracer && status == DF_OK; tracer++) {
            lab_escapes escapes;
            const lab_run run = {.tracer = *tracer,
                                 .scene = &s.scene,
                                 .solve = DF_SOLVE_ROBUST,
                                 .family = LAB_INSIDE,
                                 .seed = LAB_SEED,
                                 .count = rays / 5};
            if ((*tracer)->suits && !(*tracer)->suits(&s.scene, NULL)) continue;
            status = lab_count_escapes(&run, &escapes, err);
            if (status != DF_OK) break;
            print_escapes(s.name, *tracer, &escapes);
            escaped += escapes.count;
        }
        subject_close(&s);
    }
    if (status == DF_OK && escaped) return df_fail(err, DF_ERROR_INPUT, "%" PRIu64 " rays escaped", escaped);
    return status;
}

static df_status command_field(int argc, char **argv, df_error *err) {
    lab_surface surface;
    df_field field = {0};
    df_status status = make_field(argv[0], (uint32_t)atoi(argv[1]), argc > 3 ? atof(argv[3]) : 0, DF_FIELD_BRICKS,
                                  &surface, &field, err);
    if (status == DF_OK) status = df_field_write(&field, argv[2], err);
    df_field_free(&field);
    return status;
}

/* The colour of an error: from blue for 1e-6 voxel and less by green to red for 1 and more; misses that are wrong are
 * magenta, hits that are wrong white, the background is grey. */
static void error_colour(double error, uint8_t rgb[3]) {
    const double s = fmin(1, fmax(0, (log10(fmax(error, 1e-9)) + 6) / 6));
    rgb[0] = (uint8_t)(255 * fmin(1, fmax(0, 2 * s - 0.5)));
    rgb[1] = (uint8_t)(255 * fmax(0, 1 - fabs(2 * s - 1)));
    rgb[2] = (uint8_t)(255 * fmax(0, 1 - 2 * s));
}

static df_status command_map(int argc, char **argv, df_error *err) {
    enum { SIZE = 320 };
    const int solve = find_name(df_solve_names, argv[2]);
    const df_scene_options options = {0};
    const df_frame_options frame = {.tracer = &df_tracer_dda, .solve = solve, .tile = 64, .threads = 1};
    lab_surface surface;
    df_field field = {0};
    df_scene scene = {0};
    df_camera camera;
    df_view view;
    df_rays rays = {0};
    df_renderer *renderer = NULL;
    uint8_t *rgb = malloc(3 * SIZE * SIZE);
    float *depth = malloc(sizeof(float) * SIZE * SIZE);
    df_status status = rgb && depth ? DF_OK : df_fail(err, DF_ERROR_MEMORY, "no memory for a picture");
    if (solve < 0) status = df_fail(err, DF_ERROR_USAGE, "%s: no such solve", argv[2]);
    if (status == DF_OK)
        status = make_field(argv[0], (uint32_t)atoi(argv[1]), argc > 4 ? atof(argv[4]) : 0, DF_FIELD_BRICKS, &surface,
                            &field, err);
    if (status == DF_OK) status = df_scene_prepare(&field, 0, &options, &scene, err);
    df_camera_orbit(&field, 30, 20, 1.6, &camera);
    camera.fov_y = 0.75;
    if (status == DF_OK) status = df_view_make(&camera, &field, SIZE, SIZE, &view, err);
    if (status == DF_OK) status = df_renderer_open(&scene, &frame, SIZE, SIZE, &renderer, err);
    const df_picture picture = {.width = SIZE, .height = SIZE, .depth = depth};
    if (status == DF_OK) status = df_renderer_frame(renderer, &view, &picture, NULL, err);
    if (status == DF_OK) status = df_rays_alloc(SIZE * SIZE, true, &rays, err);
    if (status == DF_OK) df_view_rays(&view, &df_kernels_scalar, 0, 0, SIZE, SIZE, &rays);
    for (uint32_t i = 0; i < SIZE * SIZE && status == DF_OK; i++) {
        double o[3], d[3], length = 0;
        df_truth truth;
        for (int a = 0; a < 3; a++) {
            o[a] = (double)rays.origin[a][rays.shared_origin ? 0 : i];
            d[a] = (double)rays.direction[a][i];
            length += d[a] * d[a];
        }
        df_truth_trace(&field, 0, o, d, &truth);
        const bool hit = isfinite(depth[i]);
        uint8_t *c = rgb + 3 * (size_t)i;
        if (!hit && !truth.hit) memset(c, 120, 3);
        else if (!hit) c[0] = 255, c[1] = 0, c[2] = 255;
        else if (!truth.hit) memset(c, 255, 3);
        else error_colour(fabs((double)depth[i] - (double)truth.t * sqrt(length)), c);
    }
    if (status == DF_OK) status = df_image_write_png(argv[3], rgb, SIZE, SIZE, NULL, 0, err);
    if (renderer) df_renderer_close(renderer);
    df_rays_free(&rays);
    df_scene_free(&scene);
    df_field_free(&field);
    free(rgb);
    free(depth);
    return status;
}

/* The depth image of a mesh, in double, one ray after the other. */
static df_status trace_mesh(const lab_mesh *mesh, const df_field *field, const df_camera *camera, const df_view *view,
                            float *depth, df_error *err) {
    df_rays rays;
    df_status status = df_rays_alloc(view->width, true, &rays, err);
    for (uint32_t y = 0; y < view->height && status == DF_OK; y++) {
        df_view_rays(view, &df_kernels_scalar, 0, y, view->width, 1, &rays);
#pragma omp parallel for schedule(dynamic, 64)
        for (uint32_t x = 0; x < view->width; x++) {
            double o[3], d[3], at[3], world[3], square = 0;
            df_truth truth;
            for (int a = 0; a < 3; a++) {
                o[a] = (double)rays.origin[a][rays.shared_origin ? 0 : x];
                d[a] = (double)rays.direction[a][x];
            }
            lab_mesh_trace(mesh, o, d, &truth);
            for (int a = 0; a < 3; a++) at[a] = o[a] + (double)truth.t * d[a];
            df_field_grid_to_world(field, at, world);
            for (int a = 0; a < 3; a++) square += (world[a] - camera->eye[a]) * (world[a] - camera->eye[a]);
            depth[(size_t)y * view->width + x] = truth.hit ? (float)sqrt(square) : INFINITY;
        }
    }
    if (status == DF_OK) df_rays_free(&rays);
    return status;
}

static df_status command_depth(int argc, char **argv, df_error *err) {
    (void)argc;
    df_settings settings;
    df_field field = {0};
    df_camera camera;
    df_view view;
    lab_mesh *mesh = NULL;
    float *depth = NULL;
    df_settings_defaults(&settings);
    df_status status = df_parse_u32("WIDTH", argv[2], 1, 16384, &settings.width, err);
    if (status == DF_OK) status = df_parse_u32("HEIGHT", argv[3], 1, 16384, &settings.height, err);
    if (status == DF_OK) status = df_field_read(argv[0], DF_READ_COPY, &field, err);
    if (status == DF_OK) status = df_settings_camera(&settings, &field, &camera, err);
    if (status == DF_OK) status = df_view_make(&camera, &field, settings.width, settings.height, &view, err);
    if (status == DF_OK) status = lab_mesh_read(argv[1], &field, &mesh, err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&depth, (uint64_t)view.width * view.height, sizeof *depth, "picture", err);
    if (status == DF_OK) status = trace_mesh(mesh, &field, &camera, &view, depth, err);
    if (status == DF_OK) status = df_image_write_float(argv[4], depth, view.width, view.height, 1, err);
    lab_mesh_free(mesh);
    df_field_free(&field);
    free(depth);
    return status;
}

int main(int argc, char **argv) {
    static const struct {
        const char *name, *usage;
        int least;
        df_status (*run)(int argc, char **argv, df_error *err);
    } commands[] = {{"measure", "FILE.csv [--quick] [--uncounted] [FIELD...]", 1, command_measure},
                    {"choices", "FILE.csv [--quick] [--uncounted] FIELD...", 2, command_choices},
                    {"count", "FIELD SIZE --quick|--full [--choices]", 3, command_count},
                    {"escape", "[RAYS]", 0, command_escape},
                    {"filters", "[FIELD.dfield:MESH.obj...]", 0, lab_command_filters},
                    {"field", "SHAPE SIZE FILE.dfield [PARAMETER]", 3, command_field},
                    {"map", "SHAPE SIZE SOLVE FILE.png [PARAMETER]", 4, command_map},
                    {"depth", "FIELD.dfield MESH.obj WIDTH HEIGHT FILE.pfm", 5, command_depth}};
    const int command_count = sizeof commands / sizeof commands[0];
    df_output_watch_standard("df-lab");
    df_error err = {0};
    for (int i = 0; i < command_count; i++) {
        if (argc < 2 || strcmp(argv[1], commands[i].name) != 0) continue;
        if (argc - 2 < commands[i].least) break;
        df_status status = commands[i].run(argc - 2, argv + 2, &err);
        if (status != DF_OK) fprintf(stderr, "df-lab: %s\n", err.text);
        return df_exit_code(status);
    }
    fprintf(stderr, "usage:\n");
    for (int i = 0; i < command_count; i++) fprintf(stderr, "  df-lab %s %s\n", commands[i].name, commands[i].usage);
    return 2;
}
