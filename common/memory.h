/* Checked allocation. Memory is released with free(); free accepts NULL. */
#ifndef DF_MEMORY_H
#define DF_MEMORY_H

#include "common/status.h"

#include <stddef.h>
#include <stdint.h>

/* Sets *out to count zeroed elements of `size` bytes, aligned to 64 bytes. A count of 0 gives a valid pointer.
 * DF_ERROR_MEMORY with *out = NULL when the product overflows or the system has no memory; the message names `what`
 * ("samples") and the bytes. */
df_status df_alloc(void **out, uint64_t count, size_t size, const char *what, df_error *err);

/* The same without clearing, for arrays that are written whole. */
df_status df_alloc_raw(void **out, uint64_t count, size_t size, const char *what, df_error *err);

/* Moves the first `used` elements of *array, which may be NULL, to an array of `count`. When that fails, *array stays.
 */
df_status df_grow(void **array, uint64_t used, uint64_t count, size_t size, const char *what, df_error *err);

#endif
