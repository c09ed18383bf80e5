#include "convert/mesh_builder.h"

#include "common/memory.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Above this, ears cost too much (their search is quadratic), and a fan has to do. */
#define EAR_CORNERS_MAX 4096

/* Makes room for `extra` more elements. */
static bool reserve(void **array, size_t count, size_t *capacity, size_t extra, size_t size) {
    if (extra <= *capacity - count) return true;
    size_t wanted = *capacity + *capacity / 2 + extra + 1024;
    void *grown = wanted <= PTRDIFF_MAX / size ? realloc(*array, wanted * size) : NULL;
    if (!grown) return false;
    *array = grown;
    *capacity = wanted;
    return true;
}

bool df_mesh_builder_vertex(df_mesh_builder *b, double x, double y, double z) {
    b->failed = b->failed || b->vertex_count >= DF_MESH_COUNT_MAX ||
                !reserve((void **)&b->positions, b->vertex_count, &b->vertex_capacity, 1, 3 * sizeof(double));
    if (b->failed) return false;
    double *p = b->positions + b->vertex_count++ * 3;
    p[0] = x, p[1] = y, p[2] = z;
    return true;
}

bool df_mesh_builder_polygon(df_mesh_builder *b, const uint32_t *corners, size_t corner_count) {
    if (corner_count < 3) {
        b->skipped++;
        return !b->failed;
    }
    b->failed = b->failed || b->corner_count + corner_count > 3u * (size_t)DF_MESH_COUNT_MAX ||
                !reserve((void **)&b->corners, b->corner_count, &b->corner_capacity, corner_count, sizeof *corners) ||
                !reserve((void **)&b->sizes, b->polygon_count, &b->polygon_capacity, 1, sizeof *b->sizes);
    if (b->failed) return false;
    memcpy(b->corners + b->corner_count, corners, corner_count * sizeof *corners);
    b->corner_count += corner_count;
    b->sizes[b->polygon_count++] = (uint32_t)corner_count;
    return true;
}

void df_mesh_builder_free(df_mesh_builder *b) {
    free(b->positions);
    free(b->corners);
    free(b->sizes);
    *b = (df_mesh_builder){0};
}

static df_status check_corners(const df_mesh_builder *b, const char *name, df_error *err) {
    if (b->failed) {
        return df_fail(err, DF_ERROR_MEMORY, "%s: the mesh needs too much memory (after %zu vertices, %zu faces)", name,
                       b->vertex_count, b->polygon_count);
    }
    if (b->polygon_count == 0) return df_fail(err, DF_ERROR_INPUT, "%s: the mesh has no faces", name);
    for (size_t polygon = 0, i = 0; polygon < b->polygon_count; polygon++) {
        for (size_t end = i + b->sizes[polygon]; i < end; i++) {
            if (b->corners[i] < b->vertex_count) continue;
            return df_fail(err, DF_ERROR_FORMAT, "%s: face %zu uses vertex %u, but there are only %zu", name,
                           polygon + 1, b->corners[i] + 1, b->vertex_count);
        }
    }
    return DF_OK;
}

df_status df_mesh_builder_finish(df_mesh_builder *b, const char *name, df_mesh *mesh, df_error *err) {
    *mesh = (df_mesh){0};
    df_status status = check_corners(b, name, err);
    if (status != DF_OK) goto done;
    size_t triangle_count = b->corner_count - 2 * b->polygon_count;
    if (triangle_count > b->polygon_count) {
        uint32_t *triangles;
        status = df_alloc_raw((void **)&triangles, triangle_count, 3 * sizeof *triangles, "mesh", err);
        if (status != DF_OK) goto done;
        size_t corner = 0, triangle = 0;
        for (size_t polygon = 0; polygon < b->polygon_count; polygon++) {
            df_polygon_triangulate(b->positions, b->corners + corner, b->sizes[polygon], triangles + triangle * 3);
            corner += b->sizes[polygon];
            triangle += b->sizes[polygon] - 2;
        }
        assert(triangle == triangle_count);
        free(b->corners);
        b->corners = triangles;
    }
    *mesh = (df_mesh){b->positions, b->corners, (uint32_t)b->vertex_count, (uint32_t)triangle_count};
    b->positions = NULL;
    b->corners = NULL;
done:
    df_mesh_builder_free(b);
    return status;
}

/* The normal of a polygon by Newell's method, its length twice the area. */
static void polygon_normal(const double *positions, const uint32_t *corners, size_t count, double normal[3]) {
    normal[0] = normal[1] = normal[2] = 0;
    const double *origin = positions + (size_t)corners[0] * 3;
    for (size_t i = 1; i + 1 < count; i++) {
        const double *p = positions + (size_t)corners[i] * 3, *q = positions + (size_t)corners[i + 1] * 3;
        double u[3] = {p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]};
        double v[3] = {q[0] - origin[0], q[1] - origin[1], q[2] - origin[2]};
        normal[0] += u[1] * v[2] - u[2] * v[1];
        normal[1] += u[2] * v[0] - u[0] * v[2];
        normal[2] += u[0] * v[1] - u[1] * v[0];
    }
}

static double squared_distance(const double *p, const double *q) {
    double x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2];
    return x * x + y * y + z * z;
}

/* Twice the signed area of a triangle, seen against `normal`. */
static double facing(const double *positions, const uint32_t triangle[3], const double normal[3]) {
    double n[3];
    polygon_normal(positions, triangle, 3, n);
    return n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2];
}

static void split_quadrilateral(const double *positions, const uint32_t c[4], uint32_t *triangles) {
    const uint32_t cuts[2][6] = {{c[0], c[1], c[2], c[0], c[2], c[3]}, {c[1], c[2], c[3], c[1], c[3], c[0]}};
    double normal[3];
    polygon_normal(positions, c, 4, normal);
    bool proper[2];
    for (int i = 0; i < 2; i++)
        proper[i] = facing(positions, cuts[i], normal) > 0 && facing(positions, cuts[i] + 3, normal) > 0;
    int choice = squared_distance(positions + (size_t)c[1] * 3, positions + (size_t)c[3] * 3) <
                 squared_distance(positions + (size_t)c[0] * 3, positions + (size_t)c[2] * 3);
    if (proper[0] != proper[1]) choice = proper[1];
    memcpy(triangles, cuts[choice], sizeof cuts[choice]);
}

typedef struct plane_point {
    double x, y;
} plane_point;

static double cross(plane_point a, plane_point b, plane_point c) {
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

/* True when corner i of the remaining ring can be cut off: it is convex and no other corner lies in its triangle. */
static bool is_ear(const plane_point *points, const uint32_t *ring, size_t count, size_t i) {
    plane_point a = points[ring[(i + count - 1) % count]], b = points[ring[i]], c = points[ring[(i + 1) % count]];
    if (!(cross(a, b, c) > 0)) return false;
    for (size_t j = 2; j + 1 < count; j++) {
        plane_point p = points[ring[(i + j) % count]];
        if (cross(a, b, p) >= 0 && cross(b, c, p) >= 0 && cross(c, a, p) >= 0) return false;
    }
    return true;
}

/* Points of the polygon in the plane across its normal's largest axis, counter-clockwise. */
static void project(const double *positions, const uint32_t *corners, size_t count, plane_point *points) {
    double n[3];
    polygon_normal(positions, corners, count, n);
    int axis = fabs(n[0]) > fabs(n[1]) ? (fabs(n[0]) > fabs(n[2]) ? 0 : 2) : (fabs(n[1]) > fabs(n[2]) ? 1 : 2);
    int u = (axis + 1) % 3, v = (axis + 2) % 3;
    if (n[axis] < 0) {
        int swap = u;
        u = v;
        v = swap;
    }
    for (size_t i = 0; i < count; i++) {
        const double *p = positions + (size_t)corners[i] * 3;
        points[i] = (plane_point){p[u], p[v]};
    }
}

void df_polygon_triangulate(const double *positions, const uint32_t *corners, size_t count, uint32_t *triangles) {
    if (count == 3) {
        memcpy(triangles, corners, 3 * sizeof *corners);
        return;
    }
    if (count == 4) {
        split_quadrilateral(positions, corners, triangles);
        return;
    }
    plane_point *points = count <= EAR_CORNERS_MAX ? malloc(count * (sizeof *points + sizeof(uint32_t))) : NULL;
    if (!points) {
        for (size_t i = 1; i + 1 < count; i++, triangles += 3) {
            triangles[0] = corners[0], triangles[1] = corners[i], triangles[2] = corners[i + 1];
        }
        return;
    }
    uint32_t *ring = (uint32_t *)(points + count);
    project(positions, corners, count, points);
    for (size_t i = 0; i < count; i++) ring[i] = (uint32_t)i;
    size_t at = 0;
    while (count > 2) {
        size_t tries = 0;
        while (tries < count && !is_ear(points, ring, count, (at + tries) % count)) tries++;
        at = (at + tries) % count; /* no ear in a degenerate polygon: any corner will do */
        triangles[0] = corners[ring[(at + count - 1) % count]];
        triangles[1] = corners[ring[at]];
        triangles[2] = corners[ring[(at + 1) % count]];
        triangles += 3;
        memmove(ring + at, ring + at + 1, (count - at - 1) * sizeof *ring);
        count--;
        at = at % count;
    }
    free(points);
}
