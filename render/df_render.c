/* df-render: pictures of .dfield files. */
#include "common/field_file.h"
#include "common/image.h"
#include "common/interrupt.h"
#include "common/memory.h"
#include "common/options.h"
#include "common/output_file.h"
#include "common/progress.h"
#include "common/version.h"
#include "render/bench.h"
#include "render/heat.h"
#include "render/mesh/export.h"
#include "render/quality.h"

#include <argp.h>
#include <inttypes.h>
#include <omp.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Texts in the PNG. */
#define TEXT_COMMAND "distfield command"
#define TEXT_FIELD "distfield field"
#define TEXT_CHECKSUM "distfield checksum"
#define TEXT_SETTINGS "distfield settings"
#define TEXT_HEAT "distfield heat" /* instead of settings: it is not what a picture shows */

typedef struct options {
    df_settings settings;
    bool settings_given; /* any option that belongs to the picture */
    const char *field_path, *output_path, *depth_path, *normals_path, *from_path;
    const char *isa;
    const df_kernels *kernels;
    const char *mesh_path;
    uint32_t mesh_method; /* df_mc_method */
    bool mesh_method_given;
    uint32_t threads, tile; /* tile 0: not given */
    uint32_t heat;          /* DF_HEAT_... */
    df_devices_options devices;
    bool list_devices;
    uint32_t bench_frames, bench_repeats; /* frames 0: no bench */
    bool stats, json, map, quiet, verbose;
    const char *command;
} options;

enum { KEY_SETTING = 0x1000 }; /* options of df_settings_set get keys from here on */
enum {
    KEY_MAP = 0x2000,
    KEY_FROM,
    KEY_DEPTH,
    KEY_NORMALS,
    KEY_STATS,
    KEY_JSON,
    KEY_TILE,
    KEY_DEVICE,
    KEY_LIST_DEVICES,
    KEY_SHARE,
    KEY_WORK_GROUP,
    KEY_GRADIENT_IMAGE,
    KEY_THREADS,
    KEY_ISA,
    KEY_BENCH,
    KEY_REPEATS,
    KEY_MESH,
    KEY_HEAT,
    KEY_MESH_TOPOLOGY
};

static const struct argp_option option_table[] = {
    {0, 0, 0, 0, "Camera (world units)", 1},
    {"orbit", KEY_SETTING, "AZ,EL,DIST", 0,
     "Eye on a sphere about the field's centre: azimuth and elevation in degrees, distance in multiples of the longest "
     "side "
     "(default 30,20,1.6); +y is up",
     0},
    {"eye", KEY_SETTING + 1, "X,Y,Z", 0, "Position of the eye", 0},
    {"look-at", KEY_SETTING + 2, "X,Y,Z", 0, "Point in the middle of the picture (default: the field's centre)", 0},
    {"up", KEY_SETTING + 3, "X,Y,Z", 0, "Direction that is up in the picture (default 0,1,0)", 0},
    {"fov", KEY_SETTING + 4, "DEGREES", 0, "Vertical field of view (default 57.3, 1 radian)", 0},
    {0, 0, 0, 0, "Picture", 2},
    {"output", 'o', "FILE", 0, "The picture, a PNG (default: the field's name with .png, here)", 0},
    {"size", KEY_SETTING + 5, "WxH", 0, "Pixels (default 1280x1024)", 0},
    {"depth", KEY_DEPTH, "FILE", 0,
     "Also write distances from the eye, world units, infinite where nothing is hit: .exr or .pfm", 0},
    {"normals", KEY_NORMALS, "FILE", 0, "Also write unit normals in world space, 0 where nothing is hit: .exr or .pfm",
     0},
    {"from", KEY_FROM, "PICTURE", 0,
     "Render a picture of df-render again, from the settings inside it, and say whether it is equal (exit 1 if not). "
     "The field "
     "is the one named inside unless FIELD is given; with -o the new picture is written as well",
     0},
    {"heat", KEY_HEAT, "steps|time", 0,
     "The picture shows what each pixel cost instead: cells visited, or time; black is nothing, white the most. "
     "Tracers that walk packets are measured by squares of 8 pixels, or of --tile",
     0},
    {"export-mesh", KEY_MESH, "FILE", 0,
     "Write the surface as triangles, by marching cubes, with normals by --gradient: .ply (binary), .obj or .stl. No "
     "picture is made then unless -o asks for one",
     0},
    {"mesh-topology", KEY_MESH_TOPOLOGY, "NAME", 0,
     "correct: that of the trilinear surface (default); classic: by the signs of the corners alone", 0},
    {0, 0, 0, 0, "Method", 3},
    {"iso", KEY_SETTING + 6, "VALUE", 0, "The surface is where the field has this value, world units (default 0)", 0},
    {"tracer", KEY_SETTING + 7, "NAME", 0,
     "How the first hits are found: splat (surface voxels or leaves are projected to pixels), dda-packet (3DDDA over "
     "SIMD "
     "lanes), cgt (coherent grid traversal), dda (scalar 3DDDA, the reference), adf (the leaves of an octree), "
     "adf-packet (the same, SIMD packets), "
     "mc-embree and mc-raster (the marching-cubes mesh by Embree and by OpenGL, where built in: see --version); "
     "default "
     "auto: the fastest that suits the field and the view; a single picture too small to repay what splat prepares "
     "goes "
     "by packets (--verbose tells). OpenCL devices have dda and adf (auto), and cgt, whose "
     "packets are "
     "their work groups",
     0},
    {"intersect", KEY_SETTING + 8, "NAME", 0,
     "How a ray is solved in a voxel: midpoint, linear, repeated, marmitt, analytic, robust (default robust)", 0},
    {"steps", KEY_SETTING + 9, "N", 0, "Iterations of the solve (default: repeated and marmitt 3, robust at most 16)",
     0},
    {"precision", KEY_SETTING + 20, "f64|f32", 0,
     "Numbers that a voxel is solved in: f64 (default), or f32, which hits the same voxels and leaves depths as exact "
     "as the float walk, about 1e-5 voxel; not with analytic, and the CPU's only",
     0},
    {"gradient", KEY_SETTING + 10, "NAME", 0,
     "Where normals come from: analytic, central, forward, backward, corner-central, corner-forward, c0 (analytic in "
     "the 8 nearest voxels, blended), crease (corner-central, or analytic at edges, which its length betrays) (default "
     "corner-central)",
     0},
    {"quality", KEY_SETTING + 13, "NAME", 0,
     "full: as the options above say (default); auto: as many steps and such a precision and gradient as can be seen, "
     "by the field's own error and the size of a pixel on it; --verbose tells what and why",
     0},
    {"levels", KEY_SETTING + 11, "1|2", 0, "Walk a dense field uniformly or on two levels (default 2)", 0},
    {"coarse", KEY_SETTING + 12, "4|8", 0, "Voxels along a coarse cell of a dense field (default 8)", 0},
    {"packet", KEY_SETTING + 14, "N", 0,
     "Edge of a packet of cgt in rays: 1, 2, 4, 8, 16 or 32 (default 8); on OpenCL devices also of its work group", 0},
    {"clip", KEY_SETTING + 15, "on|off", 0,
     "Whether cgt clips the voxels of a block to the packet's bounds (default on)", 0},
    {"lod", KEY_SETTING + 19, "PIXELS", 0,
     "Octrees: a cell smaller than PIXELS of the picture is not looked into (default 0: all are)", 0},
    {"split", KEY_SETTING + 18, "N", 0,
     "Rays of a packet of dda-packet walk on alone once at most N are left (default 0: never)", 0},
    {"filter", KEY_SETTING + 17, "NAME", 0,
     "How the field is reconstructed between samples: trilinear (default), catmull-rom or b-spline (cubic, for dense "
     "fields, slow: references of quality)",
     0},
    {"bounds", KEY_SETTING + 16, "NAME", 0,
     "Narrow every ray beforehand to where surface is projected to its pixel: none (default), bricks (the surface's "
     "part of each brick), voxels (each surface voxel), gl (as bricks, drawn by OpenGL); for dda, dda-packet and cgt",
     0},
    {0, 0, 0, 0, "Running", 4},
    {"threads", KEY_THREADS, "N", 0, "Threads (default: all cores)", 0},
    {"device", KEY_DEVICE, "NAME", 0,
     "What renders: cpu (default), opencl (its first GPU, else its first device), opencl:N, both (cpu,opencl), several "
     "with commas, each a part of the "
     "picture, or auto: a GPU where there is one, else the CPU. The picture is the same",
     0},
    {"share", KEY_SHARE, "rows|frames", 0,
     "What several devices share: the rows of each picture (default), or the frames of the bench, each made by one "
     "device, the next that is free",
     0},
    {"list-devices", KEY_LIST_DEVICES, 0, 0, "Print the devices that --device can name", 0},
    {"gradient-image", KEY_GRADIENT_IMAGE, 0, 0,
     "OpenCL devices read samples for gradients from a 3D image (dense fields)", 0},
    {"work-group", KEY_WORK_GROUP, "WxH", 0, "Pixels of an OpenCL work group (default 8x8, or --packet)", 0},
    {"isa", KEY_ISA, "NAME", 0,
     "Instruction set: scalar, sse4.1, avx2, avx512 (default auto: the widest that the processor has)", 0},
    {"tile", KEY_TILE, "N", 0, "Edge of the square tiles that threads work on, pixels (default 64)", 0},
    {"map", KEY_MAP, 0, 0,
     "Use the field's samples in place in the mapped file; packed ones (u16 and u8 bricks) are unpacked into memory",
     0},
    {"stats", KEY_STATS, 0, 0, "Print what ran, the counts of rays and steps, and times", 0},
    {"json", KEY_JSON, 0, 0, "The same as one JSON object", 0},
    {"bench", KEY_BENCH, "FRAMES", OPTION_ARG_OPTIONAL,
     "Render FRAMES pictures (36) turning around the field, elevation 0 unless --orbit says otherwise, and print one "
     "line of CSV "
     "with times; writes no picture",
     0},
    {"repeats", KEY_REPEATS, "N", 0, "Repeats of the bench (default 5)", 0},
    {"quiet", 'q', 0, 0, "No progress", 0},
    {"verbose", 'v', 0, 0, "Say what is done", 0},
    {0},
};

static void check(struct argp_state *state, df_status status, const df_error *err) {
    if (status != DF_OK) argp_error(state, "%s", err->text);
}

static bool wants_picture(const options *opts) {
    return opts->output_path || opts->depth_path || opts->normals_path || opts->from_path;
}

static error_t on_option(int key, char *argument, struct argp_state *state) {
    options *opts = state->input;
    df_error err;
    if (key >= KEY_SETTING && key < KEY_MAP) {
        for (const struct argp_option *option = option_table;; option++) {
            bool known;
            if (option->key != key) continue;
            check(state, df_settings_set(&opts->settings, option->name, argument, &known, &err), &err);
            opts->settings_given = true;
            return 0;
        }
    }
    switch (key) {
    case 'o': opts->output_path = argument; return 0;
    case 'q': opts->quiet = true; return 0;
    case KEY_MESH: opts->mesh_path = argument; return 0;
    case KEY_MESH_TOPOLOGY:
        opts->mesh_method_given = true;
        check(state, df_parse_name("--mesh-topology", argument, df_mc_method_names, &opts->mesh_method, &err), &err);
        return 0;
    case KEY_HEAT: check(state, df_parse_name("--heat", argument, df_heat_names, &opts->heat, &err), &err); return 0;
    case 'v': opts->verbose = true; return 0;
    case KEY_MAP: opts->map = true; return 0;
    case KEY_STATS: opts->stats = true; return 0;
    case KEY_JSON: opts->json = true; return 0;
    case KEY_FROM: opts->from_path = argument; return 0;
    case KEY_DEPTH: opts->depth_path = argument; return 0;
    case KEY_NORMALS: opts->normals_path = argument; return 0;
    case KEY_DEVICE: check(state, df_devices_parse(argument, &opts->devices.choice, &err), &err); return 0;
    case KEY_SHARE: {
        static const char *const choices[] = {"rows", "frames", NULL};
        uint32_t choice = 0;
        check(state, df_parse_name("--share", argument, choices, &choice, &err), &err);
        opts->devices.deal_frames = choice == 1;
        return 0;
    }
    case KEY_LIST_DEVICES: opts->list_devices = true; return 0;
    case KEY_GRADIENT_IMAGE: opts->devices.images = true; return 0;
    case KEY_WORK_GROUP:
        check(state, df_parse_size("--work-group", argument, &opts->devices.group[0], &opts->devices.group[1], &err),
              &err);
        return 0;
    case KEY_TILE: check(state, df_parse_u32("--tile", argument, 1, 4096, &opts->tile, &err), &err); return 0;
    case KEY_THREADS: check(state, df_parse_u32("--threads", argument, 1, 1024, &opts->threads, &err), &err); return 0;
    case KEY_REPEATS:
        check(state, df_parse_u32("--repeats", argument, 1, 10000, &opts->bench_repeats, &err), &err);
        return 0;
    case KEY_BENCH:
        check(state, df_parse_u32("--bench", argument ? argument : "36", 1, 3600, &opts->bench_frames, &err), &err);
        return 0;
    case KEY_ISA: opts->isa = argument; return 0;
    case ARGP_KEY_ARG:
        if (opts->field_path) argp_error(state, "one field at a time: '%s' is too much", argument);
        opts->field_path = argument;
        return 0;
    case ARGP_KEY_END:
        if (!opts->field_path && !opts->from_path && !opts->list_devices) argp_usage(state);
        if (opts->from_path && opts->settings_given) {
            argp_error(
                state,
                "--from takes camera, size and methods from the picture: it cannot go with options that set them");
        }
        if (opts->bench_frames && (opts->from_path || opts->output_path || opts->depth_path || opts->normals_path)) {
            argp_error(state, "--bench writes no picture: it cannot go with --from, --output, --depth or --normals");
        }
        if (opts->heat && (opts->bench_frames || opts->from_path || opts->devices.choice.automatic ||
                           opts->devices.choice.count != 1 || opts->devices.choice.numbers[0] != DF_DEVICE_CPU)) {
            argp_error(state, "--heat is a picture of the CPU's work: it cannot go with --bench, --from or --device");
        }
        if (opts->devices.deal_frames && (!opts->bench_frames || opts->devices.choice.count < 2)) {
            argp_error(state, "--share frames deals the frames of --bench to several devices: it needs both");
        }
        if (opts->bench_frames && !opts->settings.has_orbit) opts->settings.orbit[0] = opts->settings.orbit[1] = 0;
        if (opts->from_path && opts->mesh_path) argp_error(state, "--from and --export-mesh contradict each other");
        if (opts->mesh_method_given && !opts->mesh_path)
            argp_error(state, "--mesh-topology is about a mesh that is written: it needs --export-mesh");
        if (opts->mesh_path && !opts->bench_frames && !wants_picture(opts) &&
            (opts->settings.tracer || opts->settings.has_solve || opts->settings.quality_auto)) {
            argp_error(state,
                       "--export-mesh makes no picture: without -o, --depth or --normals it cannot go with --tracer, "
                       "--intersect, --steps, --precision or --quality");
        }
        if (opts->quiet && opts->verbose) argp_error(state, "--quiet and --verbose contradict each other");
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

/* All that one run holds. */
typedef struct session {
    df_field field;
    df_scene scene;
    df_devices *devices;
    df_picture picture;
    df_image_png original; /* --from */
    char *own_path, *settings_text;
    df_camera camera;
    df_view view;
    df_report report;
    char heat_text[80];
} session;

static void session_free(session *s) {
    df_devices_close(s->devices);
    df_scene_free(&s->scene);
    df_field_free(&s->field);
    df_image_png_free(&s->original);
    free(s->picture.rgb);
    free(s->picture.depth);
    free(s->picture.normals);
    free(s->picture.heat);
    free(s->own_path);
    free(s->settings_text);
}

/* Everything that can be refused before the work. */
static df_status check_outputs(options *opts, session *s, df_error *err) {
    const char *float_paths[2] = {opts->depth_path, opts->normals_path};
    df_status status = DF_OK;
    if (opts->mesh_path) status = df_mc_mesh_check_path(opts->mesh_path, err);
    if (status == DF_OK && opts->mesh_path) status = df_output_check(opts->mesh_path, err);
    if (status != DF_OK) return status;
    if (!opts->output_path && !opts->from_path && !opts->bench_frames && !opts->mesh_path) {
        opts->output_path = s->own_path = df_path_with_extension(opts->field_path, ".png", 0);
        if (!s->own_path) return df_fail(err, DF_ERROR_MEMORY, "out of memory");
    }
    if (opts->output_path) status = df_output_check(opts->output_path, err);
    for (int i = 0; i < 2 && status == DF_OK; i++) {
        if (!float_paths[i]) continue;
        if (!df_image_is_float_path(float_paths[i])) {
            return df_fail(err, DF_ERROR_USAGE, "%s: expected a name that ends in .exr or .pfm", float_paths[i]);
        }
        status = df_output_check(float_paths[i], err);
    }
    return status;
}

/* Takes the settings, and unless given the field, from the picture of --from. */
static df_status read_original(options *opts, session *s, df_error *err) {
    df_status status = df_image_read_png(opts->from_path, &s->original, err);
    if (status != DF_OK) return status;
    const char *text = df_image_png_text(&s->original, TEXT_SETTINGS),
               *field = df_image_png_text(&s->original, TEXT_FIELD);
    if (!text || !field || !df_image_png_text(&s->original, TEXT_CHECKSUM)) {
        return df_fail(err, DF_ERROR_INPUT, "%s: not a picture of df-render (it has no settings inside)",
                       opts->from_path);
    }
    if (!opts->field_path) opts->field_path = field;
    return df_settings_parse(&opts->settings, text, opts->from_path, err);
}

static df_status read_field(const options *opts, session *s, df_error *err) {
    double start = df_now_ms();
    df_status status = df_field_read(opts->field_path, opts->map ? DF_READ_MAP : DF_READ_COPY, &s->field, err);
    if (status != DF_OK) return status;
    s->report.load_ms = df_now_ms() - start;
    if (opts->from_path) {
        const char *expected = df_image_png_text(&s->original, TEXT_CHECKSUM);
        char checksum[16];
        snprintf(checksum, sizeof checksum, "%08" PRIx32, s->field.checksum);
        if (strcmp(checksum, expected) != 0) {
            return df_fail(err, DF_ERROR_INPUT, "%s: checksum %s, but %s was made from a field with %s",
                           opts->field_path, checksum, opts->from_path, expected);
        }
    }
    return DF_OK;
}

static df_status alloc_picture(const options *opts, df_picture *picture, df_error *err) {
    uint64_t pixels = (uint64_t)opts->settings.width * opts->settings.height;
    picture->width = opts->settings.width;
    picture->height = opts->settings.height;
    df_status status = df_alloc((void **)&picture->rgb, pixels * 3, 1, "picture", err);
    if (status == DF_OK && opts->depth_path)
        status = df_alloc((void **)&picture->depth, pixels, sizeof(float), "depth", err);
    picture->heat_mode = (int)opts->heat;
    if (status == DF_OK && opts->heat) status = df_alloc((void **)&picture->heat, pixels, sizeof(float), "heat", err);
    if (status == DF_OK && opts->normals_path) {
        status = df_alloc((void **)&picture->normals, pixels * 3, sizeof(float), "normals", err);
    }
    return status;
}

static df_status write_png(const options *opts, const session *s, df_error *err) {
    char checksum[16], *absolute = realpath(opts->field_path, NULL);
    snprintf(checksum, sizeof checksum, "%08" PRIx32, s->field.checksum);
    const df_image_text texts[] = {
        {"Software", "distfield " DF_VERSION},
        {TEXT_COMMAND, opts->command},
        {TEXT_FIELD, absolute ? absolute : opts->field_path},
        {TEXT_CHECKSUM, checksum},
        opts->heat ? (df_image_text){TEXT_HEAT, s->heat_text} : (df_image_text){TEXT_SETTINGS, s->settings_text},
    };
    df_status status = df_image_write_png(opts->output_path, s->picture.rgb, s->picture.width, s->picture.height, texts,
                                          sizeof texts / sizeof texts[0], err);
    free(absolute);
    return status;
}

static df_status write_outputs(const options *opts, session *s, df_error *err) {
    const uint32_t width = s->picture.width, height = s->picture.height;
    df_status status = DF_OK;
    if (opts->output_path) status = write_png(opts, s, err);
    if (status == DF_OK && opts->depth_path) {
        status = df_image_write_float(opts->depth_path, s->picture.depth, width, height, 1, err);
    }
    if (status == DF_OK && opts->normals_path) {
        status = df_image_write_float(opts->normals_path, s->picture.normals, width, height, 3, err);
    }
    return status;
}

/* Says whether the picture equals the one of --from. */
static df_status compare_original(const options *opts, const session *s, df_error *err) {
    const df_image_png *original = &s->original;
    const df_picture *picture = &s->picture;
    if (original->width != picture->width || original->height != picture->height) {
        return df_fail(err, DF_ERROR_INPUT, "%s: %ux%u pixels, but its settings say %ux%u", opts->from_path,
                       original->width, original->height, picture->width, picture->height);
    }
    uint64_t pixels = (uint64_t)picture->width * picture->height, different = 0;
    for (uint64_t i = 0; i < pixels; i++) different += memcmp(original->rgb + 3 * i, picture->rgb + 3 * i, 3) != 0;
    if (different)
        return df_fail(err, DF_ERROR_INPUT, "%s: %" PRIu64 " of %" PRIu64 " pixels differ", opts->from_path, different,
                       pixels);
    printf("%s: equal\n", opts->from_path);
    return DF_OK;
}

static df_status print_report(const options *opts, session *s, df_error *err) {
    if (!opts->stats && !opts->json) return DF_OK;
    df_status status = df_count_entering(&s->view, &s->report.stats.rays_entering, err);
    if (status == DF_OK) status = df_devices_count(s->devices, &s->view, &s->report.stats, err);
    if (status != DF_OK) return status;
    json_t *json = df_report_json(&s->report);
    if (!json) return df_fail(err, DF_ERROR_MEMORY, "out of memory");
    if (opts->json) {
        json_dumpf(json, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(9));
        printf("\n");
    } else {
        df_report_print(json);
    }
    json_decref(json);
    return DF_OK;
}

/* --quality auto: settles the methods, so that the picture carries what was chosen. */
static void choose_quality(options *opts, const session *s) {
    char text[512];
    df_quality quality;
    const df_tracer *tracer = opts->settings.tracer;
    if (tracer && tracer->own_methods) {
        if (opts->verbose)
            fprintf(stderr, "df-render: quality auto: %s draws a mesh: there is nothing to choose\n", tracer->name);
        return;
    }
    const df_device_choice *devices = &opts->devices.choice;
    bool single = !devices->automatic;
    for (uint32_t i = 0; i < devices->count; i++) single = single && devices->numbers[i] == DF_DEVICE_CPU;
    df_quality_choose(&s->field, &s->camera, opts->settings.height, single, &quality);
    opts->settings.solve = quality.solve;
    opts->settings.steps = quality.steps;
    opts->settings.precision = quality.precision;
    opts->settings.gradient = quality.gradient;
    df_quality_explain(&quality, text, sizeof text);
    if (opts->verbose) fprintf(stderr, "df-render: quality auto: %s\n", text);
}

/* The picture of --heat. */
static df_status draw_heat(const options *opts, session *s, df_error *err) {
    float white = 0;
    df_status status = df_heat_measure(s->devices, &s->view, &s->picture, &s->report.stats, err);
    if (status == DF_OK) status = df_heat_colour(&s->picture, &white, err);
    snprintf(s->heat_text, sizeof s->heat_text, "white is %.*f %s a ray", white < 100 ? 1 : 0, (double)white,
             opts->heat == DF_HEAT_TIME ? "ns" : "cells");
    if (status == DF_OK && opts->verbose) fprintf(stderr, "df-render: heat: %s\n", s->heat_text);
    return status;
}

/* --tracer auto. The bench's pictures share what is prepared. */
static const df_tracer *choose_tracer(const options *opts, const session *s) {
    const df_walk_options *walk = &opts->settings.walk;
    if (opts->bench_frames) return df_tracer_choose(&s->scene, &s->view, walk);
    uint64_t repays;
    const df_tracer *tracer = df_tracer_choose_once(&s->scene, &s->view, walk, &repays);
    if (opts->verbose && repays) {
        fprintf(stderr,
                "df-render: tracer auto: %s: one picture of %u x %u pixels %s what splat prepares (%" PRIu64
                " would)\n",
                tracer->name, s->view.width, s->view.height, tracer == &df_tracer_splat ? "repays" : "does not repay",
                repays);
    }
    return tracer;
}

/* A picture without a surface is no error, but hardly what was meant. */
static void note_empty(const df_field *field, double iso) {
    if (df_field_reaches(field, (float)iso)) return;
    fprintf(stderr, "df-render: this field has no surface at iso %g: its values go from %g to %g\n", iso,
            (double)field->value_min, (double)field->value_max);
}

/* What must happen to the field in memory before the first picture, and after every edit of it. */
static df_status open_devices(const options *opts, session *s, df_error *err) {
    const df_settings *settings = &opts->settings;
    df_status status = df_scene_prepare(&s->field, (float)settings->iso, &settings->scene, &s->scene, err);
    if (status != DF_OK) return status;
    const df_tracer *tracer = settings->filter   ? &df_tracer_tricubic
                              : settings->tracer ? settings->tracer
                                                 : choose_tracer(opts, s);
    const uint32_t tile = opts->tile ? opts->tile : opts->heat ? df_heat_square(tracer) : 64;
    if (opts->heat &&
        (tracer->whole_frame || (opts->heat == DF_HEAT_STEPS && tracer->own_methods && !settings->filter)))
        return df_fail(err, DF_ERROR_USAGE, "--heat %s: --tracer %s does not count that by pixel",
                       df_heat_names[opts->heat], tracer->name);
    const df_frame_options frame = {.tracer = tracer,
                                    .solve = settings->solve,
                                    .steps = settings->steps,
                                    .precision = settings->precision,
                                    .gradient = settings->gradient,
                                    .filter = settings->filter,
                                    .tile = tile,
                                    .threads = opts->threads,
                                    .kernels = opts->kernels,
                                    .walk = settings->walk};
    s->report.tracer = tracer;
    s->report.tile = tile;
    return df_devices_open(&opts->devices, &s->scene, &frame, settings->width, settings->height, &s->devices, err);
}

static df_status render(options *opts, session *s, df_error *err) {
    const df_settings *settings = &opts->settings;
    df_status status = df_settings_camera(settings, &s->field, &s->camera, err);
    if (status == DF_OK && settings->quality_auto) choose_quality(opts, s);
    if (status == DF_OK) status = df_view_make(&s->camera, &s->field, settings->width, settings->height, &s->view, err);
    if (status != DF_OK) return status;
    s->settings_text = df_settings_text(settings, &s->camera);
    if (!s->settings_text) return df_fail(err, DF_ERROR_MEMORY, "out of memory");
    opts->devices.tracer_given = settings->tracer != NULL;
    status = alloc_picture(opts, &s->picture, err);
    if (status == DF_OK) status = open_devices(opts, s, err);
    if (status != DF_OK) return status;
    note_empty(&s->field, settings->iso);
    s->report.devices = s->devices;
    s->report.field_path = opts->field_path;
    s->report.scene = &s->scene;
    s->report.settings = settings;
    s->report.kernels = opts->kernels;
    s->report.threads = opts->threads;
    df_devices_precomputation(s->devices, &s->report.precompute_ms, &s->report.extract_ms, &s->report.precompute_bytes);
    if (opts->bench_frames) return DF_OK;
    if (opts->heat) return draw_heat(opts, s, err);
    return df_devices_frame(s->devices, &s->view, &s->picture, &s->report.stats, err);
}

static df_status list_devices(df_error *err) {
    df_opencl_info *list;
    uint32_t count;
    printf("cpu       %d threads\n", omp_get_num_procs());
    df_status status = df_opencl_find(&list, &count, err);
    if (status == DF_ERROR_UNSUPPORTED || (status == DF_OK && count == 0)) {
        fprintf(stderr, "df-render: %s\n", status == DF_OK ? "OpenCL has no device on this machine" : err->text);
        return DF_OK; /* that is the answer */
    }
    for (uint32_t i = 0; i < count; i++) {
        df_opencl_print(stdout, i, &list[i]);
        printf("\n");
    }
    free(list);
    return status;
}

/* The time from an edited field to its picture: all is made again. */
static df_status time_edits(const options *opts, session *s, df_bench *bench, df_error *err) {
    df_status status = DF_OK;
    options again = *opts;
    for (uint32_t i = 0; i < bench->repeats && status == DF_OK; i++) {
        if (df_devices_taken_over(s->devices))
            again.devices.choice = (df_device_choice){.count = 1, .numbers = {DF_DEVICE_CPU}};
        df_devices_close(s->devices);
        df_scene_free(&s->scene);
        s->devices = NULL;
        const double start = df_now_ms();
        status = open_devices(&again, s, err);
        if (status == DF_OK) status = df_devices_frame(s->devices, &s->view, &s->picture, NULL, err);
        bench->edit_ms[i] = df_now_ms() - start;
    }
    return status;
}

static df_status run_bench(const options *opts, session *s, df_error *err) {
    df_bench bench = {.frames = opts->bench_frames,
                      .repeats = opts->bench_repeats,
                      .deal_frames = opts->devices.deal_frames,
                      .command = opts->command};
    df_status status = df_bench_run(&bench, s->devices, &opts->settings, &s->field, &s->picture, err);
    if (status == DF_OK) status = time_edits(opts, s, &bench, err);
    s->report.devices = s->devices;
    if (status == DF_OK) {
        df_bench_print_header(stdout);
        status = df_bench_print(stdout, &bench, &s->report, err);
    }
    df_bench_free(&bench);
    return status;
}

/* The surface as a mesh file. */
static df_status export_mesh(const options *opts, const session *s, df_error *err) {
    const bool report = !wants_picture(opts); /* otherwise the picture's report has stdout */
    const df_export_options export = {.path = opts->mesh_path,
                                      .field_path = opts->field_path,
                                      .iso = (float)opts->settings.iso,
                                      .method = (df_mc_method)opts->mesh_method,
                                      .gradient = opts->settings.gradient,
                                      .threads = opts->threads,
                                      .quiet = opts->quiet,
                                      .stats = report && opts->stats,
                                      .json = report && opts->json};
    return df_export_mesh(&s->field, &export, err);
}

static df_status run(options *opts, session *s, df_error *err) {
    df_status status = df_kernels_select(opts->isa, &opts->kernels, err);
    if (status == DF_OK && opts->from_path) status = read_original(opts, s, err);
    if (status == DF_OK) status = check_outputs(opts, s, err);
    if (status == DF_OK) status = read_field(opts, s, err);
    if (status == DF_OK && opts->mesh_path) status = export_mesh(opts, s, err);
    if (status != DF_OK || !(wants_picture(opts) || opts->bench_frames)) return status;
    status = render(opts, s, err);
    if (status == DF_OK) status = opts->bench_frames ? run_bench(opts, s, err) : write_outputs(opts, s, err);
    if (status != DF_OK) return status;
    if (opts->verbose && opts->output_path) fprintf(stderr, "df-render: wrote %s\n", opts->output_path);
    if (!opts->bench_frames) status = print_report(opts, s, err);
    if (status == DF_OK && opts->from_path) status = compare_original(opts, s, err);
    return status;
}

/* OpenGL's library aborts, after a line of its own, where it has too little memory to start before main. */
static void on_abort(int signal_number) {
    (void)signal_number;
    _exit(1);
}
static void before_libraries(void) { signal(SIGABRT, on_abort); }
__attribute__((section(".preinit_array"), used)) static void (*const runs_before_libraries)(void) = before_libraries;

int main(int argc, char **argv) {
    static const struct argp argp = {option_table,
                                     on_option,
                                     "FIELD\n--from PICTURE [FIELD]",
                                     "Ray traces the surface of a signed distance field (.dfield, made by df-convert).",
                                     0,
                                     0,
                                     0};
    static char version[256];
    snprintf(version, sizeof version, "df-render " DF_VERSION "\ntracers:");
    for (int list = 0; list < 2; list++) {
        for (const df_tracer *const *tracer = list ? df_mc_tracers : df_tracers; *tracer; tracer++) {
            snprintf(version + strlen(version), sizeof version - strlen(version), " %s", (*tracer)->name);
        }
    }
    argp_program_version = version;
    argp_err_exit_status = 2;
    signal(SIGABRT, SIG_DFL);
    df_interrupt_install("df-render");
    df_output_watch_standard("df-render");
    options opts = {.threads = (uint32_t)omp_get_num_procs(),
                    .isa = "auto",
                    .bench_repeats = 5,
                    .devices = {.choice = {.count = 1, .numbers = {DF_DEVICE_CPU}}, .program = "df-render"}};
    session s = {0};
    df_error err = {0};
    df_settings_defaults(&opts.settings);
    opts.devices.messages = stderr;
    char *command = df_command_line(argc, argv);
    argp_parse(&argp, argc, argv, 0, NULL, &opts);
    opts.command = command ? command : "df-render";
    df_status status = opts.list_devices ? list_devices(&err) : run(&opts, &s, &err);
    if (status != DF_OK) fprintf(stderr, "df-render: %s\n", err.text);
    session_free(&s);
    free(command);
    return df_exit_code(status);
}
