/*
 * Status codes and messages.
 *
 * Every function that can fail returns a df_status and takes a caller-owned df_error as its last parameter; on failure
 * the error holds one line that names the file, the value and the limit. Library code never prints and never exits:
 * only main does.
 */
#ifndef DF_STATUS_H
#define DF_STATUS_H

#ifdef __cplusplus
extern "C" {
#endif

typedef enum df_status {
    DF_OK = 0,
    DF_ERROR_USAGE,       /* the command line asks for something impossible or contradictory: exit 2 */
    DF_ERROR_IO,          /* a file cannot be opened, read, written or replaced */
    DF_ERROR_FORMAT,      /* a file is damaged or not what its name promises */
    DF_ERROR_INPUT,       /* a well-formed input that this operation cannot handle, such as an open mesh */
    DF_ERROR_MEMORY,      /* an allocation failed, or would exceed a stated limit */
    DF_ERROR_UNSUPPORTED, /* not built in, or not supported by this machine */
} df_status;

typedef struct df_error {
    df_status status;
    char text[1024]; /* one line without a newline; empty when status is DF_OK */
} df_error;

/* Stores status and message in err; NULL: nothing. */
#ifdef __GNUC__
__attribute__((format(printf, 3, 4)))
#endif
void df_error_set(df_error *err, df_status status, const char *format, ...);

/* The same as an expression that has the status as its value, so that failing is one line, and compilers and analysers
 * see that it fails: return df_fail(err, DF_ERROR_FORMAT, "%s: brick %u points past the end (%u bricks)", path, i,
 * count); */
#define df_fail(err, status, ...) (df_error_set((err), (status), __VA_ARGS__), (status))

/* The exit code that a program ends with: 0 for DF_OK, 2 for DF_ERROR_USAGE, 1 for all others. */
int df_exit_code(df_status status);

#ifdef __cplusplus
}
#endif
#endif
