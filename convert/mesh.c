#include "convert/mesh.h"

#include "common/memory.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define COORDINATE_MAX 1e100

void df_mesh_free(df_mesh *mesh) {
    free(mesh->positions);
    free(mesh->faces);
    *mesh = (df_mesh){0};
}

void df_mesh_bounds(const df_mesh *mesh, double low[3], double high[3]) {
    for (int a = 0; a < 3; a++) low[a] = INFINITY, high[a] = -INFINITY;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        for (int a = 0; a < 3; a++) {
            double x = mesh->positions[(size_t)v * 3 + (size_t)a];
            if (x < low[a]) low[a] = x;
            if (x > high[a]) high[a] = x;
        }
    }
}

static df_status check_input(df_mesh *mesh, const char *name, df_error *err) {
    if (mesh->face_count == 0) return df_fail(err, DF_ERROR_INPUT, "%s: the mesh has no faces", name);
    for (size_t i = 0; i < (size_t)mesh->vertex_count * 3; i++) {
        double x = mesh->positions[i];
        if (!(fabs(x) <= COORDINATE_MAX)) {
            return df_fail(err, DF_ERROR_INPUT, "%s: vertex %zu has the coordinate %g", name, i / 3, x);
        }
        mesh->positions[i] = x + 0.0; /* -0 becomes 0: equal positions have equal bits */
    }
    for (size_t i = 0; i < (size_t)mesh->face_count * 3; i++) {
        if (mesh->faces[i] >= mesh->vertex_count) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: face %zu uses vertex %u, but there are only %u", name, i / 3,
                           mesh->faces[i], mesh->vertex_count);
        }
    }
    return DF_OK;
}

static uint64_t mix(uint64_t x) {
    x = (x ^ (x >> 32)) * 0xD6E8FEB86659FD93u;
    x = (x ^ (x >> 32)) * 0xD6E8FEB86659FD93u;
    return x ^ (x >> 32);
}

static uint64_t hash_position(const double p[3]) {
    uint64_t bits[3];
    memcpy(bits, p, sizeof bits);
    return mix(bits[0] + mix(bits[1] + mix(bits[2])));
}

/* A table of 2^n slots with at least twice `count`; slots hold index + 1, 0 is free. */
static df_status make_table(uint32_t count, uint32_t **table, uint32_t *mask, df_error *err) {
    uint32_t size = 16;
    while (size < 2u * count) size *= 2;
    *mask = size - 1;
    return df_alloc((void **)table, size, sizeof **table, "mesh", err);
}

/* Sets map[v] to the first vertex with v's position. */
static df_status weld_vertices(const df_mesh *mesh, uint32_t *map, uint32_t *welded, df_error *err) {
    uint32_t *table, mask;
    df_status status = make_table(mesh->vertex_count, &table, &mask, err);
    if (status != DF_OK) return status;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const double *p = mesh->positions + (size_t)v * 3;
        uint32_t slot = (uint32_t)hash_position(p) & mask;
        /* the reader has made -0 zero: equal positions have equal bytes */
        while (table[slot] &&
               // NOLINTNEXTLINE(bugprone-suspicious-memory-comparison)
               memcmp(mesh->positions + (size_t)(table[slot] - 1) * 3, p, 3 * sizeof *p) != 0) {
            slot = (slot + 1) & mask;
        }
        if (!table[slot]) table[slot] = v + 1;
        else ++*welded;
        map[v] = table[slot] - 1;
    }
    free(table);
    return DF_OK;
}

/* A face rotated so that its smallest index is first; orientation is kept. */
static void rotate_face(const uint32_t face[3], uint32_t out[3]) {
    int first = face[0] < face[1] ? (face[0] < face[2] ? 0 : 2) : (face[1] < face[2] ? 1 : 2);
    for (int c = 0; c < 3; c++) out[c] = face[(first + c) % 3];
}

/* Finds `face` (rotated) among the faces in the table; the slot is free when it is not there. */
static uint32_t find_face(const uint32_t *table, uint32_t mask, const uint32_t *faces, const uint32_t face[3]) {
    uint32_t slot = (uint32_t)mix(face[0] + mix(face[1] + mix(face[2]))) & mask;
    while (table[slot] && memcmp(faces + (size_t)(table[slot] - 1) * 3, face, 3 * sizeof *face) != 0) {
        slot = (slot + 1) & mask;
    }
    return slot;
}

/* Applies the vertex map, and drops faces that are degenerate or repeat an earlier one; faces end up rotated. */
static df_status drop_faces(df_mesh *mesh, const uint32_t *map, df_mesh_cleaning *cleaning, df_error *err) {
    uint32_t *table, mask, kept = 0, reversed = 0;
    df_status status = make_table(mesh->face_count, &table, &mask, err);
    if (status != DF_OK) return status;
    for (uint32_t f = 0; f < mesh->face_count; f++) {
        uint32_t face[3], *to = mesh->faces + (size_t)kept * 3;
        for (int c = 0; c < 3; c++) face[c] = map[mesh->faces[(size_t)f * 3 + (size_t)c]];
        if (face[0] == face[1] || face[1] == face[2] || face[2] == face[0]) {
            cleaning->degenerate++;
            continue;
        }
        rotate_face(face, to);
        uint32_t slot = find_face(table, mask, mesh->faces, to);
        if (table[slot]) {
            cleaning->duplicate++;
            continue;
        }
        table[slot] = ++kept;
        uint32_t back[3] = {to[0], to[2], to[1]};
        reversed += table[find_face(table, mask, mesh->faces, back)] != 0;
    }
    mesh->face_count = kept;
    /* Modellers that know no back faces store each face twice; elsewhere opposite faces are where two bodies touch. */
    if (reversed * 2.0 > 0.9 * kept) {
        memset(table, 0, ((size_t)mask + 1) * sizeof *table);
        kept = 0;
        for (uint32_t f = 0; f < mesh->face_count; f++) {
            const uint32_t *face = mesh->faces + (size_t)f * 3;
            uint32_t back[3] = {face[0], face[2], face[1]};
            if (table[find_face(table, mask, mesh->faces, back)]) continue;
            memmove(mesh->faces + (size_t)kept * 3, face, 3 * sizeof *face);
            table[find_face(table, mask, mesh->faces, mesh->faces + (size_t)kept * 3)] = kept + 1;
            kept++;
        }
        cleaning->reversed = mesh->face_count - kept;
        mesh->face_count = kept;
    }
    free(table);
    return DF_OK;
}

/* Removes vertices without a face; `map` is scratch. Welded vertices have no face either, and are counted apart. */
static void drop_vertices(df_mesh *mesh, uint32_t *map, df_mesh_cleaning *cleaning) {
    uint32_t kept = 0;
    memset(map, 0, mesh->vertex_count * sizeof *map);
    for (size_t i = 0; i < (size_t)mesh->face_count * 3; i++) map[mesh->faces[i]] = 1;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        if (!map[v]) continue;
        memmove(mesh->positions + (size_t)kept * 3, mesh->positions + (size_t)v * 3, 3 * sizeof(double));
        map[v] = kept++;
    }
    for (size_t i = 0; i < (size_t)mesh->face_count * 3; i++) mesh->faces[i] = map[mesh->faces[i]];
    cleaning->unreferenced = mesh->vertex_count - kept - cleaning->welded;
    mesh->vertex_count = kept;
}

static uint32_t count_zero_area(const df_mesh *mesh) {
    uint32_t count = 0;
    for (uint32_t f = 0; f < mesh->face_count; f++) {
        double u[3], v[3];
        for (size_t a = 0; a < 3; a++) {
            double p = mesh->positions[(size_t)mesh->faces[(size_t)f * 3] * 3 + a];
            u[a] = mesh->positions[(size_t)mesh->faces[(size_t)f * 3 + 1] * 3 + a] - p;
            v[a] = mesh->positions[(size_t)mesh->faces[(size_t)f * 3 + 2] * 3 + a] - p;
        }
        count += u[1] * v[2] == u[2] * v[1] && u[2] * v[0] == u[0] * v[2] && u[0] * v[1] == u[1] * v[0];
    }
    return count;
}

df_status df_mesh_clean(df_mesh *mesh, const char *name, df_mesh_cleaning *cleaning, df_error *err) {
    *cleaning = (df_mesh_cleaning){.vertices_read = mesh->vertex_count, .faces_read = mesh->face_count};
    df_status status = check_input(mesh, name, err);
    if (status != DF_OK) return status;
    uint32_t *map;
    status = df_alloc_raw((void **)&map, mesh->vertex_count, sizeof *map, "mesh", err);
    if (status != DF_OK) return status;
    status = weld_vertices(mesh, map, &cleaning->welded, err);
    if (status == DF_OK) status = drop_faces(mesh, map, cleaning, err);
    if (status == DF_OK && mesh->face_count == 0) {
        status = df_fail(err, DF_ERROR_INPUT, "%s: all %u faces are degenerate", name, cleaning->faces_read);
    }
    if (status == DF_OK) {
        drop_vertices(mesh, map, cleaning);
        cleaning->zero_area = count_zero_area(mesh);
    }
    free(map);
    return status;
}

/* A half edge in the bucket of its lower vertex. */
typedef struct half_edge {
    uint32_t high;
    int32_t direction; /* +1: from the lower to the higher vertex */
} half_edge;

static int compare_half_edges(const void *a, const void *b) {
    const half_edge *l = a, *r = b;
    return l->high < r->high ? -1 : l->high > r->high;
}

/* Fills half edges by lower vertex: those of v are halves[starts[v]] to halves[starts[v + 1]]. */
static void fill_half_edges(const df_mesh *mesh, uint32_t *starts, half_edge *halves) {
    size_t corner_count = (size_t)mesh->face_count * 3;
    for (int pass = 0; pass < 2; pass++) {
        for (size_t i = 0; i < corner_count; i++) {
            uint32_t from = mesh->faces[i], to = mesh->faces[i % 3 == 2 ? i - 2 : i + 1];
            uint32_t low = from < to ? from : to, high = from < to ? to : from;
            if (pass == 0) starts[low + 1]++;
            else halves[starts[low]++] = (half_edge){high, from < to ? 1 : -1};
        }
        if (pass == 0) {
            for (uint32_t v = 0; v < mesh->vertex_count; v++) starts[v + 1] += starts[v];
        }
    }
    for (uint32_t v = mesh->vertex_count; v > 0; v--) starts[v] = starts[v - 1];
    starts[0] = 0;
}

/* Classifies the edges of one lower vertex; borders are counted, and stored where `borders` is given. */
static uint32_t classify_edges(uint32_t low, const half_edge *halves, uint32_t half_count, df_mesh_edges *edges,
                               df_mesh_border *borders) {
    uint32_t border_count = 0;
    for (uint32_t i = 0, next; i < half_count; i = next) {
        int32_t sum = 0;
        for (next = i; next < half_count && halves[next].high == halves[i].high; next++) sum += halves[next].direction;
        if (!borders) {
            edges->edge_count++;
            edges->boundary += next - i == 1;
            edges->non_manifold += next - i > 2;
            edges->misoriented += next - i == 2 && sum != 0;
        }
        if (sum == 0) continue;
        uint32_t high = halves[i].high;
        if (borders) {
            borders[border_count] =
                sum > 0 ? (df_mesh_border){low, high, (uint32_t)sum} : (df_mesh_border){high, low, (uint32_t)-sum};
        }
        border_count++;
    }
    return border_count;
}

df_status df_mesh_find_edges(const df_mesh *mesh, df_mesh_edges *edges, df_error *err) {
    uint32_t *starts = NULL;
    half_edge *halves = NULL;
    *edges = (df_mesh_edges){0};
    df_status status = df_alloc((void **)&starts, (uint64_t)mesh->vertex_count + 1, sizeof *starts, "mesh edges", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&halves, (uint64_t)mesh->face_count * 3, sizeof *halves, "mesh edges", err);
    if (status != DF_OK) goto done;
    fill_half_edges(mesh, starts, halves);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        uint32_t count = starts[v + 1] - starts[v];
        qsort(halves + starts[v], count, sizeof *halves, compare_half_edges);
        edges->border_count += classify_edges(v, halves + starts[v], count, edges, NULL);
    }
    if (edges->border_count == 0) goto done;
    status = df_alloc_raw((void **)&edges->borders, edges->border_count, sizeof *edges->borders, "mesh edges", err);
    if (status != DF_OK) goto done;
    uint32_t stored = 0;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        stored += classify_edges(v, halves + starts[v], starts[v + 1] - starts[v], edges, edges->borders + stored);
    }
    assert(stored == edges->border_count);
done:
    free(starts);
    free(halves);
    return status;
}
