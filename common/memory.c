#include "common/memory.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

/* From here on memory is asked for in huge pages: fields are read at random, and the processor's own list of pages ends
 * at a few MB; and each page costs time when it is first touched. */
#define HUGE_FROM (1ull << 20)
#define HUGE_PAGE (2ull << 20)

df_status df_alloc_raw(void **out, uint64_t count, size_t size, const char *what, df_error *err) {
    uint64_t bytes;
    *out = NULL;
    if (__builtin_mul_overflow(count, (uint64_t)size, &bytes) || bytes > (uint64_t)PTRDIFF_MAX - 64) {
        return df_fail(err, DF_ERROR_MEMORY, "%s: %" PRIu64 " x %zu bytes is more than memory can hold", what, count,
                       size);
    }
    const uint64_t unit = bytes < HUGE_FROM ? 64 : HUGE_PAGE;
    bytes = (bytes + unit - 1) / unit * unit;
    *out = aligned_alloc(unit, bytes ? bytes : unit);
    if (!*out) return df_fail(err, DF_ERROR_MEMORY, "%s: out of memory (%.1f MB asked for)", what, (double)bytes / 1e6);
    if (unit == HUGE_PAGE) (void)madvise(*out, bytes, MADV_HUGEPAGE); /* a wish: all works without */
    return DF_OK;
}

df_status df_alloc(void **out, uint64_t count, size_t size, const char *what, df_error *err) {
    df_status status = df_alloc_raw(out, count, size, what, err);
    if (status == DF_OK) memset(*out, 0, count * size);
    return status;
}

df_status df_grow(void **array, uint64_t used, uint64_t count, size_t size, const char *what, df_error *err) {
    void *grown;
    df_status status = df_alloc_raw(&grown, count, size, what, err);
    if (status != DF_OK) return status;
    if (used) memcpy(grown, *array, used * size);
    free(*array);
    *array = grown;
    return DF_OK;
}
