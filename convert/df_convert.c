/* df-convert: triangle meshes and analytic shapes to signed distance fields. */
#include "common/digest.h"
#include "common/field_file.h"
#include "common/interrupt.h"
#include "common/options.h"
#include "common/output_file.h"
#include "common/progress.h"
#include "common/version.h"
#include "convert/adf.h"
#include "convert/array_file.h"
#include "convert/exchange.h"
#include "convert/measure.h"
#include "convert/mesh_check.h"
#include "convert/mesh_read.h"
#include "convert/quantise.h"
#include "convert/report.h"
#include "convert/shape.h"

#include <argp.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>

#define PROGRAM "df-convert"

const char *argp_program_version = PROGRAM " " DF_VERSION " (CGAL 5.5, OpenVDB 10.0, tinyobjloader 2.0, OpenMP)";

typedef enum distance_method { DISTANCE_EXACT, DISTANCE_CGAL, DISTANCE_OPENVDB } distance_method;
static const char *const distance_names[] = {"exact", "cgal", "openvdb", NULL};
static const char *const sign_names[] = {"auto", "winding", "parity", "normal", "wrap", NULL};
static const char *const sample_names[] = {"f32", "u16", "u8", "auto", NULL};
static const char *const structure_names[] = {"bricks", "dense", "adf", NULL};

/* How large an error may be. */
typedef struct error_bound {
    double value;  /* negative: not given */
    bool in_world; /* world units, otherwise voxels */
} error_bound;

/* What the command line asks for. */
typedef struct request {
    const char *input;
    const char *output;  /* as given; NULL: derived from the input */
    uint32_t resolution; /* 0: not given */
    double voxel_size;   /* 0: not given */
    double padding;      /* voxels */
    error_bound max_error, rms_error;
    bool max_error_auto; /* what a picture of view_height pixels shows from view_distance (multiples of the longest
                            side) */
    uint32_t view_width, view_height; /* 0: not given */
    double view_distance;             /* 0: not given */
    uint32_t measure;                 /* points to measure the error at */
    uint32_t samples;                 /* into sample_names */
    df_field_kind structure;
    uint32_t brick_size;
    uint32_t distance; /* distance_method */
    uint32_t sign;     /* df_sign_method */
    uint32_t threads;  /* 0: as OpenMP chooses */
    bool check, repair, allow_partial, fill, json, quiet;
    bool strict; /* uncertain signs are a failure */
    bool structure_given, brick_given, samples_given, measure_given;
    const char *grid;         /* of a .vdb; NULL: the only one */
    double band;              /* voxels; 0: not given */
    const char *mesh_option;  /* an option that shapes a field of a mesh, where one was given */
    const char *error_option; /* one that bounds the error */
    df_error *err;
} request;

enum { SAMPLES_F32, SAMPLES_U16, SAMPLES_U8, SAMPLES_AUTO };
enum {
    KEY_RESOLUTION = 256,
    KEY_VOXEL_SIZE,
    KEY_PADDING,
    KEY_STRUCTURE,
    KEY_BRICK,
    KEY_DISTANCE,
    KEY_SIGN,
    KEY_STRICT,
    KEY_CHECK,
    KEY_REPAIR,
    KEY_MAX_ERROR,
    KEY_RMS_ERROR,
    KEY_PARTIAL,
    KEY_MEASURE,
    KEY_SAMPLES,
    KEY_THREADS,
    KEY_JSON
};
enum { KEY_GRID = 512, KEY_BAND, KEY_FILL, KEY_FOR_SIZE, KEY_FOR_DISTANCE };

static const struct argp_option options[] = {
    {0, 0, 0, 0, "Output", 1},
    {"output", 'o', "FILE", 0,
     "write the field to FILE (default: the input's name with .dfield, in the current folder)", 1},
    {"structure", KEY_STRUCTURE, "NAME", 0,
     "bricks: samples near the surface only (default); dense: all samples; adf: an octree as fine as --max-error asks",
     1},
    {"brick", KEY_BRICK, "K", 0, "voxels along a brick, 4 or 8 (default 8)", 1},
    {"samples", KEY_SAMPLES, "TYPE", 0,
     "f32 (default); u16, u8: fewer bytes, rounded; auto: the smallest that stays within --max-error, or adds no more "
     "than a tenth to the error",
     1},
    {"band", KEY_BAND, "N", 0,
     "cut distances at N voxels from the surface: .vdb (default: all that bricks store, 3 of a dense field), .npy, "
     ".nrrd, dense fields of fields",
     1},
    {"fill", KEY_FILL, 0, 0,
     "a dense field of bricks: samples that they do not hold get the least distance they can have", 1},
    {"grid", KEY_GRID, "NAME", 0, "the level set to read of a .vdb (default: the only one)", 1},
    {0, 0, 0, 0, "Precision", 2},
    {"resolution", KEY_RESOLUTION, "N", 0, "voxels along the longest side, padding included (default 256)", 2},
    {"voxel-size", KEY_VOXEL_SIZE, "S", 0, "size of a voxel in units of the mesh, in place of --resolution", 2},
    {"padding", KEY_PADDING, "N", 0, "voxels left free around the surface on each side (default 3)", 2},
    {"distance", KEY_DISTANCE, "NAME", 0, "exact (default); cgal: exact as well, by CGAL, slowly; openvdb: approximate",
     2},
    {"max-error", KEY_MAX_ERROR, "E[w]", 0,
     "the largest error near the surface, in voxels (of the finest level), or world units with a w behind. Octrees are "
     "divided as far as it asks (default 0.1 where --rms-error is not given either, as far as the finest level "
     "reaches); "
     "other structures get the resolution that it asks, unless that is given. auto: half a pixel of a picture of it",
     2},
    {"for-size", KEY_FOR_SIZE, "WxH", 0, "with --max-error auto: the size of that picture (default 1280x1024)", 2},
    {"for-distance", KEY_FOR_DISTANCE, "D", 0,
     "with --max-error auto: its eye's distance from the middle of the field in multiples of the longest side, as in "
     "df-render --orbit (default 1.6)",
     2},
    {"rms-error", KEY_RMS_ERROR, "R[w]", 0,
     "the same for the root mean square over the surface. Octrees are divided where that lowers it most; with "
     "--max-error, both hold",
     2},
    {"allow-partial", KEY_PARTIAL, 0, 0, "go on where --max-error or --rms-error cannot be reached", 2},
    {"measure", KEY_MEASURE, "N", 0,
     "random points at which the error is measured, 0 for none (default 20000); the largest is looked for at half as "
     "many more",
     2},
    {0, 0, 0, 0, "Inside and outside", 3},
    {"sign", KEY_SIGN, "NAME", 0,
     "auto, winding: inside is where the oriented mesh winds around once or more, or by half where it has holes "
     "(default); parity: where a ray crosses it an odd number of times; normal: on the inner side of the nearest face, "
     "by its pseudonormal; wrap: the same, within CGAL's alpha wrap, which closes wide holes",
     3},
    {"check", KEY_CHECK, 0, 0, "say what is wrong with the mesh, and convert nothing", 3},
    {"repair", KEY_REPAIR, 0, 0,
     "orient the faces, turn bodies that are inside out, stitch borders, fill holes, and convert that", 3},
    {"strict", KEY_STRICT, 0, 0, "fail where the signs are uncertain", 3},
    {0, 0, 0, 0, "Running", 4},
    {"threads", KEY_THREADS, "N", 0, "threads (default: one for each processor)", 4},
    {"json", KEY_JSON, 0, 0, "report as one JSON object on stdout", 4},
    {"quiet", 'q', 0, 0, "no report, no progress", 4},
    {0},
};

static const char doc[] =
    "Turns a triangle mesh into a signed distance field, negative inside.\v"
    "INPUT is a mesh (.obj, .ply, .off, .stl), a field (.dfield, .vdb, .npy, .nrrd), or an analytic shape:\n"
    "  shape:sphere:radius=1\n"
    "  shape:torus:major=1,minor=0.4\n"
    "  shape:box:x=2,y=2,z=2\n"
    "  shape:rotated-box:x=2,y=2,z=2,angle=30\n"
    "  shape:gyroid:period=1,thickness=0.1,size=2\n"
    "  shape:shell:radius=1,thickness=0.1\n"
    "each with cx, cy, cz for its centre.\n\n"
    "The output's extension chooses its format: .dfield, .vdb, .npy, .nrrd.\n\n"
    "Example: df-convert bunny.obj --resolution 256 && df-render bunny.dfield";

static df_status parse_bound(const char *option, const char *arg, error_bound *bound, df_error *err) {
    char number[64];
    size_t length = strlen(arg);
    bound->in_world = length > 1 && arg[length - 1] == 'w';
    if (length - bound->in_world >= sizeof number)
        return df_fail(err, DF_ERROR_USAGE, "%s %s: expected a number", option, arg);
    memcpy(number, arg, length + 1);
    if (bound->in_world) number[length - 1] = 0;
    return df_parse_double(option, number, 0, 1e30, &bound->value, err);
}

static df_status parse_value(request *r, int key, const char *arg) {
    uint32_t index;
    df_status status;
    switch (key) {
    case KEY_RESOLUTION: return df_parse_u32("--resolution", arg, 1, DF_VOXEL_COUNT_MAX, &r->resolution, r->err);
    case KEY_VOXEL_SIZE: return df_parse_double("--voxel-size", arg, 1e-30, 1e30, &r->voxel_size, r->err);
    case KEY_PADDING: return df_parse_double("--padding", arg, 0, 10000, &r->padding, r->err);
    case KEY_DISTANCE: return df_parse_name("--distance", arg, distance_names, &r->distance, r->err);
    case KEY_FOR_SIZE: return df_parse_size("--for-size", arg, &r->view_width, &r->view_height, r->err);
    case KEY_FOR_DISTANCE: return df_parse_double("--for-distance", arg, 0.01, 1e6, &r->view_distance, r->err);
    case KEY_MAX_ERROR:
        r->max_error_auto = strcmp(arg, "auto") == 0;
        if (r->max_error_auto) return DF_OK;
        return parse_bound("--max-error", arg, &r->max_error, r->err);
    case KEY_RMS_ERROR: return parse_bound("--rms-error", arg, &r->rms_error, r->err);
    case KEY_MEASURE: r->measure_given = true; return df_parse_u32("--measure", arg, 0, 100000000, &r->measure, r->err);
    case KEY_SAMPLES: return df_parse_name("--samples", arg, sample_names, &r->samples, r->err);
    case KEY_SIGN: return df_parse_name("--sign", arg, sign_names, &r->sign, r->err);
    case KEY_THREADS: return df_parse_u32("--threads", arg, 1, 4096, &r->threads, r->err);
    case KEY_STRUCTURE:
        status = df_parse_name("--structure", arg, structure_names, &index, r->err);
        if (status == DF_OK) r->structure = index == 0 ? DF_FIELD_BRICKS : index == 1 ? DF_FIELD_DENSE : DF_FIELD_ADF;
        return status;
    case KEY_BAND: return df_parse_double("--band", arg, 2, 100000, &r->band, r->err);
    case KEY_BRICK:
        status = df_parse_u32("--brick", arg, 4, 8, &r->brick_size, r->err);
        if (status == DF_OK && r->brick_size != 4 && r->brick_size != 8) {
            status = df_fail(r->err, DF_ERROR_USAGE, "--brick %s: expected 4 or 8", arg);
        }
        return status;
    default: return DF_OK;
    }
}

/* Notes options that have no meaning for every kind of input. */
static void note_option(request *r, int key) {
    if (key == KEY_RESOLUTION) r->mesh_option = "--resolution";
    if (key == KEY_PADDING) r->mesh_option = "--padding";
    if (key == KEY_DISTANCE) r->mesh_option = "--distance";
    if (key == KEY_SIGN) r->mesh_option = "--sign";
    if (key == KEY_MAX_ERROR) r->error_option = "--max-error";
    if (key == KEY_RMS_ERROR) r->error_option = "--rms-error";
    if (key == KEY_MEASURE) r->mesh_option = "--measure";
    r->samples_given = r->samples_given || key == KEY_SAMPLES;
    r->structure_given = r->structure_given || key == KEY_STRUCTURE;
    r->brick_given = r->brick_given || key == KEY_BRICK;
}

static error_t parse_option(int key, char *arg, struct argp_state *state) {
    request *r = state->input;
    switch (key) {
    case 'o': r->output = arg; break;
    case 'q': r->quiet = true; break;
    case KEY_JSON: r->json = true; break;
    case KEY_GRID: r->grid = arg; break;
    case KEY_FILL: r->fill = true; break;
    case KEY_STRICT: r->strict = true; break;
    case KEY_CHECK: r->check = true; break;
    case KEY_REPAIR: r->repair = true; break;
    case KEY_PARTIAL: r->allow_partial = true; break;
    case ARGP_KEY_ARG:
        if (r->input) argp_error(state, "more than one input: %s, %s", r->input, arg);
        r->input = arg;
        break;
    case ARGP_KEY_NO_ARGS: argp_usage(state); break;
    default:
        if ((key < 256 || key > KEY_JSON) && key != KEY_BAND && key != KEY_FOR_SIZE && key != KEY_FOR_DISTANCE)
            return ARGP_ERR_UNKNOWN;
        note_option(r, key);
        return parse_value(r, key, arg) == DF_OK ? 0 : EINVAL;
    }
    return 0;
}

/* Options of a conversion from field to field, or to other programs' files. */
static df_status check_exchange(const request *r, df_error *err) {
    bool is_vdb = df_exchange_is_output(r->input) && !df_exchange_needs_dense(r->input);
    bool is_npy = df_array_format_of(r->input) == DF_ARRAY_NPY;
    if (r->grid && !is_vdb) return df_fail(err, DF_ERROR_USAGE, "--grid: for .vdb inputs");
    if (df_exchange_is_input(r->input)) {
        const char *option = r->check ? "--check" : r->repair ? "--repair" : r->strict ? "--strict" : r->mesh_option;
        if (r->voxel_size > 0 && !is_npy) option = "--voxel-size";
        if (!r->structure_given || r->structure != DF_FIELD_ADF) option = option ? option : r->error_option;
        if (option) return df_fail(err, DF_ERROR_USAGE, "%s: %s has its samples already", option, r->input);
        if (r->samples_given && r->output && df_exchange_is_output(r->output))
            return df_fail(err, DF_ERROR_USAGE, "--samples: for .dfield, %s has its own", r->output);
        if (!r->output && !df_exchange_is_output(r->input))
            return df_fail(err, DF_ERROR_USAGE, "%s: a .dfield needs -o", r->input);
    } else if (r->fill) {
        return df_fail(err, DF_ERROR_USAGE, "--fill: for dense fields of bricks");
    } else if (r->band > 0 && !(r->output && df_exchange_is_output(r->output))) {
        return df_fail(err, DF_ERROR_USAGE, "--band: for .vdb, .npy and .nrrd, and dense fields of fields");
    }
    if (r->output && df_exchange_needs_dense(r->output) && r->structure_given && r->structure != DF_FIELD_DENSE) {
        return df_fail(err, DF_ERROR_USAGE, "%s: an array is dense, --structure asks for something else", r->output);
    }
    return DF_OK;
}

static df_status check_request(const request *r, df_error *err) {
    df_status status = check_exchange(r, err);
    if (status == DF_OK && !r->max_error_auto && (r->view_width || r->view_distance > 0))
        return df_fail(err, DF_ERROR_USAGE, "--for-size and --for-distance are for --max-error auto");
    if (status == DF_OK && r->max_error_auto && df_exchange_is_input(r->input))
        return df_fail(err, DF_ERROR_USAGE, "--max-error auto: for meshes and shapes, %s has its size already",
                       r->input);
    if (status != DF_OK || df_exchange_is_input(r->input)) return status;
    if (r->resolution && r->voxel_size > 0) {
        return df_fail(err, DF_ERROR_USAGE, "--resolution and --voxel-size exclude each other");
    }
    if (!df_shape_is_name(r->input) && !df_mesh_is_mesh_path(r->input)) {
        return df_fail(
            err, DF_ERROR_USAGE,
            "%s: unknown format (known are .obj, .ply, .off, .stl, .dfield, .vdb, .npy, .nrrd and shape:NAME)",
            r->input);
    }
    if (df_shape_is_name(r->input) && r->distance != DISTANCE_EXACT) {
        return df_fail(err, DF_ERROR_USAGE, "--distance %s: a shape has its own exact distance",
                       distance_names[r->distance]);
    }
    if (r->structure == DF_FIELD_ADF && r->distance == DISTANCE_OPENVDB) {
        return df_fail(err, DF_ERROR_USAGE, "--structure adf needs exact distances, --distance openvdb has none");
    }
    const char *option = r->max_error.value >= 0      ? "--max-error"
                         : r->rms_error.value >= 0    ? "--rms-error"
                         : r->samples == SAMPLES_AUTO ? "--samples auto"
                                                      : NULL;
    if (option && (r->measure == 0 || r->distance == DISTANCE_OPENVDB)) {
        return df_fail(err, DF_ERROR_USAGE, "%s needs %s", option,
                       r->measure == 0 ? "points to --measure" : "exact distances, --distance openvdb has none");
    }
    if (r->measure_given && r->measure && r->distance == DISTANCE_OPENVDB) {
        return df_fail(err, DF_ERROR_USAGE, "--measure needs exact distances, --distance openvdb has none");
    }
    return DF_OK;
}

/* Where the input comes from, and the surface it gives. */
typedef struct surface {
    df_shape shape;
    df_mesh mesh;
    df_sign sign;
    df_distance_source
        source; /* made for the first field; only --distance openvdb depends on its lattice, and makes one */
    double low[3], high[3];
} surface;

/* Cleans, orients, stitches and fills; what was done goes to the report. */
static df_status repair_mesh(const request *r, df_mesh *mesh, df_convert_report *report, df_error *err) {
    df_sign_mesh sign = {0};
    df_mesh_cleaning *cleaning = &report->repair_cleaning;
    df_status status = df_mesh_clean(mesh, r->input, cleaning, err);
    if (status == DF_OK) status = df_sign_mesh_make(mesh, &sign, err);
    if (status == DF_OK) {
        memcpy(mesh->faces, sign.mesh.faces, (size_t)mesh->face_count * 3 * sizeof *mesh->faces);
        report->repaired = true;
        report->repair_flips = sign.flipped_faces;
        report->repair_turned = sign.inverted_components;
        status = df_mesh_repair(mesh, r->input, &report->repairs, err);
    }
    df_sign_mesh_free(&sign);
    return status;
}

static df_status check_mesh(const request *r, df_error *err) {
    df_mesh mesh = {0};
    df_mesh_cleaning cleaning;
    df_mesh_diagnosis diagnosis;
    df_status status = df_mesh_read(r->input, &mesh, err);
    if (status == DF_OK) status = df_mesh_clean(&mesh, r->input, &cleaning, err);
    if (status == DF_OK) status = df_mesh_check(&mesh, &cleaning, &diagnosis, err);
    if (status == DF_OK) df_mesh_print_diagnosis(r->input, &diagnosis, r->json);
    df_mesh_free(&mesh);
    return status;
}

static df_status read_surface(const request *r, surface *s, df_convert_report *report, df_error *err) {
    report->is_shape = df_shape_is_name(r->input);
    if (report->is_shape) {
        df_status status = df_shape_parse(r->input, &s->shape, err);
        if (status == DF_OK) df_shape_bounds(&s->shape, s->low, s->high);
        return status;
    }
    double start = df_now_ms();
    df_status status = df_mesh_read(r->input, &s->mesh, err);
    if (status == DF_OK) status = df_sha256_file(r->input, report->input_sha256, err);
    if (status != DF_OK) return status;
    double read = df_now_ms();
    if (r->repair) status = repair_mesh(r, &s->mesh, report, err);
    if (status != DF_OK) return status;
    status = df_mesh_clean(&s->mesh, r->input, &report->cleaning, err);
    if (status == DF_OK) status = df_mesh_find_edges(&s->mesh, &report->edges, err);
    if (status != DF_OK) return status;
    report->vertices = s->mesh.vertex_count;
    report->faces = s->mesh.face_count;
    report->read_ms = read - start;
    report->clean_ms = df_now_ms() - read;
    df_mesh_bounds(&s->mesh, s->low, s->high);
    s->sign = (df_sign){.method = (df_sign_method)r->sign, .mesh = &s->mesh};
    /* a mesh that is closed and oriented alike decides as it is; whether a body is inside out shows later */
    if (r->distance == DISTANCE_OPENVDB) return DF_OK;
    if (r->sign == DF_SIGN_NORMAL || r->sign == DF_SIGN_WRAP) return df_sign_prepare_normals(&s->sign, &s->mesh, err);
    bool decides = report->edges.border_count == 0 || r->sign == DF_SIGN_PARITY;
    return decides ? DF_OK : df_sign_orient(&s->sign, &s->mesh, err);
}

static df_status make_source(const request *r, surface *s, const df_lattice *lattice, df_convert_report *report,
                             df_error *err) {
    if (s->source.fill) return DF_OK;
    report->distance = report->is_shape ? "shape" : distance_names[r->distance];
    report->sign_method = report->is_shape                  ? "shape"
                          : r->distance == DISTANCE_OPENVDB ? "openvdb"
                          : r->sign == DF_SIGN_AUTO         ? "winding"
                                                            : sign_names[r->sign];
    if (report->is_shape) {
        df_distance_shape(&s->shape, &s->source);
        return DF_OK;
    }
    if (r->distance == DISTANCE_EXACT) return df_distance_exact(&s->mesh, &s->source, err);
    if (r->distance == DISTANCE_CGAL) return df_distance_cgal(&s->mesh, &s->source, err);
    /* in bricks no sample lies further from a face than a cell's diagonal and the reach */
    double band = (r->brick_size + 2) * 1.7320508;
    for (int a = 0; a < 3 && r->structure == DF_FIELD_DENSE; a++) band = fmax(band, 2.0 * lattice->voxel_count[a]);
    return df_distance_openvdb(&s->mesh, lattice, (float)band, &s->source, err);
}

/* Asks CGAL's exact inside test about samples spread over the field and compares it with the signs stored. CGAL counts
 * crossings by parity, so where bodies overlap it says outside; then the two may differ and the verdict is left as it
 * is. */
static df_status check_signs(const surface *s, const df_field *field, df_convert_report *report, df_error *err) {
    enum { POINTS = 2000 };
    static double points[POINTS][3];
    static int8_t sides[POINTS];
    uint64_t count = 0, total = df_dense_sample_count(field->voxel_count), step = total / POINTS + 1;
    float values[POINTS];
    for (uint64_t i = step / 2; i < total && count < POINTS; i += step) {
        uint64_t row = (uint64_t)field->voxel_count[0] + 1, rows = (uint64_t)field->voxel_count[1] + 1;
        uint32_t at[3] = {(uint32_t)(i % row), (uint32_t)(i / row % rows), (uint32_t)(i / row / rows)};
        double grid[3] = {at[0], at[1], at[2]};
        df_field_sample(field, at, &values[count]);
        df_field_grid_to_world(field, grid, points[count++]);
    }
    df_status status = df_cgal_side(&s->mesh, points[0], count, sides, err);
    if (status != DF_OK) return status;
    report->sign_checks = count;
    for (uint64_t i = 0; i < count; i++)
        report->sign_contradictions += sides[i] != 0 && (sides[i] > 0) != (values[i] < 0);
    return DF_OK;
}

/* The bound on the largest error; octrees always have one. */
static error_bound bound_of(const request *r) {
    if (r->max_error.value >= 0 || r->structure != DF_FIELD_ADF) return r->max_error;
    return (error_bound){r->rms_error.value >= 0 ? (double)INFINITY : 0.1, false};
}

/* In world units; INFINITY where there is none. */
static double bound_in_world(const error_bound *bound, double voxel_size) {
    if (bound->value < 0) return INFINITY;
    return bound->in_world ? bound->value : bound->value * voxel_size;
}

/* The options that shaped the field, for the provenance. */
static json_t *json_options(const request *r) {
    json_t *o = json_pack("{s:s, s:f}", "structure", df_field_kind_name(r->structure), "padding", r->padding);
    json_object_set_new(o, "samples", json_string(sample_names[r->samples]));
    if (r->voxel_size > 0) json_object_set_new(o, "voxel_size", json_real(r->voxel_size));
    else json_object_set_new(o, "resolution", json_integer(r->resolution ? r->resolution : 256));
    const error_bound largest = bound_of(r), *rms = &r->rms_error;
    if (largest.value >= 0 && isfinite(largest.value))
        json_object_set_new(o, largest.in_world ? "max_error_world" : "max_error", json_real(largest.value));
    if (rms->value >= 0) json_object_set_new(o, rms->in_world ? "rms_error_world" : "rms_error", json_real(rms->value));
    if (r->structure == DF_FIELD_BRICKS) json_object_set_new(o, "brick", json_integer(r->brick_size));
    return o;
}

/* What the signs are worth; report->sign_reason says why. */
static df_verdict judge_signs(const request *r, const surface *s, df_convert_report *report) {
    const df_sign_mesh *made = &s->sign.made;
    if (report->is_shape) return DF_VERDICT_CERTAIN;
    if (r->distance == DISTANCE_OPENVDB) {
        report->sign_reason = "OpenVDB fills thin gaps and cavities";
        return DF_VERDICT_UNKNOWN;
    }
    bool parity = r->sign == DF_SIGN_PARITY;
    report->flipped_faces = made->flipped_faces;
    report->inverted_components = made->inverted_components;
    report->holes = made->cap_count;
    report->hole_edges = made->border_edges;
    report->unorientable_edges = made->unorientable_edges;
    if (report->build.wall_count) report->sign_reason = "the sign changes where no surface is";
    else if (report->sign_contradictions) report->sign_reason = "CGAL's inside test disagrees";
    else if (parity && report->edges.boundary) report->sign_reason = "rays through holes were counted";
    else if (r->structure == DF_FIELD_ADF && made->cap_count) report->sign_reason = "the mesh has holes";
    if (report->sign_reason) return DF_VERDICT_UNCERTAIN;
    if (report->repaired &&
        (report->repair_flips || report->repair_turned || report->repairs.faces_added || report->repairs.stitched)) {
        report->sign_reason = "the mesh was repaired";
    }
    if (made->cap_count) report->sign_reason = "holes closed, none wider than a voxel";
    else if (made->flipped_faces) report->sign_reason = "faces oriented alike";
    else if (made->inverted_components) report->sign_reason = "bodies turned that were inside out";
    return report->sign_reason ? DF_VERDICT_REPAIRED : DF_VERDICT_CERTAIN;
}

static df_status finish_field(const request *r, const surface *s, df_field *field, df_convert_report *report,
                              df_error *err) {
    if (!report->is_shape && (r->distance == DISTANCE_CGAL || r->sign == DF_SIGN_NORMAL) &&
        report->cleaning.zero_area == 0 && report->edges.border_count == 0) {
        df_status status = check_signs(s, field, report, err);
        if (status != DF_OK) return status;
    }
    field->verdict = judge_signs(r, s, report);
    if (r->strict && field->verdict == DF_VERDICT_UNCERTAIN) {
        return df_fail(err, DF_ERROR_INPUT, "%s: the signs are uncertain: %s (--strict)", r->input,
                       report->sign_reason);
    }
    char *provenance = df_report_provenance(report, field, json_options(r));
    if (!provenance) return df_fail(err, DF_ERROR_MEMORY, "provenance: out of memory");
    df_field_own(field, provenance);
    field->provenance = provenance;
    return DF_OK;
}

/* A field without a surface is no picture of the input, whatever the reason. */
static df_status check_surface(const char *name, const df_field *field, df_error *err) {
    if (df_field_surface_voxel_count(field) > 0) return DF_OK;
    return df_fail(err, DF_ERROR_INPUT,
                   "%s: no sample lies inside the surface: it is flat, or thinner than a voxel (%.3g); "
                   "a smaller --voxel-size may find it",
                   name, field->voxel_size[0]);
}

/* An octree of a mesh or shape, and what it reads while it is built. */
typedef struct octree {
    df_face_tree made; /* empty where the source has one */
    df_shape_cells cells;
    df_adf *adf;
    df_adf_report report;
} octree;

static void free_octree(octree *o) {
    df_adf_free(o->adf);
    df_face_tree_free(&o->made);
}

static df_status start_octree(const request *r, surface *s, const df_lattice *lattice, octree *o, df_field *field,
                              const df_convert_report *report, df_error *err) {
    const error_bound largest = bound_of(r);
    const bool from_tree = !report->is_shape && r->distance == DISTANCE_EXACT;
    *o = (octree){.cells = {&s->shape, lattice}};
    df_adf_input input = {.name = r->input,
                          .lattice = lattice,
                          .source = &s->source,
                          .tree = from_tree          ? df_distance_exact_tree(&s->source)
                                  : report->is_shape ? NULL
                                                     : &o->made,
                          .tree_is_source = from_tree,
                          .crosses = df_shape_crosses,
                          .crosses_context = &o->cells,
                          .mesh = report->is_shape ? NULL : &s->mesh,
                          .sign = &s->sign,
                          .max_error = bound_in_world(&largest, lattice->voxel_size),
                          .rms_error = bound_in_world(&r->rms_error, lattice->voxel_size),
                          .quiet = r->quiet};
    df_status status = DF_OK;
    if (input.tree == &o->made) status = df_face_tree_make(&s->mesh, &o->made, err);
    return status == DF_OK ? df_adf_start(&input, &o->adf, field, &o->report, err) : status;
}

static void report_octree(const df_adf_report *adf, df_convert_report *report) {
    report->build.samples_computed = adf->samples_computed;
    report->build.sign_ms = adf->sign_ms;
    report->build.distance_ms = adf->divide_ms;
    report->build.structure_ms = adf->continuity_ms + adf->structure_ms;
    report->leaves = adf->leaves;
    report->divided_for_continuity = adf->divided_for_continuity;
}

/* Measures the field against its source. */
static df_status measure_error(const request *r, const surface *s, const df_distance_source *source, df_field *field,
                               df_convert_report *report, df_error *err) {
    if (r->distance == DISTANCE_OPENVDB || r->measure == 0) return DF_OK;
    bool same_tree = !report->is_shape && r->distance == DISTANCE_EXACT && s->sign.mesh == &s->mesh;
    df_truth truth = {source, &s->sign, same_tree ? df_distance_exact_tree(source) : NULL};
    double start = df_now_ms();
    df_status status = df_measure_error(&truth, r->measure, field, err);
    report->measure_ms += df_now_ms() - start;
    return status;
}

/* By how much the error is larger than asked, as a factor. */
static double excess_error(const request *r, const df_field *field) {
    double size = field->voxel_size[0], largest = bound_in_world(&r->max_error, size),
           rms = bound_in_world(&r->rms_error, size);
    return fmax(field->error_max / fmax(largest, 1e-300), field->error_rms / fmax(rms, 1e-300));
}

/* Quantises the samples, and measures again. */
static df_status quantise(const request *r, const surface *s, df_sample_type type, df_field *field, df_field *smaller,
                          df_convert_report *report, df_error *err) {
    df_status status = df_quantise(field, type, smaller, err);
    return status == DF_OK ? measure_error(r, s, &s->source, smaller, report, err) : status;
}

/* The smallest type that keeps the error as --samples auto says. */
static df_status quantise_as_fits(const request *r, const surface *s, df_field *field, df_convert_report *report,
                                  df_error *err) {
    const double largest = 1.1 * field->error_max, rms = 1.1 * field->error_rms;
    const bool bounded = (r->max_error.value >= 0 || r->rms_error.value >= 0) && excess_error(r, field) <= 1;
    for (int type = DF_SAMPLE_U8; type > DF_SAMPLE_F32; type--) {
        df_field smaller;
        df_status status = quantise(r, s, (df_sample_type)type, field, &smaller, report, err);
        if (status != DF_OK) return status;
        if (bounded ? excess_error(r, &smaller) <= 1 : smaller.error_max <= largest && smaller.error_rms <= rms) {
            df_field_free(field);
            *field = smaller;
            return DF_OK;
        }
        df_field_free(&smaller);
    }
    return DF_OK;
}

/* Stores the samples as --samples asks, and measures the error. */
static df_status store_samples(const request *r, const surface *s, df_field *field, df_convert_report *report,
                               df_error *err) {
    if (r->samples == SAMPLES_U16 || r->samples == SAMPLES_U8) {
        df_field smaller;
        df_status status =
            quantise(r, s, r->samples == SAMPLES_U16 ? DF_SAMPLE_U16 : DF_SAMPLE_U8, field, &smaller, report, err);
        if (status != DF_OK) return status;
        df_field_free(field);
        *field = smaller;
        return DF_OK;
    }
    df_status status = measure_error(r, s, &s->source, field, report, err);
    return status == DF_OK && r->samples == SAMPLES_AUTO ? quantise_as_fits(r, s, field, report, err) : status;
}

static df_status check_error(const request *r, const df_field *field, df_error *err) {
    if (r->allow_partial || !(excess_error(r, field) > 1)) return DF_OK;
    const bool largest = field->error_max > bound_in_world(&r->max_error, field->voxel_size[0]);
    const error_bound *bound = largest ? &r->max_error : &r->rms_error;
    return df_fail(err, DF_ERROR_INPUT,
                   "%s: --%s-error %g %s cannot be reached with voxels of %g: the error is %g; raise --resolution, or "
                   "pass --allow-partial",
                   r->input, largest ? "max" : "rms", bound->value, bound->in_world ? "world units" : "voxels",
                   field->voxel_size[0],
                   (largest ? field->error_max : field->error_rms) / (bound->in_world ? 1 : field->voxel_size[0]));
}

/* Builds an octree; divides it further where the root mean square is larger than asked, as its estimate from a part of
 * the octree may have been too low. It grows about as the square root of the slope. */
#define ADF_ATTEMPTS 4
static df_status build_octree(const request *r, surface *s, const df_lattice *lattice, df_field *field,
                              df_convert_report *report, df_error *err) {
    const double rms = bound_in_world(&r->rms_error, lattice->voxel_size);
    octree o;
    df_status status = start_octree(r, s, lattice, &o, field, report, err);
    for (int attempt = 1; status == DF_OK; attempt++) {
        report_octree(&o.report, report);
        status = check_surface(r->input, field, err);
        if (status == DF_OK) status = store_samples(r, s, field, report, err);
        if (status != DF_OK || !(field->error_rms > rms) || attempt == ADF_ATTEMPTS) break;
        const double slope = o.report.rms_slope * pow(0.97 * rms / field->error_rms, 2);
        df_field_free(field);
        status = df_adf_refine(o.adf, slope, field, &o.report, err);
    }
    free_octree(&o);
    return status;
}

static df_status build_field(const request *r, surface *s, df_field *field, df_convert_report *report, df_error *err) {
    df_lattice lattice;
    df_lattice_request wanted = {r->resolution || r->voxel_size > 0 ? r->resolution : 256, r->voxel_size, r->padding,
                                 r->brick_size};
    df_status status = df_lattice_make(&wanted, s->low, s->high, r->input, &lattice, err);
    if (status != DF_OK) return status;
    report->resolution = 0;
    for (int a = 0; a < 3; a++) {
        if (lattice.voxel_count[a] > report->resolution) report->resolution = lattice.voxel_count[a];
    }
    double start = df_now_ms();
    status = make_source(r, s, &lattice, report, err);
    report->prepare_ms += df_now_ms() - start;
    df_shape_cells shape_cells = {&s->shape, &lattice};
    df_build_input input = {.name = r->input,
                            .kind = r->structure,
                            .lattice = &lattice,
                            .source = &s->source,
                            .mesh = report->is_shape ? NULL : &s->mesh,
                            .sign = &s->sign,
                            .keep = df_shape_keeps_cell,
                            .keep_context = &shape_cells,
                            .quiet = r->quiet};
    if (status == DF_OK && r->structure == DF_FIELD_ADF) {
        status = build_octree(r, s, &lattice, field, report, err);
    } else if (status == DF_OK) {
        status = df_build(&input, field, &report->build, err);
        if (status == DF_OK) status = check_surface(r->input, field, err);
        if (status == DF_OK) status = store_samples(r, s, field, report, err);
    }
    if (status != DF_OK) df_field_free(field);
    return status;
}

/* Builds the field, where only the error is given with the resolution that reaches it: from a coarse one up, by how
 * much the error is too large. */
#define SEARCH_FIRST 48
#define SEARCH_LAST 2048
static df_status build_as_asked(const request *r, surface *s, df_field *field, df_convert_report *report,
                                df_error *err) {
    request attempt = *r;
    bool bounded = r->max_error.value >= 0 || r->rms_error.value >= 0;
    bool search = bounded && r->structure != DF_FIELD_ADF && r->resolution == 0 && !(r->voxel_size > 0);
    if (search) attempt.resolution = SEARCH_FIRST + (uint32_t)(2 * r->padding);
    df_status status = build_field(&attempt, s, field, report, err);
    while (search && status == DF_OK && excess_error(r, field) > 1 && attempt.resolution < SEARCH_LAST) {
        double next = ceil(attempt.resolution * fmin(fmax(1.03 * excess_error(r, field), 1.1), 3));
        attempt.resolution = next < SEARCH_LAST ? (uint32_t)next : SEARCH_LAST;
        df_field_free(field);
        status = build_field(&attempt, s, field, report, err);
    }
    if (status == DF_OK) status = check_error(r, field, err);
    if (status == DF_OK) status = finish_field(&attempt, s, field, report, err);
    if (status != DF_OK) df_field_free(field);
    return status;
}

/* --max-error auto: half the footprint of a pixel where the surface's box is nearest to the eye, whatever side it is
 * seen from. An octree gets voxels of that footprint to divide down to. */
static void settle_bound(request *r, const surface *s) {
    double longest = 0, diagonal = 0;
    for (int a = 0; a < 3; a++) {
        double side = s->high[a] - s->low[a];
        longest = fmax(longest, side);
        diagonal += side * side;
    }
    const double distance = r->view_distance > 0 ? r->view_distance : 1.6, field_of_view = 1; /* radian, vertical */
    const double nearest = fmax(distance * longest - sqrt(diagonal) / 2, 0.01 * longest);
    const double footprint = 2 * tan(field_of_view / 2) * nearest / (r->view_height ? r->view_height : 1024);
    r->max_error = (error_bound){footprint / 2, true};
    if (r->structure == DF_FIELD_ADF && r->resolution == 0 && !(r->voxel_size > 0))
        r->resolution = (uint32_t)fmin(ceil(longest / footprint + 2 * r->padding), SEARCH_LAST);
}

static df_status convert(request *r, const char *output, df_error *err) {
    double start = df_now_ms();
    df_convert_report report = {.input = r->input, .output = output};
    surface s = {0};
    df_field field = {0};
    df_status status = df_output_check(output, err);
    if (status == DF_OK) status = read_surface(r, &s, &report, err);
    if (status == DF_OK && r->max_error_auto) settle_bound(r, &s);
    if (status == DF_OK) status = build_as_asked(r, &s, &field, &report, err);
    double built = df_now_ms();
    if (status == DF_OK) status = df_exchange_write(&field, output, r->band, err);
    if (status == DF_OK) {
        struct stat info;
        struct rusage usage;
        if (stat(output, &info) == 0) report.bytes = (uint64_t)info.st_size;
        if (getrusage(RUSAGE_SELF, &usage) == 0) report.peak_bytes = (uint64_t)usage.ru_maxrss * 1024;
        report.write_ms = df_now_ms() - built;
        report.total_ms = df_now_ms() - start;
        if (r->json) status = df_report_print_json(&report, &field, err);
        else if (!r->quiet) df_report_print(&report, &field);
    }
    free(report.edges.borders);
    df_distance_source_free(&s.source);
    df_sign_free(&s.sign);
    df_mesh_free(&s.mesh);
    df_field_free(&field);
    return status;
}

static df_status convert_field(const request *r, const char *output, df_error *err) {
    const error_bound largest = bound_of(r);
    df_exchange_request wanted = {.input = r->input,
                                  .output = output,
                                  .samples = r->samples_given ? sample_names[r->samples] : NULL,
                                  .max_error = largest.value,
                                  .max_in_world = largest.in_world,
                                  .rms_error = r->rms_error.value >= 0 ? r->rms_error.value : (double)INFINITY,
                                  .rms_in_world = r->rms_error.in_world,
                                  .allow_partial = r->allow_partial,
                                  .structure = r->structure_given ? r->structure : 0,
                                  .brick_size = r->brick_given ? r->brick_size : 0,
                                  .grid = r->grid,
                                  .band = r->band,
                                  .fill = r->fill,
                                  .voxel_size = r->voxel_size,
                                  .json = r->json,
                                  .quiet = r->quiet};
    return df_exchange_convert(&wanted, err);
}

/* Where the field goes when no -o says so: NAME.dfield in the current folder. */
static char *default_output(const char *input) {
    if (!df_shape_is_name(input)) return df_path_with_extension(input, ".dfield", 0);
    size_t length = strcspn(input + 6, ":");
    char *out = malloc(length + sizeof ".dfield");
    if (out) {
        memcpy(out, input + 6, length);
        strcpy(out + length, ".dfield");
    }
    return out;
}

int main(int argc, char **argv) {
    df_error err = {0};
    request r = {.structure = DF_FIELD_BRICKS,
                 .brick_size = 8,
                 .padding = 3,
                 .max_error = {-1, false},
                 .rms_error = {-1, false},
                 .measure = 20000,
                 .err = &err};
    const struct argp argp = {options, parse_option, "INPUT", doc, 0, 0, 0};
    df_interrupt_install(PROGRAM);
    argp_err_exit_status = 2;
    df_status status = argp_parse(&argp, argc, argv, 0, 0, &r) == 0 ? DF_OK : DF_ERROR_USAGE;
    if (status == DF_OK) status = check_request(&r, &err);
    if (status == DF_OK && r.check && (df_shape_is_name(r.input) || r.output)) {
        status = df_fail(&err, DF_ERROR_USAGE, "--check looks at a mesh and writes nothing");
    }
    if (status == DF_OK && r.threads) omp_set_num_threads((int)r.threads);
    char *derived = status == DF_OK && !r.output ? default_output(r.input) : NULL;
    const char *output = r.output ? r.output : derived;
    if (status == DF_OK && !output) status = df_fail(&err, DF_ERROR_MEMORY, "out of memory");
    if (output && df_exchange_needs_dense(output)) r.structure = DF_FIELD_DENSE;
    if (status == DF_OK && df_exchange_is_input(r.input)) status = convert_field(&r, output, &err);
    else if (status == DF_OK) status = r.check ? check_mesh(&r, &err) : convert(&r, output, &err);
    if (status == DF_OK && (fflush(stdout) != 0 || ferror(stdout)))
        status = df_fail(&err, DF_ERROR_IO, "stdout: cannot write the report");
    if (status != DF_OK) fprintf(stderr, PROGRAM ": %s\n", err.text);
    free(derived);
    return df_exit_code(status);
}
