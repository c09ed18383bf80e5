/* Image files. Rows run from top to bottom in memory. Files are written through common/output_file.h. */
#ifndef DF_IMAGE_H
#define DF_IMAGE_H

#include "common/status.h"

#include <stdint.h>

/* One line of text stored in a PNG (tEXt, or iTXt where it is not Latin-1). */
typedef struct df_image_text {
    const char *key;
    const char *value;
} df_image_text;

/* rgb: width * height * 3 bytes, sRGB. texts: text_count entries, may be NULL when 0. */
df_status df_image_write_png(const char *path, const uint8_t *rgb, uint32_t width, uint32_t height,
                             const df_image_text *texts, uint32_t text_count, df_error *err);

/* A PNG in memory, converted to 8-bit RGB, with its texts. A zeroed struct is empty; df_image_png_free accepts it. */
typedef struct df_image_png {
    uint32_t width, height;
    uint8_t *rgb; /* width * height * 3 */
    df_image_text *texts;
    uint32_t text_count;
} df_image_png;

/* Reads a PNG of at most 65536 x 65536 pixels. On failure *image is empty. */
df_status df_image_read_png(const char *path, df_image_png *image, df_error *err);
void df_image_png_free(df_image_png *image);

/* The value of the text with this key, NULL when there is none. */
const char *df_image_png_text(const df_image_png *image, const char *key);

/* Floats, channel_count 1 or 3, interleaved: width * height * channel_count. The format follows the extension:
 * .pfm (Portable Float Map, little endian) or .exr (OpenEXR, 32-bit float, ZIP; channel Z, or X, Y and Z).
 * DF_ERROR_USAGE for other extensions. */
df_status df_image_write_float(const char *path, const float *pixels, uint32_t width, uint32_t height,
                               uint32_t channel_count, df_error *err);

/* True when the path ends in .pfm or .exr, so that a wrong name is refused before the work. */
int df_image_is_float_path(const char *path);

#endif
