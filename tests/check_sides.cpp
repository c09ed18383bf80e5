// check_sides FIELD MESH COUNT: compares the sides of COUNT random samples of a field with CGAL's exact inside test
// over the mesh in its file. For closed meshes without overlaps, where parity means inside. Shares nothing with the
// converter but its reader. Exit 0 when all agree.
extern "C" {
#include "common/field_file.h"
#include "convert/mesh_read.h"
#include "tests/oracle.h"
}

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/orient_polygon_soup.h>
#include <CGAL/Polygon_mesh_processing/polygon_soup_to_polygon_mesh.h>
#include <CGAL/Polygon_mesh_processing/repair_polygon_soup.h>
#include <CGAL/Side_of_triangle_mesh.h>
#include <CGAL/Surface_mesh.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <vector>

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Mesh = CGAL::Surface_mesh<Kernel::Point_3>;

static Mesh to_cgal(const df_mesh &mesh) {
    std::vector<Kernel::Point_3> points;
    std::vector<std::array<std::size_t, 3>> triangles;
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        const double *p = mesh.positions + std::size_t(v) * 3;
        points.emplace_back(p[0], p[1], p[2]);
    }
    for (uint32_t f = 0; f < mesh.face_count; f++) {
        const uint32_t *c = mesh.faces + std::size_t(f) * 3;
        triangles.push_back({c[0], c[1], c[2]});
    }
    CGAL::Polygon_mesh_processing::merge_duplicate_points_in_polygon_soup(points, triangles);
    CGAL::Polygon_mesh_processing::orient_polygon_soup(points, triangles);
    Mesh out;
    CGAL::Polygon_mesh_processing::polygon_soup_to_polygon_mesh(points, triangles, out);
    return out;
}

int main(int argc, char **argv) {
    df_field field{};
    df_mesh mesh{};
    df_error err{};
    if (argc < 4 || df_field_read(argv[1], DF_READ_COPY, &field, &err) != DF_OK ||
        df_mesh_read(argv[2], &mesh, &err) != DF_OK) {
        std::fprintf(stderr, "check_sides: %s\n", argc < 4 ? "FIELD MESH COUNT" : err.text);
        return 2;
    }
    const Mesh surface = to_cgal(mesh);
    if (!CGAL::is_closed(surface)) {
        std::fprintf(stderr, "check_sides: %s is not closed\n", argv[2]);
        return 2;
    }
    const CGAL::Side_of_triangle_mesh<Mesh, Kernel> side(surface);
    long wrong = 0, on_surface = 0;
    const long count = std::atol(argv[3]);
    uint64_t state = 1;
    for (long i = 0; i < count; i++) {
        uint32_t at[3];
        double grid[3], p[3];
        float value;
        for (int a = 0; a < 3; a++) {
            at[a] = uint32_t(oracle_random(&state) * (field.voxel_count[a] + 1));
            grid[a] = at[a];
        }
        df_field_sample(&field, at, &value);
        df_field_grid_to_world(&field, grid, p);
        const CGAL::Bounded_side truth = side(Kernel::Point_3(p[0], p[1], p[2]));
        on_surface += truth == CGAL::ON_BOUNDARY;
        if (truth != CGAL::ON_BOUNDARY && (value < 0) != (truth == CGAL::ON_BOUNDED_SIDE) && wrong++ == 0)
            std::printf("sample %u %u %u: %.9g\n", at[0], at[1], at[2], double(value));
    }
    std::printf("%s: %ld sides, %ld on the surface, %ld wrong\n", argv[1], count, on_surface, wrong);
    df_field_free(&field);
    df_mesh_free(&mesh);
    return wrong != 0;
}
