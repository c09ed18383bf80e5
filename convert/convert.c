#include "convert/convert.h"

#include "common/output_file.h"
#include "common/progress.h"
#include "convert/adf.h"
#include "convert/exchange.h"
#include "convert/input.h"
#include "convert/measure.h"
#include "convert/quantise.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>

/* The options that shaped the field, for the provenance. */
static json_t *json_options(const df_request *r) {
    json_t *o = json_pack("{s:s, s:f}", "structure", df_field_kind_name(r->structure), "padding", r->padding);
    json_object_set_new(o, "samples", json_string(df_request_sample_names[r->samples]));
    if (r->voxel_size > 0) json_object_set_new(o, "voxel_size", json_real(r->voxel_size));
    else json_object_set_new(o, "resolution", json_integer(r->resolution ? r->resolution : 256));
    const df_error_bound largest = df_request_max_error(r), *rms = &r->rms_error;
    if (largest.value >= 0 && isfinite(largest.value))
        json_object_set_new(o, largest.in_world ? "max_error_world" : "max_error", json_real(largest.value));
    if (rms->value >= 0) json_object_set_new(o, rms->in_world ? "rms_error_world" : "rms_error", json_real(rms->value));
    if (r->structure == DF_FIELD_BRICKS) json_object_set_new(o, "brick", json_integer(r->brick_size));
    return o;
}

static df_status finish_field(const df_request *r, const df_input *s, df_field *field, df_convert_report *report,
                              df_error *err) {
    if (!report->is_shape && (r->distance == DF_DISTANCE_CGAL || r->sign == DF_SIGN_NORMAL) &&
        report->cleaning.zero_area == 0 && report->edges.border_count == 0) {
        df_status status = df_input_check_signs(s, field, report, err);
        if (status != DF_OK) return status;
    }
    field->verdict = df_input_judge_signs(r, s, report);
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

static df_status start_octree(const df_request *r, df_input *s, const df_lattice *lattice, octree *o, df_field *field,
                              const df_convert_report *report, df_error *err) {
    const df_error_bound largest = df_request_max_error(r);
    const bool from_tree = !report->is_shape && r->distance == DF_DISTANCE_EXACT;
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
                          .max_error = df_error_bound_in_world(&largest, lattice->voxel_size),
                          .rms_error = df_error_bound_in_world(&r->rms_error, lattice->voxel_size),
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
    report->build.wall_count = adf->wall_count;
    memcpy(report->build.wall_place, adf->wall_place, sizeof adf->wall_place);
    report->leaves = adf->leaves;
    report->divided_for_continuity = adf->divided_for_continuity;
}

/* Measures the field against its source. */
static df_status measure_error(const df_request *r, const df_input *s, const df_distance_source *source,
                               df_field *field, df_convert_report *report, df_error *err) {
    if (r->distance == DF_DISTANCE_OPENVDB || r->measure == 0) return DF_OK;
    bool same_tree = !report->is_shape && r->distance == DF_DISTANCE_EXACT && s->sign.mesh == &s->mesh;
    df_truth truth = {source, &s->sign, same_tree ? df_distance_exact_tree(source) : NULL};
    double start = df_now_ms();
    df_status status = df_measure_error(&truth, r->measure, field, err);
    report->measure_ms += df_now_ms() - start;
    return status;
}

/* By how much the error is larger than asked, as a factor. */
static double excess_error(const df_request *r, const df_field *field) {
    double size = field->voxel_size[0], largest = df_error_bound_in_world(&r->max_error, size),
           rms = df_error_bound_in_world(&r->rms_error, size);
    return fmax(field->error_max / fmax(largest, 1e-300), field->error_rms / fmax(rms, 1e-300));
}

/* Quantises the samples, and measures again. */
static df_status quantise(const df_request *r, const df_input *s, df_sample_type type, df_field *field,
                          df_field *smaller, df_convert_report *report, df_error *err) {
    df_status status = df_quantise(field, type, smaller, err);
    return status == DF_OK ? measure_error(r, s, &s->source, smaller, report, err) : status;
}

/* The smallest type that keeps the error as --samples auto says. */
static df_status quantise_as_fits(const df_request *r, const df_input *s, df_field *field, df_convert_report *report,
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
static df_status store_samples(const df_request *r, const df_input *s, df_field *field, df_convert_report *report,
                               df_error *err) {
    if (r->samples == DF_SAMPLES_U16 || r->samples == DF_SAMPLES_U8) {
        df_field smaller;
        df_status status =
            quantise(r, s, r->samples == DF_SAMPLES_U16 ? DF_SAMPLE_U16 : DF_SAMPLE_U8, field, &smaller, report, err);
        if (status != DF_OK) return status;
        df_field_free(field);
        *field = smaller;
        return DF_OK;
    }
    df_status status = measure_error(r, s, &s->source, field, report, err);
    return status == DF_OK && r->samples == DF_SAMPLES_AUTO ? quantise_as_fits(r, s, field, report, err) : status;
}

static df_status check_error(const df_request *r, const df_field *field, df_error *err) {
    if (r->allow_partial || !(excess_error(r, field) > 1)) return DF_OK;
    const bool largest = field->error_max > df_error_bound_in_world(&r->max_error, field->voxel_size[0]);
    const df_error_bound *bound = largest ? &r->max_error : &r->rms_error;
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
static df_status build_octree(const df_request *r, df_input *s, const df_lattice *lattice, df_field *field,
                              df_convert_report *report, df_error *err) {
    const double rms = df_error_bound_in_world(&r->rms_error, lattice->voxel_size);
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

static df_status build_field(const df_request *r, df_input *s, df_field *field, df_convert_report *report,
                             df_error *err) {
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
    status = df_input_make_source(r, s, &lattice, report, err);
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
static df_status build_as_asked(const df_request *r, df_input *s, df_field *field, df_convert_report *report,
                                df_error *err) {
    df_request attempt = *r;
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
static void settle_bound(df_request *r, const df_input *s) {
    double longest = 0, diagonal = 0;
    for (int a = 0; a < 3; a++) {
        double side = s->high[a] - s->low[a];
        longest = fmax(longest, side);
        diagonal += side * side;
    }
    const double distance = r->view_distance > 0 ? r->view_distance : 1.6, field_of_view = 1; /* radian, vertical */
    const double nearest = fmax(distance * longest - sqrt(diagonal) / 2, 0.01 * longest);
    const double footprint = 2 * tan(field_of_view / 2) * nearest / (r->view_height ? r->view_height : 1024);
    r->max_error = (df_error_bound){footprint / 2, true};
    if (r->structure == DF_FIELD_ADF && r->resolution == 0 && !(r->voxel_size > 0))
        r->resolution = (uint32_t)fmin(ceil(longest / footprint + 2 * r->padding), SEARCH_LAST);
}

df_status df_convert(df_request *r, const char *output, df_error *err) {
    double start = df_now_ms();
    df_convert_report report = {.input = r->input, .output = output};
    df_input s = {0};
    df_field field = {0};
    df_status status = df_output_check(output, err);
    if (status == DF_OK) status = df_input_read(r, &s, &report, err);
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
    df_input_free(&s);
    df_field_free(&field);
    return status;
}
