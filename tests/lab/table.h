/*
 * A CSV that can be continued: rows that are there already are not measured again.
 *
 * The first column of each row is the version that wrote it; a file of another version, or with other columns, is
 * refused. A row is known by its key: what its columns before the first result say. One process at a time has it: it is
 * locked while it is open.
 */
#ifndef DF_TESTS_TABLE_H
#define DF_TESTS_TABLE_H

#include "common/status.h"

#include <stdbool.h>
#include <stdio.h>

typedef struct lab_table {
    FILE *file;
    char **keys;
    size_t key_count, key_capacity;
} lab_table;

/* Opens or creates. `columns` is the header without "version,"; `version` must not contain commas. A last line without
 * an end, of a run that was interrupted, is dropped. */
df_status lab_table_open(const char *path, const char *version, const char *columns, size_t key_columns,
                         lab_table *table, df_error *err);
void lab_table_close(lab_table *table);

/* True when a row with this key, its columns joined by commas without the version, is there. */
bool lab_table_has(const lab_table *table, const char *key);

/* Appends a row and writes it out. */
df_status lab_table_add(lab_table *table, const char *version, const char *key, const char *results, df_error *err);

#endif
