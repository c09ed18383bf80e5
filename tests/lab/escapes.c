#include "commands.h"
#include "measure.h"
#include "render/methods/solve_methods.h"
#include "subject.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

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

df_status lab_command_escape(int argc, char **argv, df_error *err) {
    const uint64_t rays = argc > 0 ? strtoull(argv[0], NULL, 10) : 100000000;
    const char *const shapes[] = {"box", "gyroid", "noise", "pairs", "shell"};
    df_status status = DF_OK;
    uint64_t escaped = 0;
    if (rays < 5) return df_fail(err, DF_ERROR_USAGE, "%s: rays are a number of at least 5", argv[0]);
    for (int i = 0; i < 5 && status == DF_OK; i++) {
        lab_subject s;
        status = lab_subject_open(&s, shapes[i], 64, err);
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
        lab_subject_close(&s);
    }
    if (status == DF_OK && escaped) return df_fail(err, DF_ERROR_INPUT, "%" PRIu64 " rays escaped", escaped);
    return status;
}
