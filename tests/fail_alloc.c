/*
 * A shared object for LD_PRELOAD: the DF_FAIL_AT-th allocation fails (counted from 1, over all threads, from when main
 * parses its options: what libraries do before main is theirs), and all after it when DF_FAIL_ALL is set. It says so on
 * descriptor DF_FAIL_FD, so that a test knows whether its fault occurred.
 */
#include <argp.h>
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdlib.h>
#include <unistd.h>

static atomic_long calls;
static long wanted = -1, fail_at = -1;
static int fail_all;

static void *(*real_malloc)(size_t);
static void *(*real_calloc)(size_t, size_t);
static void *(*real_realloc)(void *, size_t);
static void *(*real_aligned)(size_t, size_t);

/* dlsym itself may call calloc before the real one is known. */
static char early[65536];
static size_t early_used;

__attribute__((constructor)) static void start(void) {
    real_calloc = (void *(*)(size_t, size_t))dlsym(RTLD_NEXT, "calloc");
    real_malloc = (void *(*)(size_t))dlsym(RTLD_NEXT, "malloc");
    real_realloc = (void *(*)(void *, size_t))dlsym(RTLD_NEXT, "realloc");
    real_aligned = (void *(*)(size_t, size_t))dlsym(RTLD_NEXT, "aligned_alloc");
    const char *at = getenv("DF_FAIL_AT");
    fail_all = getenv("DF_FAIL_ALL") != NULL;
    wanted = at ? atol(at) : -1;
}

error_t argp_parse(const struct argp *argp, int argc, char **argv, unsigned flags, int *index, void *input) {
    error_t (*real)(const struct argp *, int, char **, unsigned, int *, void *) =
        (error_t(*)(const struct argp *, int, char **, unsigned, int *, void *))dlsym(RTLD_NEXT, "argp_parse");
    error_t result = real(argp, argc, argv, flags, index, input);
    fail_at = wanted;
    return result;
}

static int must_fail(void) {
    if (fail_at < 0) return 0;
    long call = atomic_fetch_add(&calls, 1) + 1;
    if (call != fail_at && !(fail_all && call > fail_at)) return 0;
    if (call == fail_at) {
        const char *fd = getenv("DF_FAIL_FD");
        if (fd) {
            ssize_t written = write(atoi(fd), "failed\n", 7);
            (void)written;
        }
    }
    errno = ENOMEM;
    return 1;
}

void *malloc(size_t size) {
    if (!real_malloc) start();
    return must_fail() ? NULL : real_malloc(size);
}

void *calloc(size_t count, size_t size) {
    if (!real_calloc) {
        void *memory = early + early_used;
        early_used += (count * size + 63) / 64 * 64;
        return early_used <= sizeof early ? memory : NULL;
    }
    return must_fail() ? NULL : real_calloc(count, size);
}

void *realloc(void *memory, size_t size) {
    if (!real_realloc) start();
    return must_fail() ? NULL : real_realloc(memory, size);
}

void *aligned_alloc(size_t alignment, size_t size) {
    if (!real_aligned) start();
    return must_fail() ? NULL : real_aligned(alignment, size);
}
