/* Hits to pixels: DF_LANES at a time. */
#include "render/cpu/fetch.h"
#include "render/cpu/kernel.h"
#include "render/methods/gradient.h"
#include "render/methods/shade.h"

#include <string.h>

typedef struct columns {
    union {
        lf lanes[64];
        float numbers[64][DF_LANES];
    } stencil;
    float direction[3][DF_LANES];
} columns;

static void write_pixel(const df_shade_job *job, const df_hits *hits, uint32_t i, const float direction[3], float light,
                        const float normal[3]) {
    const df_tile *tile = job->tile;
    const uint32_t ray = hits->ray[i];
    const size_t pixel = (size_t)(tile->y + ray / tile->width) * job->picture_width + tile->x + ray % tile->width;
    if (job->rgb) {
        const float albedo[3] = DF_SHADE_ALBEDO;
        for (int c = 0; c < 3; c++) job->rgb[3 * pixel + (size_t)c] = job->table[df_shade_level(albedo[c] * light)];
    }
    if (job->normals) memcpy(job->normals + 3 * pixel, normal, 3 * sizeof *normal);
    if (job->depth) job->depth[pixel] = df_view_distance(tile->view, direction, hits->t[i]);
}

void DF_KERNEL(df_kernel_shade)(const df_shade_job *job, const df_hits *hits) {
    const df_view *view = job->tile->view;
    const bool beyond = job->gradient != DF_GRADIENT_ANALYTIC;
    const bool octree = job->scene->levels == 0;
    const bool quick = beyond && !octree && job->scene->field->sample_type == DF_SAMPLE_F32;
    lf size[3], inverse_size[3];
    columns in;
    memset(&in, 0, sizeof in);
    for (int a = 0; a < 3; a++) {
        size[a] = lf_set(view->relative_size[a]);
        inverse_size[a] = lf_set(1.0f / view->relative_size[a]);
    }
    for (uint32_t first = 0; first < hits->count; first += DF_LANES) {
        const uint32_t lanes = hits->count - first < DF_LANES ? hits->count - first : DF_LANES;
        for (uint32_t i = 0; i < DF_LANES; i++) {
            const uint32_t from = first + (i < lanes ? i : 0);
            const uint32_t voxel[3] = {hits->cell[0][from], hits->cell[1][from], hits->cell[2][from]};
            const uint32_t size_log2 =
                hits->flags[from] >> DF_HIT_SIZE_SHIFT; /* scales the gradient, which the normal does not feel */
            if (hits->has_normals) {
                /* the tracer's own */
            } else if (quick) {
                df_fetch_stencil(job->scene, voxel, hits->block[from], &in.stencil.numbers[0][i], DF_LANES);
            } else if (octree) {
                df_scene_leaf_stencil(job->scene, voxel, hits->block[from], size_log2, beyond,
                                      &in.stencil.numbers[0][i], DF_LANES);
            } else {
                df_scene_stencil(job->scene, voxel, hits->block[from], beyond, &in.stencil.numbers[0][i], DF_LANES);
            }
            for (int a = 0; a < 3; a++) in.direction[a][i] = job->tile->rays.direction[a][hits->ray[from]];
        }
        lf local[3], gradient[3], direction[3], toward_eye[3], normal[3];
        for (int a = 0; a < 3; a++) {
            local[a] = lf_load(hits->local[a] + first);
            direction[a] = lf_load(in.direction[a]);
        }
        if (!hits->has_normals) df_gradient(job->gradient, in.stencil.lanes, local, gradient);
        for (int a = 0; a < 3 && hits->has_normals; a++) gradient[a] = lf_load(hits->normal[a] + first) * size[a];
        df_shade_toward_eye(direction, size, toward_eye);
        df_shade_normal(gradient, inverse_size, toward_eye, normal);
        float light[DF_LANES], normals[3][DF_LANES];
        lf_store(light, df_shade_light(normal, toward_eye));
        for (int a = 0; a < 3; a++) lf_store(normals[a], normal[a]);
        for (uint32_t i = 0; i < lanes; i++) {
            const float d[3] = {in.direction[0][i], in.direction[1][i], in.direction[2][i]};
            const float n[3] = {normals[0][i], normals[1][i], normals[2][i]};
            write_pixel(job, hits, first + i, d, light[i], n);
        }
    }
}
