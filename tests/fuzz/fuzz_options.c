/* The parsing of option values: no input is read past its end, and what is accepted lies within its limits. */
#include "common/options.h"
#include "common/slice.h"
#include "fuzz.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const char *const names[] = {"bricks", "dense", "adf", NULL};
    char *text = malloc(size + 1);
    if (!text) abort();
    memcpy(text, data, size);
    text[size] = 0;
    uint32_t whole, width, height;
    double number, three[3];
    df_slice slice;
    df_error err = {0};
    if (df_parse_u32("--n", text, 3, 9999, &whole, &err) == DF_OK && (whole < 3 || whole > 9999)) abort();
    if (df_parse_double("--d", text, -2, 5, &number, &err) == DF_OK && !(number >= -2 && number <= 5)) abort();
    if (df_parse_doubles("--v", text, 3, three, &err) == DF_OK && !isfinite(three[0] + three[1] * 0 + three[2] * 0))
        abort();
    if (df_parse_size("--s", text, &width, &height, &err) == DF_OK &&
        (width < 1 || width > 65536 || height < 1 || height > 65536))
        abort();
    if (df_parse_name("--k", text, names, &whole, &err) == DF_OK && whole > 2) abort();
    if (df_slice_parse("--slice", text, &slice, &err) == DF_OK &&
        (slice.axis > 2 || !(slice.position >= 0 && slice.position <= 1)))
        abort();
    free(df_path_with_extension(text, ".png", 1));
    free(df_path_with_extension(text, ".png", 0));
    free(df_command_line(1, &text));
    free(text);
    return 0;
}
