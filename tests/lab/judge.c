#include "commands.h"
#include "measure.h"
#include "render/frame.h"
#include "render/methods/solve_methods.h"
#include "subject.h"
#include "view_truth.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Families of rays from outside, which any tracer takes. */
static const lab_family families[] = {LAB_RANDOM, LAB_CAMERA, LAB_GRAZING, LAB_LATTICE, LAB_SECONDARY};
enum { FAMILY_COUNT = sizeof families / sizeof families[0], SHAPE_VOXELS = 64, SIDE = 128, PIXELS = SIDE * SIDE };
static const char *const sets[] = {"scalar", "sse4.1", "avx2", "avx512"};
enum { SET_COUNT = sizeof sets / sizeof sets[0] };

/* What is judged: a tracer on an instruction set, NULL: every one of them. */
typedef struct wanted {
    const char *tracer, *isa;
    uint64_t rays, failed, runs;
} wanted;

/* view: NULL: any rays. */
static bool takes_part(const df_tracer *tracer, const df_kernels *kernels, const df_scene *scene, const df_view *view,
                       const wanted *of) {
    if (tracer->suits && !tracer->suits(scene, view)) return false;
    if (of->tracer && strcmp(of->tracer, tracer->name) != 0) return false;
    return !of->isa || strcmp(of->isa, kernels->isa) == 0;
}

static void print_score(const char *field, const df_tracer *tracer, const df_kernels *kernels, const char *rays_of,
                        const lab_score *score) {
    printf("%s,%s,%s,%s,%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64
           ",%.3g,%.3g\n",
           field, tracer->name, kernels->isa, rays_of, score->rays, score->tangent, score->true_positive,
           score->false_positive, score->false_negative, score->leaks, score->wrong_face,
           lab_histogram_quantile(&score->depth, 0.99), score->depth.max);
    fflush(stdout);
}

/* Every tracer that is wanted over one family: the truths of the first serve the others. */
static df_status judge_family(const lab_subject *s, lab_family family, wanted *of, df_error *err) {
    lab_run run = {.scene = &s->scene,
                   .solve = DF_SOLVE_ROBUST,
                   .family = family,
                   .seed = LAB_SEED,
                   .count = of->rays / FAMILY_COUNT};
    df_status status = DF_OK;
    run.known = calloc(run.count, sizeof *run.known);
    if (!run.known) return df_fail(err, DF_ERROR_MEMORY, "no memory for truths");
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        for (size_t i = 0; i < SET_COUNT && status == DF_OK; i++) {
            lab_score score = {0};
            run.tracer = *tracer;
            if (df_kernels_select(sets[i], &run.kernels, NULL) != DF_OK) continue; /* this processor lacks it */
            if (!takes_part(*tracer, run.kernels, run.scene, NULL, of)) continue;
            status = lab_measure(&run, &score, err);
            if (status != DF_OK) break;
            print_score(s->name, *tracer, run.kernels, lab_family_names[family], &score);
            lab_print_failures(&run, &score);
            run.is_known = true;
            of->failed += lab_score_errors(&score);
            of->runs++;
        }
    }
    free(run.known);
    return status;
}

/* Of every tracer and instruction set, the pictures' scores. */
typedef lab_score view_scores[16][SET_COUNT];

/* One picture by every tracer that is wanted: scalar walks, packets and whole frames alike. */
static df_status judge_view(const df_scene *scene, const df_view *view, uint64_t first, lab_known *pixels, float *depth,
                            view_scores scores, const wanted *of, df_error *err) {
    const df_picture picture = {.width = SIDE, .height = SIDE, .depth = depth};
    df_status status = lab_view_truths(scene, view, pixels, err);
    for (int t = 0; df_tracers[t]; t++) {
        for (size_t i = 0; i < SET_COUNT && status == DF_OK; i++) {
            df_frame_options options = {.tracer = df_tracers[t], .solve = DF_SOLVE_ROBUST, .tile = 64, .threads = 1};
            df_renderer *renderer = NULL;
            if (df_kernels_select(sets[i], &options.kernels, NULL) != DF_OK) continue;
            if (!takes_part(df_tracers[t], options.kernels, scene, view, of)) continue;
            status = df_renderer_open(scene, &options, SIDE, SIDE, &renderer, err);
            if (status == DF_OK) status = df_renderer_frame(renderer, view, &picture, NULL, err);
            if (status == DF_OK) lab_score_depths(scene->field, pixels, PIXELS, first, depth, &scores[t][i]);
            df_renderer_close(renderer);
        }
    }
    return status;
}

static void print_views(const lab_subject *s, view_scores scores, wanted *of) {
    for (int t = 0; df_tracers[t]; t++) {
        for (size_t i = 0; i < SET_COUNT; i++) {
            const df_kernels *kernels;
            const lab_score *score = &scores[t][i];
            if (score->rays == 0 || df_kernels_select(sets[i], &kernels, NULL) != DF_OK) continue;
            print_score(s->name, df_tracers[t], kernels, "views", score);
            for (uint32_t n = 0; n < score->failure_count; n++) {
                const uint64_t pixel = score->failures[n].ray;
                printf("%s %s is wrong in view %" PRIu64 " at pixel %" PRIu64 ",%" PRIu64 "\n", df_tracers[t]->name,
                       kernels->isa, pixel / PIXELS, pixel % SIDE, pixel % PIXELS / SIDE);
            }
            of->failed += lab_score_errors(score);
            of->runs++;
        }
    }
}

/* Pictures from eyes inside and outside: what draws views only, and what treats the pixels of a picture otherwise than
 * any rays. */
static df_status judge_views(const lab_subject *s, wanted *of, df_error *err) {
    const uint64_t count = (of->rays / FAMILY_COUNT + PIXELS - 1) / PIXELS;
    float *depth = malloc(PIXELS * sizeof *depth);
    lab_known *pixels = calloc(PIXELS, sizeof *pixels);
    lab_score(*scores)[SET_COUNT] = calloc(1, sizeof(view_scores));
    df_status status = depth && pixels && scores ? DF_OK : df_fail(err, DF_ERROR_MEMORY, "no memory for pictures");
    for (uint64_t n = 0; n < 2 * count && status == DF_OK; n++) {
        df_camera camera;
        df_view view;
        if (!lab_random_camera(&s->field, LAB_SEED, n, &camera)) continue;
        status = df_view_make(&camera, &s->field, SIDE, SIDE, &view, err);
        if (status == DF_OK) status = judge_view(&s->scene, &view, n * PIXELS, pixels, depth, scores, of, err);
    }
    if (status == DF_OK) print_views(s, scores, of);
    free(scores);
    free(pixels);
    free(depth);
    return status;
}

df_status lab_command_judge(int argc, char **argv, df_error *err) {
    wanted of = {.rays = argc > 1 ? strtoull(argv[1], NULL, 10) : 1000000,
                 .tracer = argc > 2 ? argv[2] : NULL,
                 .isa = argc > 3 ? argv[3] : NULL};
    lab_subject s = {0};
    if (of.rays < FAMILY_COUNT)
        return df_fail(err, DF_ERROR_USAGE, "%s: rays are a number of at least %d", argv[1], FAMILY_COUNT);
    df_status status = lab_subject_open(&s, argv[0], SHAPE_VOXELS, err);
    if (status == DF_OK)
        printf("field,tracer,isa,rays_of,rays,tangent,hits,false_positive,false_negative,leaks,wrong_face,p99_voxels,"
               "max_voxels\n");
    for (int i = 0; i < FAMILY_COUNT && status == DF_OK; i++) status = judge_family(&s, families[i], &of, err);
    if (status == DF_OK) status = judge_views(&s, &of, err);
    lab_subject_close(&s);
    if (status == DF_OK && of.failed)
        return df_fail(err, DF_ERROR_INPUT, "%s: %" PRIu64 " rays are wrong", argv[0], of.failed);
    if (status == DF_OK && of.runs == 0) return df_fail(err, DF_ERROR_USAGE, "no such tracer or instruction set");
    return status;
}
