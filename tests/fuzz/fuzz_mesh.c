/* The mesh readers and what cleans up after them. The first byte of the input chooses the format. */
#include "convert/mesh.h"
#include "convert/mesh_formats.h"
#include "fuzz.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static df_status (*const parsers[])(char *, size_t, const char *, df_mesh_builder *, df_error *) = {
        df_mesh_parse_obj, df_mesh_parse_ply, df_mesh_parse_off, df_mesh_parse_stl};
    if (size < 2) return 0;
    char *text = malloc(size);
    if (!text) abort();
    memcpy(text, data + 1, size - 1);
    text[size - 1] = 0;
    df_mesh_builder builder = {0};
    df_mesh mesh = {0};
    df_error err = {0};
    df_status status = parsers[data[0] % 4](text, size - 1, "input", &builder, &err);
    free(text);
    if (status == DF_OK) status = df_mesh_builder_finish(&builder, "input", &mesh, &err);
    else df_mesh_builder_free(&builder);
    df_mesh_cleaning cleaning = {0};
    df_mesh_edges edges = {0};
    if (status == DF_OK) status = df_mesh_clean(&mesh, "input", &cleaning, &err);
    if (status == DF_OK) status = df_mesh_find_edges(&mesh, &edges, &err);
    if (status != DF_OK && !err.text[0]) abort(); /* refused without a reason */
    free(edges.borders);
    df_mesh_free(&mesh);
    return 0;
}
