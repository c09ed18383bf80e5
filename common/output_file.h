/*
 * Output files that appear whole or not at all.
 *
 * The data goes to an unnamed file in the target's folder (or a named one beside it where the file system has no
 * unnamed files), is synced, and takes the target's name in df_output_commit: an old file is whole until the new one
 * is. A target that is not a regular file (/dev/stdout, a pipe, a device) is opened and written, never replaced;
 * symbolic links are followed. Nothing is left behind on failure, on SIGINT or on SIGTERM.
 */
#ifndef DF_OUTPUT_FILE_H
#define DF_OUTPUT_FILE_H

#include "common/status.h"

#include <stdbool.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct df_output {
    int fd;            /* -1 when closed */
    bool direct;       /* the target is no regular file: written in place */
    bool named;        /* the data lies in temporary_path */
    char *path;        /* as the caller gave it, for messages */
    char *target_path; /* links resolved */
    char *temporary_path;
} df_output;

/* Opens an output. On failure the output is closed and nothing exists. DF_ERROR_IO names path and reason. */
df_status df_output_open(df_output *output, const char *path, df_error *err);

/* Appends bytes. After a failure only df_output_discard is allowed. */
df_status df_output_write(df_output *output, const void *data, size_t size, df_error *err);

/* Syncs, gives the file its name, and closes, whatever the outcome. */
df_status df_output_commit(df_output *output, df_error *err);

/* Drops what was written and closes. Accepts an output that is closed already. */
void df_output_discard(df_output *output);

/* Checks early that `path` can be written, before hours of work: its folder exists, is writable, and it is no folder
 * itself. Creates nothing. */
df_status df_output_check(const char *path, df_error *err);

/* Writes a whole buffer to a file: open, write, commit. */
df_status df_output_buffer(const char *path, const void *data, size_t size, df_error *err);

/* For main, before it parses options: at exit, also from argp's --help and --version, what standard output did not take
 * becomes "PROGRAM: standard output: REASON" and exit code 1. Says nothing where the program fails anyway. `program`
 * must stay valid. */
void df_output_watch_standard(const char *program);

#ifdef __cplusplus
}
#endif
#endif
