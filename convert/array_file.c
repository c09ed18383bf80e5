#include "convert/array_file.h"

#include "common/memory.h"
#include "common/output_file.h"

#include <assert.h>
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#define HEADER_MAX 65536 /* bytes; more is no header of ours or NumPy's */

/* What a header says. */
typedef struct array {
    uint64_t count[3];    /* samples along x, y, z */
    bool z_fastest;       /* in the file; otherwise x */
    uint32_t sample_size; /* 4 or 8 */
    bool big_endian;
    double voxel_size[3], origin[3];
} array;

df_array_format df_array_format_of(const char *path) {
    const char *dot = strrchr(path, '.');
    if (dot && strcasecmp(dot, ".npy") == 0) return DF_ARRAY_NPY;
    return dot && strcasecmp(dot, ".nrrd") == 0 ? DF_ARRAY_NRRD : DF_ARRAY_NONE;
}

/* The text after `key` and a colon in NumPy's dictionary. NULL when there is none. */
static const char *npy_entry(const char *header, const char *key) {
    const char *at = strstr(header, key);
    if (!at) return NULL;
    at += strlen(key);
    return *at == ':' ? at + 1 + strspn(at + 1, " ") : NULL;
}

static df_status parse_npy(const char *path, const char *header, array *out, df_error *err) {
    const char *type = npy_entry(header, "'descr'"), *order = npy_entry(header, "'fortran_order'"),
               *shape = npy_entry(header, "'shape'");
    if (!type || !order || !shape || (strncmp(order, "True", 4) != 0 && strncmp(order, "False", 5) != 0)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: its header does not say 'descr', 'fortran_order' and 'shape'", path);
    }
    static const char *const known[] = {"'<f4'", "'<f8'", "'>f4'", "'>f8'"};
    const size_t known_count = sizeof known / sizeof known[0], quoted = 5;
    size_t kind = 0;
    while (kind < known_count && strncmp(type, known[kind], quoted) != 0) kind++;
    if (kind == known_count)
        return df_fail(err, DF_ERROR_INPUT, "%s: its elements are %.*s; known are '<f4' and '<f8'", path,
                       (int)strcspn(type, ",}"), type);
    out->big_endian = type[1] == '>';
    out->sample_size = (uint32_t)(type[3] - '0');
    out->z_fastest = *order == 'T'; /* axis 0 is z */
    int end = 0;
    int got =
        sscanf(shape, "(%" SCNu64 " ,%" SCNu64 " ,%" SCNu64 "%n", &out->count[2], &out->count[1], &out->count[0], &end);
    bool closed = got == 3 && shape[end + strspn(shape + end, ", ")] == ')';
    if (!closed) {
        return df_fail(err, DF_ERROR_INPUT, "%s: its shape is %.*s; expected 3 axes (z, y, x)", path,
                       (int)strcspn(shape, ")") + 1, shape);
    }
    return DF_OK;
}

static df_status read_npy(FILE *file, const char *path, double voxel_size, array *out, df_error *err) {
    unsigned char start[12];
    if (fread(start, 1, 10, file) != 10 || memcmp(start, "\x93NUMPY", 6) != 0)
        return df_fail(err, DF_ERROR_FORMAT, "%s: no .npy file", path);
    size_t length = start[8] | (size_t)start[9] << 8;
    if (start[6] > 1) {
        if (fread(start + 10, 1, 2, file) != 2) return df_fail(err, DF_ERROR_FORMAT, "%s: the file is truncated", path);
        length |= (size_t)start[10] << 16 | (size_t)start[11] << 24;
    }
    char *header = length < HEADER_MAX ? malloc(length + 1) : NULL;
    if (!header) return df_fail(err, DF_ERROR_FORMAT, "%s: a header of %zu bytes", path, length);
    size_t got = fread(header, 1, length, file);
    header[got] = 0;
    df_status status = got == length ? parse_npy(path, header, out, err)
                                     : df_fail(err, DF_ERROR_FORMAT, "%s: the file is truncated", path);
    free(header);
    for (int a = 0; a < 3; a++) out->voxel_size[a] = voxel_size > 0 ? voxel_size : 1;
    return status;
}

/* Space directions of the three axes: "(a,0,0) (0,b,0) (0,0,c)". */
static bool parse_directions(const char *text, double size[3]) {
    double m[9];
    int got = sscanf(text, " ( %lf , %lf , %lf ) ( %lf , %lf , %lf ) ( %lf , %lf , %lf )", m, m + 1, m + 2, m + 3,
                     m + 4, m + 5, m + 6, m + 7, m + 8);
    if (got != 9) return false;
    for (int i = 0; i < 9; i++) {
        if (i % 4 == 0) size[i / 4] = m[i];
        else if (m[i] != 0) return false;
    }
    return true;
}

/* One "field: value" of a NRRD header. */
static df_status parse_nrrd_field(const char *path, const char *key, const char *value, array *out, bool *has_endian,
                                  df_error *err) {
    if (strcasecmp(key, "type") == 0) {
        out->sample_size = strcasecmp(value, "float") == 0 ? 4 : strcasecmp(value, "double") == 0 ? 8 : 0;
        if (!out->sample_size)
            return df_fail(err, DF_ERROR_INPUT, "%s: type %s; known are float and double", path, value);
    } else if (strcasecmp(key, "dimension") == 0 && strcmp(value, "3") != 0) {
        return df_fail(err, DF_ERROR_INPUT, "%s: dimension %s; expected 3", path, value);
    } else if (strcasecmp(key, "sizes") == 0) {
        int got = sscanf(value, "%" SCNu64 " %" SCNu64 " %" SCNu64, &out->count[0], &out->count[1], &out->count[2]);
        if (got != 3) return df_fail(err, DF_ERROR_FORMAT, "%s: sizes %s; expected 3 numbers", path, value);
    } else if (strcasecmp(key, "encoding") == 0 && strcasecmp(value, "raw") != 0) {
        return df_fail(err, DF_ERROR_INPUT, "%s: encoding %s; known is raw", path, value);
    } else if (strcasecmp(key, "endian") == 0) {
        *has_endian = true;
        out->big_endian = strcasecmp(value, "big") == 0;
        if (!out->big_endian && strcasecmp(value, "little") != 0)
            return df_fail(err, DF_ERROR_FORMAT, "%s: endian %s", path, value);
    } else if (strcasecmp(key, "space directions") == 0) {
        if (!parse_directions(value, out->voxel_size))
            return df_fail(err, DF_ERROR_INPUT, "%s: space directions %s: its grid is turned or sheared", path, value);
    } else if (strcasecmp(key, "spacings") == 0) {
        if (sscanf(value, "%lf %lf %lf", &out->voxel_size[0], &out->voxel_size[1], &out->voxel_size[2]) != 3) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: spacings %s; expected 3 numbers", path, value);
        }
    } else if (strcasecmp(key, "space origin") == 0) {
        if (sscanf(value, " ( %lf , %lf , %lf )", &out->origin[0], &out->origin[1], &out->origin[2]) != 3) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: space origin %s; expected (x,y,z)", path, value);
        }
    } else if (strcasecmp(key, "data file") == 0 || strcasecmp(key, "datafile") == 0 ||
               strcasecmp(key, "axis mins") == 0 || strcasecmp(key, "line skip") == 0 ||
               strcasecmp(key, "byte skip") == 0) {
        return df_fail(err, DF_ERROR_INPUT, "%s: \"%s: %s\" is not supported", path, key, value);
    }
    return DF_OK;
}

static df_status read_nrrd(FILE *file, const char *path, array *out, df_error *err) {
    char *line = NULL;
    size_t capacity = 0;
    bool has_endian = false, ended = false;
    df_status status = DF_OK;
    ssize_t length = getline(&line, &capacity, file);
    if (length < 8 || strncmp(line, "NRRD000", 7) != 0)
        status = df_fail(err, DF_ERROR_FORMAT, "%s: no .nrrd file", path);
    for (int a = 0; a < 3; a++) out->voxel_size[a] = 1;
    while (status == DF_OK && !ended && getline(&line, &capacity, file) > 0 && ftell(file) < HEADER_MAX) {
        line[strcspn(line, "\r\n")] = 0;
        ended = !*line;
        char *colon = strstr(line, ": ");
        if (ended || *line == '#' || strstr(line, ":=") || !colon) continue;
        *colon = 0;
        status = parse_nrrd_field(path, line, colon + 2, out, &has_endian, err);
    }
    free(line);
    if (status != DF_OK) return status;
    if (!ended) return df_fail(err, DF_ERROR_FORMAT, "%s: its header does not end", path);
    if (!out->sample_size || !out->count[0] || !has_endian)
        return df_fail(err, DF_ERROR_FORMAT, "%s: its header lacks type, sizes or endian", path);
    return DF_OK;
}

/* A sample as a float. What is below zero stays below zero. */
static float decode(const array *a, const unsigned char *bytes) {
    uint64_t bits = 0;
    for (uint32_t i = 0; i < a->sample_size; i++)
        bits |= (uint64_t)bytes[a->big_endian ? a->sample_size - 1 - i : i] << 8 * i;
    if (a->sample_size == 4) {
        float value;
        uint32_t low = (uint32_t)bits;
        memcpy(&value, &low, sizeof value);
        return value + 0.0f;
    }
    double value;
    memcpy(&value, &bits, sizeof value);
    return value < 0 && (float)value == 0 ? -0x1p-149f : (float)value + 0.0f;
}

static df_status read_samples(FILE *file, const char *path, const array *a, df_field *field, df_error *err) {
    float *samples;
    uint64_t total = a->count[0] * a->count[1] * a->count[2], slow = a->z_fastest ? a->count[0] : a->count[2];
    uint64_t row = total / slow; /* samples of one step of the slowest axis */
    unsigned char *bytes = NULL;
    df_status status = df_alloc_raw((void **)&samples, total, sizeof *samples, "samples", err);
    if (status != DF_OK) return status;
    df_field_own(field, samples);
    field->samples = samples;
    status = df_alloc_raw((void **)&bytes, row, a->sample_size, "samples", err);
    for (uint64_t s = 0; status == DF_OK && s < slow; s++) {
        if (fread(bytes, a->sample_size, row, file) != row)
            status = df_fail(err, DF_ERROR_FORMAT, "%s: the file is truncated", path);
        for (uint64_t i = 0; status == DF_OK && i < row; i++) {
            uint64_t z = i % a->count[2], y = i / a->count[2]; /* where z is fastest, and s is x */
            uint64_t at = a->z_fastest ? s + a->count[0] * (y + a->count[1] * z) : s * row + i;
            samples[at] = decode(a, bytes + i * a->sample_size);
        }
    }
    free(bytes);
    return status;
}

static df_status check_array(FILE *file, const char *path, const array *a, df_error *err) {
    struct stat info;
    for (int axis = 0; axis < 3; axis++) {
        if (a->count[axis] < 2 || a->count[axis] > DF_VOXEL_COUNT_MAX + 1ull) {
            return df_fail(err, DF_ERROR_INPUT, "%s: %" PRIu64 " samples along %c (2 to %u are possible)", path,
                           a->count[axis], "xyz"[axis], DF_VOXEL_COUNT_MAX + 1);
        }
    }
    uint64_t expected = a->count[0] * a->count[1] * a->count[2] * a->sample_size;
    if (fstat(fileno(file), &info) != 0 || (uint64_t)info.st_size != expected + (uint64_t)ftell(file)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: %lld bytes of samples, its header promises %" PRIu64, path,
                       (long long)info.st_size - ftell(file), expected);
    }
    return DF_OK;
}

df_status df_array_read(const char *path, double voxel_size, df_field *field, df_error *err) {
    array a = {0};
    df_array_format format = df_array_format_of(path);
    *field = (df_field){.kind = DF_FIELD_DENSE, .sample_type = DF_SAMPLE_F32, .error_max = -1, .error_rms = -1};
    FILE *file = fopen(path, "rbe");
    if (!file) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    df_status status =
        format == DF_ARRAY_NPY ? read_npy(file, path, voxel_size, &a, err) : read_nrrd(file, path, &a, err);
    if (status == DF_OK) status = check_array(file, path, &a, err);
    for (int axis = 0; status == DF_OK && axis < 3; axis++) {
        field->voxel_count[axis] = (uint32_t)a.count[axis] - 1;
        field->voxel_size[axis] = a.voxel_size[axis];
        field->origin[axis] = a.origin[axis];
    }
    if (status == DF_OK) status = read_samples(file, path, &a, field, err);
    if (status != DF_OK && ferror(file)) status = df_fail(err, DF_ERROR_IO, "%s: cannot read the file", path);
    if (status == DF_OK) status = df_field_finish(field, path, err);
    fclose(file);
    if (status != DF_OK) df_field_free(field);
    return status;
}

/* The dictionary of a .npy file is padded with spaces so that the samples begin at a multiple of 64. */
static int npy_header(const df_field *f, char *out, size_t size) {
    enum { START = 10, LENGTH = 128 };
    assert(size > LENGTH);
    memcpy(out, "\x93NUMPY\1\0", 8);
    out[8] = LENGTH - START;
    out[9] = 0;
    int length =
        START + snprintf(out + START, size - START,
                         "{'descr': '<f4', 'fortran_order': False, 'shape': (%" PRIu32 ", %" PRIu32 ", %" PRIu32 "), }",
                         f->voxel_count[2] + 1, f->voxel_count[1] + 1, f->voxel_count[0] + 1);
    assert(length < LENGTH);
    memset(out + length, ' ', (size_t)(LENGTH - length));
    out[LENGTH - 1] = '\n';
    return LENGTH;
}

static int nrrd_header(const df_field *f, char *out, size_t size) {
    return snprintf(
        out, size,
        "NRRD0005\n# signed distances, negative inside\ntype: float\ndimension: 3\nspace dimension: 3\nsizes: %" PRIu32
        " %" PRIu32 " %" PRIu32 "\nspace directions: (%.17g,0,0) (0,%.17g,0) (0,0,%.17g)\nspace origin: "
        "(%.17g,%.17g,%.17g)\nkinds: domain domain domain\n"
        "centerings: node node node\nendian: little\nencoding: raw\nverdict:=%s\n\n",
        f->voxel_count[0] + 1, f->voxel_count[1] + 1, f->voxel_count[2] + 1, f->voxel_size[0], f->voxel_size[1],
        f->voxel_size[2], f->origin[0], f->origin[1], f->origin[2], df_verdict_name(f->verdict));
}

df_status df_array_write(const df_field *field, const char *path, df_error *err) {
    assert(field->kind == DF_FIELD_DENSE);
    char header[1024];
    int length = df_array_format_of(path) == DF_ARRAY_NPY ? npy_header(field, header, sizeof header)
                                                          : nrrd_header(field, header, sizeof header);
    uint64_t slice = ((uint64_t)field->voxel_count[0] + 1) * ((uint64_t)field->voxel_count[1] + 1);
    float *values;
    df_output output;
    df_status status = df_alloc_raw((void **)&values, slice, sizeof *values, "samples", err);
    if (status != DF_OK) return status;
    status = df_output_open(&output, path, err);
    if (status != DF_OK) goto done;
    status = df_output_write(&output, header, (size_t)length, err);
    for (uint64_t z = 0; status == DF_OK && z <= field->voxel_count[2]; z++) {
        for (uint64_t i = 0; i < slice; i++) values[i] = df_field_decode(field, z * slice + i, field->step_exponent);
        status = df_output_write(&output, values, slice * sizeof *values, err);
    }
    if (status == DF_OK) status = df_output_commit(&output, err);
    else df_output_discard(&output);
done:
    free(values);
    return status;
}
