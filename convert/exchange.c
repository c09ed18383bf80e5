#include "convert/exchange.h"

#include "common/digest.h"
#include "common/field_file.h"
#include "common/output_file.h"
#include "common/progress.h"
#include "common/version.h"
#include "convert/array_file.h"
#include "convert/build.h"
#include "convert/restructure.h"
#include "convert/vdb.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/resource.h>
#include <sys/stat.h>

/* A conversion in progress: what the report and the provenance say about it. */
typedef struct conversion {
    const df_exchange_request *request;
    df_field field;
    char sha256[65];
    const char *format;      /* of the input: "dfield", "vdb", "npy", "nrrd" */
    df_field_kind from_kind; /* of the input; 0 for a .vdb */
    char grid[128];          /* of a .vdb */
    uint32_t version;        /* of a .vdb's format, where it is newer than the last that OpenVDB knows; 0 */
    uint32_t known_version;  /* that last one */
    double band;             /* voxels: where distances end; 0: nowhere */
    double filled;           /* voxels: the distance that samples got which were not stored; 0: none */
    uint64_t clipped;        /* stored samples of a .vdb that stand at the end of its band */
    json_t *source;          /* provenance of a .dfield; NULL */
    double read_ms, structure_ms, write_ms, total_ms;
    uint64_t bytes;
} conversion;

static bool has_extension(const char *path, const char *extension) {
    const char *dot = strrchr(path, '.');
    return dot && strcasecmp(dot, extension) == 0;
}

bool df_exchange_needs_dense(const char *path) { return df_array_format_of(path) != DF_ARRAY_NONE; }

bool df_exchange_is_output(const char *path) { return df_exchange_needs_dense(path) || has_extension(path, ".vdb"); }

bool df_exchange_is_input(const char *path) { return df_exchange_is_output(path) || has_extension(path, ".dfield"); }

/* Replaces a field by another structure of it. */
static df_status restructure(df_field *field, const df_restructure_request *wanted, df_error *err) {
    df_field other = {0};
    df_status status = df_restructure(field, wanted, &other, err);
    if (status != DF_OK) return status;
    other.provenance = "{}";
    df_field_free(field);
    *field = other;
    return DF_OK;
}

df_status df_exchange_write(df_field *field, const char *path, double band, df_error *err) {
    if (!df_exchange_is_output(path)) return df_field_write(field, path, err);
    bool dense = df_exchange_needs_dense(path);
    df_restructure_request wanted = {.name = path,
                                     .kind = dense ? DF_FIELD_DENSE : DF_FIELD_BRICKS,
                                     .brick_size = 8,
                                     .band = dense ? band : 0,
                                     .quiet = true};
    bool fits = dense ? field->kind == DF_FIELD_DENSE && !(band > 0) : field->kind != DF_FIELD_ADF;
    df_field other = {0};
    const df_field *written = fits ? field : &other;
    df_status status = fits ? DF_OK : df_restructure(field, &wanted, &other, err);
    if (status == DF_OK && !dense && band > df_restructure_band(written)) {
        status = df_fail(err, DF_ERROR_INPUT,
                         "%s: --band %g: the bricks hold all samples up to %.3f voxels from the surface only", path,
                         band, df_restructure_band(written));
    }
    if (status == DF_OK && !fits) other.provenance = field->provenance;
    if (status == DF_OK) status = dense ? df_array_write(written, path, err) : df_vdb_write(written, band, path, err);
    df_field_free(&other);
    return status;
}

/* The structure that the request leads to. */
static df_field_kind wanted_kind(const conversion *c) {
    const df_exchange_request *r = c->request;
    if (df_exchange_needs_dense(r->output)) return DF_FIELD_DENSE;
    if (r->structure) return r->structure;
    if (c->from_kind == DF_FIELD_DENSE && (strcmp(c->format, "dfield") == 0 || has_extension(r->output, ".vdb")))
        return DF_FIELD_DENSE;
    if (c->from_kind == DF_FIELD_ADF && !has_extension(r->output, ".vdb")) return DF_FIELD_ADF;
    return DF_FIELD_BRICKS;
}

/* Neighbouring coarse cells without bricks must lie on one side: in a .vdb nothing else makes sure of that. */
static df_status check_sides(const char *name, const df_field *f, df_error *err) {
    uint64_t step[3] = {1, f->cell_count[0], (uint64_t)f->cell_count[0] * f->cell_count[1]},
             total = step[2] * f->cell_count[2];
    for (uint64_t i = 0; i < total; i++) {
        uint64_t at[3] = {i % step[1], i / step[1] % f->cell_count[1], i / step[2]};
        for (int a = 0; a < 3; a++) {
            if (at[a] + 1 >= f->cell_count[a] || f->cells[i] < DF_CELL_INSIDE || f->cells[i + step[a]] < DF_CELL_INSIDE)
                continue;
            if (f->cells[i] == f->cells[i + step[a]]) continue;
            return df_fail(err, DF_ERROR_INPUT, "%s: its inside and outside touch without distances between them",
                           name);
        }
    }
    return DF_OK;
}

/* Counts the samples that stand at the end of a .vdb's band: less is known of them than they say. */
static uint64_t count_clipped(const df_field *field, float limit) {
    const float *samples = field->samples;
    uint64_t count = 0;
    for (uint64_t i = 0; i < field->sample_count; i++) count += fabsf(samples[i]) >= limit;
    return count;
}

static df_status read_vdb(conversion *c, df_error *err) {
    const df_exchange_request *r = c->request;
    df_vdb *vdb;
    df_vdb_info info;
    df_distance_source source;
    df_build_report report;
    double start = df_now_ms();
    df_status status = df_vdb_read(r->input, r->grid, r->brick_size ? r->brick_size : 8, &vdb, &info, err);
    if (status != DF_OK) return status;
    c->read_ms = df_now_ms() - start;
    c->band = info.band;
    if (info.version > info.known_version) {
        c->version = info.version;
        c->known_version = info.known_version;
    }
    snprintf(c->grid, sizeof c->grid, "%s", info.grid);
    df_vdb_source(vdb, &source);
    df_build_input input = {.name = r->input,
                            .kind = wanted_kind(c) == DF_FIELD_DENSE ? DF_FIELD_DENSE : DF_FIELD_BRICKS,
                            .lattice = &info.lattice,
                            .source = &source,
                            .keep = df_vdb_keeps_cell,
                            .keep_context = vdb,
                            .quiet = r->quiet};
    status = df_build(&input, &c->field, &report, err);
    for (int a = 0; status == DF_OK && a < 3; a++) c->field.voxel_size[a] = info.voxel_size[a];
    if (status == DF_OK && c->field.kind == DF_FIELD_BRICKS) status = check_sides(r->input, &c->field, err);
    if (status == DF_OK) c->clipped = count_clipped(&c->field, info.background);
    c->structure_ms = df_now_ms() - start - c->read_ms;
    df_vdb_free(vdb);
    return status;
}

static df_status read_field(conversion *c, df_error *err) {
    const char *path = c->request->input;
    double start = df_now_ms();
    df_status status = DF_OK;
    if (strcmp(c->format, "dfield") == 0) {
        status = df_field_read(path, DF_READ_COPY, &c->field, err);
        if (status == DF_OK) c->source = json_loads(c->field.provenance, 0, NULL);
    } else {
        status = df_array_read(path, c->request->voxel_size, &c->field, err);
    }
    c->from_kind = c->field.kind;
    c->read_ms = df_now_ms() - start;
    return status;
}

/* Brings the field that was read into the structure that is wanted, unless it is in it. */
static df_status change_structure(conversion *c, df_error *err) {
    const df_exchange_request *r = c->request;
    df_field_kind kind = wanted_kind(c);
    uint32_t own = c->field.kind == DF_FIELD_BRICKS ? c->field.brick_size : 8,
             size = r->brick_size ? r->brick_size : own;
    bool cut = r->band > 0 && !df_exchange_is_output(r->output); /* otherwise cut as it is written */
    if (cut && kind != DF_FIELD_DENSE)
        return df_fail(err, DF_ERROR_USAGE, "--band: for dense fields, .vdb, .npy and .nrrd");
    if (r->band > 0) c->band = c->band > 0 ? fmin(c->band, r->band) : r->band;
    bool same = kind == c->field.kind && (kind != DF_FIELD_BRICKS || size == own);
    if (r->fill && (kind != DF_FIELD_DENSE || c->field.kind != DF_FIELD_BRICKS))
        return df_fail(err, DF_ERROR_USAGE, "--fill: for dense fields of bricks");
    if (same && !cut) return DF_OK;
    if (r->fill) c->filled = df_restructure_band(&c->field);
    df_restructure_request wanted = {.name = r->input,
                                     .kind = kind,
                                     .brick_size = size,
                                     .band = cut ? r->band : 0,
                                     .fill = r->fill,
                                     .max_error = r->max_error * (r->max_in_world ? 1 : c->field.voxel_size[0]),
                                     .rms_error = r->rms_error * (r->rms_in_world ? 1 : c->field.voxel_size[0]),
                                     .allow_partial = r->allow_partial,
                                     .quiet = r->quiet};
    double start = df_now_ms();
    df_status status = restructure(&c->field, &wanted, err);
    c->structure_ms = df_now_ms() - start;
    return status;
}

/* What --samples auto may add to the largest error: a tenth of it, or a thousandth of a voxel where it is not known. */
static double auto_limit(const df_field *f) { return f->error_max >= 0 ? 0.1 * f->error_max : 1e-3 * f->voxel_size[0]; }

/* Brings the samples into the type that is wanted. */
static df_status change_samples(conversion *c, df_error *err) {
    static const df_sample_type types[] = {DF_SAMPLE_U8, DF_SAMPLE_U16, DF_SAMPLE_F32};
    const char *wanted = c->request->samples;
    const bool any = wanted && strcmp(wanted, "auto") == 0;
    for (int i = 0; wanted && i < 3; i++) {
        df_field other = {0};
        double added;
        if (!any && strcmp(wanted, df_sample_type_name(types[i])) != 0) continue;
        if (types[i] == c->field.sample_type) return DF_OK;
        df_status status = df_restructure_samples(&c->field, c->request->input, types[i], &added, &other, err);
        if (status != DF_OK) return status;
        const bool fits = !any || added <= auto_limit(&c->field);
        if (fits) {
            other.provenance = "{}";
            df_field_free(&c->field);
            c->field = other;
            return DF_OK;
        }
        df_field_free(&other);
    }
    return DF_OK;
}

/* The provenance: this step, and within it that of the file it came from. */
static df_status set_provenance(conversion *c, df_error *err) {
    json_t *root = json_pack("{s:s, s:s, s:s, s:s}", "program", "df-convert " DF_VERSION, "input", c->request->input,
                             "input_sha256", c->sha256, "format", c->format);
    if (root && c->grid[0]) json_object_set_new(root, "grid", json_string(c->grid));
    if (root && c->band > 0) json_object_set_new(root, "band_voxels", json_real(c->band));
    if (root && c->filled > 0) json_object_set_new(root, "filled_voxels", json_real(c->filled));
    if (root && c->clipped) json_object_set_new(root, "clipped_samples", json_integer((json_int_t)c->clipped));
    if (root && c->from_kind && c->from_kind != c->field.kind)
        json_object_set_new(root, "from_structure", json_string(df_field_kind_name(c->from_kind)));
    if (root && c->source) json_object_set(root, "source", c->source);
    char *text = root ? json_dumps(root, JSON_INDENT(1)) : NULL;
    json_decref(root);
    if (!text) return df_fail(err, DF_ERROR_MEMORY, "provenance: out of memory");
    df_field_own(&c->field, text);
    c->field.provenance = text;
    return DF_OK;
}

static void print_report(const conversion *c, uint64_t peak) {
    const df_field *f = &c->field;
    printf("read      %s", c->request->input);
    if (c->grid[0]) printf(", grid \"%s\"", c->grid);
    printf(", in %.0f ms\n", c->read_ms);
    printf("lattice   %" PRIu32 " x %" PRIu32 " x %" PRIu32 " voxels of %g\n", f->voxel_count[0], f->voxel_count[1],
           f->voxel_count[2], f->voxel_size[0]);
    if (c->band > 0) printf("band      distances end at %g voxels", c->band);
    if (c->clipped) printf(": %" PRIu64 " of %" PRIu64 " stored samples stand there", c->clipped, f->sample_count);
    if (c->band > 0) printf("\n");
    if (c->filled > 0)
        printf("filled    samples that no brick holds are %g voxels from the surface, or more\n", c->filled);
    printf("signs     as in the input: %s\n", df_verdict_name(f->verdict));
    if (f->kind == DF_FIELD_BRICKS)
        printf("bricks    %" PRIu32 " of %" PRIu32 "^3 voxels in %.0f ms\n", f->brick_count, f->brick_size,
               c->structure_ms);
    else
        printf("structure %s, %" PRIu64 " samples in %.0f ms\n", df_field_kind_name(f->kind), f->sample_count,
               c->structure_ms);
    if (c->from_kind == DF_FIELD_ADF && f->kind != DF_FIELD_ADF)
        printf("note      samples interpolated in the octree's leaves\n");
    if (c->version)
        printf("note      version %" PRIu32 " of the format is newer than %" PRIu32
               ", the last that OpenVDB knows here\n",
               c->version, c->known_version);
    printf("wrote     %s, %.2f MB, in %.0f ms\n", c->request->output, (double)c->bytes / 1e6, c->write_ms);
    printf("total     %.0f ms, peak memory %.0f MB\n", c->total_ms, (double)peak / 1e6);
}

static df_status print_json(const conversion *c, uint64_t peak, df_error *err) {
    const df_field *f = &c->field;
    const uint32_t *n = f->voxel_count;
    uint32_t longest = n[0] > n[1] ? n[0] : n[1];
    longest = n[2] > longest ? n[2] : longest;
    json_t *root = json_pack(
        "{s:s, s:s, s:s, s:s, s:s, s:s, s:I, s:[I,I,I], s:f, s:I, s:s, s:f, s:f, s:I, s:{s:f, s:f, s:f}, s:f, s:I}",
        "input", c->request->input, "input_sha256", c->sha256, "format", c->format, "output", c->request->output,
        "structure", df_field_kind_name(f->kind), "samples", df_sample_type_name(f->sample_type), "resolution",
        (json_int_t)longest, "voxels", (json_int_t)n[0], (json_int_t)n[1], (json_int_t)n[2], "voxel_size",
        f->voxel_size[0], "bytes", (json_int_t)c->bytes, "verdict", df_verdict_name(f->verdict), "max_error",
        f->error_max, "rms_error", f->error_rms, "clipped_samples", (json_int_t)c->clipped, "phases", "read_ms",
        c->read_ms, "structure_ms", c->structure_ms, "write_ms", c->write_ms, "total_ms", c->total_ms, "peak_bytes",
        (json_int_t)peak);
    if (root && c->grid[0]) json_object_set_new(root, "grid", json_string(c->grid));
    if (root && c->band > 0) json_object_set_new(root, "band_voxels", json_real(c->band));
    if (root && c->version) json_object_set_new(root, "unknown_version", json_integer(c->version));
    if (root && f->kind == DF_FIELD_BRICKS) json_object_set_new(root, "bricks", json_integer(f->brick_count));
    bool printed = root && json_dumpf(root, stdout, JSON_INDENT(1)) == 0 && printf("\n") > 0;
    json_decref(root);
    return printed ? DF_OK : df_fail(err, DF_ERROR_IO, "standard output: cannot write");
}

static df_status report(conversion *c, double start, df_error *err) {
    struct stat info;
    struct rusage usage;
    uint64_t peak = getrusage(RUSAGE_SELF, &usage) == 0 ? (uint64_t)usage.ru_maxrss * 1024 : 0;
    if (stat(c->request->output, &info) == 0) c->bytes = (uint64_t)info.st_size;
    c->total_ms = df_now_ms() - start;
    if (c->request->json) return print_json(c, peak, err);
    if (!c->request->quiet) print_report(c, peak);
    return DF_OK;
}

df_status df_exchange_convert(const df_exchange_request *r, df_error *err) {
    double start = df_now_ms();
    conversion c = {.request = r};
    df_array_format array = df_array_format_of(r->input);
    c.format = array == DF_ARRAY_NPY             ? "npy"
               : array == DF_ARRAY_NRRD          ? "nrrd"
               : has_extension(r->input, ".vdb") ? "vdb"
                                                 : "dfield";
    bool is_vdb = strcmp(c.format, "vdb") == 0;
    df_status status = df_output_check(r->output, err);
    if (status == DF_OK) status = is_vdb ? read_vdb(&c, err) : read_field(&c, err);
    if (status == DF_OK) status = change_structure(&c, err);
    if (status == DF_OK) status = change_samples(&c, err);
    if (status == DF_OK && df_field_surface_voxel_count(&c.field) == 0) {
        status = df_fail(err, DF_ERROR_INPUT, "%s: no surface: its samples are all on one side of zero", r->input);
    }
    if (status == DF_OK) status = df_sha256_file(r->input, c.sha256, err);
    if (status == DF_OK) status = set_provenance(&c, err);
    double built = df_now_ms();
    if (status == DF_OK) status = df_exchange_write(&c.field, r->output, r->band, err);
    c.write_ms = df_now_ms() - built;
    if (status == DF_OK) status = report(&c, start, err);
    json_decref(c.source);
    df_field_free(&c.field);
    return status;
}
