#include "commands.h"
#include "measure.h"
#include "render/methods/solve_methods.h"
#include "subject.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Families of rays from outside, which any tracer takes. */
static const lab_family families[] = {LAB_RANDOM, LAB_CAMERA, LAB_GRAZING, LAB_LATTICE, LAB_SECONDARY};
enum { FAMILY_COUNT = sizeof families / sizeof families[0], SHAPE_VOXELS = 64 };

/* What is judged: a tracer on an instruction set, NULL: every one of them. */
typedef struct wanted {
    const char *tracer, *isa;
    uint64_t rays, failed, runs;
} wanted;

static bool takes_part(const df_tracer *tracer, const df_kernels *kernels, const df_scene *scene, const wanted *of) {
    if (tracer->suits && !tracer->suits(scene, NULL)) return false;
    if (of->tracer && strcmp(of->tracer, tracer->name) != 0) return false;
    return !of->isa || strcmp(of->isa, kernels->isa) == 0;
}

static void print_score(const char *field, const lab_run *run, const lab_score *score) {
    printf("%s,%s,%s,%s,%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64
           ",%.3g,%.3g\n",
           field, run->tracer->name, run->kernels->isa, lab_family_names[run->family], score->rays, score->tangent,
           score->true_positive, score->false_positive, score->false_negative, score->leaks, score->wrong_face,
           lab_histogram_quantile(&score->depth, 0.99), score->depth.max);
    fflush(stdout);
    lab_print_failures(run, score);
}

/* Every tracer that is wanted over one family: the truths of the first serve the others. */
static df_status judge_family(const lab_subject *s, lab_family family, wanted *of, df_error *err) {
    static const char *const sets[] = {"scalar", "sse4.1", "avx2", "avx512"};
    lab_run run = {.scene = &s->scene,
                   .solve = DF_SOLVE_ROBUST,
                   .family = family,
                   .seed = LAB_SEED,
                   .count = of->rays / FAMILY_COUNT};
    df_status status = DF_OK;
    run.known = calloc(run.count, sizeof *run.known);
    if (!run.known) return df_fail(err, DF_ERROR_MEMORY, "no memory for truths");
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        for (size_t i = 0; i < sizeof sets / sizeof sets[0] && status == DF_OK; i++) {
            lab_score score = {0};
            run.tracer = *tracer;
            if (df_kernels_select(sets[i], &run.kernels, NULL) != DF_OK) continue; /* this processor lacks it */
            if (!takes_part(*tracer, run.kernels, run.scene, of)) continue;
            status = lab_measure(&run, &score, err);
            if (status != DF_OK) break;
            print_score(s->name, &run, &score);
            run.is_known = true;
            of->failed += lab_score_errors(&score);
            of->runs++;
        }
    }
    free(run.known);
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
    lab_subject_close(&s);
    if (status == DF_OK && of.failed)
        return df_fail(err, DF_ERROR_INPUT, "%s: %" PRIu64 " rays are wrong", argv[0], of.failed);
    if (status == DF_OK && of.runs == 0) return df_fail(err, DF_ERROR_USAGE, "no such tracer or instruction set");
    return status;
}
