/*
 * Instructions of user code, counted: by the processor's counter where the system lets a program read it
 * (perf_event_open), otherwise by running the program again under valgrind's callgrind, which counts to the digit,
 * without malloc and free.
 *
 * Callgrind: the parent calls lab_count_start and, later, lab_count_finish; its child, the same program with other
 * arguments and one thread, calls lab_count_begin and lab_count_end("label") around each piece, and the parent then
 * asks for the labels. The child runs beside the parent, which may be slow: it is not timed.
 */
#ifndef DF_TESTS_INSTRUCTIONS_H
#define DF_TESTS_INSTRUCTIONS_H

#include "common/status.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct lab_counts {
    struct lab_count {
        char *label;
        uint64_t instructions;
    } * list;
    size_t count;
} lab_counts;

/* The processor's counter of this thread, running; -1 where there is none to be had. */
int lab_counter_open(void);
uint64_t lab_counter_read(int counter);

/* In a child under callgrind: what runs between begin and end is counted under a label, which must not hold a newline.
 * Only between on and off, outside of which the child runs faster. */
void lab_counting_on(void);
void lab_counting_off(void);
void lab_count_begin(void);
void lab_count_end(const char *label);

#define LAB_COUNT_ARGUMENTS_MAX 128

/* A child that counts; zero: none. */
typedef struct lab_count_run {
    int child; /* its process */
    char folder[512];
} lab_count_run;

/* Starts this program with these arguments (at most so many, ended by NULL, without the program's name) under
 * callgrind. folder: made for its files and removed with them; what is left of a run that was cut off is cleared. */
df_status lab_count_start(const char *const *arguments, const char *folder, lab_count_run *run, df_error *err);
/* Waits for it and adds its counts; where there was none, does nothing. No valgrind is no error: nothing is added. */
df_status lab_count_finish(lab_count_run *run, lab_counts *counts, df_error *err);
/* Ends it; what it has counted is lost. */
void lab_count_abandon(lab_count_run *run);

df_status lab_counts_add(lab_counts *counts, const char *label, uint64_t instructions, df_error *err);
void lab_counts_free(lab_counts *counts);

/* 0: not counted */
uint64_t lab_counts_find(const lab_counts *counts, const char *label);

#endif
