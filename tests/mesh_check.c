#include "mesh_check.h"

#include <stdlib.h>
#include <string.h>

typedef struct half_edge {
    uint32_t from, to;
} half_edge;

static int compare_half_edges(const void *a, const void *b) {
    const half_edge *x = a, *y = b;
    if (x->from != y->from) return x->from < y->from ? -1 : 1;
    return x->to < y->to ? -1 : x->to > y->to;
}

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

/* Groups the opposite edges of all triangles by vertex. */
static void check_vertices(const df_mesh *mesh, mesh_check *check) {
    uint64_t *start = calloc((size_t)mesh->vertex_count + 2, sizeof *start);
    half_edge *links = malloc(3 * (size_t)mesh->triangle_count * sizeof *links);
    for (uint64_t i = 0; i < 3 * (uint64_t)mesh->triangle_count; i++) start[mesh->triangles[i] + 2]++;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) start[v + 2] += start[v + 1];
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles + 3 * (size_t)t;
        for (int i = 0; i < 3; i++) links[start[v[i] + 1]++] = (half_edge){v[(i + 1) % 3], v[(i + 2) % 3]};
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        uint32_t count = (uint32_t)(start[v + 1] - start[v]);
        check->unused_vertices += count == 0;
        check->split_vertices += count > 0 && count_fans(links + start[v], count) != 1;
    }
    free(start);
    free(links);
}

mesh_check check_mesh(const df_mesh *mesh) {
    mesh_check check = {0};
    uint64_t count = 3 * (uint64_t)mesh->triangle_count, pairs = 0;
    half_edge *edges = malloc((count + 1) * sizeof *edges);
    for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangles + 3 * (size_t)t;
        check.degenerate += v[0] == v[1] || v[1] == v[2] || v[2] == v[0];
        for (int i = 0; i < 3; i++) edges[3 * (size_t)t + (size_t)i] = (half_edge){v[i], v[(i + 1) % 3]};
    }
    qsort(edges, count, sizeof *edges, compare_half_edges);
    for (uint64_t i = 0; i < count; i++) {
        half_edge opposite = {edges[i].to, edges[i].from};
        check.crowded_edges += i > 0 && compare_half_edges(&edges[i - 1], &edges[i]) == 0;
        if (bsearch(&opposite, edges, count, sizeof *edges, compare_half_edges)) pairs++;
        else check.border_edges++;
    }
    free(edges);
    check_vertices(mesh, &check);
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

/* Where a layer of the fine lattice is inside; z counts fine steps. */
static void fine_layer(const df_field *field, float iso, uint32_t n, uint32_t z, const uint32_t size[3],
                       uint8_t *inside) {
    for (uint32_t y = 0; y < size[1]; y++) {
        for (uint32_t x = 0; x < size[0]; x++) {
            double grid[3] = {(double)x / n, (double)y / n, (double)z / n};
            inside[x + (size_t)size[0] * y] = value_at(field, grid) < (double)iso;
        }
    }
}

int64_t subdivided_euler(const df_field *field, float iso, uint32_t n) {
    uint32_t size[3];
    for (int a = 0; a < 3; a++) size[a] = field->voxel_count[a] * n + 1;
    size_t layer = (size_t)size[0] * size[1];
    uint8_t *inside = malloc(2 * layer);
    int64_t euler = 0;
    fine_layer(field, iso, n, 0, size, inside);
    for (uint32_t z = 0; z + 1 < size[2]; z++) {
        const uint8_t *low = inside + (z & 1) * layer, *high = inside + (~z & 1) * layer;
        fine_layer(field, iso, n, z + 1, size, inside + (~z & 1) * layer);
        for (size_t y = 0; y + 1 < size[1]; y++) {
            for (size_t x = 0; x + 1 < size[0]; x++) {
                /* The cells of every dimension that start at this point. */
                const uint8_t *p = low + x + size[0] * y, *q = high + x + size[0] * y;
                int a = p[0], b = p[1], c = p[size[0]], d = p[size[0] + 1], e = q[0], f = q[1], g = q[size[0]],
                    h = q[size[0] + 1];
                euler += a - (a & b) - (a & c) - (a & e) + (a & b & c & d) + (a & b & e & f) + (a & c & e & g);
                euler -= a & b & c & d & e & f & g & h;
            }
        }
    }
    free(inside);
    return 2 * euler;
}
