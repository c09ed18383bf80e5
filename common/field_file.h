/*
 * Fields in files (.dfield). The layout is documented byte by byte in common/FORMAT.md.
 *
 * A file is refused, with one line that names the place, when anything is wrong with it: every bit is covered by a
 * checksum, and sizes, indices, ranges and masks are verified against the samples before anyone uses them.
 */
#ifndef DF_FIELD_FILE_H
#define DF_FIELD_FILE_H

#include "common/field.h"

#include <jansson.h>

typedef enum df_read_mode {
    DF_READ_COPY, /* the file is read into memory */
    DF_READ_MAP,  /* samples are used in place, but for packed ones; index arrays are copied and validated. When the
                     file changes underneath, the process ends with one line and exit code 1 (a SIGBUS handler is
                     installed) */
} df_read_mode;

/* Reads and verifies a field. On failure *field is empty. */
df_status df_field_read(const char *path, df_read_mode mode, df_field *field, df_error *err);

/* Writes a finished field; sets field->checksum. An existing file stays whole until the new one is complete; see
 * common/output_file.h. The bytes depend on the field alone. */
df_status df_field_write(df_field *field, const char *path, df_error *err);

/* One section of a file, as df-info lists them. */
typedef struct df_section_info {
    char name[5];
    uint64_t offset, size;
} df_section_info;

#define DF_SECTION_COUNT_MAX 64

/* Lists the sections of a file whose header and table are sound. Returns the number in *count. */
df_status df_field_sections(const char *path, df_section_info sections[DF_SECTION_COUNT_MAX], uint32_t *count,
                            df_error *err);

#endif
