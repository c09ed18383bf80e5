#include "render/quality.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"
#include "render/tracer.h"

#include <math.h>
#include <stdio.h>

/* The 99th percentile of robust's error in double after so many steps, in voxels: the worst over the fields of the
 * accuracy laboratory at 64 and 256 voxels and its families of rays that a picture has (all but secondary), rounded up.
 * Fewer than 6 steps are never taken: after 4, single rays through pairs of crossings are still more than half a voxel
 * off, far outside any percentile, and what they save is below 0.01 % of a frame from where they would do. */
static const struct {
    int steps;
    double error;
} robust_errors[] = {{6, 3e-3}, {16, 1e-5}};
enum { CHOICE_COUNT = sizeof robust_errors / sizeof robust_errors[0] };

/* What float adds to that, a voxel of the field's longest side: 99 of 100 rays that graze a sphere stay within 2.9e-3
 * voxel at 64 voxels and 7.6e-3 at 256. */
static const double single_error = 5e-5;

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

/* Takes the first precision and number of steps, in the order of what they cost, that stays within the bound. */
static void choose_solve(const df_field *field, bool single, df_quality *q) {
    uint32_t longest = 0;
    for (int a = 0; a < 3; a++) longest = field->voxel_count[a] > longest ? field->voxel_count[a] : longest;
    q->solve = DF_SOLVE_ROBUST;
    for (q->precision = single ? DF_PRECISION_F32 : DF_PRECISION_F64;; q->precision = DF_PRECISION_F64) {
        const double more = q->precision == DF_PRECISION_F32 ? single_error * longest : 0;
        for (int i = 0; i < CHOICE_COUNT; i++) {
            q->steps = robust_errors[i].steps;
            q->error = robust_errors[i].error + more;
            if (q->error <= q->bound) return;
        }
        if (q->precision == DF_PRECISION_F64) return; /* nothing does: the most exact */
    }
}

void df_quality_choose(const df_field *field, const df_camera *camera, uint32_t height, bool single, df_quality *q) {
    double largest = fmax(field->voxel_size[0], fmax(field->voxel_size[1], field->voxel_size[2]));
    const double half_pixel = box_distance(field, camera->eye) * tan(camera->fov_y / 2) / height;
    q->field_floor = field->error_rms >= 0 ? field->error_rms / largest : -1;
    q->pixel_floor =
        half_pixel / largest; /* of the largest voxel side: errors in voxels are at most that much in the world */
    q->bound = 0.1 * fmax(q->field_floor, q->pixel_floor);
    choose_solve(field, single, q);
    q->gradient = half_pixel >= largest ? DF_GRADIENT_ANALYTIC : DF_GRADIENT_CORNER_CENTRAL;
}

void df_quality_explain(const df_quality *q, char *text, size_t size) {
    char field[64] = "not known";
    if (q->field_floor >= 0) snprintf(field, sizeof field, "%.2g voxel", q->field_floor);
    snprintf(text, size,
             "intersect %s in %s with at most %d steps (%.2g voxel left), gradient %s: half a pixel is %.2g voxel, the "
             "field's own error %s, "
             "a tenth of the higher %.2g",
             df_solve_names[q->solve], df_precision_names[q->precision], q->steps, q->error,
             df_gradient_names[q->gradient], q->pixel_floor, field, q->bound);
}
