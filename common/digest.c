#include "common/digest.h"

#include <errno.h>
#include <fcntl.h>
#include <isa-l/crc.h>
#include <limits.h>
#include <nettle/sha2.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

uint32_t df_crc32c(uint32_t crc, const void *data, size_t size) {
    const unsigned char *bytes = data;
    crc = ~crc;
    while (size > 0) {
        size_t part = size < INT_MAX / 2 ? size : INT_MAX / 2; /* the library counts in int */
        crc = crc32_iscsi((unsigned char *)bytes, (int)part, crc);
        bytes += part;
        size -= part;
    }
    return ~crc;
}

df_status df_sha256_file(const char *path, char hex[65], df_error *err) {
    struct sha256_ctx context;
    uint8_t digest[SHA256_DIGEST_SIZE], buffer[65536];
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    sha256_init(&context);
    ssize_t got;
    while ((got = read(fd, buffer, sizeof buffer)) > 0) sha256_update(&context, (size_t)got, buffer);
    int error = errno;
    close(fd);
    if (got < 0) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(error));
    sha256_digest(&context, sizeof digest, digest);
    for (size_t i = 0; i < sizeof digest; i++) snprintf(hex + 2 * i, 3, "%02x", digest[i]);
    return DF_OK;
}
