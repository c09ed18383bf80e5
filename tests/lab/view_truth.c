#include "view_truth.h"
#include "families.h"
#include "random.h"
#include "view_ray.h"

#include <math.h>

bool lab_random_camera(const df_field *field, uint64_t seed, uint64_t index, df_camera *camera) {
    const bool inside = index % 2 == 0;
    uint64_t state = seed + 0x632BE59BD9B4E019u * (index + 1);
    double away[3], eye[3], at[3];
    lab_random_bits(&state);
    if (inside && !lab_family_ray(field, LAB_INSIDE, seed, index, eye, away)) return false;
    const double distance = pow(2, lab_random(&state, -1, 1.5)) * field->voxel_count[0];
    if (!inside) lab_random_direction(&state, away);
    for (int a = 0; a < 3 && !inside; a++) eye[a] = field->voxel_count[a] / 2.0 + distance * away[a];
    for (int a = 0; a < 3; a++) at[a] = lab_random(&state, 0, field->voxel_count[a]);
    df_field_grid_to_world(field, eye, camera->eye);
    df_field_grid_to_world(field, at, camera->look_at);
    lab_random_direction(&state, camera->up);
    camera->fov_y = lab_random(&state, 0.3, 2);
    return true;
}

df_status lab_view_truths(const df_scene *scene, const df_view *view, lab_known *pixels, df_error *err) {
    const uint32_t count = view->width * view->height;
    df_rays rays;
    df_status status = df_rays_alloc(count, true, &rays, err);
    if (status != DF_OK) return status;
    df_view_rays(view, &df_kernels_scalar, 0, 0, view->width, view->height, &rays);
#pragma omp parallel for schedule(dynamic, 256)
    for (uint32_t i = 0; i < count; i++) {
        lab_known *pixel = &pixels[i];
        lab_view_ray(&rays, i, pixel->origin, pixel->direction);
        pixel->made = true;
        df_truth_trace(scene->field, scene->iso, pixel->origin, pixel->direction, &pixel->truth);
    }
    df_rays_free(&rays);
    return DF_OK;
}

double lab_known_depth(const df_field *field, const lab_known *pixel) {
    double square = 0;
    for (int a = 0; a < 3; a++) {
        const double along = pixel->direction[a] * field->voxel_size[a];
        square += along * along;
    }
    return pixel->truth.hit ? (double)pixel->truth.t * sqrt(square) : (double)INFINITY;
}

void lab_score_depths(const df_field *field, const lab_known *pixels, uint64_t count, uint64_t first,
                      const float *depth, lab_score *score) {
    for (uint64_t i = 0; i < count; i++) {
        const double off = fabs((double)depth[i] - lab_known_depth(field, &pixels[i])) / field->voxel_size[0];
        lab_score_pair(score, first + i, &pixels[i].truth, isfinite(depth[i]), off);
    }
}
