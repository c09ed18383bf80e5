/* Level sets of other programs. The reader wants a file, so the input is written to one; it tries each in a process of
 * its own, which makes this target the slowest. */
#include "convert/vdb.h"
#include "fuzz.h"

#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

/* OpenVDB 10 forgets a node whose children it cannot read; the process ends soon after. */
const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void) { return "leak:readTopology\n"; }

/* What ends the child that reads a .vdb first is no finding: that is what the child is for. */
void __attribute__((weak)) __sanitizer_set_death_callback(void (*callback)(void));
static void forget_the_fuzzer(void) {
    static const int signals[] = {SIGABRT, SIGALRM, SIGBUS, SIGFPE, SIGILL, SIGSEGV};
    for (size_t i = 0; i < sizeof signals / sizeof *signals; i++) signal(signals[i], SIG_DFL);
    if (__sanitizer_set_death_callback) __sanitizer_set_death_callback(NULL);
}

static void prepare_forks(void) { pthread_atfork(NULL, NULL, forget_the_fuzzer); }

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    char path[64];
    pthread_once(&once, prepare_forks);
    snprintf(path, sizeof path, "/tmp/fuzz-vdb-%ld.vdb", (long)getpid());
    FILE *file = fopen(path, "wb");
    if (!file || fwrite(data, 1, size, file) != size || fclose(file) != 0) abort();
    df_vdb *vdb = NULL;
    df_vdb_info info;
    df_error err = {0};
    df_status status = df_vdb_read(path, NULL, 8, &vdb, &info, &err);
    remove(path);
    if (status != DF_OK && !err.text[0]) abort(); /* refused without a reason */
    if (vdb) df_vdb_free(vdb);
    return 0;
}
