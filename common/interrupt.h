/* What happens on SIGINT, SIGTERM and SIGBUS: temporaries are removed, one line is written, and the process ends with
 * 130, 143 and 1. A file that grows past its limit (SIGXFSZ) is a failed write like others. Called by main; the other
 * functions are for output_file.c and field_file_read.c. */
#ifndef DF_INTERRUPT_H
#define DF_INTERRUPT_H

#include <stddef.h>

/* Installs the handlers for SIGINT and SIGTERM, and ignores SIGXFSZ. `program` stands before messages and must stay
 * valid. */
void df_interrupt_install(const char *program);

/* The one named temporary that a signal must remove; NULL for none. The string must stay valid until the next call. */
void df_interrupt_set_temporary(const char *path);

/* Installs the SIGBUS handler once: "NAME: the file changed while it was in use", exit 1. `path` is copied. */
void df_interrupt_guard_mapping(const char *path);

#endif
