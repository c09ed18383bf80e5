/* CGAL 5.5 reads PLY too, but refuses triangle strips, believes list lengths before it has read them, and takes several
 * times as long; so this format has a reader of its own. */
#include "convert/mesh_formats.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef enum ply_type { PLY_NONE, PLY_I8, PLY_U8, PLY_I16, PLY_U16, PLY_I32, PLY_U32, PLY_F32, PLY_F64 } ply_type;

static const struct {
    const char *name, *alias;
    unsigned size;
} types[] = {{"", "", 0},           {"char", "int8", 1},     {"uchar", "uint8", 1},
             {"short", "int16", 2}, {"ushort", "uint16", 2}, {"int", "int32", 4},
             {"uint", "uint32", 4}, {"float", "float32", 4}, {"double", "float64", 8}};

typedef enum ply_role { PLY_IGNORED, PLY_X, PLY_Y, PLY_Z, PLY_FACE, PLY_STRIPS } ply_role;

typedef struct ply_property {
    ply_type length; /* of a list; PLY_NONE for a single value */
    ply_type type;
    ply_role role;
} ply_property;

#define PROPERTY_COUNT_MAX 64
#define ELEMENT_COUNT_MAX 16

typedef struct ply_element {
    char name[32];
    uint64_t count;
    ply_property properties[PROPERTY_COUNT_MAX];
    int property_count;
    int last_used; /* index of the last property with a role, -1 for none */
} ply_element;

typedef enum ply_encoding { PLY_ASCII, PLY_LITTLE, PLY_BIG } ply_encoding;

typedef struct ply_reader {
    const char *name;
    const char *at, *end;
    const char *line_end; /* ASCII: of the current element */
    ply_encoding encoding;
    ply_element elements[ELEMENT_COUNT_MAX];
    int element_count;
    uint32_t *list; /* the indices of the current face or strip */
    uint64_t list_capacity;
} ply_reader;

static ply_type find_type(const char *name) {
    for (int t = PLY_I8; t <= PLY_F64; t++) {
        if (strcmp(name, types[t].name) == 0 || strcmp(name, types[t].alias) == 0) return (ply_type)t;
    }
    return PLY_NONE;
}

static ply_role find_role(const char *element, const char *name, int is_list) {
    if (strcmp(element, "vertex") == 0 && !is_list) {
        if (strcmp(name, "x") == 0) return PLY_X;
        if (strcmp(name, "y") == 0) return PLY_Y;
        if (strcmp(name, "z") == 0) return PLY_Z;
    }
    int indices = is_list && (strcmp(name, "vertex_indices") == 0 || strcmp(name, "vertex_index") == 0);
    if (indices && strcmp(element, "face") == 0) return PLY_FACE;
    if (indices && strcmp(element, "tristrips") == 0) return PLY_STRIPS;
    return PLY_IGNORED;
}

/* Copies the next header line, without its end, to `line`; false at the end of the file or where it is too long. */
static int next_line(ply_reader *r, char *line, size_t size) {
    const char *stop = memchr(r->at, '\n', (size_t)(r->end - r->at));
    if (!stop || (size_t)(stop - r->at) >= size) return 0;
    size_t length = (size_t)(stop - r->at);
    memcpy(line, r->at, length);
    while (length > 0 && (line[length - 1] == '\r' || line[length - 1] == ' ')) length--;
    line[length] = 0;
    r->at = stop + 1;
    return 1;
}

static df_status parse_property(ply_reader *r, const char *line, df_error *err) {
    char word[4][64] = {{0}};
    int count = sscanf(line, "property %63s %63s %63s %63s", word[0], word[1], word[2], word[3]);
    int is_list = count == 4 && strcmp(word[0], "list") == 0;
    ply_element *e = &r->elements[r->element_count > 0 ? r->element_count - 1 : 0];
    if (r->element_count == 0 || e->property_count == PROPERTY_COUNT_MAX || (count != 2 && !is_list)) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: PLY header: misplaced or malformed '%s'", r->name, line);
    }
    ply_property p = {is_list ? find_type(word[1]) : PLY_NONE, find_type(word[is_list ? 2 : 0]), PLY_IGNORED};
    if (p.type == PLY_NONE || (is_list && (p.length == PLY_NONE || p.length >= PLY_F32))) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: PLY header: unknown type in '%s'", r->name, line);
    }
    p.role = find_role(e->name, word[is_list ? 3 : 1], is_list);
    if (p.role != PLY_IGNORED) e->last_used = e->property_count;
    e->properties[e->property_count++] = p;
    return DF_OK;
}

static df_status parse_element(ply_reader *r, const char *line, df_error *err) {
    if (r->element_count == ELEMENT_COUNT_MAX) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: PLY header: more than %d elements", r->name, ELEMENT_COUNT_MAX);
    }
    ply_element *e = &r->elements[r->element_count];
    *e = (ply_element){.last_used = -1};
    if (sscanf(line, "element %31s %" SCNu64, e->name, &e->count) != 2) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: PLY header: malformed '%s'", r->name, line);
    }
    if (e->count > (uint64_t)(r->end - r->at)) { /* each takes a byte at least */
        return df_fail(err, DF_ERROR_FORMAT, "%s: the header promises %" PRIu64 " of '%s', more than the file can hold",
                       r->name, e->count, e->name);
    }
    r->element_count++;
    return DF_OK;
}

static df_status parse_format(ply_reader *r, const char *line, df_error *err) {
    static const char *const names[] = {"format ascii", "format binary_little_endian", "format binary_big_endian"};
    for (int i = 0; i < 3; i++) {
        if (strncmp(line, names[i], strlen(names[i])) != 0) continue;
        r->encoding = (ply_encoding)i;
        return DF_OK;
    }
    return df_fail(err, DF_ERROR_FORMAT, "%s: PLY header: unknown '%s'", r->name, line);
}

static df_status parse_header(ply_reader *r, df_error *err) {
    char line[1024];
    if (!next_line(r, line, sizeof line) || strcmp(line, "ply") != 0) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: not a PLY file", r->name);
    }
    int has_format = 0;
    while (next_line(r, line, sizeof line)) {
        df_status status = DF_OK;
        if (strcmp(line, "end_header") == 0) {
            return has_format ? DF_OK : df_fail(err, DF_ERROR_FORMAT, "%s: PLY header: no format line", r->name);
        }
        if (strncmp(line, "format ", 7) == 0) {
            has_format = 1;
            status = parse_format(r, line, err);
        } else if (strncmp(line, "element ", 8) == 0) {
            status = parse_element(r, line, err);
        } else if (strncmp(line, "property ", 9) == 0) {
            status = parse_property(r, line, err);
        } else if (*line && strncmp(line, "comment", 7) != 0 && strncmp(line, "obj_info", 8) != 0) {
            status = df_fail(err, DF_ERROR_FORMAT, "%s: PLY header: unknown '%s'", r->name, line);
        }
        if (status != DF_OK) return status;
    }
    return df_fail(err, DF_ERROR_FORMAT, "%s: the PLY header does not end", r->name);
}

/* A decimal number at *at, before `end`. Correctly rounded: where 19 digits and an exact power of ten do not suffice,
 * strtod is asked (the text is zero-terminated). Returns 0 where there is no number. */
static int parse_number(const char **at, const char *end, double *value) {
    static const double powers[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                    1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    const char *c = *at;
    while (c < end && (*c == ' ' || *c == '\t' || *c == '\r')) c++;
    const char *start = c;
    int negative = c < end && *c == '-';
    if (c < end && (*c == '-' || *c == '+')) c++;
    uint64_t mantissa = 0;
    int digits = 0, exponent = 0;
    for (; c < end && *c >= '0' && *c <= '9'; c++, digits++) mantissa = mantissa * 10 + (uint64_t)(*c - '0');
    if (c < end && *c == '.') {
        for (c++; c < end && *c >= '0' && *c <= '9'; c++, digits++, exponent--)
            mantissa = mantissa * 10 + (uint64_t)(*c - '0');
    }
    if (digits > 0 && digits <= 19 && mantissa <= (1ull << 53) && exponent >= -22 && (c == end || *c <= ' ')) {
        double magnitude = (double)mantissa / powers[-exponent];
        *value = negative ? -magnitude : magnitude;
        *at = c;
        return 1;
    }
    if (start == end) return 0;
    char *stop;
    *value = strtod(start, &stop);
    *at = stop;
    return stop > start && stop <= end;
}

/* The next value of a type. Returns 0 at the end of the data. */
static int read_value(ply_reader *r, ply_type type, double *value) {
    if (r->encoding == PLY_ASCII) return parse_number(&r->at, r->line_end, value);
    unsigned size = types[type].size;
    if ((size_t)(r->end - r->at) < size) return 0;
    unsigned char raw[8];
    for (unsigned i = 0; i < size; i++) raw[i] = (unsigned char)r->at[r->encoding == PLY_BIG ? size - 1 - i : i];
    r->at += size;
    uint64_t bits = 0;
    for (unsigned i = 0; i < size; i++) bits |= (uint64_t)raw[i] << (8 * i);
    uint32_t bits32 = (uint32_t)bits;
    float f;
    switch (type) {
    case PLY_I8: *value = (int8_t)bits; break;
    case PLY_I16: *value = (int16_t)bits; break;
    case PLY_I32: *value = (int32_t)bits; break;
    case PLY_F32:
        memcpy(&f, &bits32, sizeof f);
        *value = (double)f;
        break;
    case PLY_F64: memcpy(value, &bits, sizeof bits); break;
    default: *value = (double)bits;
    }
    return 1;
}

static df_status fail_at(const ply_reader *r, const ply_element *e, uint64_t index, const char *what, df_error *err) {
    return df_fail(err, DF_ERROR_FORMAT, "%s: %s %" PRIu64 " of %" PRIu64 ": %s", r->name, e->name, index + 1, e->count,
                   what);
}

/* Cuts the strip in r->list at its -1 entries (0xFFFFFFFF) and adds the triangles, every second one turned round. */
static void add_strip(const ply_reader *r, uint64_t count, df_mesh_builder *builder) {
    uint64_t start = 0;
    for (uint64_t i = 0; i < count; i++) {
        if (r->list[i] == UINT32_MAX) {
            start = i + 1;
            continue;
        }
        if (i < start + 2) continue;
        int odd = (i - start) & 1;
        uint32_t triangle[3] = {r->list[i - 2 + (uint64_t)odd], r->list[i - 1 - (uint64_t)odd], r->list[i]};
        if (triangle[0] != triangle[1] && triangle[1] != triangle[2] && triangle[2] != triangle[0]) {
            df_mesh_builder_polygon(builder, triangle, 3);
        }
    }
}

/* Reads a list property into r->list (only where it has a role). Returns NULL or what is wrong. */
static const char *read_list(ply_reader *r, const ply_property *p, uint64_t *count) {
    double value;
    if (!read_value(r, p->length, &value)) return "the data end in it";
    const char *end = r->encoding == PLY_ASCII ? r->line_end : r->end;
    if (value < 0 || value > (double)(end - r->at)) return "a list is longer than the data";
    *count = (uint64_t)value;
    if (*count > r->list_capacity) {
        uint32_t *grown = realloc(r->list, *count * 2 * sizeof *grown);
        if (!grown) return "out of memory";
        r->list = grown;
        r->list_capacity = *count * 2;
    }
    for (uint64_t i = 0; i < *count; i++) {
        if (!read_value(r, p->type, &value)) return "the data end in it";
        if (p->role == PLY_IGNORED) continue;
        int restart = p->role == PLY_STRIPS && value == -1;
        if (!restart && !(value >= 0 && value < UINT32_MAX)) return "a vertex index is negative or too large";
        r->list[i] = restart ? UINT32_MAX : (uint32_t)value;
    }
    return NULL;
}

static const char *read_item(ply_reader *r, const ply_element *e, df_mesh_builder *builder) {
    double position[3] = {0}, value;
    int coordinates = 0;
    for (int i = 0; i < e->property_count; i++) {
        /* what follows the last thing of use on a line of text is skipped, and may be missing */
        if (r->encoding == PLY_ASCII && i > e->last_used) break;
        const ply_property *p = &e->properties[i];
        uint64_t count;
        if (p->length != PLY_NONE) {
            const char *wrong = read_list(r, p, &count);
            if (wrong) return wrong;
            if (p->role == PLY_FACE) df_mesh_builder_polygon(builder, r->list, count);
            if (p->role == PLY_STRIPS) add_strip(r, count, builder);
            continue;
        }
        if (!read_value(r, p->type, &value)) return "the data end in it";
        if (p->role >= PLY_X && p->role <= PLY_Z) position[p->role - PLY_X] = value, coordinates++;
    }
    if (coordinates == 3) df_mesh_builder_vertex(builder, position[0], position[1], position[2]);
    return NULL;
}

static df_status read_element(ply_reader *r, const ply_element *e, df_mesh_builder *builder, df_error *err) {
    for (uint64_t i = 0; i < e->count; i++) {
        if (r->encoding == PLY_ASCII) {
            while (r->at < r->end && (unsigned char)*r->at <= ' ') r->at++;
            if (r->at == r->end) return fail_at(r, e, i, "the file ends before it", err);
            r->line_end = memchr(r->at, '\n', (size_t)(r->end - r->at));
            if (!r->line_end) r->line_end = r->end;
        }
        const char *wrong = read_item(r, e, builder);
        if (wrong) return fail_at(r, e, i, wrong, err);
        if (r->encoding == PLY_ASCII) r->at = r->line_end;
    }
    return DF_OK;
}

df_status df_mesh_parse_ply(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err) {
    ply_reader *r = calloc(1, sizeof *r);
    if (!r) return df_fail(err, DF_ERROR_MEMORY, "%s: out of memory", name);
    r->name = name;
    r->at = text;
    r->end = text + size;
    df_status status = parse_header(r, err);
    for (int i = 0; i < r->element_count && status == DF_OK; i++) {
        status = read_element(r, &r->elements[i], builder, err);
    }
    free(r->list);
    free(r);
    return status;
}
