#include "convert/winding.h"

#include "common/memory.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The range of lattice indices with coordinates in [low, high], one wider on both sides against rounding; false when
 * empty. */
static int index_range(const df_lattice *lattice, int axis, double low, double high, uint32_t *first, uint32_t *last) {
    double f = ceil((low - lattice->origin[axis]) / lattice->voxel_size - 1e-3);
    double l = floor((high - lattice->origin[axis]) / lattice->voxel_size + 1e-3);
    double end = (double)lattice->voxel_count[axis];
    if (f < 0) f = 0;
    if (l > end) l = end;
    if (!(f <= l)) return 0;
    *first = (uint32_t)f;
    *last = (uint32_t)l;
    return 1;
}

static void face_range(const df_mesh *mesh, uint32_t face, int axis, double *low, double *high) {
    const uint32_t *f = mesh->faces + (size_t)face * 3;
    double a = mesh->positions[(size_t)f[0] * 3 + (size_t)axis], b = mesh->positions[(size_t)f[1] * 3 + (size_t)axis],
           c = mesh->positions[(size_t)f[2] * 3 + (size_t)axis];
    *low = fmin(a, fmin(b, c));
    *high = fmax(a, fmax(b, c));
}

/* A vertex in the plane across the rows, relative to the row. */
typedef struct point {
    double y, z;
} point;

/* The exact sign of the determinant |a b|, seen from a row moved by an infinitesimal (e, e^2): 0 only where a and b
 * coincide. The comparison of the rounded products is exact where they differ, since rounding is monotone; where they
 * are equal, their errors decide. */
static int orientation(point a, point b) {
    double p = a.y * b.z, q = a.z * b.y;
    if (p != q) return p > q ? 1 : -1;
    double p_error = fma(a.y, b.z, -p), q_error = fma(a.z, b.y, -q);
    if (p_error != q_error) return p_error > q_error ? 1 : -1;
    if (a.z != b.z) return a.z > b.z ? 1 : -1;
    return (b.y > a.y) - (b.y < a.y);
}

/* If the row at (0, 0) crosses the triangle, stores where in *x and returns the change of the winding number, otherwise
 * 0. */
static int cross_face(const point p[3], const double x_corner[3], double *x) {
    int s0 = orientation(p[1], p[2]), s1 = orientation(p[2], p[0]), s2 = orientation(p[0], p[1]);
    if (s0 == 0 || s0 != s1 || s0 != s2) return 0;
    double w0 = fabs(p[1].y * p[2].z - p[1].z * p[2].y), w1 = fabs(p[2].y * p[0].z - p[2].z * p[0].y),
           w2 = fabs(p[0].y * p[1].z - p[0].z * p[1].y), sum = w0 + w1 + w2;
    *x = sum > 0 ? (w0 * x_corner[0] + w1 * x_corner[1] + w2 * x_corner[2]) / sum : x_corner[0];
    return -s0; /* counter-clockwise in (y, z): its outer side looks along +x, so the row leaves */
}

int32_t df_winding_cross(const double a[3], const double b[3], const double c[3], const double p[3]) {
    point corners[3] = {{a[1] - p[1], a[2] - p[2]}, {b[1] - p[1], b[2] - p[2]}, {c[1] - p[1], c[2] - p[2]}};
    double x_corner[3] = {a[0], b[0], c[0]}, x = 0;
    int change = cross_face(corners, x_corner, &x);
    return x <= p[0] ? change : 0;
}

/* The first sample at or beyond x. */
static uint32_t first_sample_beyond(const df_lattice *lattice, double x) {
    double guess = ceil((x - lattice->origin[0]) / lattice->voxel_size);
    uint32_t end = lattice->voxel_count[0] + 1;
    uint32_t i = guess <= 0 ? 0 : guess >= end ? end : (uint32_t)guess;
    while (i > 0 && df_lattice_at(lattice, 0, i - 1) >= x) i--;
    while (i < end && df_lattice_at(lattice, 0, i) < x) i++;
    return i;
}

static df_status grow(df_winding_slab *slab, df_error *err) {
    uint64_t capacity = slab->capacity * 2 + 4096;
    uint32_t *rows = realloc(slab->rows, capacity * sizeof *rows);
    if (rows) slab->rows = rows;
    df_crossing *crossings = realloc(slab->unsorted, capacity * sizeof *crossings);
    if (crossings) slab->unsorted = crossings;
    if (!rows || !crossings || capacity > UINT32_MAX)
        return df_fail(err, DF_ERROR_MEMORY, "winding numbers: out of memory");
    slab->capacity = capacity;
    return DF_OK;
}

/* Appends the crossings of one face to the unsorted ones. */
static df_status add_face(df_winding_slab *slab, const df_mesh *mesh, uint32_t face, const df_lattice *lattice,
                          uint32_t *count, df_error *err) {
    double low, high;
    uint32_t y_first, y_last, z_first, z_last;
    face_range(mesh, face, 2, &low, &high);
    if (!index_range(lattice, 2, low, high, &z_first, &z_last)) return DF_OK;
    if (z_first < slab->z_first) z_first = slab->z_first;
    if (z_last >= slab->z_first + slab->z_count) z_last = slab->z_first + slab->z_count - 1;
    if (z_first > z_last) return DF_OK;
    face_range(mesh, face, 1, &low, &high);
    if (!index_range(lattice, 1, low, high, &y_first, &y_last)) return DF_OK;
    const double *corners[3];
    for (int c = 0; c < 3; c++) corners[c] = mesh->positions + (size_t)mesh->faces[(size_t)face * 3 + (size_t)c] * 3;
    double x_corner[3] = {corners[0][0], corners[1][0], corners[2][0]}, x;
    for (uint32_t k = z_first; k <= z_last; k++) {
        double z = df_lattice_at(lattice, 2, k);
        for (uint32_t j = y_first; j <= y_last; j++) {
            double y = df_lattice_at(lattice, 1, j);
            point p[3];
            for (int c = 0; c < 3; c++) p[c] = (point){corners[c][1] - y, corners[c][2] - z};
            int change = cross_face(p, x_corner, &x);
            if (change == 0) continue;
            if (*count == slab->capacity) {
                df_status status = grow(slab, err);
                if (status != DF_OK) return status;
            }
            slab->rows[*count] = j + slab->y_count * (k - slab->z_first);
            slab->unsorted[(*count)++] = (df_crossing){first_sample_beyond(lattice, x), change};
        }
    }
    return DF_OK;
}

static void sort_row(df_crossing *row, uint32_t count) {
    for (uint32_t i = 1; i < count; i++) {
        df_crossing moved = row[i];
        uint32_t to = i;
        for (; to > 0 && row[to - 1].sample > moved.sample; to--) row[to] = row[to - 1];
        row[to] = moved;
    }
}

/* Sorts the crossings by row, and within a row by sample. */
static df_status sort_crossings(df_winding_slab *slab, uint32_t count, df_error *err) {
    uint32_t row_count = slab->y_count * slab->z_count;
    free(slab->starts);
    free(slab->crossings);
    slab->crossings = NULL;
    df_status status =
        df_alloc((void **)&slab->starts, (uint64_t)row_count + 2, sizeof *slab->starts, "winding numbers", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&slab->crossings, count, sizeof *slab->crossings, "winding numbers", err);
    if (status != DF_OK) return status;
    uint32_t *at =
        slab->starts + 1; /* at[row] runs from the start of the row to its end, which is the start of the next */
    for (uint32_t i = 0; i < count; i++) at[slab->rows[i] + 1]++;
    for (uint32_t r = 0; r < row_count; r++) at[r + 1] += at[r];
    for (uint32_t i = 0; i < count; i++) slab->crossings[at[slab->rows[i]]++] = slab->unsorted[i];
    for (uint32_t r = 0; r < row_count; r++)
        sort_row(slab->crossings + slab->starts[r], slab->starts[r + 1] - slab->starts[r]);
    return DF_OK;
}

df_status df_winding_slab_find(df_winding_slab *slab, const df_mesh *mesh, const uint32_t *faces, uint32_t face_count,
                               const df_lattice *lattice, uint32_t z_first, uint32_t z_count, df_error *err) {
    slab->z_first = z_first;
    slab->z_count = z_count;
    slab->y_count = lattice->voxel_count[1] + 1;
    slab->x_last = lattice->voxel_count[0];
    uint32_t count = 0;
    for (uint32_t i = 0; i < face_count; i++) {
        df_status status = add_face(slab, mesh, faces ? faces[i] : i, lattice, &count, err);
        if (status != DF_OK) return status;
    }
    return sort_crossings(slab, count, err);
}

void df_winding_slab_free(df_winding_slab *slab) {
    free(slab->starts);
    free(slab->crossings);
    free(slab->rows);
    free(slab->unsorted);
    *slab = (df_winding_slab){0};
}

void df_winding_row(const df_winding_slab *slab, uint32_t y, uint32_t z, uint32_t x_first, uint32_t x_count,
                    int32_t *winding) {
    assert(y < slab->y_count && z >= slab->z_first && z - slab->z_first < slab->z_count);
    uint32_t row = y + slab->y_count * (z - slab->z_first);
    const df_crossing *at = slab->crossings + slab->starts[row], *end = slab->crossings + slab->starts[row + 1];
    int32_t sum = 0;
    for (uint32_t i = 0; i < x_count; i++) {
        uint32_t sample = x_first + i < slab->x_last ? x_first + i : slab->x_last;
        while (at < end && at->sample <= sample) sum += at++->change;
        winding[i] = sum;
    }
}

int32_t df_winding_at(const df_winding_slab *slab, uint32_t x, uint32_t y, uint32_t z) {
    int32_t winding = 0;
    bool beyond = x > slab->x_last || y >= slab->y_count || z < slab->z_first || z - slab->z_first >= slab->z_count;
    if (!beyond) df_winding_row(slab, y, z, x, 1, &winding);
    return winding;
}

bool df_winding_has_negative(const df_winding_slab *slab) {
    uint64_t row_count = (uint64_t)slab->y_count * slab->z_count;
    for (uint64_t row = 0; row < row_count; row++) {
        int32_t sum = 0;
        for (uint32_t i = slab->starts[row]; i < slab->starts[row + 1]; i++) {
            sum += slab->crossings[i].change;
            bool last_here =
                i + 1 == slab->starts[row + 1] || slab->crossings[i + 1].sample != slab->crossings[i].sample;
            if (sum < 0 && last_here) return true;
        }
    }
    return false;
}

df_status df_face_slabs_make(const df_mesh *mesh, const df_lattice *lattice, uint32_t z_step, df_face_slabs *slabs,
                             df_error *err) {
    *slabs = (df_face_slabs){.slab_count = lattice->voxel_count[2] / z_step + 1};
    df_status status =
        df_alloc((void **)&slabs->starts, (uint64_t)slabs->slab_count + 2, sizeof *slabs->starts, "mesh", err);
    uint32_t *at = slabs->starts + 1;
    for (int pass = 0; pass < 2 && status == DF_OK; pass++) {
        for (uint32_t f = 0; f < mesh->face_count; f++) {
            double low, high;
            uint32_t first, last;
            face_range(mesh, f, 2, &low, &high);
            if (!index_range(lattice, 2, low, high, &first, &last)) continue;
            uint32_t s_first = first / z_step, s_last = last / z_step;
            if (s_first > 0 && first % z_step == 0) s_first--; /* the layer is the last of the slab below as well */
            for (uint32_t s = s_first; s <= s_last; s++) {
                if (pass == 0) at[s + 1]++;
                else slabs->faces[at[s]++] = f;
            }
        }
        if (pass == 1) break;
        for (uint32_t s = 0; s < slabs->slab_count; s++) at[s + 1] += at[s];
        status = df_alloc_raw((void **)&slabs->faces, at[slabs->slab_count], sizeof *slabs->faces, "mesh", err);
    }
    return status;
}

void df_face_slabs_free(df_face_slabs *slabs) {
    free(slabs->starts);
    free(slabs->faces);
    *slabs = (df_face_slabs){0};
}
