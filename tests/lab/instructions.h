/*
 * Instructions of user code, counted: by the processor's counter where the system lets a program read it
 * (perf_event_open), otherwise by running the program again under valgrind's callgrind, which counts to the digit.
 *
 * Callgrind: the parent calls lab_count_again; its child, the same program with other arguments, calls
 * lab_count_begin and lab_count_end("label") around each piece, and the parent then asks for the labels.
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

/* In a child under callgrind: what runs between the two is counted under a label, which must not hold a newline. */
void lab_count_begin(void);
void lab_count_end(const char *label);

/* Runs this program with these arguments (ended by NULL, without the program's name) under callgrind. Where there is no
 * valgrind, *counts is empty and that is no error. Free with lab_counts_free. */
df_status lab_count_again(const char *const *arguments, lab_counts *counts, df_error *err);
void lab_counts_free(lab_counts *counts);

/* 0: not counted */
uint64_t lab_counts_find(const lab_counts *counts, const char *label);

#endif
