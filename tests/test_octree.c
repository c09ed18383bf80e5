/*
 * Octrees whose levels do not fit (T29): the truth jumps on faces between leaves, and every tracer must hit where it
 * jumps to the other side, lose nothing and add nothing. Random T-junctions at the surface, in all families of rays.
 */
#include "fields.h"
#include "lab/measure.h"
#include "lab/octree.h"
#include "render/methods/solve_methods.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static uint64_t ray_count = 400;

typedef struct fixture {
    df_field field;
    df_scene scene;
} fixture;

static void open_octree(fixture *f, lab_shape shape, double keep) {
    const lab_surface surface = lab_surface_make(shape, 64, shape == LAB_NOISE ? 5 : 0);
    const df_scene_options options = {0};
    df_error err;
    memset(f, 0, sizeof *f);
    if (lab_octree_make(&surface, 6, keep, LAB_SEED, &f->field, &err)) fail_msg("%s", err.text);
    if (df_scene_prepare(&f->field, 0, &options, &f->scene, &err)) fail_msg("%s", err.text);
}

static void close_octree(fixture *f) {
    df_scene_free(&f->scene);
    df_field_free(&f->field);
}

static bool takes_rays(const df_tracer *tracer, const df_scene *scene) {
    return !tracer->suits || tracer->suits(scene, NULL);
}

static void leaves_that_do_not_fit_lose_no_hit(void **unused) {
    (void)unused;
    const lab_shape shapes[] = {LAB_SPHERE, LAB_BOX, LAB_GYROID, LAB_NOISE};
    const double keep[] = {0, 0.2, 0.5};
    int tracers = 0, wrong = 0;
    for (int s = 0; s < 12; s++) {
        fixture f;
        open_octree(&f, shapes[s % 4], keep[s / 4]);
        for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
            if (!takes_rays(*tracer, &f.scene)) continue;
            tracers++;
            for (int family = 0; family < LAB_FAMILY_COUNT; family++) {
                lab_score score = {0};
                df_error err;
                const lab_run run = {.tracer = *tracer,
                                     .scene = &f.scene,
                                     .solve = DF_SOLVE_ROBUST,
                                     .family = (lab_family)family,
                                     .seed = LAB_SEED,
                                     .count = ray_count};
                if (lab_measure(&run, &score, &err)) fail_msg("%s", err.text);
                if (!lab_score_errors(&score)) continue;
                print_error("%s, %g left: %s, %s: %d false hits, %d false misses, %d leaks, %d wrong faces of %d\n",
                            lab_shape_names[shapes[s % 4]], keep[s / 4], (*tracer)->name, lab_family_names[family],
                            (int)score.false_positive, (int)score.false_negative, (int)score.leaks,
                            (int)score.wrong_face, (int)score.rays);
                lab_print_failures(&run, &score);
                wrong++;
            }
        }
        close_octree(&f);
    }
    assert_true(tracers > 0);
    assert_int_equal(wrong, 0);
}

static void nothing_escapes_from_a_closed_octree(void **unused) {
    (void)unused;
    fixture f;
    open_octree(&f, LAB_GYROID, 0.5);
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if (!takes_rays(*tracer, &f.scene)) continue;
        for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
            lab_escapes escapes;
            df_error err;
            const lab_run run = {.tracer = *tracer,
                                 .scene = &f.scene,
                                 .solve = solve,
                                 .family = LAB_INSIDE,
                                 .seed = LAB_SEED + 3,
                                 .count = 40 * ray_count};
            if (lab_count_escapes(&run, &escapes, &err)) fail_msg("%s", err.text);
            if (escapes.count)
                fail_msg("%s, %s: %d rays escape, the first without a hit is %d", (*tracer)->name,
                         df_solve_names[solve], (int)escapes.count, (int)escapes.kept[0].ray);
        }
    }
    close_octree(&f);
}

int main(int argc, char **argv) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(leaves_that_do_not_fit_lose_no_hit),
        cmocka_unit_test(nothing_escapes_from_a_closed_octree),
    };
    if (argc > 1) ray_count = strtoull(argv[1], NULL, 10);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
