#include "render/mesh/mesh_normals.h"

#include "render/mesh/mc_private.h"
#include "render/methods/gradient.h"

#include <math.h>

/* Where a vertex is read: the voxel or leaf that it lies in, and the place within. */
typedef struct place {
    uint32_t corner[3], block, size_log2;
    float local[3];
} place;

static void find_place(const df_scene *scene, const double at[3], place *p) {
    df_adf_cell leaf = {.side = 1};
    if (scene->levels == 0) df_adf_find(scene->field, at, DF_LEVEL_COUNT_MAX, &leaf);
    p->size_log2 = (uint32_t)__builtin_ctz(leaf.side);
    for (int a = 0; a < 3; a++) {
        const uint32_t last = scene->voxel_count[a] - 1, voxel = at[a] > 0 ? (uint32_t)at[a] : 0;
        p->corner[a] = scene->levels == 0 ? leaf.corner[a] : voxel < last ? voxel : last;
        p->local[a] = (float)((at[a] - p->corner[a]) / leaf.side);
    }
    p->block = scene->levels == 0   ? 8 * leaf.family + leaf.child
               : scene->levels == 2 ? df_scene_block(scene, p->corner[0], p->corner[1], p->corner[2])
                                    : 0;
}

static void renew(const df_scene *scene, int gradient, const double at[3], float *normal) {
    place p;
    float stencil[64] = {0}, inverse_step[3], slope[3];
    find_place(scene, at, &p);
    const int reach = df_gradient_reach(gradient);
    if (scene->levels == 0) df_scene_leaf_stencil(scene, p.corner, p.block, p.size_log2, reach, stencil, 1);
    else df_scene_stencil(scene, p.corner, p.block, reach, stencil, 1);
    for (int a = 0; a < 3; a++)
        inverse_step[a] = (float)(1 / (scene->field->voxel_size[a] * (double)(1u << p.size_log2)));
    df_gradient(gradient, stencil, p.local, inverse_step, slope);
    const double steep[3] = {(double)slope[0], (double)slope[1], (double)slope[2]};
    const double before[3] = {(double)normal[0], (double)normal[1], (double)normal[2]};
    df_mc_normal(scene->field, steep, before, normal);
}

df_status df_mc_mesh_renew_normals(df_mc_mesh *mesh, const df_field *field, const df_mc_params *params, int gradient,
                                   df_error *err) {
    df_scene scene;
    const df_scene_options options = {0};
    df_status status = df_scene_prepare(field, params->iso, &options, &scene, err);
    if (status != DF_OK) return status;
#pragma omp parallel for schedule(static) num_threads(df_mc_threads(params))
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        renew(&scene, gradient, mesh->positions + 3 * (size_t)v, mesh->normals + 3 * (size_t)v);
    df_scene_free(&scene);
    return DF_OK;
}
