#include "convert/exception_wall.hpp"
#include "convert/memory_stream.hpp"
#include "convert/mesh_formats.h"

#define TINYOBJLOADER_USE_DOUBLE
#include <tiny_obj_loader.h>

#include <cstring>
#include <limits>

namespace {

struct context {
    df_mesh_builder *builder;
    std::vector<uint32_t> corners;
    long long bad_index = 0; // an index that names no vertex: 0, or further back than the first
    bool bad = false;
};

void add_vertex(void *user, double x, double y, double z, double) {
    df_mesh_builder_vertex(static_cast<context *>(user)->builder, x, y, z);
}

void add_face(void *user, tinyobj::index_t *indices, int count) {
    auto *c = static_cast<context *>(user);
    c->corners.clear();
    const auto vertex_count = static_cast<long long>(c->builder->vertex_count);
    for (int i = 0; i < count; i++) {
        const long long index = indices[i].vertex_index;
        const long long corner = index > 0 ? index - 1 : vertex_count + index;
        if (index == 0 || corner < 0) {
            if (!c->bad) c->bad_index = index;
            c->bad = true;
            return;
        }
        c->corners.push_back(static_cast<uint32_t>(corner));
    }
    df_mesh_builder_polygon(c->builder, c->corners.data(), c->corners.size());
}

// A line that ends in a backslash goes on in the next; tinyobjloader does not know that.
void join_lines(char *text, size_t size) {
    for (char *at = text; (at = static_cast<char *>(std::memchr(at, '\\', size_t(text + size - at)))); at++) {
        if (at[1] == '\n') at[0] = at[1] = ' ';
        else if (at[1] == '\r' && at[2] == '\n') at[0] = at[1] = at[2] = ' ';
    }
}

// A comment may follow a face in its line; tinyobjloader would read it as corners.
void blank_comments(char *text, size_t size) {
    char *end = text + size;
    for (char *at = text; (at = static_cast<char *>(std::memchr(at, '#', size_t(end - at))));) {
        while (at < end && *at != '\n' && *at != '\r') *at++ = ' ';
    }
}

// tinyobjloader reads "nan", "inf" and any other word as 0. Returns the number of the first vertex line with a letter
// that is not part of a number, 0 when there is none.
size_t find_bad_vertex(const char *text, const char *end) {
    for (size_t line = 1; text < end; line++) {
        const char *next = static_cast<const char *>(std::memchr(text, '\n', size_t(end - text)));
        if (!next) next = end;
        while (text < next && (*text == ' ' || *text == '\t')) text++;
        if (next - text > 2 && text[0] == 'v' && (text[1] == ' ' || text[1] == '\t')) {
            size_t words = 0;
            for (const char *c = text + 1; c < next && *c != '#'; c++) {
                if (!std::strchr("0123456789+-.eE \t\r", *c) || !*c) return line;
                words += *c > ' ' && c[-1] <= ' ';
            }
            if (words < 3) return line;
        }
        text = next + 1;
    }
    return 0;
}

} // namespace

df_status df_mesh_parse_obj(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err) {
    return df::guard(name, DF_ERROR_FORMAT, err, [&]() -> df_status {
        join_lines(text, size);
        blank_comments(text, size);
        if (const size_t line = find_bad_vertex(text, text + size)) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: line %zu: the vertex is not three finite numbers", name, line);
        }
        context c{builder, {}};
        tinyobj::callback_t callback;
        callback.vertex_cb = add_vertex;
        callback.index_cb = add_face;
        df::memory_buffer buffer(text, size);
        std::istream stream(&buffer);
        std::string warning, message;
        if (!tinyobj::LoadObjWithCallback(stream, callback, &c, nullptr, &warning, &message)) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: %s", name, message.c_str());
        }
        if (c.bad) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: a face uses vertex %lld, which does not exist", name,
                           c.bad_index);
        }
        return DF_OK;
    });
}
