/* make_seeds FOLDER: writes the seed corpora: small valid inputs of every kind, in FOLDER/dfield, FOLDER/mesh,
 * FOLDER/arrays, FOLDER/vdb, FOLDER/trace and FOLDER/options. */
#include "../fields.h"
#include "common/field_file.h"
#include "convert/array_file.h"
#include "convert/vdb.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

static const char *folder;

static void put(const char *corpus, const char *name, int first, const void *data, size_t size) {
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", folder, corpus);
    if (mkdir(path, 0777) != 0 && errno != EEXIST) exit(1);
    snprintf(path, sizeof path, "%s/%s/%s", folder, corpus, name);
    FILE *file = fopen(path, "wb");
    if (!file) exit(1);
    if (first >= 0) fputc(first, file);
    fwrite(data, 1, size, file);
    if (fclose(file) != 0) exit(1);
}

static void put_field(df_field *field) {
    static uint8_t bytes[1 << 20];
    char path[4096], name[64];
    df_error err = {0};
    snprintf(path, sizeof path, "%s/seed.dfield", folder);
    if (df_field_write(field, path, &err) != DF_OK) exit(1);
    FILE *file = fopen(path, "rb");
    size_t size = file ? fread(bytes, 1, sizeof bytes, file) : 0;
    if (!file || fclose(file) != 0) exit(1);
    for (int mode = 0; mode < 3; mode++) {
        snprintf(name, sizeof name, "%s-%s-%d", df_field_kind_name(field->kind),
                 df_sample_type_name(field->sample_type), mode);
        put("dfield", name, mode, bytes, size);
    }
    remove(path);
}

/* Fields of all kinds and types. */
static void put_fields(void) {
    const uint32_t voxels[3] = {7, 5, 6};
    for (int kind = DF_FIELD_DENSE; kind <= DF_FIELD_ADF; kind++) {
        for (int type = DF_SAMPLE_F32; type <= DF_SAMPLE_U8; type++) {
            df_field field;
            df_error err = {0};
            if (test_field_sphere(&field, (df_field_kind)kind, 4, voxels, 1.7, &err) != DF_OK) exit(1);
            if (type != DF_SAMPLE_F32 && test_field_quantise(&field, (df_sample_type)type, &err) != DF_OK) exit(1);
            put_field(&field);
            df_field_free(&field);
        }
    }
}

/* A file that a library wrote, with a first byte that says which. */
static void put_file(const char *corpus, const char *name, int first, const char *path) {
    static uint8_t bytes[1 << 20];
    FILE *file = fopen(path, "rb");
    const size_t size = file ? fread(bytes, 1, sizeof bytes, file) : 0;
    if (!file || fclose(file) != 0) exit(1);
    put(corpus, name, first, bytes, size);
    remove(path);
}

static void put_other_programs(void) {
    static const char *const names[] = {"sphere.npy", "sphere.nrrd", "sphere.vdb"};
    const uint32_t voxels[3] = {7, 5, 6};
    df_field field;
    df_error err = {0};
    if (test_field_sphere(&field, DF_FIELD_DENSE, 0, voxels, 1.7, &err) != DF_OK) exit(1);
    for (int i = 0; i < 3; i++) {
        char path[4096];
        snprintf(path, sizeof path, "%s/%s", folder, names[i]);
        if ((i < 2 ? df_array_write(&field, path, &err) : df_vdb_write(&field, 0, path, &err)) != DF_OK) exit(1);
        put_file(i < 2 ? "arrays" : "vdb", names[i], i < 2 ? i : -1, path);
    }
    df_field_free(&field);
}

/* Samples of every structure for fuzz_trace: a wave, and noise. */
static void put_traces(void) {
    for (uint8_t kind = 0; kind < 6; kind++) {
        uint8_t bytes[8 + 512] = {kind, kind / 3 * 3, 7, 5, 10, 0, kind, 0};
        char name[16];
        uint32_t random = 12345;
        for (int i = 0; i < 512; i++) {
            random = random * 1664525u + 1013904223u;
            bytes[8 + i] = kind < 3 ? (uint8_t)(i % 13 * 9 - 50) : (uint8_t)(random >> 24);
        }
        snprintf(name, sizeof name, "%d", kind);
        put("trace", name, -1, bytes, sizeof bytes);
    }
}

static void put_text(const char *name, int format, const char *text) { put("mesh", name, format, text, strlen(text)); }

static void put_meshes(void) {
    put_text("tetrahedron.obj", 0,
             "# t\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvn 0 0 1\nf 1/1/1 3/1/1 2/1/1\nf -4 -3 -1\nf 2//1 3//1 "
             "4//1\nf 1 4 3\n");
    put_text("quad.obj", 0, "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 2 2\nf 1 2 3 4 5\nf 1 \\\n 2 3\n");
    put_text("ascii.ply", 1,
             "ply\nformat ascii 1.0\ncomment c\nelement vertex 4\nproperty float x\nproperty double y\nproperty float "
             "z\nproperty uchar red\n"
             "element face 4\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1\n1 0 0 2\n0 1 0 3\n0 0 1 "
             "4\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n");
    put_text("strips.ply", 1,
             "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
             "element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n6 0 1 "
             "2 3 -1 0\n");
    put("mesh", "binary.ply", 1,
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float "
        "z\nelement face 1\n"
        "property list uchar int "
        "vertex_indices\nend_"
        "header\n\0\0\0\0\0\0\0\0\0\0\0\0\0\0\200\77\0\0\0\0\0\0\0\0\0\0\0\0\0\0\200\77\0\0\0\0\3\0\0\0\0\1\0\0\0\2\0\0"
        "\0",
        211);
    put_text("tetrahedron.off", 2, "OFF\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n");
    put_text("ascii.stl", 3,
             "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 "
             "0\nendloop\nendfacet\nendsolid a\n");
    uint8_t stl[84 + 50] = "binary";
    const float corners[12] = {0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0};
    stl[80] = 1;
    memcpy(stl + 84, corners, sizeof corners);
    put("mesh", "binary.stl", 3, stl, sizeof stl);
}

int main(int argc, char **argv) {
    if (argc != 2) return 2;
    folder = argv[1];
    if (mkdir(folder, 0777) != 0 && errno != EEXIST) return 1;
    put_fields();
    put_meshes();
    put_other_programs();
    put_traces();
    static const char *const options[] = {"256", "1280x1024", "-1.5e-3", "1,2.5,-3", "bricks", "z=0.5", "a b'c/d.obj"};
    for (size_t i = 0; i < sizeof options / sizeof options[0]; i++) {
        char name[8];
        snprintf(name, sizeof name, "%zu", i);
        put("options", name, -1, options[i], strlen(options[i]));
    }
    return 0;
}
