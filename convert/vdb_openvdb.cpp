#include "convert/vdb.h"

#include "common/output_file.h"
#include "convert/exception_wall.hpp"

#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <memory>
#include <new>
#include <sstream>
#include <stdexcept>
#include <string>
#include <sys/stat.h>
#include <vector>

using openvdb::Coord;
using openvdb::FloatGrid;
using leaf = FloatGrid::TreeType::LeafNodeType;

struct df_vdb {
    FloatGrid::Ptr grid;
    std::string name;
    Coord first; // voxel of sample (0,0,0)
    df_lattice lattice;
    std::vector<uint8_t> near; // by coarse cell: 1 where a leaf of the tree is near it
};

namespace {

const char *const box_key = "distfield_voxel_count"; // metadata: the box of a field that we wrote

std::string quoted(const std::string &name) { return "\"" + name + "\""; }

// OpenVDB logs to std::cout, where reports go. What it would warn of is in df_vdb_info.
struct silence {
    std::streambuf *const kept = std::cout.rdbuf(nullptr);
    silence() = default;
    silence(const silence &) = delete;
    silence &operator=(const silence &) = delete;
    ~silence() { std::cout.rdbuf(kept); }
};

// Every grid of a file. Reading throws where the file ends too soon: its stream reports that, OpenVDB by itself does
// not.
openvdb::GridPtrVecPtr read_grids(std::ifstream &file) {
    const silence while_reading;
    file.exceptions(std::ios::badbit | std::ios::failbit | std::ios::eofbit);
    return openvdb::io::Stream(file, false).getGrids();
}

// OpenVDB trusts counts and offsets in a file, so that a damaged one may overrun its buffers. A child process reads it
// first: what ends the child would have ended us, and what it cannot hold, no file of that size says.
constexpr int too_much = 3;

#ifdef DF_SANITIZED
// in every sanitizer; gcc's come without the header
extern "C" int __sanitizer_install_malloc_and_free_hooks(void (*)(const volatile void *, size_t),
                                                         void (*)(const volatile void *));
extern "C" size_t __sanitizer_get_allocated_size(const volatile void *);

// it has reserved more addresses than a limit could allow: what is allocated is counted instead
std::int64_t bytes_left;

void count_allocated(const volatile void *, size_t size) {
    bytes_left -= std::int64_t(size);
    if (bytes_left < 0) _exit(too_much);
}

void count_freed(const volatile void *memory) { bytes_left += std::int64_t(__sanitizer_get_allocated_size(memory)); }

void allow_more(std::int64_t bytes) {
    bytes_left = bytes;
    __sanitizer_install_malloc_and_free_hooks(count_allocated, count_freed);
}
#else
void allow_more(std::int64_t bytes) {
    unsigned long long pages = 0;
    std::FILE *own = std::fopen("/proc/self/statm", "re");
    if (own && std::fscanf(own, "%llu", &pages) == 1) {
        const rlim_t all = rlim_t(pages) * 4096 + rlim_t(bytes);
        const rlimit limit = {all, all};
        setrlimit(RLIMIT_AS, &limit);
    }
    if (own) std::fclose(own);
}
#endif

// Limits the memory of this process to what it has and what a file of some size can hold: a node of 32^3 children takes
// 256 kB in memory and 8 kB or more in the file, one of 16^3 32 kB and 1 kB, a leaf 2 kB and 130 bytes.
void limit_memory(const char *path) {
    constexpr std::int64_t bytes_per_byte = 128, bytes_more = 128 << 20;
    struct stat info;
    if (stat(path, &info) == 0) allow_more(std::int64_t(info.st_size) * bytes_per_byte + bytes_more);
}

df_status try_reading(const char *path, df_error *err) {
    const pid_t child = fork();
    if (child < 0)
        return df_fail(err, DF_ERROR_MEMORY, "%s: cannot start a process to read it: %s", path, std::strerror(errno));
    if (child == 0) {
        const rlimit no_core = {0, 0};
        setrlimit(RLIMIT_CORE, &no_core);
        limit_memory(path);
        const int null = open("/dev/null", O_WRONLY | O_CLOEXEC);
        if (null >= 0) dup2(null, STDERR_FILENO);
        try {
            std::ifstream file(path, std::ios::binary);
            read_grids(file);
        } catch (const std::bad_alloc &) {
            _exit(too_much);
        } catch (const std::length_error &) {
            _exit(too_much);
        } catch (...) { // the parent will meet it, too, and say what it is
        }
        _exit(0);
    }
    int state = 0;
    while (waitpid(child, &state, 0) < 0 && errno == EINTR) {
    }
    if (WIFEXITED(state) && WEXITSTATUS(state) == too_much)
        return df_fail(err, DF_ERROR_FORMAT, "%s: the file is damaged: it asks for more memory than its size allows",
                       path);
    if (WIFEXITED(state) && WEXITSTATUS(state) == 0) return DF_OK;
    return df_fail(err, DF_ERROR_FORMAT, "%s: the file is damaged", path);
}

bool is_level_set(const openvdb::GridBase &grid) {
    return grid.isType<FloatGrid>() && grid.getGridClass() == openvdb::GRID_LEVEL_SET;
}

std::string kind_of(const openvdb::GridBase &grid) {
    return (grid.getGridClass() == openvdb::GRID_UNKNOWN
                ? std::string("no class")
                : openvdb::GridBase::gridClassToMenuName(grid.getGridClass())) +
           " of " + grid.valueType();
}

// What the file holds, for a message.
std::string list(const openvdb::GridPtrVec &grids) {
    std::string text;
    for (const auto &grid : grids)
        text += (text.empty() ? "" : ", ") + quoted(grid->getName()) + " (" + kind_of(*grid) + ")";
    return text.empty() ? "no grid" : text;
}

df_status choose(const openvdb::GridPtrVec &grids, const char *path, const char *name, FloatGrid::Ptr &chosen,
                 df_error *err) {
    unsigned count = 0;
    for (const auto &grid : grids) {
        if (name ? grid->getName() != name : !is_level_set(*grid)) continue;
        if (!is_level_set(*grid)) {
            return df_fail(err, DF_ERROR_INPUT, "%s: grid %s is no level set of floats: %s", path, quoted(name).c_str(),
                           kind_of(*grid).c_str());
        }
        chosen = openvdb::gridPtrCast<FloatGrid>(grid);
        count++;
    }
    if (count == 1) return DF_OK;
    if (count > 1 && !name)
        return df_fail(err, DF_ERROR_INPUT, "%s: choose a level set with --grid: %s", path, list(grids).c_str());
    if (count > 1) return df_fail(err, DF_ERROR_INPUT, "%s: %u grids are called %s", path, count, quoted(name).c_str());
    if (name)
        return df_fail(err, DF_ERROR_INPUT, "%s: no grid %s; it holds %s", path, quoted(name).c_str(),
                       list(grids).c_str());
    return df_fail(err, DF_ERROR_INPUT, "%s: no level set of floats; it holds %s", path, list(grids).c_str());
}

// The voxel size and the position of voxel (0,0,0) of a grid that is only scaled and moved.
df_status read_transform(const FloatGrid &grid, const char *path, double size[3], double origin[3], df_error *err) {
    if (!grid.transform().isLinear()) return df_fail(err, DF_ERROR_INPUT, "%s: its grid tapers (a frustum)", path);
    const openvdb::math::Mat4d m = grid.transform().baseMap()->getAffineMap()->getMat4();
    for (int a = 0; a < 3; a++) {
        for (int b = 0; b < 3; b++) {
            if (a != b && std::fabs(m(a, b)) > 1e-12 * std::fabs(m(a, a)))
                return df_fail(err, DF_ERROR_INPUT, "%s: its grid is turned or sheared", path);
        }
        if (!(m(a, a) > 0))
            return df_fail(err, DF_ERROR_INPUT, "%s: its grid is mirrored or flat along %c", path, "xyz"[a]);
        size[a] = m(a, a);
        origin[a] = m(3, a);
    }
    return DF_OK;
}

// OpenVDB adds to the coordinates of a file whatever they are: those that int cannot hold are refused first.
df_status check_range(const FloatGrid &grid, const char *path, df_error *err) {
    constexpr int most = 1 << 30;
    for (auto it = grid.tree().root().cbeginChildAll(); it; ++it) {
        const Coord at = it.getCoord();
        for (int a = 0; a < 3; a++) {
            if (at[a] < -most || at[a] > most)
                return df_fail(err, DF_ERROR_INPUT, "%s: it has a voxel at %c = %d (-2^30 to 2^30 are possible)", path,
                               "xyz"[a], at[a]);
        }
    }
    return DF_OK;
}

// The box of a grid's samples: that of the field it was written from, where the active voxels still lie in it, or
// theirs.
df_status find_box(const FloatGrid &grid, const char *path, Coord &first, uint32_t voxel_count[3], df_error *err) {
    openvdb::CoordBBox box = grid.evalActiveVoxelBoundingBox();
    if (box.empty())
        return df_fail(err, DF_ERROR_INPUT, "%s: grid %s has no active voxel", path, quoted(grid.getName()).c_str());
    const auto ours = grid.getMetadata<openvdb::Vec3IMetadata>(box_key);
    if (ours && openvdb::CoordBBox(Coord(0), Coord(ours->value())).isInside(box))
        box = {Coord(0), Coord(ours->value())};
    first = box.min();
    for (int a = 0; a < 3; a++) {
        const int64_t count = int64_t(box.max()[a]) - box.min()[a];
        if (count < 1 || count > DF_VOXEL_COUNT_MAX) {
            return df_fail(err, DF_ERROR_INPUT, "%s: %lld voxels along %c (1 to %u are possible)", path,
                           (long long)count, "xyz"[a], DF_VOXEL_COUNT_MAX);
        }
        voxel_count[a] = uint32_t(count);
    }
    return DF_OK;
}

// Marks the coarse cells within two voxels of a leaf: all that can hold a change of sign, or a stencil that reaches
// one.
void mark_cells(df_vdb &vdb) {
    const df_lattice &l = vdb.lattice;
    vdb.near.assign(df_lattice_cell_total(&l), 0);
    for (auto it = vdb.grid->tree().cbeginLeaf(); it; ++it) {
        uint32_t low[3], high[3];
        bool inside = true;
        for (int a = 0; a < 3; a++) {
            const int64_t begin = int64_t(it->origin()[a]) - vdb.first[a] - 2, end = begin + leaf::DIM + 3;
            low[a] = uint32_t(std::max<int64_t>(begin, 0) / l.brick_size);
            high[a] = uint32_t(std::min<int64_t>(std::max<int64_t>(end, 0) / l.brick_size, l.cell_count[a] - 1));
            inside = inside && end >= 0 && low[a] <= high[a];
        }
        for (uint32_t z = low[2]; inside && z <= high[2]; z++) {
            for (uint32_t y = low[1]; y <= high[1]; y++) {
                uint8_t *row = vdb.near.data() + l.cell_count[0] * (y + size_t(l.cell_count[1]) * z);
                std::fill(row + low[0], row + high[0] + 1, 1);
            }
        }
    }
}

void fill(const void *user, const df_lattice *, const df_sample_box *box, float *out) {
    const df_vdb *vdb = static_cast<const df_vdb *>(user);
    const auto accessor = vdb->grid->getConstUnsafeAccessor(); // caches the path it walked: one for each call
    for (uint32_t k = 0; k < box->count[2]; k++) {
        for (uint32_t j = 0; j < box->count[1]; j++) {
            for (uint32_t i = 0; i < box->count[0]; i++) {
                *out++ = accessor.getValue(vdb->first.offsetBy(int(box->first[0] + i), int(box->first[1] + j),
                                                               int(box->first[2] + k))) +
                         0.0f;
            }
        }
    }
}

df_status read_file(const char *path, openvdb::GridPtrVecPtr &grids, df_vdb_info *info, df_error *err) {
    std::ifstream file(path, std::ios::binary);
    if (!file) return df_fail(err, DF_ERROR_IO, "%s: cannot be opened", path);
    try {
        grids = read_grids(file);
    } catch (const std::ios_base::failure &) {
        if (file.bad()) return df_fail(err, DF_ERROR_IO, "%s: cannot read the file", path);
        return df_fail(err, DF_ERROR_FORMAT, "%s: the file is truncated", path);
    } catch (const openvdb::Exception &e) {
        return df_fail(err, DF_ERROR_FORMAT, "%s: the file is damaged: %s", path, e.what());
    } catch (const std::bad_alloc &) {
        return df_fail(err, DF_ERROR_MEMORY, "%s: out of memory, or the file is damaged", path);
    }
    info->version = openvdb::io::getFormatVersion(file);
    info->known_version = openvdb::OPENVDB_FILE_VERSION;
    return DF_OK;
}

df_status read_level_set(const char *path, const char *grid, uint32_t brick_size, df_vdb &vdb, df_vdb_info *info,
                         df_error *err) {
    openvdb::GridPtrVecPtr grids;
    double index_origin[3];
    df_status status = read_file(path, grids, info, err);
    if (status == DF_OK) status = choose(*grids, path, grid, vdb.grid, err);
    if (status == DF_OK) status = read_transform(*vdb.grid, path, info->voxel_size, index_origin, err);
    df_lattice &l = vdb.lattice;
    if (status == DF_OK) status = check_range(*vdb.grid, path, err);
    if (status == DF_OK) status = find_box(*vdb.grid, path, vdb.first, l.voxel_count, err);
    if (status != DF_OK) return status;
    l.voxel_size = info->voxel_size[0];
    l.brick_size = brick_size;
    for (int a = 0; a < 3; a++) {
        l.origin[a] = index_origin[a] + vdb.first[a] * info->voxel_size[a];
        l.cell_count[a] = (l.voxel_count[a] + brick_size - 1) / brick_size;
    }
    if (!(vdb.grid->background() > 0))
        return df_fail(err, DF_ERROR_INPUT, "%s: its background %g is not outside", path,
                       double(vdb.grid->background()));
    mark_cells(vdb);
    vdb.name = vdb.grid->getName();
    info->grid = vdb.name.c_str();
    info->lattice = l;
    info->background = vdb.grid->background();
    info->band = double(info->background) / info->voxel_size[0];
    info->active_voxels = vdb.grid->activeVoxelCount();
    info->half = vdb.grid->saveFloatAsHalf();
    return DF_OK;
}

} // namespace

df_status df_vdb_read_trusted(const char *path, const char *grid, uint32_t brick_size, df_vdb **out, df_vdb_info *info,
                              df_error *err) {
    *out = nullptr;
    *info = df_vdb_info{};
    auto vdb = std::unique_ptr<df_vdb>();
    const df_status status = df::guard(path, DF_ERROR_FORMAT, err, [&]() -> df_status {
        openvdb::initialize();
        vdb = std::make_unique<df_vdb>();
        return read_level_set(path, grid, brick_size, *vdb, info, err);
    });
    if (status == DF_OK) *out = vdb.release();
    return status;
}

df_status df_vdb_read(const char *path, const char *grid, uint32_t brick_size, df_vdb **out, df_vdb_info *info,
                      df_error *err) {
    *out = nullptr;
    *info = df_vdb_info{};
    const df_status tried = df::guard(path, DF_ERROR_FORMAT, err, [&]() -> df_status {
        openvdb::initialize();
        return try_reading(path, err);
    });
    return tried == DF_OK ? df_vdb_read_trusted(path, grid, brick_size, out, info, err) : tried;
}

void df_vdb_free(df_vdb *vdb) { delete vdb; }

void df_vdb_source(df_vdb *vdb, df_distance_source *source) {
    *source = df_distance_source{};
    source->context = vdb;
    source->is_signed = true;
    source->fill = fill;
}

bool df_vdb_keeps_cell(const void *user, const uint32_t cell[3]) {
    const df_vdb *vdb = static_cast<const df_vdb *>(user);
    const df_lattice &l = vdb->lattice;
    if (!vdb->near[cell[0] + l.cell_count[0] * (cell[1] + size_t(l.cell_count[1]) * cell[2])]) return false;
    const auto accessor = vdb->grid->getConstUnsafeAccessor();
    Coord low, high;
    for (int a = 0; a < 3; a++) {
        const int begin = int(cell[a] * l.brick_size), end = begin + int(l.brick_size) + 1;
        low[a] = vdb->first[a] + std::max(begin - 1, 0);
        high[a] = vdb->first[a] + std::min(end, int(l.voxel_count[a]));
    }
    const bool side = accessor.getValue(low) < 0;
    for (auto it = openvdb::CoordBBox(low, high).begin(); it; ++it) {
        if ((accessor.getValue(*it) < 0) != side) return true;
    }
    return false;
}

namespace {

// Archive can write to any stream that it may seek in; only its files and streams are public.
class archive : public openvdb::io::Archive {
  public:
    Ptr copy() const override { return std::make_shared<archive>(*this); }
    void write_grids(std::ostream &stream, const openvdb::GridCPtrVec &grids) const {
        Archive::write(stream, grids, true);
    }
};

struct block_reader {
    const df_field *field;
    float background;

    // True where a block of 8^3 samples may hold one that is stored. A sample on a face of cells lies in the lower
    // cells as well.
    bool may_be_stored(const uint32_t first[3]) const {
        if (field->kind == DF_FIELD_DENSE) return true;
        const uint32_t k = field->brick_size;
        uint32_t low[3], high[3];
        for (int a = 0; a < 3; a++) {
            low[a] = first[a] ? (first[a] - 1) / k : 0;
            high[a] = std::min((first[a] + leaf::DIM - 1) / k, field->cell_count[a] - 1);
        }
        for (uint32_t z = low[2]; z <= high[2]; z++) {
            for (uint32_t y = low[1]; y <= high[1]; y++) {
                for (uint32_t x = low[0]; x <= high[0]; x++) {
                    if (field->cells[x + field->cell_count[0] * (y + size_t(field->cell_count[1]) * z)] <
                        DF_CELL_INSIDE)
                        return true;
                }
            }
        }
        return false;
    }

    // Fills a leaf; returns true where it has an active voxel, or both sides.
    bool read(const uint32_t first[3], leaf &out) const {
        unsigned inside = 0;
        for (leaf::ValueAllIter it = out.beginValueAll(); it; ++it) {
            const Coord local = leaf::offsetToLocalCoord(it.pos());
            uint32_t at[3];
            bool exists = true;
            for (int a = 0; a < 3; a++) {
                at[a] = first[a] + uint32_t(local[a]);
                exists = exists && at[a] <= field->voxel_count[a];
            }
            float value = background;
            const bool stored = exists && df_field_sample(field, at, &value);
            const bool active = stored && std::fabs(value) < background;
            it.setValue(active ? value : value < 0 ? -background : background);
            it.setValueOn(active);
            inside += value < 0;
        }
        return !out.isEmpty() || (inside > 0 && inside < leaf::SIZE);
    }
};

// The side of a block without active voxels.
bool is_inside(const df_field *field, const uint32_t first[3]) {
    float value;
    df_field_sample(field, first, &value);
    return value < 0;
}

FloatGrid::Ptr make_grid(const df_field *field, float background) {
    auto grid = FloatGrid::create(background);
    const block_reader reader{field, background};
    uint32_t first[3];
    for (first[2] = 0; first[2] <= field->voxel_count[2]; first[2] += leaf::DIM) {
        for (first[1] = 0; first[1] <= field->voxel_count[1]; first[1] += leaf::DIM) {
            for (first[0] = 0; first[0] <= field->voxel_count[0]; first[0] += leaf::DIM) {
                const Coord origin{int(first[0]), int(first[1]), int(first[2])};
                auto block = std::make_unique<leaf>(origin, background);
                if (reader.may_be_stored(first) && reader.read(first, *block)) grid->tree().addLeaf(block.release());
                else if (is_inside(field, first)) grid->tree().addTile(1, origin, -background, false);
            }
        }
    }
    return grid;
}

// Where the band ends, in world units. Where none is asked for: OpenVDB's usual 3 voxels of a dense field; of bricks
// just beyond the largest sample.
float background_of(const df_field *field, double band) {
    const double voxel = std::min({field->voxel_size[0], field->voxel_size[1], field->voxel_size[2]});
    if (band > 0 || field->kind == DF_FIELD_DENSE) return float((band > 0 ? band : 3) * voxel);
    return std::nextafter(std::max(std::fabs(field->value_min), std::fabs(field->value_max)), INFINITY);
}

df_status write_stream(std::stringbuf &buffer, const char *path, df_error *err) {
    df_output output;
    df_status status = df_output_open(&output, path, err);
    if (status != DF_OK) return status;
    std::vector<char> chunk(1 << 20);
    for (std::streamsize size;
         status == DF_OK && (size = buffer.sgetn(chunk.data(), std::streamsize(chunk.size()))) > 0;) {
        status = df_output_write(&output, chunk.data(), size_t(size), err);
    }
    if (status == DF_OK) return df_output_commit(&output, err);
    df_output_discard(&output);
    return status;
}

} // namespace

df_status df_vdb_write(const df_field *field, double band, const char *path, df_error *err) {
    return df::guard(path, DF_ERROR_IO, err, [&]() -> df_status {
        openvdb::initialize();
        auto grid = make_grid(field, background_of(field, band));
        auto transform = openvdb::math::Transform::createLinearTransform(1);
        const double *size = field->voxel_size;
        if (size[0] == size[1] && size[0] == size[2])
            transform = openvdb::math::Transform::createLinearTransform(size[0]);
        else transform->postScale(openvdb::Vec3d(size[0], size[1], size[2]));
        transform->postTranslate(openvdb::Vec3d(field->origin[0], field->origin[1], field->origin[2]));
        grid->setTransform(transform);
        grid->setGridClass(openvdb::GRID_LEVEL_SET);
        grid->setName("surface");
        grid->setCreator("distfield df-convert");
        grid->insertMeta(box_key,
                         openvdb::Vec3IMetadata(openvdb::Vec3i(int(field->voxel_count[0]), int(field->voxel_count[1]),
                                                               int(field->voxel_count[2]))));
        grid->insertMeta("distfield_provenance", openvdb::StringMetadata(field->provenance ? field->provenance : "{}"));
        std::stringbuf buffer(std::ios::in | std::ios::out | std::ios::binary);
        std::ostream stream(&buffer);
        stream.exceptions(std::ios::badbit | std::ios::failbit);
        archive().write_grids(stream, {grid});
        return write_stream(buffer, path, err);
    });
}
