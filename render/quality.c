#include "render/quality.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"
#include "render/tracer.h"

#include <math.h>
#include <stdio.h>

/* The 99th percentile of robust's error after so many steps, in voxels: the worst over the fields and families of rays
 * of the accuracy laboratory, rounded up. */
static const struct {
    int steps;
    double error;
} robust_errors[] = {{1, 0.55}, {2, 0.19}, {3, 0.07}, {4, 0.018}, {6, 1.2e-3}, {16, 3e-6}};
enum { CHOICE_COUNT = sizeof robust_errors / sizeof robust_errors[0] };

/* From the eye to the nearest point of the field's box, world units. */
static double box_distance(const df_field *field, const double eye[3]) {
    double sum = 0;
    for (int a = 0; a < 3; a++) {
        double low = field->origin[a], high = low + field->voxel_size[a] * field->voxel_count[a];
        double beyond = fmax(0, fmax(low - eye[a], eye[a] - high));
        sum += beyond * beyond;
    }
    return sqrt(sum);
}

void df_quality_choose(const df_field *field, const df_camera *camera, uint32_t height, df_quality *q) {
    double largest = fmax(field->voxel_size[0], fmax(field->voxel_size[1], field->voxel_size[2]));
    const double half_pixel = box_distance(field, camera->eye) * tan(camera->fov_y / 2) / height;
    q->field_floor = field->error_rms >= 0 ? field->error_rms / largest : -1;
    q->pixel_floor =
        half_pixel / largest; /* of the largest voxel side: errors in voxels are at most that much in the world */
    q->bound = 0.1 * fmax(q->field_floor, q->pixel_floor);
    int choice = 0;
    while (choice < CHOICE_COUNT - 1 && robust_errors[choice].error > q->bound) choice++;
    q->solve = DF_SOLVE_ROBUST;
    q->steps = robust_errors[choice].steps;
    q->precision = DF_PRECISION_F64;
    q->error = robust_errors[choice].error;
    q->gradient = half_pixel >= largest ? DF_GRADIENT_ANALYTIC : DF_GRADIENT_CORNER_CENTRAL;
}

void df_quality_explain(const df_quality *q, char *text, size_t size) {
    char field[64] = "not known";
    if (q->field_floor >= 0) snprintf(field, sizeof field, "%.2g voxel", q->field_floor);
    snprintf(text, size,
             "intersect %s with at most %d steps (%.2g voxel left), gradient %s: half a pixel is %.2g voxel, the "
             "field's own error %s, "
             "a tenth of the higher %.2g",
             df_solve_names[q->solve], q->steps, q->error, df_gradient_names[q->gradient], q->pixel_floor, field,
             q->bound);
}
