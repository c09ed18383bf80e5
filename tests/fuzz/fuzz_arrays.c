/* Arrays of other programs. The first byte of the input chooses the format; the reader wants a file, so the rest is
 * written to one. */
#include "convert/array_file.h"
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    char path[64];
    if (size < 2) return 0;
    snprintf(path, sizeof path, "/tmp/fuzz-arrays-%ld.%s", (long)getpid(), data[0] % 2 ? "nrrd" : "npy");
    FILE *file = fopen(path, "wb");
    if (!file || fwrite(data + 1, 1, size - 1, file) != size - 1 || fclose(file) != 0) abort();
    df_field field = {0};
    df_error err = {0};
    df_status status = df_array_read(path, 0, &field, &err);
    remove(path);
    if (status != DF_OK && !err.text[0]) abort(); /* refused without a reason */
    df_field_free(&field);
    return 0;
}
