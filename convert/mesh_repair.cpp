#include "convert/mesh_repair.h"

#include "convert/exception_wall.hpp"
#include "convert/mesh_builder.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/border.h>
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/self_intersections.h>
#include <CGAL/Polygon_mesh_processing/stitch_borders.h>
#include <CGAL/Polygon_mesh_processing/triangulate_hole.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/alpha_wrap_3.h>

#include <array>
#include <vector>

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Mesh = CGAL::Surface_mesh<Point>;
namespace PMP = CGAL::Polygon_mesh_processing;

using Triangles = std::vector<std::array<std::size_t, 3>>;

void to_soup(const df_mesh *from, std::vector<Point> &points, Triangles &triangles) {
    points.reserve(from->vertex_count);
    for (uint32_t v = 0; v < from->vertex_count; v++) {
        const double *p = from->positions + size_t(v) * 3;
        points.emplace_back(p[0], p[1], p[2]);
    }
    for (uint32_t f = 0; f < from->face_count; f++) {
        const uint32_t *c = from->faces + size_t(f) * 3;
        triangles.push_back({c[0], c[1], c[2]});
    }
}

// A manifold mesh of the faces; where they do not allow one, vertices are split. Returns the number of copies.
std::size_t to_surface_mesh(const df_mesh *from, Mesh &to) {
    std::vector<Point> points;
    Triangles triangles;
    to_soup(from, points, triangles);
    const std::size_t before = points.size();
    if (!PMP::is_polygon_soup_a_polygon_mesh(triangles)) PMP::orient_polygon_soup(points, triangles);
    PMP::polygon_soup_to_polygon_mesh(points, triangles, to);
    return points.size() - before;
}

df_status from_surface_mesh(const Mesh &from, const char *name, df_mesh *to, df_error *err) {
    df_mesh_builder builder{};
    std::vector<uint32_t> number(from.number_of_vertices() + from.number_of_removed_vertices());
    uint32_t next = 0;
    for (const auto v : from.vertices()) {
        const Point &p = from.point(v);
        number[v] = next++;
        df_mesh_builder_vertex(&builder, p.x(), p.y(), p.z());
    }
    for (const auto f : from.faces()) {
        uint32_t corners[3];
        int count = 0;
        for (const auto v : CGAL::vertices_around_face(from.halfedge(f), from)) {
            if (count < 3) corners[count++] = number[v];
        }
        df_mesh_builder_polygon(&builder, corners, 3);
    }
    return df_mesh_builder_finish(&builder, name, to, err);
}

} // namespace

df_status df_mesh_count_intersections(const df_mesh *mesh, uint64_t *pairs, df_error *err) {
    return df::guard("CGAL", DF_ERROR_INPUT, err, [&]() -> df_status {
        Mesh surface;
        to_surface_mesh(mesh, surface);
        std::vector<std::pair<Mesh::Face_index, Mesh::Face_index>> found;
        PMP::self_intersections(surface, std::back_inserter(found));
        *pairs = 0;
        for (const auto &[f, g] : found) { // faces that share a position only touch: copies of split vertices
            bool touch = false;
            for (const auto v : CGAL::vertices_around_face(surface.halfedge(f), surface)) {
                for (const auto w : CGAL::vertices_around_face(surface.halfedge(g), surface)) {
                    touch = touch || (v != w && surface.point(v) == surface.point(w));
                }
            }
            *pairs += !touch;
        }
        return DF_OK;
    });
}

df_status df_mesh_repair(df_mesh *mesh, const char *name, df_mesh_repairs *repairs, df_error *err) {
    *repairs = df_mesh_repairs{};
    return df::guard(name, DF_ERROR_INPUT, err, [&]() -> df_status {
        Mesh surface;
        repairs->split_vertices = uint32_t(to_surface_mesh(mesh, surface));
        repairs->stitched = uint32_t(PMP::stitch_borders(surface));
        std::vector<Mesh::Halfedge_index> borders;
        PMP::extract_boundary_cycles(surface, std::back_inserter(borders));
        for (const auto border : borders) {
            std::vector<Mesh::Face_index> patch;
            PMP::triangulate_hole(surface, border, std::back_inserter(patch));
            if (patch.empty()) repairs->holes_left++;
            else repairs->holes_filled++;
            repairs->faces_added += uint32_t(patch.size());
        }
        df_mesh repaired{};
        const df_status status = from_surface_mesh(surface, name, &repaired, err);
        if (status != DF_OK) return status;
        df_mesh_free(mesh);
        *mesh = repaired;
        return DF_OK;
    });
}

df_status df_mesh_wrap(const df_mesh *mesh, double alpha, double offset, df_mesh *wrap, df_error *err) {
    return df::guard("alpha wrap", DF_ERROR_INPUT, err, [&]() -> df_status {
        std::vector<Point> points;
        Triangles triangles;
        Mesh surface;
        to_soup(mesh, points, triangles);
        CGAL::alpha_wrap_3(points, triangles, alpha, offset, surface);
        return from_surface_mesh(surface, "alpha wrap", wrap, err);
    });
}
