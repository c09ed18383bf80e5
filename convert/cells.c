#include "convert/cells.h"

#include "common/field.h"
#include "common/memory.h"
#include "convert/smaller.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A box of coarse cells: low[a] <= c < high[a]. */
typedef struct cell_box {
    uint32_t low[3], high[3];
} cell_box;

typedef struct marker {
    const df_lattice *lattice;
    uint32_t *marks;
    double reach; /* by which cells are grown, world units */
    const double *corners[3];
    double normal[3]; /* of the face's plane, any length */
} marker;

/* The extent of the cells low..high along an axis, grown by the reach, in world units. */
static void grown_extent(const marker *m, const cell_box *box, int a, double *low, double *high) {
    const df_lattice *l = m->lattice;
    *low = l->origin[a] + (double)box->low[a] * l->brick_size * l->voxel_size - m->reach;
    *high = l->origin[a] + (double)box->high[a] * l->brick_size * l->voxel_size + m->reach;
}

/* False where the box of cells, grown by the reach, lies beyond the face's box or on one side of its plane. */
static bool may_touch(const marker *m, const cell_box *box) {
    double middle = 0, radius = 0, scale = 0;
    for (int a = 0; a < 3; a++) {
        double low, high, p = m->corners[0][a], q = m->corners[1][a], r = m->corners[2][a];
        grown_extent(m, box, a, &low, &high);
        if (df_larger(p, df_larger(q, r)) < low || df_smaller(p, df_smaller(q, r)) > high) return false;
        middle += m->normal[a] * ((low + high) / 2 - p);
        radius += fabs(m->normal[a]) * (high - low) / 2;
        scale += fabs(m->normal[a]) * (fabs(low) + fabs(high) + fabs(p));
    }
    return fabs(middle) <= radius + 1e-14 * scale;
}

/* False where an axis across an edge of the box and an edge of the face separates the two: with may_touch, the exact
 * test. */
static bool edges_touch(const marker *m, const cell_box *box) {
    double centre[3], half[3];
    for (int a = 0; a < 3; a++) {
        double low, high;
        grown_extent(m, box, a, &low, &high);
        centre[a] = (low + high) / 2;
        half[a] = (high - low) / 2;
    }
    for (int c = 0; c < 3; c++) {
        const double *p = m->corners[c], *q = m->corners[(c + 1) % 3], *r = m->corners[(c + 2) % 3];
        for (int a = 0; a < 3; a++) {
            int u = (a + 1) % 3, v = (a + 2) % 3;
            double du = q[u] - p[u], dv = q[v] - p[v];
            double edge = du * (p[v] - centre[v]) - dv * (p[u] - centre[u]);
            double across = du * (r[v] - centre[v]) - dv * (r[u] - centre[u]);
            double radius = fabs(du) * half[v] + fabs(dv) * half[u];
            if (df_smaller(edge, across) > radius || df_larger(edge, across) < -radius) return false;
        }
    }
    return true;
}

static void mark(const marker *m, const cell_box *box) {
    if (!may_touch(m, box)) return;
    uint32_t longest = 0, length = 0;
    for (uint32_t a = 0; a < 3; a++) {
        if (box->high[a] - box->low[a] > length) length = box->high[longest = a] - box->low[a];
    }
    if (length == 1) {
        if (!edges_touch(m, box)) return;
        const uint32_t *count = m->lattice->cell_count;
        uint32_t *to = m->marks + box->low[0] + (size_t)count[0] * (box->low[1] + (size_t)count[1] * box->low[2]);
#pragma omp atomic write
        *to = 1;
        return;
    }
    cell_box half = *box;
    half.high[longest] -= length / 2;
    mark(m, &half);
    half.low[longest] = half.high[longest];
    half.high[longest] = box->high[longest];
    mark(m, &half);
}

static void mark_face(const df_mesh *mesh, uint32_t face, const df_lattice *l, double reach, uint32_t *marks) {
    marker m = {l, marks, reach, {0}, {0}};
    for (int c = 0; c < 3; c++) m.corners[c] = mesh->positions + (size_t)mesh->faces[(size_t)face * 3 + (size_t)c] * 3;
    cell_box box;
    double u[3], v[3];
    for (int a = 0; a < 3; a++) {
        double p = m.corners[0][a], q = m.corners[1][a], r = m.corners[2][a], size = l->voxel_size * l->brick_size;
        double first = floor((df_smaller(p, df_smaller(q, r)) - l->origin[a] - reach) / size - 1e-9);
        double last = floor((df_larger(p, df_larger(q, r)) - l->origin[a] + reach) / size + 1e-9);
        if (last < 0 || first >= l->cell_count[a]) return;
        box.low[a] = first < 0 ? 0 : (uint32_t)first;
        box.high[a] = last >= l->cell_count[a] ? l->cell_count[a] : (uint32_t)last + 1;
        u[a] = q - p;
        v[a] = r - p;
    }
    for (int a = 0; a < 3; a++) m.normal[a] = u[(a + 1) % 3] * v[(a + 2) % 3] - u[(a + 2) % 3] * v[(a + 1) % 3];
    mark(&m, &box);
}

/* Numbers the marked cells. */
static df_status number_cells(const df_lattice *lattice, df_cells *cells, df_error *err) {
    uint64_t total = df_lattice_cell_total(lattice), count = 0;
    for (uint64_t i = 0; i < total; i++) count += cells->bricks[i];
    if (count > DF_BRICK_COUNT_MAX)
        return df_fail(err, DF_ERROR_MEMORY, "too many bricks (%llu)", (unsigned long long)count);
    df_status status = df_alloc_raw((void **)&cells->indices, count, sizeof *cells->indices, "brick index", err);
    if (status != DF_OK) return status;
    for (uint64_t i = 0; i < total; i++) {
        if (cells->bricks[i]) cells->indices[cells->brick_count] = (uint32_t)i;
        cells->bricks[i] = cells->bricks[i] ? cells->brick_count++ : DF_NO_BRICK;
    }
    return DF_OK;
}

static df_status make_marks(const df_lattice *lattice, df_cells *cells, df_error *err) {
    *cells = (df_cells){0};
    uint64_t total = df_lattice_cell_total(lattice);
    if (total > UINT32_MAX)
        return df_fail(err, DF_ERROR_MEMORY, "too many coarse cells (%llu)", (unsigned long long)total);
    return df_alloc((void **)&cells->bricks, total, sizeof *cells->bricks, "coarse cells", err);
}

df_status df_cells_find(const df_mesh *mesh, const df_lattice *lattice, double reach_voxels, df_cells *cells,
                        df_error *err) {
    df_status status = make_marks(lattice, cells, err);
    if (status != DF_OK) return status;
    double reach = reach_voxels * lattice->voxel_size;
#pragma omp parallel for schedule(dynamic, 1024)
    for (uint32_t f = 0; f < mesh->face_count; f++) mark_face(mesh, f, lattice, reach, cells->bricks);
    return number_cells(lattice, cells, err);
}

df_status df_cells_select(const df_lattice *lattice, bool (*keep)(const void *context, const uint32_t cell[3]),
                          const void *context, df_cells *cells, df_error *err) {
    df_status status = make_marks(lattice, cells, err);
    if (status != DF_OK) return status;
    uint32_t total = (uint32_t)df_lattice_cell_total(lattice);
#pragma omp parallel for schedule(dynamic, 256)
    for (uint32_t i = 0; i < total; i++) {
        uint32_t cell[3];
        df_cell_position(lattice, i, cell);
        cells->bricks[i] = keep(context, cell);
    }
    return number_cells(lattice, cells, err);
}

df_status df_cells_append(df_cells *cells, uint32_t index, df_error *err) {
    if (cells->brick_count == DF_BRICK_COUNT_MAX)
        return df_fail(err, DF_ERROR_MEMORY, "too many bricks (%u)", cells->brick_count);
    if (cells->brick_count >= cells->capacity) {
        uint32_t capacity = cells->brick_count + cells->brick_count / 4 + 64;
        df_status status =
            df_grow((void **)&cells->indices, cells->brick_count, capacity, sizeof *cells->indices, "brick index", err);
        if (status != DF_OK) return status;
        cells->capacity = capacity;
    }
    cells->indices[cells->brick_count] = index;
    cells->bricks[index] = cells->brick_count++;
    return DF_OK;
}

df_status df_cells_sort(const df_lattice *lattice, df_cells *cells, uint32_t **from, df_error *err) {
    df_status status = df_alloc_raw((void **)from, cells->brick_count, sizeof **from, "brick index", err);
    uint64_t total = df_lattice_cell_total(lattice);
    uint32_t count = 0;
    for (uint64_t i = 0; status == DF_OK && i < total; i++) {
        if (cells->bricks[i] == DF_NO_BRICK) continue;
        (*from)[count] = cells->bricks[i];
        cells->indices[count] = (uint32_t)i;
        cells->bricks[i] = count++;
    }
    return status;
}

void df_cells_free(df_cells *cells) {
    free(cells->bricks);
    free(cells->indices);
    *cells = (df_cells){0};
}
