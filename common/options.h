/* Parsing of option values for the three programs (their options themselves are argp's). Each function refuses trailing
 * text, overflow, NaN and values out of range with DF_ERROR_USAGE: "--resolution 0: expected a whole number from 1 to
 * 65536". */
#ifndef DF_OPTIONS_H
#define DF_OPTIONS_H

#include "common/status.h"

#include <stdint.h>

df_status df_parse_u32(const char *option, const char *text, uint32_t low, uint32_t high, uint32_t *out, df_error *err);

/* A finite number in [low, high]. */
df_status df_parse_double(const char *option, const char *text, double low, double high, double *out, df_error *err);

/* `count` numbers separated by commas, each finite. */
df_status df_parse_doubles(const char *option, const char *text, uint32_t count, double *out, df_error *err);

/* WxH, each 1 to 65536. */
df_status df_parse_size(const char *option, const char *text, uint32_t *width, uint32_t *height, df_error *err);

/* One of `names` (NULL-terminated); *out is its index. The message lists the names. */
df_status df_parse_name(const char *option, const char *text, const char *const *names, uint32_t *out, df_error *err);

/* A copy of `path` whose extension is replaced ("a/b.obj", ".dfield" -> "a/b.dfield"), without its folder when
 * `keep_folder` is 0. NULL when memory is short. free() it. */
char *df_path_with_extension(const char *path, const char *extension, int keep_folder);

/* The command line as one string, quoted where a shell needs it. NULL when memory is short. free() it. */
char *df_command_line(int argc, char **argv);

#endif
