/* Checksums of bytes and files. */
#ifndef DF_DIGEST_H
#define DF_DIGEST_H

#include "common/status.h"

#include <stddef.h>
#include <stdint.h>

/* CRC-32C (Castagnoli), as in iSCSI: initial value and final inversion 0xFFFFFFFF. Start with crc = 0; the result of
 * one call continues in the next. */
uint32_t df_crc32c(uint32_t crc, const void *data, size_t size);

/* SHA-256 of a file, as 64 lower-case hexadecimal digits and a zero. */
df_status df_sha256_file(const char *path, char hex[65], df_error *err);

#endif
