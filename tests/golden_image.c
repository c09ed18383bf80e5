/* golden_image PICTURE.png: prints a picture as CSV for comparing with a golden file: its size and checksum, and every
 * 8th pixel of every 8th row, so that a difference can be seen in the diff. */
#include "common/digest.h"
#include "common/image.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

int main(int argc, char **argv) {
    enum { STEP = 8 };
    df_image_png png;
    df_error err = {0};
    if (argc != 2) return 2;
    if (df_image_read_png(argv[1], &png, &err) != DF_OK) {
        fprintf(stderr, "%s\n", err.text);
        return 1;
    }
    printf("width,%u\nheight,%u\nrgb_crc32c,%08" PRIx32 "\n", png.width, png.height,
           df_crc32c(0, png.rgb, (size_t)png.width * png.height * 3));
    for (uint32_t y = 0; y < png.height; y += STEP) {
        for (uint32_t x = 0; x < png.width; x += STEP) {
            const uint8_t *p = png.rgb + 3 * ((size_t)y * png.width + x);
            printf("%s%02x%02x%02x", x ? "," : "", p[0], p[1], p[2]);
        }
        printf("\n");
    }
    df_image_png_free(&png);
    return 0;
}
