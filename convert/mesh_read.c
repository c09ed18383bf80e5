#include "convert/mesh_read.h"

#include "common/memory.h"
#include "convert/mesh_formats.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

typedef df_status parser(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err);

static const struct {
    const char *extension;
    parser *parse;
} formats[] = {
    {".obj", df_mesh_parse_obj}, {".ply", df_mesh_parse_ply}, {".off", df_mesh_parse_off}, {".stl", df_mesh_parse_stl}};

static parser *find_parser(const char *path) {
    const char *dot = strrchr(path, '.');
    for (size_t i = 0; dot && i < sizeof formats / sizeof *formats; i++) {
        if (strcasecmp(dot, formats[i].extension) == 0) return formats[i].parse;
    }
    return NULL;
}

bool df_mesh_is_mesh_path(const char *path) { return find_parser(path) != NULL; }

/* Reads all bytes of an open file; `hint` is its size, or 0 where that is unknown (a pipe). A zero byte follows. */
static df_status read_all(int fd, size_t hint, const char *path, char **text, size_t *size, df_error *err) {
    size_t capacity = hint + 2;
    df_status status = df_alloc_raw((void **)text, capacity, 1, path, err);
    *size = 0;
    while (status == DF_OK) {
        ssize_t count = read(fd, *text + *size, capacity - 1 - *size);
        if (count < 0 && errno == EINTR) continue;
        if (count < 0) status = df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
        if (count <= 0) break;
        *size += (size_t)count;
        if (*size + 1 < capacity) continue;
        capacity = capacity * 2 + 65536;
        char *grown = realloc(*text, capacity);
        if (grown) *text = grown;
        else status = df_fail(err, DF_ERROR_MEMORY, "%s: out of memory", path);
    }
    if (status == DF_OK) {
        (*text)[*size] = 0;
    } else {
        free(*text);
        *text = NULL;
    }
    return status;
}

static df_status load(const char *path, char **text, size_t *size, df_error *err) {
    *text = NULL;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    struct stat info;
    df_status status = DF_OK;
    if (fstat(fd, &info) != 0) status = df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    else if (S_ISDIR(info.st_mode)) status = df_fail(err, DF_ERROR_IO, "%s: is a directory", path);
    else status = read_all(fd, S_ISREG(info.st_mode) ? (size_t)info.st_size : 0, path, text, size, err);
    close(fd);
    return status;
}

df_status df_mesh_read(const char *path, df_mesh *mesh, df_error *err) {
    *mesh = (df_mesh){0};
    parser *parse = find_parser(path);
    if (!parse) return df_fail(err, DF_ERROR_USAGE, "%s: unknown format (known are .obj, .ply, .off, .stl)", path);
    char *text;
    size_t size = 0;
    df_status status = load(path, &text, &size, err);
    if (status != DF_OK) return status;
    df_mesh_builder builder = {0};
    status = size == 0 ? df_fail(err, DF_ERROR_FORMAT, "%s: the file is empty", path)
                       : parse(text, size, path, &builder, err);
    free(text);
    if (status == DF_OK) return df_mesh_builder_finish(&builder, path, mesh, err);
    df_mesh_builder_free(&builder);
    return status;
}
