#include "render/cpu/kernels.h"

#include <string.h>

/* From the narrowest to the widest. */
static const df_kernels *const all[] = {
    &df_kernels_scalar,
#ifdef DF_X86
    &df_kernels_sse41,
    &df_kernels_avx2,
    &df_kernels_avx512,
#endif
};
enum { ALL_COUNT = sizeof all / sizeof all[0] };

static int supported(const df_kernels *kernels) {
#ifdef DF_X86
    if (kernels == &df_kernels_sse41) return __builtin_cpu_supports("sse4.1");
    if (kernels == &df_kernels_avx2) return __builtin_cpu_supports("avx2");
    if (kernels == &df_kernels_avx512) {
        return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
               __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
    }
#endif
    return kernels == &df_kernels_scalar;
}

df_status df_kernels_select(const char *isa, const df_kernels **out, df_error *err) {
    *out = NULL;
    for (int i = 0; i < ALL_COUNT; i++) {
        if (strcmp(isa, "auto") == 0) {
            if (supported(all[i])) *out = all[i];
        } else if (strcmp(isa, all[i]->isa) == 0) {
            if (!supported(all[i]))
                return df_fail(err, DF_ERROR_UNSUPPORTED, "--isa %s: this processor does not have it", isa);
            *out = all[i];
        }
    }
    if (!*out) return df_fail(err, DF_ERROR_USAGE, "--isa %s: expected auto, scalar, sse4.1, avx2 or avx512", isa);
    return DF_OK;
}
