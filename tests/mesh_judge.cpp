#include "mesh_judge.h"

#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_mesh_to_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>

#include <array>
#include <vector>

int judge_mesh(const double *positions, uint32_t vertex_count, const uint32_t *triangles, uint32_t triangle_count) {
    namespace PMP = CGAL::Polygon_mesh_processing;
    using Point = CGAL::Simple_cartesian<double>::Point_3;
    try {
        std::vector<Point> points;
        std::vector<std::array<std::size_t, 3>> faces;
        for (uint32_t v = 0; v < vertex_count; v++)
            points.emplace_back(positions[3 * v], positions[3 * v + 1], positions[3 * v + 2]);
        for (uint32_t t = 0; t < triangle_count; t++)
            faces.push_back({triangles[3 * t], triangles[3 * t + 1], triangles[3 * t + 2]});
        if (!PMP::is_polygon_soup_a_polygon_mesh(faces)) return 0;
        CGAL::Surface_mesh<Point> mesh;
        PMP::polygon_soup_to_polygon_mesh(points, faces, mesh);
        return mesh.is_valid() && CGAL::is_closed(mesh) && mesh.number_of_faces() == triangle_count &&
               mesh.number_of_vertices() == vertex_count;
    } catch (...) {
        return -1;
    }
}
