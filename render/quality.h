/*
 * No more than a scene needs: --quality auto.
 *
 * Two floors hide what a method does: the error of the field itself, as the file states it, and half the footprint of a
 * pixel where the field's box is nearest to the eye. The choice is the cheapest whose error lies under a tenth of the
 * higher of them:
 *   solve     always one that isolates (robust), so that no crossing is missed at any distance; as few Illinois steps
 *             as the bound allows, by the errors that the accuracy laboratory measured on its worst field
 *             (pipelines/ACCURACY.md);
 *   precision float where its rounding, which grows with the field's coordinates, stays under the bound too: it hits
 *             the same voxels for fewer instructions; otherwise double;
 *   gradient  of the trilinear field (analytic) where a voxel is smaller than half a pixel, so that the jumps of the
 *             normal between voxels cannot be seen; otherwise corner-central.
 */
#ifndef DF_QUALITY_H
#define DF_QUALITY_H

#include "common/field.h"
#include "render/view.h"

typedef struct df_quality {
    int solve, steps, precision, gradient;
    double field_floor; /* voxels, RMS; negative: the file does not state it */
    double pixel_floor; /* voxels; 0 where the eye is inside the box */
    double bound;       /* voxels: a tenth of the higher floor */
    double error;       /* voxels: what the choice may leave, 99 rays of 100 on the worst field */
} df_quality;

/* height: of the picture, pixels. single: whether the device solves in float, too (the CPU does). */
void df_quality_choose(const df_field *field, const df_camera *camera, uint32_t height, bool single,
                       df_quality *quality);

/* One line that says what was chosen and why; text holds `size` bytes. */
void df_quality_explain(const df_quality *quality, char *text, size_t size);

#endif
