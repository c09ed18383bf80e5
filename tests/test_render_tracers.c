/* Every tracer with every instruction set draws the picture of the scalar 3DDDA, bit for bit. With --full: every
 * structure, sample type, solve, precision and gradient with every other, which takes minutes; otherwise every pair. */
#include "fields.h"
#include "render/frame.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static bool all_combinations;
static const char *const isas[] = {"scalar", "sse4.1", "avx2", "avx512"};

/* Two tori, one lying and one standing, with a dent: fronts, backs and silhouettes in many bricks. */
static double rings(const double p[3], const void *context) {
    const double n = *(const double *)context, x = p[0] - n / 2, y = p[1] - n / 2, z = p[2] - n / 2;
    double a = sqrt(x * x + z * z) - 0.33 * n, b = sqrt(y * y + (z - 0.1 * n) * (z - 0.1 * n)) - 0.25 * n;
    double d = fmin(sqrt(a * a + y * y) - 0.11 * n, sqrt(b * b + x * x) - 0.08 * n);
    return fmax(d, 0.15 * n - sqrt((x - 0.3 * n) * (x - 0.3 * n) + y * y + z * z));
}

/* The box of half the side: faces, edges and corners on grid planes. */
static double cube(const double p[3], const void *context) {
    const double n = *(const double *)context;
    double d = -1e9;
    for (int a = 0; a < 3; a++) d = fmax(d, fabs(p[a] - n / 2) - n / 4);
    return d;
}

typedef struct picture {
    uint32_t width, height;
    uint8_t *rgb;
    float *depth, *normals;
} picture;

static picture new_picture(uint32_t width, uint32_t height) {
    size_t n = (size_t)width * height;
    return (picture){width, height, malloc(3 * n), malloc(n * sizeof(float)), malloc(3 * n * sizeof(float))};
}

static void free_picture(picture *p) {
    free(p->rgb);
    free(p->depth);
    free(p->normals);
}

static void draw(const df_scene *scene, const df_view *view, const df_frame_options *options, picture *p) {
    df_renderer *renderer;
    df_error err;
    if (df_renderer_open(scene, options, p->width, p->height, &renderer, &err)) fail_msg("%s", err.text);
    const df_picture out = {
        .width = p->width, .height = p->height, .rgb = p->rgb, .depth = p->depth, .normals = p->normals};
    if (df_renderer_frame(renderer, view, &out, NULL, &err)) fail_msg("%s", err.text);
    df_renderer_close(renderer);
}

static void compare(const picture *reference, const picture *other, const df_frame_options *options, const char *name) {
    for (uint32_t i = 0; i < reference->width * reference->height; i++) {
        if (memcmp(&reference->depth[i], &other->depth[i], 4) ||
            memcmp(reference->normals + 3 * i, other->normals + 3 * i, 12) ||
            memcmp(reference->rgb + 3 * i, other->rgb + 3 * i, 3)) {
            fail_msg("%s: %s, %s, bounds %s, pixel %u,%u: depth %.9g instead of %.9g", name, options->tracer->name,
                     options->kernels->isa, df_bounds_names[options->walk.bounds], i % reference->width,
                     i / reference->width, (double)other->depth[i], (double)reference->depth[i]);
        }
    }
}

/* Draws a view with everything that can and compares with the scalar 3DDDA. Returns the number of pixels that hit. */
static uint32_t compare_methods(const df_scene *scene, const df_camera *camera, uint32_t width, uint32_t height,
                                uint32_t tile, int solve, int precision, int gradient, const char *name) {
    df_view view;
    df_error err;
    uint32_t hits = 0;
    picture reference = new_picture(width, height), other = new_picture(width, height);
    if (df_view_make(camera, scene->field, width, height, &view, &err)) fail_msg("%s", err.text);
    const df_frame_options plain = {
        .tracer = scene->levels ? &df_tracer_dda : &df_tracer_adf,
        .solve = solve,
        .precision = precision,
        .gradient = gradient,
        .tile = 64,
        .threads = 1,
    };
    draw(scene, &view, &plain, &reference);
    for (uint32_t i = 0; i < width * height; i++) hits += isfinite(reference.depth[i]);
    for (const df_tracer *const *tracer = df_tracers; *tracer; tracer++) {
        if ((*tracer)->suits && !(*tracer)->suits(scene, &view)) continue;
        for (int isa = 0; isa < 4; isa++) {
            df_frame_options options = plain;
            options.tracer = *tracer;
            options.tile = tile;
            options.threads = 2;
            if (df_kernels_select(isas[isa], &options.kernels, &err) != DF_OK) continue;
            draw(scene, &view, &options, &other);
            compare(&reference, &other, &options, name);
            if (!(*tracer)->takes_bounds) continue;
            options.walk.split = *tracer == &df_tracer_packet ? (uint32_t)isa + 1 : 0;
            options.walk.bounds = isa % 2 ? DF_BOUNDS_VOXELS : DF_BOUNDS_BRICKS;
            draw(scene, &view, &options, &other);
            compare(&reference, &other, &options, name);
        }
    }
    free_picture(&reference);
    free_picture(&other);
    return hits;
}

static uint32_t compare_all(const df_scene *scene, const df_camera *camera, uint32_t width, uint32_t height,
                            uint32_t tile, int solve, int gradient, const char *name) {
    return compare_methods(scene, camera, width, height, tile, solve, DF_PRECISION_F64, gradient, name);
}

/* k of a dense field: 1 for the uniform walk. */
static void open_scene(df_field *field, df_scene *scene, df_field_kind kind, uint32_t k, double n,
                       test_function function) {
    const uint32_t count[3] = {(uint32_t)n, (uint32_t)n, (uint32_t)n};
    const df_scene_options options = {.levels = kind == DF_FIELD_DENSE && k == 1};
    df_error err;
    memset(field, 0, sizeof *field);
    if (test_field_from_function(field, kind, k, count, function, &n, &err)) fail_msg("%s", err.text);
    if (df_scene_prepare(field, 0, &options, scene, &err)) fail_msg("%s", err.text);
}

static void close_scene(df_field *field, df_scene *scene) {
    df_scene_free(scene);
    df_field_free(field);
}

static void tracers_agree_on_pictures(void **unused) {
    (void)unused;
    static const struct {
        df_field_kind kind;
        uint32_t k;
    } kinds[] = {
        {DF_FIELD_BRICKS, 8}, {DF_FIELD_BRICKS, 4}, {DF_FIELD_DENSE, 8}, {DF_FIELD_DENSE, 1}, {DF_FIELD_ADF, 0}};
    for (int i = 0; i < 5; i++) {
        df_field field;
        df_scene scene;
        df_camera camera;
        open_scene(&field, &scene, kinds[i].kind, kinds[i].k, 50 + i, rings);
        for (int view = 0; view < 6; view++) {
            char name[64];
            snprintf(name, sizeof name, "kind %d view %d", i, view);
            df_camera_orbit(&field, 67.0 * view, 29.0 * view - 70, 0.7 + 0.3 * view, &camera);
            camera.fov_y = 1;
            assert_true(compare_all(&scene, &camera, 203, 151, 64, DF_SOLVE_ROBUST, DF_GRADIENT_CORNER_CENTRAL, name) >
                        1000);
        }
        close_scene(&field, &scene);
    }
}

static void tracers_agree_for_every_solve_and_gradient(void **unused) {
    (void)unused;
    df_field field;
    df_scene scene;
    df_camera camera;
    open_scene(&field, &scene, DF_FIELD_BRICKS, 8, 40, rings);
    df_camera_orbit(&field, 30, 40, 1.3, &camera);
    camera.fov_y = 1;
    for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
        compare_all(&scene, &camera, 97, 83, 32, solve, solve % DF_GRADIENT_COUNT, df_solve_names[solve]);
    }
    for (int gradient = 0; gradient < DF_GRADIENT_COUNT; gradient++) {
        compare_all(&scene, &camera, 90, 70, 16, DF_SOLVE_LINEAR, gradient, df_gradient_names[gradient]);
    }
    close_scene(&field, &scene);
    open_scene(&field, &scene, DF_FIELD_ADF, 0, 32, rings);
    for (int gradient = 0; gradient < DF_GRADIENT_COUNT; gradient++) {
        compare_all(&scene, &camera, 90, 70, 16, DF_SOLVE_ROBUST, gradient, df_gradient_names[gradient]);
    }
    close_scene(&field, &scene);
}

/* What a picture combines: the number of a structure, a sample type, a solve, a precision and a gradient. */
enum { BY_STRUCTURE, BY_TYPE, BY_SOLVE, BY_PRECISION, BY_GRADIENT, CHOICE_COUNT };
static const struct {
    df_field_kind kind;
    uint32_t k;
    df_scene_options scene;
} structures[] = {{DF_FIELD_DENSE, 0, {1, 0}},  {DF_FIELD_DENSE, 0, {2, 4}},  {DF_FIELD_DENSE, 0, {2, 8}},
                  {DF_FIELD_BRICKS, 4, {0, 0}}, {DF_FIELD_BRICKS, 8, {0, 0}}, {DF_FIELD_ADF, 0, {0, 0}}};
enum { STRUCTURE_COUNT = sizeof structures / sizeof structures[0], TYPE_COUNT = 3, PRECISION_COUNT = 2 };
static const int choice_counts[CHOICE_COUNT] = {STRUCTURE_COUNT, TYPE_COUNT, DF_SOLVE_COUNT, PRECISION_COUNT,
                                                DF_GRADIENT_COUNT};
static bool pairs_seen[CHOICE_COUNT][CHOICE_COUNT][8][8];

/* The closed form is in double only. */
static bool makes_sense(int kind_a, int a, int kind_b, int b) {
    return !(kind_a == BY_SOLVE && a == DF_SOLVE_ANALYTIC && kind_b == BY_PRECISION && b == DF_PRECISION_F32) &&
           !(kind_b == BY_SOLVE && b == DF_SOLVE_ANALYTIC && kind_a == BY_PRECISION && a == DF_PRECISION_F32);
}

/* Marks the pairs of a combination. Returns how many are new. */
static int see_pairs(const int choice[CHOICE_COUNT]) {
    int fresh = 0;
    for (int a = 0; a < CHOICE_COUNT; a++) {
        for (int b = 0; b < CHOICE_COUNT; b++) {
            fresh += !pairs_seen[a][b][choice[a]][choice[b]];
            pairs_seen[a][b][choice[a]][choice[b]] = true;
        }
    }
    return fresh;
}

/* One field, all the combinations that are wanted of it: those that bring a new pair, or all. */
static void compare_combinations(int structure, int type) {
    const double n = 32;
    const uint32_t count[3] = {32, 32, 32};
    df_field field = {0};
    df_scene scene;
    df_camera camera;
    df_error err;
    if (test_field_from_function(&field, structures[structure].kind, structures[structure].k, count, rings, &n, &err) ||
        (type > 0 && test_field_quantise(&field, DF_SAMPLE_F32 + (df_sample_type)type, &err)) ||
        df_scene_prepare(&field, 0, &structures[structure].scene, &scene, &err))
        fail_msg("%s", err.text);
    df_camera_orbit(&field, 40.0 * structure, 15.0 * type + 10, 1.2, &camera);
    camera.fov_y = 1;
    for (int i = 0; i < DF_SOLVE_COUNT * PRECISION_COUNT * DF_GRADIENT_COUNT; i++) {
        const int solve = i % DF_SOLVE_COUNT, precision = i / DF_SOLVE_COUNT % PRECISION_COUNT,
                  gradient = i / DF_SOLVE_COUNT / PRECISION_COUNT;
        const int choice[CHOICE_COUNT] = {structure, type, solve, precision, gradient};
        if (!makes_sense(BY_SOLVE, solve, BY_PRECISION, precision)) continue;
        if (see_pairs(choice) == 0 && !all_combinations) continue;
        char name[128];
        snprintf(name, sizeof name, "structure %d, sample type %d, %s, precision %d, gradient %s", structure, type,
                 df_solve_names[solve], precision, df_gradient_names[gradient]);
        assert_true(compare_methods(&scene, &camera, 93, 71, 32, solve, precision, gradient, name) > 500);
    }
    close_scene(&field, &scene);
}

static void tracers_agree_for_every_pair_of_choices(void **unused) {
    (void)unused;
    for (int structure = 0; structure < STRUCTURE_COUNT; structure++) {
        for (int type = 0; type < TYPE_COUNT; type++) compare_combinations(structure, type);
    }
    for (int a = 0; a < CHOICE_COUNT; a++) {
        for (int b = 0; b < CHOICE_COUNT; b++) {
            for (int i = 0; i < choice_counts[a] * choice_counts[b] && a != b; i++) {
                const int of_a = i % choice_counts[a], of_b = i / choice_counts[a];
                if (makes_sense(a, of_a, b, of_b) && !pairs_seen[a][b][of_a][of_b])
                    fail_msg("kind %d choice %d was never seen with kind %d choice %d", a, of_a, b, of_b);
            }
        }
    }
}

/* Each with the closed form left out, which is in double only. */
static void tracers_agree_in_single_precision(void **unused) {
    (void)unused;
    static const df_field_kind kinds[] = {DF_FIELD_BRICKS, DF_FIELD_DENSE, DF_FIELD_ADF};
    for (int i = 0; i < 3; i++) {
        df_field field;
        df_scene scene;
        df_camera camera;
        open_scene(&field, &scene, kinds[i], kinds[i] == DF_FIELD_DENSE ? 1 : 8, 40, rings);
        for (int solve = 0; solve < DF_SOLVE_COUNT; solve++) {
            if (solve == DF_SOLVE_ANALYTIC) continue;
            df_camera_orbit(&field, 30 + 50 * solve, 20 * solve - 40, solve == DF_SOLVE_ROBUST ? 0.3 : 1.3, &camera);
            camera.fov_y = 1;
            assert_true(compare_methods(&scene, &camera, 97, 83, 32, solve, DF_PRECISION_F32,
                                        DF_GRADIENT_CORNER_CENTRAL, df_solve_names[solve]) > 500);
        }
        close_scene(&field, &scene);
    }
}

/* Symmetric views of a box on grid planes: rays through edges and corners of voxels, ties everywhere. */
static void tracers_agree_where_rays_run_along_the_grid(void **unused) {
    (void)unused;
    df_field field;
    df_scene scene;
    df_camera camera;
    open_scene(&field, &scene, DF_FIELD_BRICKS, 8, 48, cube);
    static const double eyes[][3] = {{24, 24, 100}, {24, 24, -60}, {100, 24, 24}, {84, 24, 84},
                                     {84, 84, 84},  {-40, 24, 88}, {24, 90, 24.5}};
    for (int i = 0; i < 7; i++) {
        char name[32];
        snprintf(name, sizeof name, "eye %d", i);
        memset(&camera, 0, sizeof camera);
        for (int a = 0; a < 3; a++) {
            camera.eye[a] = eyes[i][a];
            camera.look_at[a] = 24;
        }
        camera.up[i == 6 ? 2 : 1] = 1;
        camera.fov_y = 0.7;
        assert_true(compare_all(&scene, &camera, 129, 129, 64, DF_SOLVE_ROBUST, DF_GRADIENT_ANALYTIC, name) > 500);
        assert_true(compare_all(&scene, &camera, 128, 128, 64, DF_SOLVE_ROBUST, DF_GRADIENT_ANALYTIC, name) > 500);
    }
    close_scene(&field, &scene);
}

static void tracers_agree_from_inside_and_afar(void **unused) {
    (void)unused;
    df_field field;
    df_scene scene;
    open_scene(&field, &scene, DF_FIELD_BRICKS, 8, 48, rings);
    static const double eyes[][3] = {{24, 24, 24}, {40.3, 24.2, 24.1}, {24, 33, 28}, {0, 0, 0},
                                     {47, 25, 3},  {1e6, 3e5, -2e5},   {48, 24, 24}, {39.5, 24, 24}};
    for (int i = 0; i < 8; i++) {
        char name[32];
        snprintf(name, sizeof name, "eye %d", i);
        df_camera camera = {.up = {0, 1, 0}, .look_at = {23, 22, 19}, .fov_y = i == 5 ? 5e-5 : 1.7};
        memcpy(camera.eye, eyes[i], sizeof camera.eye);
        compare_all(&scene, &camera, 110, 75, 32, DF_SOLVE_ROBUST, DF_GRADIENT_CORNER_CENTRAL, name);
    }
    close_scene(&field, &scene);
}

static void tracers_agree_at_every_size_of_picture_and_tile(void **unused) {
    (void)unused;
    df_field field;
    df_scene scene;
    df_camera camera;
    open_scene(&field, &scene, DF_FIELD_BRICKS, 4, 20, rings);
    df_camera_orbit(&field, -50, 20, 1, &camera);
    camera.fov_y = 1;
    static const uint32_t sizes[][3] = {{1, 1, 64},  {1, 40, 8},   {37, 1, 5},      {33, 65, 32},
                                        {17, 16, 1}, {64, 64, 64}, {100, 100, 500}, {63, 31, 7}};
    for (int i = 0; i < 8; i++) {
        compare_all(&scene, &camera, sizes[i][0], sizes[i][1], sizes[i][2], DF_SOLVE_ROBUST, DF_GRADIENT_CORNER_CENTRAL,
                    "size");
    }
    close_scene(&field, &scene);
}

static void cgt_agrees_for_every_packet_with_and_without_clipping(void **unused) {
    (void)unused;
    enum { W = 90, H = 61 };
    df_field field;
    df_scene scene;
    df_camera camera;
    df_view view;
    df_error err;
    picture reference = new_picture(W, H), other = new_picture(W, H);
    open_scene(&field, &scene, DF_FIELD_BRICKS, 4, 30, rings);
    df_camera_orbit(&field, 12, 50, 0.9, &camera);
    camera.fov_y = 1.4;
    if (df_view_make(&camera, &field, W, H, &view, &err)) fail_msg("%s", err.text);
    const df_frame_options plain = {
        .tracer = &df_tracer_dda, .solve = DF_SOLVE_ROBUST, .gradient = DF_GRADIENT_CENTRAL, .tile = 64, .threads = 1};
    draw(&scene, &view, &plain, &reference);
    for (uint32_t packet = 1; packet <= DF_CGT_PACKET_MAX; packet *= 2) {
        for (int clip = 0; clip < 2; clip++) {
            df_frame_options options = {.tracer = &df_tracer_cgt,
                                        .solve = DF_SOLVE_ROBUST,
                                        .gradient = DF_GRADIENT_CENTRAL,
                                        .tile = 48,
                                        .threads = 2,
                                        .walk = {.packet = packet, .no_clip = !clip}};
            if (df_kernels_select("auto", &options.kernels, &err)) fail_msg("%s", err.text);
            draw(&scene, &view, &options, &other);
            assert_memory_equal(reference.depth, other.depth, W * H * sizeof(float));
            assert_memory_equal(reference.rgb, other.rgb, 3 * W * H);
        }
    }
    free_picture(&reference);
    free_picture(&other);
    close_scene(&field, &scene);
}

/* Cells that are not divided because they look small: packets and single rays agree on them, and what they show is off
 * by no more than a few times what is left out. */
static void levels_of_detail_agree_and_stay_near(void **unused) {
    (void)unused;
    enum { W = 111, H = 77 };
    static const double distances[] = {0.8, 4, 50};
    df_field field;
    df_scene scene;
    df_error err;
    picture full = new_picture(W, H), reference = new_picture(W, H), other = new_picture(W, H);
    open_scene(&field, &scene, DF_FIELD_ADF, 0, 64, rings);
    for (int d = 0; d < 3; d++) {
        df_camera camera;
        df_view view;
        df_camera_orbit(&field, 12, 30, distances[d], &camera);
        camera.fov_y = 1.6 / distances[d];
        if (df_view_make(&camera, &field, W, H, &view, &err)) fail_msg("%s", err.text);
        df_frame_options options = {.tracer = &df_tracer_adf,
                                    .solve = DF_SOLVE_ROBUST,
                                    .gradient = DF_GRADIENT_CORNER_CENTRAL,
                                    .tile = 32,
                                    .threads = 2};
        draw(&scene, &view, &options, &full);
        for (double lod = 0.5; lod < 10; lod *= 4) {
            uint32_t lost = 0, hits = 0, off = 0;
            options.walk.lod = lod;
            options.tracer = &df_tracer_adf;
            options.kernels = NULL;
            draw(&scene, &view, &options, &reference);
            options.tracer = &df_tracer_adf_packet;
            for (int isa = 0; isa < 4; isa++) {
                if (df_kernels_select(isas[isa], &options.kernels, &err) != DF_OK) continue;
                draw(&scene, &view, &options, &other);
                compare(&reference, &other, &options, "levels of detail");
            }
            const double pixel = distances[d] * 64 * 2 * tan(camera.fov_y / 2) / H;
            for (uint32_t i = 0; i < W * H; i++) {
                const bool hit = isfinite(full.depth[i]), seen = isfinite(reference.depth[i]);
                hits += hit;
                lost += hit != seen;
                off += hit && seen && fabs((double)full.depth[i] - (double)reference.depth[i]) > 4 * lod * pixel + 0.2;
            }
            if (lod < 4 && (lost > hits / 20 || off > hits / 50))
                fail_msg("distance %g, lod %g: of %u hits %u lost or won, %u off", distances[d], lod, hits, lost, off);
        }
    }
    free_picture(&full);
    free_picture(&reference);
    free_picture(&other);
    close_scene(&field, &scene);
}

static void fields_without_a_surface_or_with_one_voxel_draw(void **unused) {
    (void)unused;
    static const double sizes[] = {1, 2, 3, 9};
    for (int i = 0; i < 4; i++) {
        df_field field;
        df_scene scene;
        df_camera camera;
        open_scene(&field, &scene, DF_FIELD_BRICKS, 8, sizes[i], cube);
        df_camera_orbit(&field, 30, 30, 1.5, &camera);
        camera.fov_y = 1;
        compare_all(&scene, &camera, 40, 40, 16, DF_SOLVE_ROBUST, DF_GRADIENT_CORNER_CENTRAL, "small");
        close_scene(&field, &scene);
    }
}

int main(int argc, char **argv) {
    all_combinations = argc > 1 && strcmp(argv[1], "--full") == 0;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tracers_agree_on_pictures),
        cmocka_unit_test(tracers_agree_for_every_solve_and_gradient),
        cmocka_unit_test(tracers_agree_for_every_pair_of_choices),
        cmocka_unit_test(tracers_agree_in_single_precision),
        cmocka_unit_test(tracers_agree_where_rays_run_along_the_grid),
        cmocka_unit_test(tracers_agree_from_inside_and_afar),
        cmocka_unit_test(tracers_agree_at_every_size_of_picture_and_tile),
        cmocka_unit_test(cgt_agrees_for_every_packet_with_and_without_clipping),
        cmocka_unit_test(levels_of_detail_agree_and_stay_near),
        cmocka_unit_test(fields_without_a_surface_or_with_one_voxel_draw),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
