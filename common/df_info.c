/* df-info: what a .dfield file holds. */
#include "common/field_file.h"
#include "common/image.h"
#include "common/interrupt.h"
#include "common/options.h"
#include "common/output_file.h"
#include "common/slice.h"
#include "common/version.h"

#include <argp.h>
#include <errno.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

typedef struct options {
    const char *field_path;
    const char *query_path;
    const char *slice_text;
    const char *output_path;
    uint32_t longest;
    bool json;
} options;

static const struct argp_option option_table[] = {
    {"json", 'j', 0, 0, "Print one JSON object", 0},
    {"slice", 's', "AXIS=PART", 0,
     "Draw a plane through the field as a PNG: z=0.5 is half way up the box. Black is the surface, thin lines are "
     "contours, outlines "
     "are the cells that the structure stores",
     0},
    {"output", 'o', "FILE", 0, "Name of the slice (default: FIELD with .png)", 0},
    {"pixels", 'p', "N", 0, "Longer side of the slice (default 1024)", 0},
    {"query", 'q', "POINTS", 0,
     "Print value, gradient and side (outside, inside, surface voxel) at each point of a text file with lines of x y z "
     "in "
     "world units; - reads standard input",
     0},
    {0},
};

static error_t on_option(int key, char *argument, struct argp_state *state) {
    options *opts = state->input;
    df_error err = {0};
    switch (key) {
    case 'j': opts->json = true; return 0;
    case 's': opts->slice_text = argument; return 0;
    case 'o': opts->output_path = argument; return 0;
    case 'p':
        if (df_parse_u32("--pixels", argument, 1, 16384, &opts->longest, &err) != DF_OK)
            argp_error(state, "%s", err.text);
        return 0;
    case 'q': opts->query_path = argument; return 0;
    case ARGP_KEY_ARG:
        if (state->arg_num > 0) argp_error(state, "one file at a time: '%s' is too much", argument);
        opts->field_path = argument;
        return 0;
    case ARGP_KEY_NO_ARGS: argp_usage(state); return 0;
    case ARGP_KEY_END:
        if (opts->slice_text && (opts->json || opts->query_path))
            argp_error(state, "--slice goes without --json and --query");
        if (!opts->slice_text && (opts->output_path || opts->longest))
            argp_error(state, "--output and --pixels are for --slice");
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static json_t *numbers(const double *values, size_t count) {
    json_t *array = json_array();
    for (size_t i = 0; i < count; i++) json_array_append_new(array, json_real(values[i]));
    return array;
}

/* The field as a JSON object; NULL when memory is short. */
static json_t *describe(const char *path, const df_field *field, const df_section_info *sections,
                        uint32_t section_count) {
    char checksum[9];
    snprintf(checksum, sizeof checksum, "%08" PRIx32, field->checksum);
    json_t *json = json_pack(
        "{s:s, s:s, s:s, s:s, s:[iii], s:o, s:o, s:[ff], s:I, s:s, s:o, s:o}", "file", path, "structure",
        df_field_kind_name(field->kind), "samples", df_sample_type_name(field->sample_type), "checksum", checksum,
        "voxels", field->voxel_count[0], field->voxel_count[1], field->voxel_count[2], "voxel_size",
        numbers(field->voxel_size, 3), "origin", numbers(field->origin, 3), "value_range", (double)field->value_min,
        (double)field->value_max, "sample_count", (json_int_t)field->sample_count, "verdict",
        df_verdict_name(field->verdict), "max_error", field->error_max < 0 ? json_null() : json_real(field->error_max),
        "rms_error", field->error_rms < 0 ? json_null() : json_real(field->error_rms));
    if (!json) return NULL;
    json_object_set_new(json, "surface_voxels", json_integer((json_int_t)df_field_surface_voxel_count(field)));
    if (field->kind == DF_FIELD_BRICKS) {
        uint64_t cell_total = (uint64_t)field->cell_count[0] * field->cell_count[1] * field->cell_count[2], inside = 0;
        for (uint64_t i = 0; i < cell_total; i++) inside += field->cells[i] == DF_CELL_INSIDE;
        json_object_set_new(json, "brick_size", json_integer(field->brick_size));
        json_object_set_new(json, "bricks", json_integer(field->brick_count));
        json_object_set_new(json, "cells_inside", json_integer((json_int_t)inside));
        json_object_set_new(json, "cells_outside",
                            json_integer((json_int_t)(cell_total - inside - field->brick_count)));
    }
    if (field->kind == DF_FIELD_ADF) {
        json_object_set_new(json, "levels", json_integer(field->level_count));
        json_object_set_new(json, "families", json_integer(field->family_count));
        json_object_set_new(json, "leaves", json_integer(7 * (json_int_t)field->family_count + 1));
    }
    json_t *list = json_object();
    uint64_t bytes = 0;
    for (uint32_t i = 0; i < section_count; i++) {
        json_object_set_new(list, sections[i].name, json_integer((json_int_t)sections[i].size));
        bytes = sections[i].offset + sections[i].size;
    }
    json_object_set_new(json, "bytes", json_integer((json_int_t)bytes));
    json_object_set_new(json, "sections", list);
    json_object_set_new(json, "provenance", json_loads(field->provenance, 0, NULL));
    return json;
}

static void print_text(const char *path, const df_field *field, const json_t *json) {
    const uint32_t *n = field->voxel_count;
    const double *h = field->voxel_size, *o = field->origin;
    printf("%s: %s of %s samples, checksums verified (%08" PRIx32 ")\n", path, df_field_kind_name(field->kind),
           df_sample_type_name(field->sample_type), field->checksum);
    printf("  voxels        %u x %u x %u, %" PRIu64 " at the surface\n", n[0], n[1], n[2],
           (uint64_t)json_integer_value(json_object_get(json, "surface_voxels")));
    printf("  voxel size    %.9g x %.9g x %.9g world units\n", h[0], h[1], h[2]);
    printf("  box           (%.9g, %.9g, %.9g) to (%.9g, %.9g, %.9g)\n", o[0], o[1], o[2], o[0] + h[0] * n[0],
           o[1] + h[1] * n[1], o[2] + h[2] * n[2]);
    printf("  values        %.9g to %.9g, %" PRIu64 " samples\n", (double)field->value_min, (double)field->value_max,
           field->sample_count);
    if (field->kind == DF_FIELD_BRICKS) {
        printf("  bricks        %u of %u^3 voxels; cells without one: %" JSON_INTEGER_FORMAT
               " outside, %" JSON_INTEGER_FORMAT " inside\n",
               field->brick_count, field->brick_size, json_integer_value(json_object_get(json, "cells_outside")),
               json_integer_value(json_object_get(json, "cells_inside")));
    }
    if (field->kind == DF_FIELD_ADF) {
        printf("  octree        %u levels, %u families, %" PRIu64 " leaves\n", field->level_count, field->family_count,
               7 * (uint64_t)field->family_count + 1);
    }
    printf("  signs         %s\n", df_verdict_name(field->verdict));
    if (field->error_max >= 0) {
        printf("  error         at most %.3g, RMS %.3g world units (measured)\n", field->error_max, field->error_rms);
    }
    printf("  bytes         %" JSON_INTEGER_FORMAT ":", json_integer_value(json_object_get(json, "bytes")));
    const char *name;
    json_t *value;
    json_object_foreach(json_object_get(json, "sections"), name, value) {
        printf(" %s %" JSON_INTEGER_FORMAT, name, json_integer_value(value));
    }
    printf("\n");
    json_object_foreach(json_object_get(json, "provenance"), name, value) {
        char *text = json_dumps(value, JSON_ENCODE_ANY | JSON_COMPACT | JSON_REAL_PRECISION(9));
        printf("  %-13s %s\n", name, text ? text : "?");
        free(text);
    }
}

static const char *side_name(const df_point_info *info) {
    if (info->side == DF_SIDE_BEYOND) return "beyond";
    if (info->surface) return info->side == DF_SIDE_INSIDE ? "inside,surface" : "outside,surface";
    return info->side == DF_SIDE_INSIDE ? "inside" : "outside";
}

static void print_point(const df_field *field, const double point[3], json_t *list) {
    df_point_info info;
    df_field_query(field, point, &info);
    if (list) {
        json_t *entry = json_pack("{s:o, s:s}", "point", numbers(point, 3), "side", side_name(&info));
        if (info.stored) {
            json_object_set_new(entry, "value", json_real(info.value));
            json_object_set_new(entry, "gradient", numbers(info.gradient, 3));
        }
        json_array_append_new(list, entry);
    } else if (info.stored) {
        printf("%.9g %.9g %.9g  %.9g  %.9g %.9g %.9g  %s\n", point[0], point[1], point[2], info.value, info.gradient[0],
               info.gradient[1], info.gradient[2], side_name(&info));
    } else {
        printf("%.9g %.9g %.9g  -  - - -  %s\n", point[0], point[1], point[2], side_name(&info));
    }
}

/* Answers the points of a text file; blank lines and lines from # on are skipped. With `list` into that, else to
 * stdout. */
static df_status answer_queries(const df_field *field, const char *path, json_t *list, df_error *err) {
    bool standard = strcmp(path, "-") == 0;
    FILE *file = standard ? stdin : fopen(path, "r");
    if (!file) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    char *line = NULL;
    size_t capacity = 0;
    df_status status = DF_OK;
    if (!list) printf("# x y z  value  gradient  side\n");
    for (unsigned long number = 1; getline(&line, &capacity, file) >= 0; number++) {
        double point[3];
        char rest;
        line[strcspn(line, "#\n\r")] = 0;
        if (line[strspn(line, " \t")] == 0) continue;
        if (sscanf(line, "%lf %lf %lf %c", &point[0], &point[1], &point[2], &rest) != 3) {
            status = df_fail(err, DF_ERROR_INPUT, "%s:%lu: expected three numbers x y z", path, number);
            break;
        }
        print_point(field, point, list);
    }
    if (status == DF_OK && ferror(file)) status = df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    free(line);
    if (!standard) fclose(file);
    return status;
}

static df_status draw_slice(const options *opts, const df_field *field, df_error *err) {
    df_slice slice = {.longest = opts->longest};
    char *path = opts->output_path ? strdup(opts->output_path) : df_path_with_extension(opts->field_path, ".png", 1);
    uint8_t *rgb = NULL;
    uint32_t width, height;
    double contour_voxels;
    df_status status = path ? df_output_check(path, err) : df_fail(err, DF_ERROR_MEMORY, "out of memory");
    if (status == DF_OK) status = df_slice_parse("--slice", opts->slice_text, &slice, err);
    if (status == DF_OK) status = df_slice_draw(field, &slice, &rgb, &width, &height, &contour_voxels, err);
    if (status == DF_OK) status = df_image_write_png(path, rgb, width, height, NULL, 0, err);
    if (status == DF_OK) printf("%s: %u x %u pixels, contours %g voxels apart\n", path, width, height, contour_voxels);
    free(rgb);
    free(path);
    return status;
}

static df_status run(const options *opts, df_error *err) {
    df_field field;
    df_section_info sections[DF_SECTION_COUNT_MAX];
    uint32_t section_count;
    df_status status = df_field_read(opts->field_path, DF_READ_COPY, &field, err);
    if (status != DF_OK) return status;
    json_t *json = NULL;
    if (opts->slice_text) {
        status = draw_slice(opts, &field, err);
        goto done;
    }
    status = df_field_sections(opts->field_path, sections, &section_count, err);
    if (status != DF_OK) goto done;
    json = describe(opts->field_path, &field, sections, section_count);
    if (!json) {
        status = df_fail(err, DF_ERROR_MEMORY, "%s: out of memory", opts->field_path);
        goto done;
    }
    if (opts->json) {
        if (opts->query_path) {
            json_t *list = json_array();
            json_object_set_new(json, "query", list);
            status = answer_queries(&field, opts->query_path, list, err);
        }
        if (status == DF_OK) {
            json_dumpf(json, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(17));
            printf("\n");
        }
    } else if (opts->query_path) {
        status = answer_queries(&field, opts->query_path, NULL, err);
    } else {
        print_text(opts->field_path, &field, json);
    }
done:
    json_decref(json);
    df_field_free(&field);
    return status;
}

int main(int argc, char **argv) {
    static const struct argp argp = {
        option_table,
        on_option,
        "FIELD",
        "Verifies a .dfield file and prints what it holds: structure, grid, values, bytes by section, provenance.",
        0,
        0,
        0};
    argp_program_version = "df-info " DF_VERSION;
    argp_err_exit_status = 2;
    df_interrupt_install("df-info");
    df_output_watch_standard("df-info");
    options opts = {0};
    df_error err = {0};
    argp_parse(&argp, argc, argv, 0, NULL, &opts);
    df_status status = run(&opts, &err);
    if (status != DF_OK) fprintf(stderr, "df-info: %s\n", err.text);
    return df_exit_code(status);
}
