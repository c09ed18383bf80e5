/* Arrays and level sets of other programs. The first byte of the input chooses the format; the readers want files, so
 * it is written to one. */
#include "convert/array_file.h"
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
    static const char *const extensions[] = {"npy", "nrrd", "vdb"};
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    char path[64];
    if (size < 2) return 0;
    pthread_once(&once, prepare_forks);
    const int format = data[0] % 3;
    snprintf(path, sizeof path, "/tmp/fuzz-exchange-%ld.%s", (long)getpid(), extensions[format]);
    FILE *file = fopen(path, "wb");
    if (!file || fwrite(data + 1, 1, size - 1, file) != size - 1 || fclose(file) != 0) abort();
    df_field field = {0};
    df_vdb *vdb = NULL;
    df_vdb_info info;
    df_error err = {0};
    df_status status =
        format < 2 ? df_array_read(path, 0, &field, &err) : df_vdb_read(path, NULL, 8, &vdb, &info, &err);
    remove(path);
    if (status != DF_OK && !err.text[0]) abort(); /* refused without a reason */
    df_field_free(&field);
    if (vdb) df_vdb_free(vdb);
    return 0;
}
