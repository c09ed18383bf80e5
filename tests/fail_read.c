/*
 * A shared object for LD_PRELOAD: the DF_FAIL_AT-th read (counted from 1) of the file DF_FAIL_PATH fails with EIO, as
 * of a disk with a bad block, and all after it. It says so on descriptor DF_FAIL_FD, so that a test knows whether its
 * fault occurred. Reads are calls of read, pread, fread and getline, under the names that fortified programs call as
 * well; C++ streams call read.
 */
#undef _FORTIFY_SOURCE /* the names below are ours to define */
#define __NO_INLINE__ 1
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

ssize_t __read_chk(int fd, void *out, size_t size, size_t room);
ssize_t __pread_chk(int fd, void *out, size_t size, off_t offset, size_t room);
ssize_t __pread64_chk(int fd, void *out, size_t size, off_t offset, size_t room);
size_t __fread_chk(void *out, size_t room, size_t size, size_t count, FILE *file);
ssize_t __getdelim(char **line, size_t *capacity, int end, FILE *file);

static atomic_long calls;

/* True where this read of the descriptor is the one to fail. */
static int must_fail(int fd) {
    const char *path = getenv("DF_FAIL_PATH"), *at = getenv("DF_FAIL_AT"), *report = getenv("DF_FAIL_FD");
    struct stat wanted, read;
    if (!path || !at || stat(path, &wanted) != 0 || fstat(fd, &read) != 0) return 0;
    if (wanted.st_dev != read.st_dev || wanted.st_ino != read.st_ino) return 0;
    if (atomic_fetch_add(&calls, 1) + 1 < atol(at)) return 0;
    if (report) {
        ssize_t written = write(atoi(report), "failed\n", 7);
        (void)written;
    }
    errno = EIO;
    return 1;
}

/* As must_fail; the stream then knows of the error, as after a read of its own. */
static int stream_must_fail(FILE *file) {
    if (!must_fail(fileno(file))) return 0;
    file->_flags |= 0x20; /* what ferror of the GNU C library looks at */
    return 1;
}

static void *next(const char *name) { return dlsym(RTLD_NEXT, name); }

ssize_t read(int fd, void *out, size_t size) {
    ssize_t (*real)(int, void *, size_t) = (ssize_t(*)(int, void *, size_t))next("read");
    return must_fail(fd) ? -1 : real(fd, out, size);
}

ssize_t pread(int fd, void *out, size_t size, off_t offset) {
    ssize_t (*real)(int, void *, size_t, off_t) = (ssize_t(*)(int, void *, size_t, off_t))next("pread");
    return must_fail(fd) ? -1 : real(fd, out, size, offset);
}

size_t fread(void *out, size_t size, size_t count, FILE *file) {
    size_t (*real)(void *, size_t, size_t, FILE *) = (size_t(*)(void *, size_t, size_t, FILE *))next("fread");
    return stream_must_fail(file) ? 0 : real(out, size, count, file);
}

ssize_t __getdelim(char **line, size_t *capacity, int end, FILE *file) {
    ssize_t (*real)(char **, size_t *, int, FILE *) = (ssize_t(*)(char **, size_t *, int, FILE *))next("__getdelim");
    return stream_must_fail(file) ? -1 : real(line, capacity, end, file);
}

ssize_t getdelim(char **line, size_t *capacity, int end, FILE *file) { return __getdelim(line, capacity, end, file); }
ssize_t getline(char **line, size_t *capacity, FILE *file) { return __getdelim(line, capacity, '\n', file); }
ssize_t pread64(int fd, void *out, size_t size, off_t offset) { return pread(fd, out, size, offset); }

ssize_t __read_chk(int fd, void *out, size_t size, size_t room) {
    return size <= room ? read(fd, out, size) : (abort(), 0);
}

ssize_t __pread_chk(int fd, void *out, size_t size, off_t offset, size_t room) {
    return size <= room ? pread(fd, out, size, offset) : (abort(), 0);
}

ssize_t __pread64_chk(int fd, void *out, size_t size, off_t offset, size_t room) {
    return __pread_chk(fd, out, size, offset, room);
}

size_t __fread_chk(void *out, size_t room, size_t size, size_t count, FILE *file) {
    return size * count <= room ? fread(out, size, count, file) : (abort(), 0);
}
