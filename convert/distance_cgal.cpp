#include "convert/distance.h"
#include "convert/exception_wall.hpp"

#include <CGAL/AABB_traits.h>
#include <CGAL/AABB_tree.h>
#include <CGAL/AABB_triangle_primitive.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Side_of_triangle_mesh.h>

#include <cmath>
#include <memory>
#include <vector>

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Triangle = Kernel::Triangle_3;
using Primitive = CGAL::AABB_triangle_primitive<Kernel, std::vector<Triangle>::const_iterator>;
using Traits = CGAL::AABB_traits<Kernel, Primitive>;
using Tree = CGAL::AABB_tree<Traits>;

struct context {
    std::vector<Triangle> triangles;
    std::unique_ptr<Tree> tree;
};

Point vertex(const df_mesh *mesh, uint32_t face, int corner) {
    const double *p = mesh->positions + size_t(mesh->faces[size_t(face) * 3 + size_t(corner)]) * 3;
    return {p[0], p[1], p[2]};
}

void fill_or_throw(const context *c, const df_lattice *lattice, const df_sample_box *box, float *out) {
    for (uint32_t k = 0; k < box->count[2]; k++) {
        for (uint32_t j = 0; j < box->count[1]; j++) {
            for (uint32_t i = 0; i < box->count[0]; i++) {
                const Point p(df_lattice_at(lattice, 0, box->first[0] + i),
                              df_lattice_at(lattice, 1, box->first[1] + j),
                              df_lattice_at(lattice, 2, box->first[2] + k));
                *out++ = df_distance_round(std::sqrt(c->tree->squared_distance(p)));
            }
        }
    }
}

// CGAL allocates in queries. No exception may reach the C code that calls this from many threads; a NaN makes
// df_field_finish refuse the field.
void fill(const void *user, const df_lattice *lattice, const df_sample_box *box, float *out) {
    try {
        fill_or_throw(static_cast<const context *>(user), lattice, box, out);
    } catch (...) {
        out[0] = NAN;
    }
}

double at(const void *user, const double p[3]) {
    try {
        return std::sqrt(static_cast<const context *>(user)->tree->squared_distance(Point(p[0], p[1], p[2])));
    } catch (...) {
        return NAN; // as in fill
    }
}

void release(void *user) { delete static_cast<context *>(user); }

} // namespace

df_status df_distance_cgal(const df_mesh *mesh, df_distance_source *source, df_error *err) {
    *source = df_distance_source{};
    return df::guard("CGAL", DF_ERROR_INPUT, err, [&]() -> df_status {
        auto c = std::make_unique<context>();
        c->triangles.reserve(mesh->face_count);
        for (uint32_t f = 0; f < mesh->face_count; f++) {
            Triangle t(vertex(mesh, f, 0), vertex(mesh, f, 1), vertex(mesh, f, 2));
            // faces without area are undefined behaviour in the tree; their edges belong to neighbours
            if (!t.is_degenerate()) c->triangles.push_back(t);
        }
        if (c->triangles.empty()) return df_fail(err, DF_ERROR_INPUT, "the mesh has no face with an area");
        c->tree = std::make_unique<Tree>(c->triangles.cbegin(), c->triangles.cend());
        c->tree->build(); // before threads ask: CGAL builds lazily
        c->tree->accelerate_distance_queries();
        *source = {c.release(), false, fill, at, release};
        return DF_OK;
    });
}

df_status df_cgal_side(const df_mesh *mesh, const double *points, uint64_t count, int8_t *sides, df_error *err) {
    return df::guard("CGAL", DF_ERROR_INPUT, err, [&]() -> df_status {
        std::vector<Triangle> triangles;
        for (uint32_t f = 0; f < mesh->face_count; f++) {
            triangles.emplace_back(vertex(mesh, f, 0), vertex(mesh, f, 1), vertex(mesh, f, 2));
        }
        Tree tree(triangles.cbegin(), triangles.cend());
        tree.build();
        // Side_of_triangle_mesh without its mesh class, so that it takes soups as well: the same exact ray test
        const CGAL::internal::Point_inside_vertical_ray_cast<Kernel, Tree> test;
        for (uint64_t i = 0; i < count; i++) {
            const CGAL::Bounded_side side = test(Point(points[i * 3], points[i * 3 + 1], points[i * 3 + 2]), tree);
            sides[i] = side == CGAL::ON_BOUNDED_SIDE ? 1 : side == CGAL::ON_BOUNDARY ? 0 : -1;
        }
        return DF_OK;
    });
}
