#include "common/output_file.h"
#include "common/interrupt.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static df_status fail_errno(const df_output *output, df_error *err, const char *what) {
    return df_fail(err, DF_ERROR_IO, "%s: cannot %s: %s", output->path, what, strerror(errno));
}

static void reset(df_output *output) {
    if (output->fd >= 0) close(output->fd);
    if (output->named && output->temporary_path) {
        unlink(output->temporary_path);
        df_interrupt_set_temporary(NULL);
    }
    free(output->path);
    free(output->target_path);
    free(output->temporary_path);
    *output = (df_output){.fd = -1};
}

/* The file that `path` names once links are followed, even where it does not exist yet. NULL with errno set. */
static char *resolve(const char *path) {
    char *real = realpath(path, NULL);
    if (real || errno != ENOENT) return real;
    char link[PATH_MAX];
    ssize_t length = readlink(path, link, sizeof link - 1);
    if (length < 0) return strdup(path); /* no such name: a new file */
    link[length] = 0;
    if (link[0] == '/') return strdup(link);
    char *copy = strdup(path), *out = NULL;
    if (copy && asprintf(&out, "%s/%s", dirname(copy), link) < 0) out = NULL;
    free(copy);
    return out;
}

/* Opens the temporary: unnamed where the file system can do that and /proc can name it later, else beside the target.
 */
static int open_temporary(df_output *output, const char *folder, mode_t mode) {
    if (access("/proc/self/fd", X_OK) == 0) {
        int fd = open(folder, O_TMPFILE | O_WRONLY | O_CLOEXEC, mode);
        if (fd >= 0 || (errno != EOPNOTSUPP && errno != EISDIR && errno != EINVAL)) return fd;
    }
    int fd = open(output->temporary_path, O_WRONLY | O_CREAT | O_TRUNC | O_NOFOLLOW | O_CLOEXEC, mode);
    if (fd < 0) return fd;
    output->named = true;
    df_interrupt_set_temporary(output->temporary_path);
    return fd;
}

/* Removes the temporaries of this target, ".BASE.PID.tmp", whose process is no more: killed in the moment between
 * naming and renaming. */
static void remove_stale(const char *folder, const char *base) {
    const size_t length = strlen(base);
    DIR *directory = opendir(folder);
    for (const struct dirent *entry; directory && (entry = readdir(directory));) {
        const char *name = entry->d_name;
        char *end;
        if (name[0] != '.' || strncmp(name + 1, base, length) != 0 || name[length + 1] != '.') continue;
        if (!isdigit((unsigned char)name[length + 2])) continue;
        const long pid = strtol(name + length + 2, &end, 10);
        if (strcmp(end, ".tmp") == 0 && pid > 0 && kill((pid_t)pid, 0) != 0 && errno == ESRCH)
            unlinkat(dirfd(directory), name, 0);
    }
    if (directory) closedir(directory);
}

df_status df_output_open(df_output *output, const char *path, df_error *err) {
    *output = (df_output){.fd = -1};
    output->path = strdup(path);
    output->target_path = resolve(path);
    df_status status = DF_OK;
    if (!output->path || !output->target_path) {
        status = df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
        reset(output);
        return status;
    }
    struct stat info;
    bool exists = stat(output->target_path, &info) == 0;
    if (exists && S_ISDIR(info.st_mode)) {
        status = df_fail(err, DF_ERROR_IO, "%s: is a folder", path);
    } else if (exists && !S_ISREG(info.st_mode)) {
        output->direct = true;
        output->fd = open(output->target_path, O_WRONLY | O_CLOEXEC);
        if (output->fd < 0) status = fail_errno(output, err, "write");
    } else if (exists && access(output->target_path, W_OK) != 0) {
        status = fail_errno(output, err, "replace");
    } else {
        char *copy = strdup(output->target_path), *base = strdup(output->target_path);
        const char *folder = copy ? dirname(copy) : NULL;
        if (!copy || !base ||
            asprintf(&output->temporary_path, "%s/.%s.%ld.tmp", folder, basename(base), (long)getpid()) < 0) {
            output->temporary_path = NULL;
            status = df_fail(err, DF_ERROR_MEMORY, "%s: out of memory", path);
        } else {
            const char *slash = strrchr(output->target_path, '/');
            remove_stale(folder, slash ? slash + 1 : output->target_path);
            output->fd = open_temporary(output, folder, 0666);
            if (output->fd < 0) status = fail_errno(output, err, "create");
            else if (exists) (void)!fchmod(output->fd, info.st_mode & 07777);
        }
        free(copy);
        free(base);
    }
    if (status != DF_OK) reset(output);
    return status;
}

df_status df_output_write(df_output *output, const void *data, size_t size, df_error *err) {
    const char *bytes = data;
    while (size > 0) {
        ssize_t done = write(output->fd, bytes, size);
        if (done < 0 && errno == EINTR) continue;
        if (done < 0) return fail_errno(output, err, "write");
        bytes += done;
        size -= (size_t)done;
    }
    return DF_OK;
}

/* Gives the unnamed file a name: the target's own when it is free, else a temporary one to rename from. */
static int link_unnamed(df_output *output) {
    char self[64];
    snprintf(self, sizeof self, "/proc/self/fd/%d", output->fd);
    if (linkat(AT_FDCWD, self, AT_FDCWD, output->target_path, AT_SYMLINK_FOLLOW) == 0) return 0;
    if (errno != EEXIST) return -1;
    unlink(output->temporary_path); /* left by a killed process that had our number */
    if (linkat(AT_FDCWD, self, AT_FDCWD, output->temporary_path, AT_SYMLINK_FOLLOW) != 0) return -1;
    output->named = true;
    df_interrupt_set_temporary(output->temporary_path);
    return 0;
}

df_status df_output_commit(df_output *output, df_error *err) {
    df_status status = DF_OK;
    if (!output->direct) {
        if (fsync(output->fd) != 0) status = fail_errno(output, err, "write");
        else if (!output->named && link_unnamed(output) != 0) status = fail_errno(output, err, "create");
        else if (output->named) {
            if (rename(output->temporary_path, output->target_path) != 0) {
                status = fail_errno(output, err, "replace");
            } else {
                output->named = false;
                df_interrupt_set_temporary(NULL);
            }
        }
    }
    int closed = close(output->fd);
    output->fd = -1;
    if (closed != 0 && status == DF_OK) status = fail_errno(output, err, "write");
    reset(output);
    return status;
}

void df_output_discard(df_output *output) {
    if (output->path) reset(output);
}

df_status df_output_check(const char *path, df_error *err) {
    struct stat info;
    if (!*path) return df_fail(err, DF_ERROR_USAGE, "the output has an empty name");
    if (stat(path, &info) == 0) {
        if (S_ISDIR(info.st_mode)) return df_fail(err, DF_ERROR_IO, "%s: is a folder", path);
        if (access(path, W_OK) != 0) return df_fail(err, DF_ERROR_IO, "%s: cannot replace: %s", path, strerror(errno));
        if (!S_ISREG(info.st_mode)) return DF_OK;
    }
    char *target = resolve(path);
    if (!target) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    const char *folder = dirname(target);
    df_status status = DF_OK;
    if (access(folder, W_OK | X_OK) != 0) {
        status = df_fail(err, DF_ERROR_IO, "%s: cannot create: folder %s: %s", path, folder, strerror(errno));
    }
    free(target);
    return status;
}

df_status df_output_buffer(const char *path, const void *data, size_t size, df_error *err) {
    df_output output;
    df_status status = df_output_open(&output, path, err);
    if (status != DF_OK) return status;
    status = df_output_write(&output, data, size, err);
    if (status == DF_OK) return df_output_commit(&output, err);
    df_output_discard(&output);
    return status;
}

static void finish_standard(int exit_code, void *program) {
    errno = 0; /* stays 0 where an earlier write failed */
    if (exit_code != 0 || (fflush(stdout) == 0 && !ferror(stdout))) return;
    fprintf(stderr, "%s: standard output: %s\n", (const char *)program, errno ? strerror(errno) : "cannot write");
    _exit(1);
}

void df_output_watch_standard(const char *program) { on_exit(finish_standard, (void *)(uintptr_t)program); }
