#include "render/mesh/mesh_file.h"
#include "common/memory.h"
#include "common/output_file.h"
#include "common/version.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* A file that is written in pieces of some size: `used` bytes of `buffer` wait. */
enum { BUFFER_SIZE = 1 << 18, RECORD_MAX = 256 };
typedef struct stream {
    df_output output;
    char *buffer;
    size_t used;
    uint64_t records; /* since the last flush, for the progress */
    df_progress *progress;
    df_status status;
    df_error *err;
} stream;

static void flush(stream *s) {
    if (s->status == DF_OK && s->used) s->status = df_output_write(&s->output, s->buffer, s->used, s->err);
    s->used = 0;
    df_progress_add(s->progress, s->records);
    s->records = 0;
}

/* Room for a record of at most RECORD_MAX bytes; the caller adds what it used to s->used. */
static char *room(stream *s) {
    if (s->used + RECORD_MAX > BUFFER_SIZE) flush(s);
    return s->buffer + s->used;
}

static void put(stream *s, const void *data, size_t size) {
    assert(size <= RECORD_MAX);
    memcpy(room(s), data, size);
    s->used += size;
}

static const char *extension(const char *path) {
    const char *dot = strrchr(path, '.'), *slash = strrchr(path, '/');
    return dot && (!slash || dot > slash) ? dot : "";
}

df_status df_mc_mesh_check_path(const char *path, df_error *err) {
    const char *known[] = {".ply", ".obj", ".stl"};
    for (int i = 0; i < 3; i++) {
        if (strcasecmp(extension(path), known[i]) == 0) return DF_OK;
    }
    return df_fail(err, DF_ERROR_USAGE, "%s: expected a name that ends in .ply, .obj or .stl", path);
}

static void world_position(const df_mc_mesh *mesh, const df_field *field, uint32_t vertex, double world[3]) {
    df_field_grid_to_world(field, mesh->positions + 3 * (size_t)vertex, world);
}

static void write_ply(stream *s, const df_mc_mesh *mesh, const df_field *field) {
    s->used += (size_t)snprintf(room(s), RECORD_MAX,
                                "ply\nformat binary_little_endian 1.0\ncomment distfield " DF_VERSION "\n");
    s->used += (size_t)snprintf(room(s), RECORD_MAX,
                                "element vertex %" PRIu32 "\nproperty double x\nproperty double y\nproperty double z\n",
                                mesh->vertex_count);
    if (mesh->normals)
        s->used += (size_t)snprintf(room(s), RECORD_MAX, "property float nx\nproperty float ny\nproperty float nz\n");
    s->used += (size_t)snprintf(room(s), RECORD_MAX,
                                "element face %" PRIu32 "\nproperty list uchar int vertex_indices\nend_header\n",
                                mesh->triangle_count);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        double world[3];
        world_position(mesh, field, v, world);
        s->records++;
        put(s, world, sizeof world);
        if (mesh->normals) put(s, mesh->normals + 3 * (size_t)v, 3 * sizeof(float));
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        char record[13] = {3};
        s->records++;
        memcpy(record + 1, mesh->triangles + 3 * (size_t)t, 12);
        put(s, record, sizeof record);
    }
}

static void write_obj(stream *s, const df_mc_mesh *mesh, const df_field *field) {
    s->used += (size_t)snprintf(room(s), RECORD_MAX, "# distfield " DF_VERSION "\n");
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        double w[3];
        world_position(mesh, field, v, w);
        s->records++;
        s->used += (size_t)snprintf(room(s), RECORD_MAX, "v %.12g %.12g %.12g\n", w[0], w[1], w[2]);
    }
    for (uint32_t v = 0; mesh->normals && v < mesh->vertex_count; v++) {
        const float *n = mesh->normals + 3 * (size_t)v;
        s->used +=
            (size_t)snprintf(room(s), RECORD_MAX, "vn %.6g %.6g %.6g\n", (double)n[0], (double)n[1], (double)n[2]);
    }
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles + 3 * (size_t)t;
        const uint32_t a = v[0] + 1, b = v[1] + 1, c = v[2] + 1;
        s->records++;
        if (mesh->normals) {
            s->used += (size_t)snprintf(
                room(s), RECORD_MAX, "f %" PRIu32 "//%" PRIu32 " %" PRIu32 "//%" PRIu32 " %" PRIu32 "//%" PRIu32 "\n",
                a, a, b, b, c, c);
        } else {
            s->used += (size_t)snprintf(room(s), RECORD_MAX, "f %" PRIu32 " %" PRIu32 " %" PRIu32 "\n", a, b, c);
        }
    }
}

static void write_stl(stream *s, const df_mc_mesh *mesh, const df_field *field) {
    char header[80] = "distfield " DF_VERSION; /* must not begin with "solid" */
    s->records += mesh->vertex_count;          /* of which no more is written than the triangles' corners */
    put(s, header, sizeof header);
    put(s, &mesh->triangle_count, sizeof mesh->triangle_count);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        struct {
            float normal[3], corners[3][3];
        } facet;
        double p[3][3], u[3], w[3], n[3];
        s->records++;
        for (int i = 0; i < 3; i++) {
            world_position(mesh, field, mesh->triangles[3 * (size_t)t + (size_t)i], p[i]);
            for (int a = 0; a < 3; a++) facet.corners[i][a] = (float)p[i][a];
        }
        for (int a = 0; a < 3; a++) {
            u[a] = p[1][a] - p[0][a];
            w[a] = p[2][a] - p[0][a];
        }
        for (int a = 0; a < 3; a++) n[a] = u[(a + 1) % 3] * w[(a + 2) % 3] - u[(a + 2) % 3] * w[(a + 1) % 3];
        double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int a = 0; a < 3; a++) facet.normal[a] = length > 0 ? (float)(n[a] / length) : 0;
        put(s, &facet, sizeof facet);
        put(s, "\0", 2); /* attributes: none */
    }
}

uint64_t df_mc_mesh_write_work(const df_mc_mesh *mesh) { return mesh->vertex_count + (uint64_t)mesh->triangle_count; }

df_status df_mc_mesh_write(const df_mc_mesh *mesh, const df_field *field, const char *path, df_progress *progress,
                           df_error *err) {
    stream s = {.progress = progress, .err = err};
    df_status status = df_mc_mesh_check_path(path, err);
    if (status == DF_OK) status = df_alloc_raw((void **)&s.buffer, BUFFER_SIZE, 1, "mesh file", err);
    if (status == DF_OK) status = df_output_open(&s.output, path, err);
    if (status != DF_OK) {
        free(s.buffer);
        return status;
    }
    const char *type = extension(path);
    if (strcasecmp(type, ".ply") == 0) write_ply(&s, mesh, field);
    else if (strcasecmp(type, ".obj") == 0) write_obj(&s, mesh, field);
    else write_stl(&s, mesh, field);
    flush(&s);
    free(s.buffer);
    if (s.status == DF_OK) return df_output_commit(&s.output, err);
    df_output_discard(&s.output);
    return s.status;
}
