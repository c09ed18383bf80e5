#include "convert/exception_wall.hpp"
#include "convert/memory_stream.hpp"
#include "convert/mesh_formats.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/IO/OFF.h>
#include <CGAL/IO/STL.h>

#include <array>
#include <cstring>
#include <stdexcept>
#include <vector>

namespace {

using Point = CGAL::Exact_predicates_inexact_constructions_kernel::Point_3;

// CGAL sizes a polygon as the file says before it reads its corners; this one refuses what the file cannot hold.
thread_local size_t corner_limit;
class polygon : public std::vector<uint32_t> {
  public:
    void resize(size_t count) {
        if (count > corner_limit) throw std::runtime_error("a face has more corners than the file can hold");
        std::vector<uint32_t>::resize(count);
    }
};

} // namespace

namespace CGAL {
namespace internal {
inline void resize(polygon &p, std::size_t count) { p.resize(count); }
} // namespace internal
} // namespace CGAL

namespace {

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

df_status df_mesh_parse_off(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err) {
    return df::guard(name, DF_ERROR_FORMAT, err, [&]() -> df_status {
        df::memory_buffer buffer(text, size);
        std::istream stream(&buffer);
        CGAL::File_header_OFF header;
        stream >> header;
        if (!stream) return df_fail(err, DF_ERROR_FORMAT, "%s: not an OFF file", name);
        // each vertex and face takes more than one byte
        if (header.size_of_vertices() > size || header.size_of_facets() > size) {
            return df_fail(err, DF_ERROR_FORMAT,
                           "%s: the header promises %zu vertices and %zu faces, more than %zu bytes can hold", name,
                           header.size_of_vertices(), header.size_of_facets(), size);
        }
        stream.clear();
        stream.seekg(0);
        corner_limit = size;
        std::vector<Point> points;
        std::vector<polygon> polygons;
        if (!CGAL::IO::read_OFF(stream, points, polygons, CGAL::parameters::verbose(false))) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: damaged or truncated OFF file (%zu vertices, %zu faces promised)",
                           name, header.size_of_vertices(), header.size_of_facets());
        }
        hand_over(points, polygons, builder);
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
