#include "common/options.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A whole number that fills `text` up to `end`; false otherwise. */
static int read_whole(const char *text, const char **end, unsigned long long *value) {
    if (*text < '0' || *text > '9') return 0;
    char *stop;
    errno = 0;
    *value = strtoull(text, &stop, 10);
    *end = stop;
    return errno == 0;
}

df_status df_parse_u32(const char *option, const char *text, uint32_t low, uint32_t high, uint32_t *out,
                       df_error *err) {
    unsigned long long value;
    const char *end;
    if (!read_whole(text, &end, &value) || *end || value < low || value > high) {
        return df_fail(err, DF_ERROR_USAGE, "%s %s: expected a whole number from %u to %u", option, text, low, high);
    }
    *out = (uint32_t)value;
    return DF_OK;
}

df_status df_parse_double(const char *option, const char *text, double low, double high, double *out, df_error *err) {
    char *end;
    double value = strtod(text, &end);
    if (end == text || *end || !isfinite(value) || value < low || value > high) {
        return df_fail(err, DF_ERROR_USAGE, "%s %s: expected a number from %g to %g", option, text, low, high);
    }
    *out = value;
    return DF_OK;
}

df_status df_parse_doubles(const char *option, const char *text, uint32_t count, double *out, df_error *err) {
    const char *at = text;
    for (uint32_t i = 0; i < count; i++) {
        char *end;
        out[i] = strtod(at, &end);
        if (end == at || !isfinite(out[i]) || *end != (i + 1 < count ? ',' : 0)) {
            return df_fail(err, DF_ERROR_USAGE, "%s %s: expected %u numbers separated by commas", option, text, count);
        }
        at = end + 1;
    }
    return DF_OK;
}

df_status df_parse_size(const char *option, const char *text, uint32_t *width, uint32_t *height, df_error *err) {
    unsigned long long w, h;
    const char *end;
    if (!read_whole(text, &end, &w) || *end != 'x' || !read_whole(end + 1, &end, &h) || *end || w < 1 || w > 65536 ||
        h < 1 || h > 65536) {
        return df_fail(err, DF_ERROR_USAGE, "%s %s: expected WIDTHxHEIGHT, each from 1 to 65536", option, text);
    }
    *width = (uint32_t)w;
    *height = (uint32_t)h;
    return DF_OK;
}

df_status df_parse_name(const char *option, const char *text, const char *const *names, uint32_t *out, df_error *err) {
    char list[512] = "";
    for (uint32_t i = 0; names[i]; i++) {
        if (strcmp(text, names[i]) == 0) {
            *out = i;
            return DF_OK;
        }
        size_t used = strlen(list);
        snprintf(list + used, sizeof list - used, "%s%s", i ? ", " : "", names[i]);
    }
    return df_fail(err, DF_ERROR_USAGE, "%s %s: expected one of %s", option, text, list);
}

char *df_path_with_extension(const char *path, const char *extension, int keep_folder) {
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path, *dot = strrchr(name, '.');
    const char *start = keep_folder ? path : name;
    size_t length = dot && dot > name ? (size_t)(dot - start) : strlen(start);
    char *out;
    return asprintf(&out, "%.*s%s", (int)length, start, extension) < 0 ? NULL : out;
}

char *df_command_line(int argc, char **argv) {
    size_t size = 1;
    for (int i = 0; i < argc; i++) size += 4 * strlen(argv[i]) + 3;
    char *out = malloc(size), *at = out;
    if (!out) return NULL;
    for (int i = 0; i < argc; i++) {
        if (i) *at++ = ' ';
        static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+=./,:@%";
        int quote = argv[i][0] == 0 || argv[i][strspn(argv[i], plain)] != 0;
        if (quote) *at++ = '\'';
        for (const char *c = argv[i]; *c; c++) {
            if (*c == '\'') at = stpcpy(at, "'\\''");
            else *at++ = *c;
        }
        if (quote) *at++ = '\'';
    }
    *at = 0;
    return out;
}
