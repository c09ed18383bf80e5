#include "render/mesh/mc_model.h"
#include "common/memory.h"
#include "common/progress.h"
#include "render/mesh/marching_cubes.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

df_status df_mc_model_make(const df_scene *scene, uint32_t threads, df_mc_model *model, df_error *err) {
    df_mc_mesh mesh;
    memset(model, 0, sizeof *model);
    const double start = df_now_ms();
    const df_mc_params params = {.iso = scene->iso, .thread_count = threads};
    df_status status = df_mc_extract(scene->field, "this field", &params, &mesh, err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&model->positions, 3 * (uint64_t)mesh.vertex_count + 1, sizeof(float),
                              "mesh positions", err);
    if (status == DF_OK) {
        for (uint64_t i = 0; i < 3 * (uint64_t)mesh.vertex_count; i++) model->positions[i] = (float)mesh.positions[i];
        model->positions[3 * (uint64_t)mesh.vertex_count] = 0;
        model->vertex_count = mesh.vertex_count;
        model->triangle_count = mesh.triangle_count;
        model->normals = mesh.normals;
        model->triangles = mesh.triangles;
        mesh.normals = NULL;
        mesh.triangles = NULL;
    }
    df_mc_mesh_free(&mesh);
    model->extract_ms = df_now_ms() - start;
    return status;
}

void df_mc_model_free(df_mc_model *model) {
    free(model->positions);
    free(model->normals);
    free(model->triangles);
    memset(model, 0, sizeof *model);
}

uint64_t df_mc_model_bytes(const df_mc_model *model) {
    return model->vertex_count * (uint64_t)(6 * sizeof(float)) +
           model->triangle_count * (uint64_t)(3 * sizeof(uint32_t));
}

void df_mc_model_hit(const df_scene *scene, const df_rays *rays, uint32_t ray, float t, const float normal[3],
                     bool back, df_hits *hits) {
    const uint32_t i = hits->count++;
    assert(i < hits->capacity);
    hits->ray[i] = ray;
    hits->block[i] = 0;
    hits->flags[i] = back ? DF_HIT_BACK : 0;
    hits->t[i] = (double)t + (rays->t_base ? rays->t_base[ray] : 0);
    for (int a = 0; a < 3; a++) {
        const float at = rays->origin[a][rays->shared_origin ? 0 : ray] + t * rays->direction[a][ray];
        const float last = (float)(scene->voxel_count[a] - 1);
        const float voxel = at < 0 ? 0 : at > last ? last : (float)(uint32_t)at;
        hits->cell[a][i] = (uint16_t)voxel;
        hits->local[a][i] = at - voxel < 0 ? 0 : at - voxel > 1 ? 1 : at - voxel;
        hits->normal[a][i] = normal[a];
    }
}
