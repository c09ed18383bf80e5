#include "instructions.h"

#include <glob.h>
#include <linux/perf_event.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>
#if __has_include(<valgrind/callgrind.h>)
#include <valgrind/callgrind.h>
#else
#define CALLGRIND_ZERO_STATS
#define CALLGRIND_DUMP_STATS_AT(label) ((void)(label))
#endif

#define ARGUMENTS_MAX 16
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

void lab_count_begin(void) { CALLGRIND_ZERO_STATS; }

void lab_count_end(const char *label) { CALLGRIND_DUMP_STATS_AT(label); }

static df_status run_callgrind(const char *const *arguments, const char *folder, bool *ran, df_error *err) {
    char program[1024], out[1100];
    const char *command[ARGUMENTS_MAX + 8] = {"valgrind", "-q", "--tool=callgrind", out, program};
    const ssize_t length = readlink("/proc/self/exe", program, sizeof program - 1);
    int count = 5, code = 0;
    if (length <= 0) return df_fail(err, DF_ERROR_IO, "/proc/self/exe: cannot be read");
    program[length] = 0;
    snprintf(out, sizeof out, "--callgrind-out-file=%s/counts", folder);
    for (int i = 0; arguments[i] && i < ARGUMENTS_MAX; i++) command[count++] = arguments[i];
    fflush(NULL);
    const pid_t child = fork();
    if (child == 0) {
        execvp(command[0], (char *const *)(uintptr_t)command);
        _exit(NO_VALGRIND);
    }
    if (child < 0 || waitpid(child, &code, 0) != child) return df_fail(err, DF_ERROR_IO, "valgrind: cannot be started");
    *ran = !(WIFEXITED(code) && WEXITSTATUS(code) == NO_VALGRIND);
    if (*ran && !(WIFEXITED(code) && WEXITSTATUS(code) == 0))
        return df_fail(err, DF_ERROR_IO, "valgrind: the counted run failed");
    return DF_OK;
}

/* Takes the label and the total of one file of callgrind's. */
static df_status read_counts(const char *path, lab_counts *counts, df_error *err) {
    static const char label_is[] = "desc: Trigger: Client Request: ";
    char line[1024];
    struct lab_count found = {0};
    FILE *file = fopen(path, "r");
    while (file && fgets(line, sizeof line, file)) {
        line[strcspn(line, "\n")] = 0;
        if (strncmp(line, label_is, sizeof label_is - 1) == 0 && !found.label)
            found.label = strdup(line + sizeof label_is - 1);
        if (strncmp(line, "totals: ", 8) == 0) found.instructions = strtoull(line + 8, NULL, 10);
    }
    if (file) fclose(file);
    if (!found.label) return DF_OK; /* callgrind's last file: what ran after the last label */
    struct lab_count *list = realloc(counts->list, (counts->count + 1) * sizeof *list);
    if (!list) {
        free(found.label);
        return df_fail(err, DF_ERROR_MEMORY, "no memory for counts");
    }
    counts->list = list;
    counts->list[counts->count++] = found;
    return DF_OK;
}

df_status lab_count_again(const char *const *arguments, lab_counts *counts, df_error *err) {
    const char *place = getenv("TMPDIR");
    char folder[512], pattern[600];
    glob_t files = {0};
    bool ran = false;
    *counts = (lab_counts){0};
    snprintf(folder, sizeof folder, "%s/df-lab-XXXXXX", place ? place : "/tmp");
    if (!mkdtemp(folder)) return df_fail(err, DF_ERROR_IO, "%s: cannot make a folder", folder);
    snprintf(pattern, sizeof pattern, "%s/counts*", folder);
    df_status status = run_callgrind(arguments, folder, &ran, err);
    if (glob(pattern, 0, NULL, &files) == 0) {
        for (size_t i = 0; i < files.gl_pathc; i++) {
            if (status == DF_OK) status = read_counts(files.gl_pathv[i], counts, err);
            unlink(files.gl_pathv[i]);
        }
    }
    globfree(&files);
    rmdir(folder);
    return status;
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
