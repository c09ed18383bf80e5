#include "convert/exception_wall.hpp"
#include "convert/memory_stream.hpp"
#include "convert/mesh_formats.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/IO/OFF/File_scanner_OFF.h>
#include <CGAL/IO/STL.h>

#include <array>
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

} // namespace

// Coordinates and corners only. Colours and normals are stepped over: CGAL's functions for them read past the numbers
// that a line has.
df_status df_mesh_parse_off(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err) {
    return df::guard(name, DF_ERROR_FORMAT, err, [&]() -> df_status {
        df::memory_buffer buffer(text, size);
        std::istream stream(&buffer);
        CGAL::File_scanner_OFF scanner(stream);
        if (!stream) return df_fail(err, DF_ERROR_FORMAT, "%s: not an OFF file", name);
        const size_t vertices = scanner.size_of_vertices(), faces = scanner.size_of_facets();
        // each vertex and face takes more than one byte
        if (vertices > size || faces > size) {
            return df_fail(err, DF_ERROR_FORMAT,
                           "%s: the header promises %zu vertices and %zu faces, more than %zu bytes can hold", name,
                           vertices, faces, size);
        }
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
