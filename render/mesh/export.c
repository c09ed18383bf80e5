#include "render/mesh/export.h"

#include "render/mesh/mesh_normals.h"
#include "render/methods/gradient.h"

#include <inttypes.h>
#include <jansson.h>
#include <stdio.h>

const char *const df_mc_method_names[] = {"correct", "classic", NULL};

static df_status print_report(const df_mc_mesh *mesh, const df_export_options *options, double extract_ms,
                              double write_ms, df_error *err) {
    uint64_t bytes = df_mc_mesh_bytes(mesh);
    if (!options->json) {
        printf("%s: %" PRIu32 " vertices, %" PRIu32
               " triangles, %.1f MB in memory; extracted in %.1f ms, written in %.1f ms\n",
               options->path, mesh->vertex_count, mesh->triangle_count, (double)bytes * 1e-6, extract_ms, write_ms);
        return DF_OK;
    }
    json_t *json = json_pack("{s:s, s:s, s:s, s:I, s:I, s:I, s:f, s:f}", "field", options->field_path, "mesh",
                             options->path, "topology", df_mc_method_names[options->method], "vertices",
                             (json_int_t)mesh->vertex_count, "triangles", (json_int_t)mesh->triangle_count, "bytes",
                             (json_int_t)bytes, "extract_ms", extract_ms, "write_ms", write_ms);
    if (!json) return df_fail(err, DF_ERROR_MEMORY, "out of memory");
    json_dumpf(json, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(9));
    printf("\n");
    json_decref(json);
    return DF_OK;
}

df_status df_export_mesh(const df_field *field, const df_export_options *options, df_error *err) {
    df_mc_mesh mesh;
    df_progress progress;
    double start = df_now_ms();
    df_progress_begin(&progress, "mesh", df_mc_mesh_work(field), options->quiet);
    const df_mc_params params = {
        .iso = options->iso, .method = options->method, .thread_count = options->threads, .progress = &progress};
    df_status status = df_mc_extract(field, options->field_path, &params, &mesh, err);
    df_progress_end(&progress);
    if (status == DF_OK && options->gradient != DF_GRADIENT_CORNER_CENTRAL) /* those are the mesh's own */
        status = df_mc_mesh_renew_normals(&mesh, field, &params, options->gradient, err);
    double extracted = df_now_ms();
    if (status == DF_OK) {
        df_progress_begin(&progress, "write", df_mc_mesh_write_work(&mesh), options->quiet);
        status = df_mc_mesh_write(&mesh, field, options->path, &progress, err);
        df_progress_end(&progress);
    }
    double written = df_now_ms();
    if (status == DF_OK && (options->stats || options->json)) {
        status = print_report(&mesh, options, extracted - start, written - extracted, err);
    }
    df_mc_mesh_free(&mesh);
    return status;
}
