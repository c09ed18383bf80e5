#include "commands.h"
#include "common/version.h"
#include "fields.h"
#include "octree.h"
#include "opencl_tracer.h"
#include "render/methods/solve_methods.h"
#include "subject.h"
#include "table.h"
#include "view_escapes.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { VOXELS_LOG2 = 6, VOXELS = 1 << VOXELS_LOG2 };

static const lab_shape shapes[] = {LAB_BOX, LAB_GYROID, LAB_NOISE, LAB_PAIRS, LAB_SHELL};
enum { SHAPE_COUNT = sizeof shapes / sizeof shapes[0] };

typedef enum layout { DENSE, BRICKS, OCTREE, JUNCTIONS, STRUCTURE_COUNT } layout;
static const char *const structure_names[] = {"dense", "bricks", "octree", "octree with junctions", NULL};

/* Of --table: runs without an escape are not made again. The format counts as a part of the version. */
#define TABLE_VERSION DF_VERSION "-1"
#define TABLE_KEY_COLUMNS 5
static const char table_columns[] = "field,structure,tracer,isa,rays,traced,escaped,tangent";

static df_status make_structure(lab_shape shape, layout structure, df_field *field, df_error *err) {
    static const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_BRICKS, DF_FIELD_ADF};
    lab_surface surface = lab_surface_make(shape, VOXELS, 0);
    /* leaves of different sizes meet at the surface, where they do not fit */
    if (structure == JUNCTIONS) return lab_octree_make(&surface, VOXELS_LOG2, 0.3, LAB_SEED, field, err);
    return lab_field_make(lab_shape_names[shape], VOXELS, 0, kinds[structure], &surface, field, err);
}

static void print_escapes(const char *field, const char *structure, const char *tracer, const lab_escapes *escapes) {
    printf("%s, %s, %s: %" PRIu64 " of %" PRIu64 " rays escape, %" PRIu64 " tangent ones end without a hit\n", field,
           structure, tracer, escapes->count, escapes->rays, escapes->tangent);
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

/* Whether a tracer has anything to do with a structure: rays in any direction, or else views. */
static bool takes_rays(const df_tracer *tracer, const df_scene *scene) {
    return !tracer->suits || tracer->suits(scene, NULL);
}

static bool takes_views(const df_tracer *tracer, const df_scene *scene) {
    df_camera camera;
    df_view view;
    df_camera_orbit(scene->field, 0, 0, 2, &camera);
    camera.fov_y = 1;
    return df_view_make(&camera, scene->field, 64, 64, &view, NULL) == DF_OK && tracer->suits(scene, &view);
}

typedef struct tally {
    const df_kernels *kernels;
    lab_table table;    /* no file: none */
    const char *wanted; /* NULL: every tracer */
    uint64_t rays;      /* a field */
    uint64_t runs, escaped;
    bool no_device;
} tally;

/* A tracer in a field. */
typedef struct contest {
    const df_tracer *tracer;
    char key[256]; /* of its row */
    lab_escapes escapes;
} contest;
enum { CONTESTS_MAX = 16, SLAB_RAYS = 1 << 20 };

static df_status finish_contest(contest *c, const char *shape, const char *structure, tally *sum, df_error *err) {
    char results[128];
    lab_escapes_sort(&c->escapes);
    print_escapes(shape, structure, c->tracer->name, &c->escapes);
    sum->runs++;
    sum->escaped += c->escapes.count;
    if (!sum->table.file || c->escapes.count > 0) return DF_OK;
    snprintf(results, sizeof results, "%" PRIu64 ",%" PRIu64 ",%" PRIu64, c->escapes.rays, c->escapes.count,
             c->escapes.tangent);
    return lab_table_add(&sum->table, TABLE_VERSION, c->key, results, err);
}

/* The same rays by each tracer: to find them takes longer than to trace them. *count: those that remain, without a
 * device that is not there. */
static df_status send_rays(contest *contests, int *count, const df_scene *scene, tally *sum, df_error *err) {
    df_status status = DF_OK;
    lab_known *known = malloc(SLAB_RAYS * sizeof *known);
    if (!known) return df_fail(err, DF_ERROR_MEMORY, "no memory for rays");
    for (uint64_t first = 0; first < sum->rays && status == DF_OK; first += SLAB_RAYS) {
        const uint64_t left = sum->rays - first;
        lab_run run = {.kernels = sum->kernels,
                       .scene = scene,
                       .solve = DF_SOLVE_ROBUST,
                       .family = LAB_INSIDE,
                       .seed = LAB_SEED,
                       .first = first,
                       .count = left < SLAB_RAYS ? left : SLAB_RAYS,
                       .known = known};
        memset(known, 0, run.count * sizeof *known);
        for (int i = 0; i < *count && status == DF_OK; i++) {
            lab_escapes escapes;
            run.tracer = contests[i].tracer;
            status = lab_count_escapes(&run, &escapes, err);
            if (status == DF_OK) lab_escapes_merge(&contests[i].escapes, &escapes);
            run.is_known = true;
            if (status != DF_ERROR_UNSUPPORTED || run.tracer != &lab_tracer_opencl) continue;
            sum->no_device = true;
            status = DF_OK;
            --*count; /* it is the last */
        }
    }
    free(known);
    return status;
}

/* Whether a tracer is wanted, and its rays are not known to stay in. */
static bool begin_contest(contest *c, const char *shape, const char *structure, const df_tracer *tracer, tally *sum) {
    *c = (contest){.tracer = tracer};
    if (sum->wanted && strcmp(sum->wanted, tracer->name) != 0) return false;
    snprintf(c->key, sizeof c->key, "%s,%s,%s,%s,%" PRIu64, shape, structure, tracer->name,
             tracer == &lab_tracer_opencl ? "device" : sum->kernels->isa, sum->rays);
    if (!sum->table.file || !lab_table_has(&sum->table, c->key)) return true;
    sum->runs++;
    return false;
}

static df_status measure_scene(const char *shape, const char *structure, const df_scene *scene, tally *sum,
                               df_error *err) {
    contest *contests = calloc(CONTESTS_MAX, sizeof *contests);
    int count = 0;
    df_status status = contests ? DF_OK : df_fail(err, DF_ERROR_MEMORY, "no memory for tracers");
    for (const df_tracer *const *tracer = df_tracers; *tracer && status == DF_OK; tracer++) {
        contest *next = &contests[count];
        if (takes_rays(*tracer, scene)) count += begin_contest(next, shape, structure, *tracer, sum);
        else if (takes_views(*tracer, scene) && begin_contest(next, shape, structure, *tracer, sum)) {
            status = lab_count_view_escapes(*tracer, scene, LAB_SEED, sum->rays, &next->escapes, err);
            if (status == DF_OK) status = finish_contest(next, shape, structure, sum, err);
        }
    }
    if (status == DF_OK) count += begin_contest(&contests[count], shape, structure, &lab_tracer_opencl, sum);
    if (status == DF_OK && count > 0) status = send_rays(contests, &count, scene, sum, err);
    for (int i = 0; i < count && status == DF_OK; i++)
        status = finish_contest(&contests[i], shape, structure, sum, err);
    free(contests);
    return status;
}

static df_status measure_structure(layout structure, tally *sum, df_error *err) {
    const df_scene_options options = {0};
    df_status status = DF_OK;
    for (int i = 0; i < SHAPE_COUNT && status == DF_OK; i++) {
        df_field field = {0};
        df_scene scene = {0};
        status = make_structure(shapes[i], structure, &field, err);
        if (status == DF_OK) status = df_scene_prepare(&field, 0, &options, &scene, err);
        if (status == DF_OK)
            status = measure_scene(lab_shape_names[shapes[i]], structure_names[structure], &scene, sum, err);
        df_scene_free(&scene);
        df_field_free(&field);
    }
    return status;
}

df_status lab_command_escape(int argc, char **argv, df_error *err) {
    const char *path = NULL;
    if (argc > 1 && strcmp(argv[0], "--table") == 0) path = argv[1], argc -= 2, argv += 2;
    tally sum = {.rays = (argc > 0 ? strtoull(argv[0], NULL, 10) : 100000000) / SHAPE_COUNT,
                 .wanted = argc > 1 ? argv[1] : NULL};
    if (sum.rays == 0)
        return df_fail(err, DF_ERROR_USAGE, "%s: rays are a number of at least %d", argv[0], SHAPE_COUNT);
    df_status status = df_kernels_select("auto", &sum.kernels, err);
    if (status == DF_OK && path)
        status = lab_table_open(path, TABLE_VERSION, table_columns, TABLE_KEY_COLUMNS, &sum.table, err);
    for (int s = 0; s < STRUCTURE_COUNT && status == DF_OK; s++) {
        if (argc > 2 && strcmp(argv[2], structure_names[s]) != 0) continue;
        status = measure_structure((layout)s, &sum, err);
    }
    lab_table_close(&sum.table);
    if (sum.no_device) fprintf(stderr, "df-lab: no OpenCL device: opencl was not measured\n");
    if (status == DF_OK && sum.escaped) return df_fail(err, DF_ERROR_INPUT, "%" PRIu64 " rays escaped", sum.escaped);
    if (status == DF_OK && sum.runs == 0) return df_fail(err, DF_ERROR_USAGE, "no such tracer or structure");
    return status;
}
