/* A picture of a plane through a field: what is stored, and where. */
#ifndef DF_SLICE_H
#define DF_SLICE_H

#include "common/field.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct df_slice {
    uint32_t axis;      /* the plane's normal: 0, 1, 2 */
    double position;    /* 0 to 1 through the field's box */
    uint32_t longest;   /* pixels along the longer side of the picture; 0: 1024 */
} df_slice;

/* Parses "x=0.25", "y=0.5", "z=1". */
df_status df_slice_parse(const char *option, const char *text, df_slice *slice, df_error *err);

/* Draws the slice into *rgb: *width * *height * 3 bytes, sRGB, rows from top to bottom; free() it. Right and up are the next two axes
 * (slice x: y and z; y: x and z; z: x and y). Inside is blue, outside orange, paler with the distance; the surface is a
 * black line, contours are thin lines *contour_voxels voxels apart. Cells of the structure (bricks, leaves; voxels where they are
 * large enough) are outlined; coarse cells without samples are flat grey-blue and grey-orange. */
df_status df_slice_draw(const df_field *field, const df_slice *slice, uint8_t **rgb, uint32_t *width, uint32_t *height,
                        double *contour_voxels, df_error *err);

#ifdef __cplusplus
}
#endif
#endif
