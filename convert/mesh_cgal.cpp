#include "convert/exception_wall.hpp"
#include "convert/memory_stream.hpp"
#include "convert/mesh_formats.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/IO/OFF/File_scanner_OFF.h>
#include <CGAL/IO/STL.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace {

using Point = CGAL::Exact_predicates_inexact_constructions_kernel::Point_3;

template <typename Polygons>
void hand_over(const std::vector<Point> &points, const Polygons &polygons, df_mesh_builder *builder) {
    for (const Point &p : points) df_mesh_builder_vertex(builder, p.x(), p.y(), p.z());
    std::vector<uint32_t> corners;
    for (const auto &p : polygons) {
        corners.assign(p.begin(), p.end());
        df_mesh_builder_polygon(builder, corners.data(), corners.size());
    }
}

// The first word of an OFF file says what its vertices hold: [ST][C][N][4]OFF. The first number may follow at once.
bool read_keyword(std::istream &in, CGAL::File_header_OFF &header) {
    constexpr size_t longest = 7;
    std::string word;
    size_t at = 0;
    while (word.size() < longest && (word.size() < 3 || word.compare(word.size() - 3, 3, "OFF") != 0))
        word += char(in.get());
    const auto take = [&](const char *prefix) {
        const size_t length = std::strlen(prefix);
        const bool is_there = word.compare(at, length, prefix) == 0;
        if (is_there) at += length;
        return is_there;
    };
    header.set_textures(take("ST"));
    header.set_colors(take("C"));
    header.set_normals(take("N"));
    header.set_homogeneous(take("4"));
    return word.compare(at, std::string::npos, "OFF") == 0;
}

// The numbers of vertices, faces and edges. CGAL's reader of headers computes with the last, until it overflows.
bool read_counts(std::istream &in, CGAL::File_header_OFF &header) {
    std::array<std::int32_t, 3> counts{};
    in >> CGAL::skip_comment_OFF;
    if (in.peek() == 'B') {
        std::string line;
        std::getline(in, line);
        if (line.compare(0, 6, "BINARY") != 0) return false;
        header.set_binary(true);
    }
    for (std::int32_t &count : counts) {
        if (header.binary()) CGAL::I_Binary_read_big_endian_integer32(in, count);
        else in >> CGAL::skip_comment_OFF >> count;
    }
    if (!in || counts[0] < 0 || counts[1] < 0) return false;
    header.set_off_header(true);
    header.set_index_offset(0);
    header.set_vertices(size_t(counts[0]));
    header.set_facets(size_t(counts[1]));
    return true;
}

} // namespace

// Coordinates and corners only. Colours and normals are stepped over: CGAL's functions for them read past the numbers
// that a line has.
df_status df_mesh_parse_off(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err) {
    return df::guard(name, DF_ERROR_FORMAT, err, [&]() -> df_status {
        df::memory_buffer buffer(text, size);
        std::istream stream(&buffer);
        CGAL::File_header_OFF header;
        if (!read_keyword(stream >> CGAL::skip_comment_OFF, header))
            return df_fail(err, DF_ERROR_FORMAT, "%s: not an OFF file", name);
        if (!read_counts(stream, header)) {
            return df_fail(err, DF_ERROR_FORMAT,
                           "%s: the numbers of vertices, faces and edges after OFF are damaged or missing", name);
        }
        const size_t vertices = header.size_of_vertices(), faces = header.size_of_facets();
        // each vertex and face takes more than one byte
        if (vertices > size || faces > size) {
            return df_fail(err, DF_ERROR_FORMAT,
                           "%s: the header promises %zu vertices and %zu faces, more than %zu bytes can hold", name,
                           vertices, faces, size);
        }
        CGAL::File_scanner_OFF scanner(stream, header);
        for (size_t i = 0; i < vertices; i++) {
            double x = 0, y = 0, z = 0, w = 1;
            scanner.scan_vertex(x, y, z, w);
            if (stream) scanner.skip_to_next_vertex(i);
            if (!stream || w == 0)
                return df_fail(err, DF_ERROR_FORMAT, "%s: vertex %zu of %zu is damaged or missing", name, i, vertices);
            df_mesh_builder_vertex(builder, x / w, y / w, z / w);
        }
        std::vector<uint32_t> corners;
        for (size_t i = 0; i < faces; i++) {
            size_t count = 0, corner = 0;
            scanner.scan_facet(count, i);
            if (stream && count > size)
                return df_fail(err, DF_ERROR_FORMAT, "%s: face %zu has more corners than the file can hold", name, i);
            corners.clear();
            for (size_t c = 1; stream && c <= count; c++) {
                scanner.scan_facet_vertex_index(corner, c, i);
                corners.push_back(uint32_t(corner));
            }
            if (!stream)
                return df_fail(err, DF_ERROR_FORMAT, "%s: face %zu of %zu is damaged or missing", name, i, faces);
            scanner.skip_to_next_facet(i);
            df_mesh_builder_polygon(builder, corners.data(), corners.size());
        }
        return DF_OK;
    });
}

df_status df_mesh_parse_stl(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err) {
    return df::guard(name, DF_ERROR_FORMAT, err, [&]() -> df_status {
        df::memory_buffer buffer(text, size);
        std::istream stream(&buffer);
        std::vector<Point> points;
        std::vector<std::array<uint32_t, 3>> triangles;
        if (!CGAL::IO::read_STL(stream, points, triangles, CGAL::parameters::verbose(false))) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: damaged or truncated STL file", name);
        }
        hand_over(points, triangles, builder);
        return DF_OK;
    });
}
