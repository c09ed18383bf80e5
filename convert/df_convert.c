/* df-convert: triangle meshes and analytic shapes to signed distance fields. */
#include "common/interrupt.h"
#include "common/options.h"
#include "common/output_file.h"
#include "common/version.h"
#include "convert/convert.h"
#include "convert/exchange.h"
#include "convert/mesh_check.h"
#include "convert/mesh_read.h"
#include "convert/shape.h"

#include <argp.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

#define PROGRAM "df-convert"

const char *argp_program_version = PROGRAM " " DF_VERSION " (CGAL 5.5, OpenVDB 10.0, tinyobjloader 2.0, OpenMP)";

static df_status check_mesh(const df_request *r, df_error *err) {
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

static df_status convert_field(const df_request *r, const char *output, df_error *err) {
    const df_error_bound largest = df_request_max_error(r);
    df_exchange_request wanted = {.input = r->input,
                                  .output = output,
                                  .samples = r->samples_given ? df_request_sample_names[r->samples] : NULL,
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
    df_request r;
    df_interrupt_install(PROGRAM);
    df_output_watch_standard(PROGRAM);
    df_status status = df_request_parse(argc, argv, &r, &err);
    if (status == DF_OK && r.threads) omp_set_num_threads((int)r.threads);
    char *derived = status == DF_OK && !r.output ? default_output(r.input) : NULL;
    const char *output = r.output ? r.output : derived;
    if (status == DF_OK && !output) status = df_fail(&err, DF_ERROR_MEMORY, "out of memory");
    if (status == DF_OK && df_exchange_is_input(r.input)) status = convert_field(&r, output, &err);
    else if (status == DF_OK) status = r.check ? check_mesh(&r, &err) : df_convert(&r, output, &err);
    if (status != DF_OK) fprintf(stderr, PROGRAM ": %s\n", err.text);
    free(derived);
    return df_exit_code(status);
}
