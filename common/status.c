#include "common/status.h"

#include <stdarg.h>
#include <stdio.h>

void df_error_set(df_error *err, df_status status, const char *format, ...) {
    if (!err) return;
    err->status = status;
    va_list args;
    va_start(args, format);
    vsnprintf(err->text, sizeof err->text, format, args);
    va_end(args);
    for (char *c = err->text; *c; c++) {
        if ((unsigned char)*c < ' ') *c = ' '; /* names of files may hold anything; a message stays one line */
    }
}

int df_exit_code(df_status status) {
    if (status == DF_OK) return 0;
    return status == DF_ERROR_USAGE ? 2 : 1;
}
