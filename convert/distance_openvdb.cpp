#include "convert/distance.h"
#include "convert/exception_wall.hpp"

#include <openvdb/openvdb.h>
#include <openvdb/tools/MeshToVolume.h>

#include <memory>

namespace {

struct context {
    openvdb::FloatGrid::Ptr grid; // in index space: sample (i,j,k) is voxel (i,j,k)
};

void fill(const void *user, const df_lattice *lattice, const df_sample_box *box, float *out) {
    (void)lattice;
    // an accessor caches the path it walked: one for each call, so that threads do not share it
    const auto accessor = static_cast<const context *>(user)->grid->getConstUnsafeAccessor();
    for (uint32_t k = 0; k < box->count[2]; k++) {
        for (uint32_t j = 0; j < box->count[1]; j++) {
            for (uint32_t i = 0; i < box->count[0]; i++) {
                *out++ =
                    accessor.getValue({int(box->first[0] + i), int(box->first[1] + j), int(box->first[2] + k)}) + 0.0f;
            }
        }
    }
}

void release(void *user) { delete static_cast<context *>(user); }

} // namespace

df_status df_distance_openvdb(const df_mesh *mesh, const df_lattice *lattice, float band_voxels,
                              df_distance_source *source, df_error *err) {
    *source = df_distance_source{};
    return df::guard("OpenVDB", DF_ERROR_INPUT, err, [&]() -> df_status {
        openvdb::initialize();
        std::vector<openvdb::Vec3s> points;
        std::vector<openvdb::Vec3I> triangles;
        points.reserve(mesh->vertex_count);
        triangles.reserve(mesh->face_count);
        for (uint32_t v = 0; v < mesh->vertex_count; v++) {
            const double *p = mesh->positions + size_t(v) * 3;
            points.emplace_back(float((p[0] - lattice->origin[0]) / lattice->voxel_size),
                                float((p[1] - lattice->origin[1]) / lattice->voxel_size),
                                float((p[2] - lattice->origin[2]) / lattice->voxel_size));
        }
        for (uint32_t f = 0; f < mesh->face_count; f++) {
            const uint32_t *t = mesh->faces + size_t(f) * 3;
            triangles.emplace_back(t[0], t[1], t[2]);
        }
        // points are in voxels already; the transform scales the values
        const auto transform = openvdb::math::Transform::createLinearTransform(lattice->voxel_size);
        openvdb::tools::QuadAndTriangleDataAdapter<openvdb::Vec3s, openvdb::Vec3I> adapter(points, triangles);
        auto c = std::make_unique<context>();
        c->grid = openvdb::tools::meshToVolume<openvdb::FloatGrid>(adapter, *transform, band_voxels, band_voxels);
        *source = {c.release(), true, fill, nullptr, release};
        return DF_OK;
    });
}
