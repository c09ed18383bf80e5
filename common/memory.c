#include "common/memory.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

df_status df_alloc_raw(void **out, uint64_t count, size_t size, const char *what, df_error *err) {
    uint64_t bytes;
    *out = NULL;
    if (__builtin_mul_overflow(count, (uint64_t)size, &bytes) || bytes > (uint64_t)PTRDIFF_MAX - 64) {
        return df_fail(err, DF_ERROR_MEMORY, "%s: %" PRIu64 " x %zu bytes is more than memory can hold", what, count,
                       size);
    }
    bytes = (bytes + 63) / 64 * 64;
    *out = aligned_alloc(64, bytes ? bytes : 64);
    if (!*out) return df_fail(err, DF_ERROR_MEMORY, "%s: out of memory (%.1f MB asked for)", what, (double)bytes / 1e6);
    return DF_OK;
}

df_status df_alloc(void **out, uint64_t count, size_t size, const char *what, df_error *err) {
    df_status status = df_alloc_raw(out, count, size, what, err);
    if (status == DF_OK) memset(*out, 0, count * size);
    return status;
}
