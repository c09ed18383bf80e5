#include "instructions.h"

#include <glob.h>
#include <linux/perf_event.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>
#if __has_include(<valgrind/callgrind.h>)
#include <valgrind/callgrind.h>
#else
#define CALLGRIND_START_INSTRUMENTATION
#define CALLGRIND_STOP_INSTRUMENTATION
#define CALLGRIND_ZERO_STATS
#define CALLGRIND_DUMP_STATS_AT(label) ((void)(label))
#endif

#define NO_VALGRIND 127 /* what the child exits with */

int lab_counter_open(void) {
    struct perf_event_attr wanted = {.type = PERF_TYPE_HARDWARE,
                                     .size = sizeof wanted,
                                     .config = PERF_COUNT_HW_INSTRUCTIONS,
                                     .exclude_kernel = 1,
                                     .exclude_hv = 1};
    return (int)syscall(SYS_perf_event_open, &wanted, 0, -1, -1, 0);
}

uint64_t lab_counter_read(int counter) {
    uint64_t value = 0;
    return read(counter, &value, sizeof value) == (ssize_t)sizeof value ? value : 0;
}

void lab_counting_on(void) { CALLGRIND_START_INSTRUMENTATION; }

void lab_counting_off(void) { CALLGRIND_STOP_INSTRUMENTATION; }

void lab_count_begin(void) { CALLGRIND_ZERO_STATS; }

void lab_count_end(const char *label) { CALLGRIND_DUMP_STATS_AT(label); }

df_status lab_counts_add(lab_counts *counts, const char *label, uint64_t instructions, df_error *err) {
    struct lab_count *list = realloc(counts->list, (counts->count + 1) * sizeof *list);
    char *own = strdup(label);
    if (list) counts->list = list;
    if (!list || !own) {
        free(own);
        return df_fail(err, DF_ERROR_MEMORY, "no memory for counts");
    }
    list[counts->count++] = (struct lab_count){own, instructions};
    return DF_OK;
}

/* Takes the label and the total of one file of callgrind's. */
static df_status read_counts(const char *path, lab_counts *counts, df_error *err) {
    static const char label_is[] = "desc: Trigger: Client Request: ";
    char line[1024], label[1024] = "";
    uint64_t instructions = 0;
    FILE *file = fopen(path, "r");
    while (file && fgets(line, sizeof line, file)) {
        line[strcspn(line, "\n")] = 0;
        if (strncmp(line, label_is, sizeof label_is - 1) == 0 && !label[0])
            snprintf(label, sizeof label, "%s", line + sizeof label_is - 1);
        if (strncmp(line, "totals: ", 8) == 0) instructions = strtoull(line + 8, NULL, 10);
    }
    if (file) fclose(file);
    /* callgrind's last file has none: what ran after the last label */
    return label[0] ? lab_counts_add(counts, label, instructions, err) : DF_OK;
}

/* Removes the folder of a child that has ended; counts: NULL: nothing is read. */
static df_status empty_folder(lab_count_run *run, lab_counts *counts, df_error *err) {
    char pattern[600];
    glob_t files = {0};
    df_status status = DF_OK;
    snprintf(pattern, sizeof pattern, "%s/counts*", run->folder);
    if (glob(pattern, 0, NULL, &files) == 0) {
        for (size_t i = 0; i < files.gl_pathc; i++) {
            if (counts && status == DF_OK) status = read_counts(files.gl_pathv[i], counts, err);
            unlink(files.gl_pathv[i]);
        }
    }
    globfree(&files);
    rmdir(run->folder);
    run->child = 0;
    return status;
}

/* In the child. One thread: more would wait for each other for so many instructions. */
static void become_callgrind(const char *program, const char *folder, const char *const *arguments) {
    char out[600];
    /* What the C library does to find memory hangs on where its heap lies, which differs from run to run. */
    const char *command[LAB_COUNT_ARGUMENTS_MAX + 16] = {"valgrind",
                                                         "-q",
                                                         "--tool=callgrind",
                                                         "--instr-atstart=no",
                                                         "--toggle-collect=malloc",
                                                         "--toggle-collect=calloc",
                                                         "--toggle-collect=realloc",
                                                         "--toggle-collect=memalign",
                                                         "--toggle-collect=aligned_alloc",
                                                         "--toggle-collect=free",
                                                         "--collect-atstart=yes",
                                                         out,
                                                         program};
    int count = 13;
    snprintf(out, sizeof out, "--callgrind-out-file=%s/counts", folder);
    for (int i = 0; arguments[i]; i++) command[count++] = arguments[i];
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    setenv("OMP_NUM_THREADS", "1", 1);
    execvp(command[0], (char *const *)(uintptr_t)command);
    _exit(NO_VALGRIND);
}

df_status lab_count_start(const char *const *arguments, const char *folder, lab_count_run *run, df_error *err) {
    char program[1024];
    const ssize_t length = readlink("/proc/self/exe", program, sizeof program - 1);
    if (length <= 0) return df_fail(err, DF_ERROR_IO, "/proc/self/exe: cannot be read");
    program[length] = 0;
    snprintf(run->folder, sizeof run->folder, "%s", folder);
    empty_folder(run, NULL, NULL);
    if (mkdir(run->folder, 0777) != 0) return df_fail(err, DF_ERROR_IO, "%s: cannot make a folder", run->folder);
    fflush(NULL);
    run->child = fork();
    if (run->child == 0) become_callgrind(program, run->folder, arguments);
    if (run->child > 0) return DF_OK;
    run->child = 0;
    rmdir(run->folder);
    return df_fail(err, DF_ERROR_IO, "valgrind: cannot be started");
}

df_status lab_count_finish(lab_count_run *run, lab_counts *counts, df_error *err) {
    int code = 0;
    if (!run->child) return DF_OK;
    const bool waited = waitpid(run->child, &code, 0) == run->child && WIFEXITED(code);
    df_status status = empty_folder(run, counts, err);
    if (waited && WEXITSTATUS(code) == NO_VALGRIND) return DF_OK;
    if (!waited || WEXITSTATUS(code) != 0) return df_fail(err, DF_ERROR_IO, "valgrind: the counted run failed");
    return status;
}

void lab_count_abandon(lab_count_run *run) {
    if (!run->child) return;
    kill(run->child, SIGTERM);
    waitpid(run->child, NULL, 0);
    empty_folder(run, NULL, NULL);
}

void lab_counts_free(lab_counts *counts) {
    for (size_t i = 0; i < counts->count; i++) free(counts->list[i].label);
    free(counts->list);
    *counts = (lab_counts){0};
}

uint64_t lab_counts_find(const lab_counts *counts, const char *label) {
    for (size_t i = 0; i < counts->count; i++) {
        if (strcmp(counts->list[i].label, label) == 0) return counts->list[i].instructions;
    }
    return 0;
}
