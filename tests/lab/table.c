#include "table.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static df_status add_key(lab_table *table, char *key, df_error *err) {
    if (table->key_count == table->key_capacity) {
        size_t capacity = table->key_capacity ? 2 * table->key_capacity : 256;
        char **keys = realloc(table->keys, capacity * sizeof *keys);
        if (!keys) {
            free(key);
            return df_fail(err, DF_ERROR_MEMORY, "no memory for %zu rows", capacity);
        }
        table->keys = keys;
        table->key_capacity = capacity;
    }
    table->keys[table->key_count++] = key;
    return key ? DF_OK : df_fail(err, DF_ERROR_MEMORY, "no memory for a row");
}

/* Reads the rows that are there; *end is where the next one belongs. */
static df_status read_rows(lab_table *table, const char *path, const char *version, const char *columns,
                           size_t key_columns, long *end, df_error *err) {
    char *line = NULL;
    size_t size = 0;
    ssize_t length;
    df_status status = DF_OK;
    *end = 0;
    for (size_t row = 0;
         status == DF_OK && (length = getline(&line, &size, table->file)) > 0 && line[length - 1] == '\n'; row++) {
        line[length - 1] = 0;
        *end += (long)length;
        char *rest = strchr(line, ',');
        if (rest) *rest++ = 0;
        if (row == 0) {
            if (!rest || strcmp(line, "version") != 0 || strcmp(rest, columns) != 0) {
                status =
                    df_fail(err, DF_ERROR_FORMAT, "%s: its columns are not those of this version (%s)", path, version);
            }
            continue;
        }
        if (!rest || strcmp(line, version) != 0) {
            status =
                df_fail(err, DF_ERROR_FORMAT, "%s: row %zu is of version %s, this is %s", path, row, line, version);
            continue;
        }
        char *at = rest;
        for (size_t i = 0; at && i < key_columns; i++) at = strchr(at + (i > 0), ',');
        if (!at) status = df_fail(err, DF_ERROR_FORMAT, "%s: row %zu has too few columns", path, row);
        else status = add_key(table, strndup(rest, (size_t)(at - rest)), err);
    }
    free(line);
    return status;
}

/* A lock that the system takes back when its process ends, however that ends. */
static df_status lock_table(FILE *file, const char *path, df_error *err) {
    struct flock lock = {.l_type = F_WRLCK, .l_whence = SEEK_SET};
    char name_path[64], name[32] = "";
    if (fcntl(fileno(file), F_SETLK, &lock) == 0) return DF_OK;
    if (errno != EACCES && errno != EAGAIN) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    if (fcntl(fileno(file), F_GETLK, &lock) != 0 || lock.l_type == F_UNLCK || lock.l_pid <= 0)
        return df_fail(err, DF_ERROR_IO, "%s: another process writes it", path);
    snprintf(name_path, sizeof name_path, "/proc/%d/comm", (int)lock.l_pid);
    FILE *names = fopen(name_path, "r");
    if (!names || !fgets(name, sizeof name, names)) snprintf(name, sizeof name, "unknown");
    if (names) fclose(names);
    name[strcspn(name, "\n")] = 0;
    return df_fail(err, DF_ERROR_IO, "%s: process %d (%s) writes it: wait for its end, or take another table", path,
                   (int)lock.l_pid, name);
}

df_status lab_table_open(const char *path, const char *version, const char *columns, size_t key_columns,
                         lab_table *table, df_error *err) {
    long end;
    memset(table, 0, sizeof *table);
    table->file = fopen(path, "a+e");
    if (!table->file) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    rewind(table->file);
    df_status status = lock_table(table->file, path, err);
    if (status == DF_OK) status = read_rows(table, path, version, columns, key_columns, &end, err);
    if (status == DF_OK && (fseek(table->file, 0, SEEK_END) != 0 || ftruncate(fileno(table->file), end) != 0)) {
        status = df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    }
    if (status == DF_OK && end == 0 && fprintf(table->file, "version,%s\n", columns) < 0) {
        status = df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    }
    if (status != DF_OK) lab_table_close(table);
    return status;
}

void lab_table_close(lab_table *table) {
    if (table->file) fclose(table->file);
    for (size_t i = 0; i < table->key_count; i++) free(table->keys[i]);
    free(table->keys);
    memset(table, 0, sizeof *table);
}

bool lab_table_has(const lab_table *table, const char *key) {
    for (size_t i = 0; i < table->key_count; i++) {
        if (strcmp(table->keys[i], key) == 0) return true;
    }
    return false;
}

df_status lab_table_add(lab_table *table, const char *version, const char *key, const char *results, df_error *err) {
    if (fprintf(table->file, "%s,%s,%s\n", version, key, results) < 0 || fflush(table->file) != 0) {
        return df_fail(err, DF_ERROR_IO, "the table: %s", strerror(errno));
    }
    return add_key(table, strdup(key), err);
}
