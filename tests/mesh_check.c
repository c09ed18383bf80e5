#include "mesh_check.h"

#include <stdlib.h>
#include <string.h>

typedef struct half_edge {
    uint32_t from, to;
} half_edge;

/* The number of fans of triangles around a vertex: its half edges `link` (from one neighbour to the next) form so many
 * cycles or chains. */
static uint64_t count_fans(const half_edge *link, uint32_t count) {
    uint64_t fans = 0;
    uint8_t *seen = calloc(count, 1);
    for (uint32_t turn = 0; turn < 2 * count; turn++) {
        uint32_t first = turn % count, before = 0;
        for (uint32_t i = 0; i < count; i++) before += link[i].to == link[first].from;
        if (seen[first] || (turn < count && before)) continue; /* chains are followed from their beginnings first */
        fans++;
        uint32_t i = first;
        while (i < count && !seen[i]) {
            seen[i] = 1;
            uint32_t to = link[i].to;
            for (i = 0; i < count && link[i].from != to; i++) {
            }
        }
    }
    free(seen);
    return fans;
}

/* The half edges that begin at a vertex, v to link[i].from, and those that end there, link[i].to to v. */
static uint64_t check_half_edges(const half_edge *link, uint32_t count, mesh_check *check) {
    uint64_t pairs = 0;
    for (uint32_t i = 0; i < count; i++) {
        bool opposite = false, again = false;
        for (uint32_t k = 0; k < count; k++) {
            opposite = opposite || link[k].to == link[i].from;
            again = again || (k < i && link[k].from == link[i].from);
        }
        check->crowded_edges += again;
        check->border_edges += !opposite;
        pairs += opposite;
    }
    return pairs;
}

mesh_check check_mesh(const df_mc_mesh *mesh) {
    mesh_check check = {0};
    uint64_t pairs = 0, *start = calloc((size_t)mesh->vertex_count + 2, sizeof *start);
    half_edge *links = malloc((3 * (size_t)mesh->triangle_count + 1) * sizeof *links); /* by vertex: opposite edges */
    for (uint64_t i = 0; i < 3 * (uint64_t)mesh->triangle_count; i++) start[mesh->triangles[i] + 2]++;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) start[v + 2] += start[v + 1];
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles + 3 * (size_t)t;
        check.degenerate += v[0] == v[1] || v[1] == v[2] || v[2] == v[0];
        for (int i = 0; i < 3; i++) links[start[v[i] + 1]++] = (half_edge){v[(i + 1) % 3], v[(i + 2) % 3]};
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        uint32_t count = (uint32_t)(start[v + 1] - start[v]);
        check.unused_vertices += count == 0;
        check.split_vertices += count > 0 && count_fans(links + start[v], count) != 1;
        pairs += check_half_edges(links + start[v], count, &check);
    }
    free(start);
    free(links);
    check.euler =
        (int64_t)mesh->vertex_count - (int64_t)(pairs / 2 + check.border_edges) + (int64_t)mesh->triangle_count;
    return check;
}

static double value_at(const df_field *field, const double grid[3]) {
    double local[3];
    float corners[8];
    if (field->kind == DF_FIELD_ADF) {
        df_adf_cell cell;
        df_adf_find(field, grid, DF_LEVEL_COUNT_MAX, &cell);
        df_adf_corners(field, cell.family, cell.child, corners);
        for (int a = 0; a < 3; a++) local[a] = (grid[a] - cell.corner[a]) / cell.side;
        return df_trilinear(corners, local);
    }
    uint32_t voxel[3];
    for (int a = 0; a < 3; a++) {
        voxel[a] = (uint32_t)grid[a];
        if (voxel[a] == field->voxel_count[a]) voxel[a]--;
        local[a] = grid[a] - voxel[a];
    }
    df_field_corners(field, voxel, corners);
    return df_trilinear(corners, local);
}

enum { DEPTH_MAX = 60 };

/* The Euler characteristic with compact support of the part f < 0 of an open box of `dim` dimensions, f interpolating
 * its corners. Where f rises along an axis all over the box, f < 0 is a stack of open intervals over that part of the
 * lower face: the face's characteristic, negated; falling, of the upper. Otherwise the box is divided into its halves,
 * quarters and so on and what lies between them. */
static int64_t open_box(int dim, const double *corners, int depth) {
    const int count = 1 << dim;
    int inside = 0;
    for (int c = 0; c < count; c++) inside += corners[c] < 0;
    if (inside == 0) return 0;
    if (inside == count) return dim & 1 ? -1 : 1;
    for (int axis = 0; axis < dim; axis++) {
        double faces[2][4];
        int rising = 0, falling = 0, pairs = 0;
        for (int c = 0; c < count; c++) {
            if (c >> axis & 1) continue;
            faces[0][pairs] = corners[c];
            faces[1][pairs] = corners[c | 1 << axis];
            rising += faces[1][pairs] > faces[0][pairs];
            falling += faces[1][pairs] < faces[0][pairs];
            pairs++;
        }
        if (rising == pairs) return -open_box(dim - 1, faces[0], depth);
        if (falling == pairs) return -open_box(dim - 1, faces[1], depth);
    }
    if (depth == DEPTH_MAX) abort(); /* a saddle on the surface: no field that this is for */
    static const int step[4] = {1, 3, 9, 27};
    double lattice[27];
    for (int i = 0; i < step[dim]; i++) {
        double sum = 0; /* over the corners around: one on an axis where the place is an end, both in the middle */
        int terms = 0;
        for (int c = 0; c < count; c++) {
            bool around = true;
            for (int a = 0; a < dim; a++) {
                const int place = i / step[a] % 3;
                around = around && (place == 1 || place == 2 * (c >> a & 1));
            }
            if (!around) continue;
            sum += corners[c];
            terms++;
        }
        lattice[i] = sum / terms;
    }
    int64_t euler = 0;
    for (int piece = 0; piece < step[dim];
         piece++) { /* on each axis: the lower half, what is between, the upper half */
        double part[8];
        int axes[3], axis_count = 0, base = 0;
        for (int a = 0; a < dim; a++) {
            const int place = piece / step[a] % 3;
            base += step[a] * (place != 0);
            if (place != 1) axes[axis_count++] = a;
        }
        for (int c = 0; c < 1 << axis_count; c++) {
            int at = base;
            for (int a = 0; a < axis_count; a++) at += step[axes[a]] * (c >> a & 1);
            part[c] = lattice[at];
        }
        euler += open_box(axis_count, part, depth + 1);
    }
    return euler;
}

int64_t subdivided_euler(const df_field *field) {
    const uint32_t *voxels = field->voxel_count;
    int64_t euler = 0;
    for (uint32_t z = 0; z <= voxels[2]; z++) {
        for (uint32_t y = 0; y <= voxels[1]; y++) {
            for (uint32_t x = 0; x <= voxels[0]; x++) {
                /* The boxes of every dimension that start at this sample: bit a of `axes` is set where one extends. */
                for (int axes = 0; axes < 8; axes++) {
                    if ((axes & 1 && x == voxels[0]) || (axes & 2 && y == voxels[1]) || (axes & 4 && z == voxels[2]))
                        continue;
                    double corners[8];
                    int dim = 0;
                    for (int c = 0; c < 8; c++) {
                        if (c & ~axes) continue;
                        const double grid[3] = {x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)};
                        corners[dim++] = value_at(field, grid);
                    }
                    euler += open_box(__builtin_popcount((uint32_t)axes), corners, 0);
                }
            }
        }
    }
    return -2 * euler;
}
