#include "convert/request.h"

#include "common/options.h"
#include "convert/array_file.h"
#include "convert/exchange.h"
#include "convert/mesh_read.h"
#include "convert/shape.h"

#include <argp.h>
#include <math.h>
#include <string.h>

const char *const df_request_distance_names[] = {"exact", "cgal", "openvdb", NULL};
const char *const df_request_sign_names[] = {"auto", "winding", "parity", "normal", "wrap", NULL};
const char *const df_request_sample_names[] = {"f32", "u16", "u8", "auto", NULL};
static const char *const structure_names[] = {"bricks", "dense", "adf", NULL};

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

static df_status parse_bound(const char *option, const char *arg, df_error_bound *bound, df_error *err) {
    char number[64];
    size_t length = strlen(arg);
    bound->in_world = length > 1 && arg[length - 1] == 'w';
    if (length - bound->in_world >= sizeof number)
        return df_fail(err, DF_ERROR_USAGE, "%s %s: expected a number", option, arg);
    memcpy(number, arg, length + 1);
    if (bound->in_world) number[length - 1] = 0;
    return df_parse_double(option, number, 0, 1e30, &bound->value, err);
}

static df_status parse_value(df_request *r, int key, const char *arg) {
    uint32_t index;
    df_status status;
    switch (key) {
    case KEY_RESOLUTION: return df_parse_u32("--resolution", arg, 1, DF_VOXEL_COUNT_MAX, &r->resolution, r->err);
    case KEY_VOXEL_SIZE: return df_parse_double("--voxel-size", arg, 1e-30, 1e30, &r->voxel_size, r->err);
    case KEY_PADDING: return df_parse_double("--padding", arg, 0, 10000, &r->padding, r->err);
    case KEY_DISTANCE: return df_parse_name("--distance", arg, df_request_distance_names, &r->distance, r->err);
    case KEY_FOR_SIZE: return df_parse_size("--for-size", arg, &r->view_width, &r->view_height, r->err);
    case KEY_FOR_DISTANCE: return df_parse_double("--for-distance", arg, 0.01, 1e6, &r->view_distance, r->err);
    case KEY_MAX_ERROR:
        r->max_error_auto = strcmp(arg, "auto") == 0;
        if (r->max_error_auto) return DF_OK;
        return parse_bound("--max-error", arg, &r->max_error, r->err);
    case KEY_RMS_ERROR: return parse_bound("--rms-error", arg, &r->rms_error, r->err);
    case KEY_MEASURE: r->measure_given = true; return df_parse_u32("--measure", arg, 0, 100000000, &r->measure, r->err);
    case KEY_SAMPLES: return df_parse_name("--samples", arg, df_request_sample_names, &r->samples, r->err);
    case KEY_SIGN: return df_parse_name("--sign", arg, df_request_sign_names, &r->sign, r->err);
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
static void note_option(df_request *r, int key) {
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
    df_request *r = state->input;
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
static df_status check_exchange(const df_request *r, df_error *err) {
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

static df_status check_request(const df_request *r, df_error *err) {
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
    if (df_shape_is_name(r->input) && r->distance != DF_DISTANCE_EXACT) {
        return df_fail(err, DF_ERROR_USAGE, "--distance %s: a shape has its own exact distance",
                       df_request_distance_names[r->distance]);
    }
    if (r->structure == DF_FIELD_ADF && r->distance == DF_DISTANCE_OPENVDB) {
        return df_fail(err, DF_ERROR_USAGE, "--structure adf needs exact distances, --distance openvdb has none");
    }
    const char *option = r->max_error.value >= 0         ? "--max-error"
                         : r->rms_error.value >= 0       ? "--rms-error"
                         : r->samples == DF_SAMPLES_AUTO ? "--samples auto"
                                                         : NULL;
    if (option && (r->measure == 0 || r->distance == DF_DISTANCE_OPENVDB)) {
        return df_fail(err, DF_ERROR_USAGE, "%s needs %s", option,
                       r->measure == 0 ? "points to --measure" : "exact distances, --distance openvdb has none");
    }
    if (r->measure_given && r->measure && r->distance == DF_DISTANCE_OPENVDB) {
        return df_fail(err, DF_ERROR_USAGE, "--measure needs exact distances, --distance openvdb has none");
    }
    return DF_OK;
}

df_status df_request_parse(int argc, char **argv, df_request *r, df_error *err) {
    const struct argp argp = {options, parse_option, "INPUT", doc, 0, 0, 0};
    *r = (df_request){.structure = DF_FIELD_BRICKS,
                      .brick_size = 8,
                      .padding = 3,
                      .max_error = {-1, false},
                      .rms_error = {-1, false},
                      .measure = 20000,
                      .err = err};
    argp_err_exit_status = 2;
    df_status status = argp_parse(&argp, argc, argv, 0, 0, r) == 0 ? DF_OK : DF_ERROR_USAGE;
    if (status == DF_OK) status = check_request(r, err);
    if (status == DF_OK && r->check && (df_shape_is_name(r->input) || r->output))
        return df_fail(err, DF_ERROR_USAGE, "--check looks at a mesh and writes nothing");
    if (r->output && df_exchange_needs_dense(r->output)) r->structure = DF_FIELD_DENSE;
    return status;
}

df_error_bound df_request_max_error(const df_request *r) {
    if (r->max_error.value >= 0 || r->structure != DF_FIELD_ADF) return r->max_error;
    return (df_error_bound){r->rms_error.value >= 0 ? (double)INFINITY : 0.1, false};
}

double df_error_bound_in_world(const df_error_bound *bound, double voxel_size) {
    if (bound->value < 0) return INFINITY;
    return bound->in_world ? bound->value : bound->value * voxel_size;
}
