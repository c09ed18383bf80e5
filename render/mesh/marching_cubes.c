#include "render/mesh/marching_cubes.h"
#include "common/memory.h"
#include "render/mesh/mc_private.h"

#include <inttypes.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

void df_mc_mesh_free(df_mc_mesh *mesh) {
    free(mesh->positions);
    free(mesh->normals);
    free(mesh->triangles);
    memset(mesh, 0, sizeof *mesh);
}

uint64_t df_mc_mesh_bytes(const df_mc_mesh *mesh) {
    uint64_t vertex = 3 * sizeof(double) + (mesh->normals ? 3 * sizeof(float) : 0);
    return mesh->vertex_count * vertex + mesh->triangle_count * (uint64_t)(3 * sizeof(uint32_t));
}

df_status df_mc_mesh_allocate(df_mc_mesh *mesh, const char *name, uint64_t vertex_count, uint64_t triangle_count,
                              bool normals, df_error *err) {
    memset(mesh, 0, sizeof *mesh);
    if (3 * triangle_count > DF_MESH_INDEX_MAX || vertex_count > DF_MESH_INDEX_MAX) {
        return df_fail(err, DF_ERROR_INPUT, "%s: the mesh would have %" PRIu64 " triangles (at most %u are possible)",
                       name, triangle_count, DF_MESH_INDEX_MAX / 3);
    }
    df_status status = df_alloc_raw((void **)&mesh->positions, vertex_count, 3 * sizeof(double), "mesh positions", err);
    if (status == DF_OK && normals)
        status = df_alloc_raw((void **)&mesh->normals, vertex_count, 3 * sizeof(float), "mesh normals", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&mesh->triangles, triangle_count, 3 * sizeof(uint32_t), "mesh triangles", err);
    if (status != DF_OK) {
        df_mc_mesh_free(mesh);
        return status;
    }
    mesh->vertex_count = (uint32_t)vertex_count;
    mesh->triangle_count = (uint32_t)triangle_count;
    return DF_OK;
}

static double largest_of(const double v[3]) {
    double x = fabs(v[0]), y = fabs(v[1]), z = fabs(v[2]), xy = x > y ? x : y;
    return xy > z ? xy : z;
}

void df_mc_normal(const df_field *field, const double gradient[3], const double fallback[3], float normal[3]) {
    const double *size = field->voxel_size;
    double g[3] = {gradient[0], gradient[1], gradient[2]};
    if (size[0] != size[1] || size[0] != size[2]) {
        for (int a = 0; a < 3; a++) g[a] /= size[a];
    }
    double largest = largest_of(g);
    if (!(largest > 0)) {
        memcpy(g, fallback, sizeof g);
        largest = largest_of(g);
    }
    const double scale = 1 / largest; /* squares neither overflow nor vanish */
    for (int a = 0; a < 3; a++) g[a] *= scale;
    const double inverse_length = 1 / sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
    for (int a = 0; a < 3; a++) normal[a] = (float)(g[a] * inverse_length);
}

int df_mc_threads(const df_mc_params *params) {
    return params->thread_count ? (int)params->thread_count : omp_get_max_threads();
}

uint64_t df_mc_mesh_work(const df_field *field) {
    if (field->kind == DF_FIELD_ADF) return 2 * (uint64_t)field->family_count;
    if (field->kind == DF_FIELD_BRICKS) return 2 * (uint64_t)field->brick_count;
    uint64_t blocks = 1;
    for (int a = 0; a < 3; a++) blocks *= (field->voxel_count[a] + DF_MC_DENSE_BLOCK - 1) / DF_MC_DENSE_BLOCK;
    return 2 * blocks;
}

static df_status no_surface(const df_field *field, const char *name, float iso, df_error *err) {
    return df_fail(err, DF_ERROR_INPUT, "%s: no surface at iso %g: the values go from %g to %g", name, (double)iso,
                   (double)field->value_min, (double)field->value_max);
}

df_status df_mc_extract(const df_field *field, const char *name, const df_mc_params *params, df_mc_mesh *mesh,
                        df_error *err) {
    memset(mesh, 0, sizeof *mesh);
    const float iso = params->iso;
    float low = -INFINITY, high = INFINITY;
    if (iso != 0) df_field_iso_range(field, &low, &high); /* 0 is what every field is made for */
    if (!isfinite(iso)) return df_fail(err, DF_ERROR_USAGE, "%s: iso %g is not a finite number", name, (double)iso);
    if (!df_field_reaches(field, iso)) return no_surface(field, name, iso, err);
    if (!(low < iso && iso <= high)) {
        return df_fail(err, DF_ERROR_INPUT, "%s: the surface at iso %g leaves what is stored (above %g, up to %g)",
                       name, (double)iso, (double)low, (double)high);
    }
    if (field->kind == DF_FIELD_ADF && params->method == DF_MC_CLASSIC) {
        return df_fail(err, DF_ERROR_UNSUPPORTED, "%s: the classic tables do not fit the levels of an ADF", name);
    }
    df_status status = field->kind == DF_FIELD_ADF ? df_mc_extract_octree(field, name, params, mesh, err)
                                                   : df_mc_extract_blocks(field, name, params, mesh, err);
    return status == DF_OK && !mesh->triangle_count ? no_surface(field, name, iso, err) : status;
}
