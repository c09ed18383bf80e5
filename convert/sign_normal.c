#include "convert/sign_normal.h"

#include "common/memory.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void subtract(const double a[3], const double b[3], double out[3]) {
    for (int i = 0; i < 3; i++) out[i] = a[i] - b[i];
}

static void cross(const double a[3], const double b[3], double out[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
    }
}

static void add_scaled(const double v[3], double factor, double out[3]) {
    for (int i = 0; i < 3; i++) out[i] += factor * v[i];
}

static const double *corner(const df_mesh *mesh, uint32_t face, uint32_t c) {
    return mesh->positions + (size_t)mesh->faces[(size_t)face * 3 + c % 3] * 3;
}

/* The unit normal; 0 for a face without area. */
static void face_normal(const df_mesh *mesh, uint32_t face, double out[3]) {
    double u[3], v[3];
    subtract(corner(mesh, face, 1), corner(mesh, face, 0), u);
    subtract(corner(mesh, face, 2), corner(mesh, face, 0), v);
    cross(u, v, out);
    const double length = sqrt(dot(out, out));
    for (int i = 0; i < 3; i++) out[i] = length > 0 ? out[i] / length : 0;
}

static double angle_at(const df_mesh *mesh, uint32_t face, uint32_t c) {
    double u[3], v[3], n[3];
    subtract(corner(mesh, face, c + 1), corner(mesh, face, c), u);
    subtract(corner(mesh, face, c + 2), corner(mesh, face, c), v);
    cross(u, v, n);
    return atan2(sqrt(dot(n, n)), dot(u, v));
}

/* A side of a face: the sides between the same two vertices belong to one edge. */
typedef struct side {
    uint32_t low, high, index; /* index: face * 3 + side */
} side;

static int compare_sides(const void *a, const void *b) {
    const side *l = a, *r = b;
    if (l->low != r->low) return l->low < r->low ? -1 : 1;
    if (l->high != r->high) return l->high < r->high ? -1 : 1;
    return l->index < r->index ? -1 : l->index > r->index;
}

/* Gives every side the sum of the normals of the faces at its edge. */
static df_status sum_over_edges(const df_mesh *mesh, uint32_t face_count, double (*of_edge)[3], df_error *err) {
    const size_t count = (size_t)face_count * 3;
    side *sides;
    df_status status = df_alloc_raw((void **)&sides, count, sizeof *sides, "normals", err);
    if (status != DF_OK) return status;
    for (size_t i = 0; i < count; i++) {
        const uint32_t from = mesh->faces[i], to = mesh->faces[i % 3 == 2 ? i - 2 : i + 1];
        sides[i] = (side){from < to ? from : to, from < to ? to : from, (uint32_t)i};
    }
    qsort(sides, count, sizeof *sides, compare_sides);
    for (size_t i = 0, next; i < count; i = next) {
        double sum[3] = {0, 0, 0};
        for (next = i; next < count && sides[next].low == sides[i].low && sides[next].high == sides[i].high; next++) {
            double n[3];
            face_normal(mesh, sides[next].index / 3, n);
            add_scaled(n, 1, sum);
        }
        for (size_t s = i; s < next; s++) memcpy(of_edge[sides[s].index], sum, sizeof sum);
    }
    free(sides);
    return DF_OK;
}

df_status df_sign_normals_make(const df_mesh *mesh, uint32_t face_count, df_sign_normals *normals, df_error *err) {
    df_mesh faces = *mesh;
    faces.face_count = face_count;
    *normals = (df_sign_normals){.mesh = mesh};
    df_status status = df_face_tree_make(&faces, &normals->tree, err);
    if (status == DF_OK)
        status = df_alloc((void **)&normals->of_vertex, mesh->vertex_count, sizeof *normals->of_vertex, "normals", err);
    if (status == DF_OK)
        status =
            df_alloc((void **)&normals->of_edge, (uint64_t)face_count * 3, sizeof *normals->of_edge, "normals", err);
    if (status == DF_OK) status = sum_over_edges(mesh, face_count, normals->of_edge, err);
    for (uint32_t f = 0; status == DF_OK && f < face_count; f++) {
        double n[3];
        face_normal(mesh, f, n);
        for (uint32_t c = 0; c < 3; c++) {
            add_scaled(n, angle_at(mesh, f, c), normals->of_vertex[mesh->faces[(size_t)f * 3 + c]]);
        }
    }
    if (status != DF_OK) df_sign_normals_free(normals);
    return status;
}

void df_sign_normals_free(df_sign_normals *normals) {
    df_face_tree_free(&normals->tree);
    free(normals->of_vertex);
    free(normals->of_edge);
    *normals = (df_sign_normals){0};
}

/* The feature of a face nearest to p (Ericson 2005, 5.1.5): 0 to 2 corners, 3 to 5 sides, 6 the face itself. *out gets
 * a point of it. */
static uint32_t nearest_feature(const df_mesh *mesh, uint32_t face, const double p[3], const double **out) {
    double along[3], rest[3];
    bool beyond[3], before[3]; /* by side: p projects past its end, before its start */
    for (uint32_t s = 0; s < 3; s++) {
        subtract(corner(mesh, face, s + 1), corner(mesh, face, s), along);
        subtract(p, corner(mesh, face, s), rest);
        const double at = dot(rest, along);
        before[s] = at <= 0;
        beyond[s] = at >= dot(along, along);
    }
    for (uint32_t c = 0; c < 3; c++) {
        *out = corner(mesh, face, c);
        if (before[c] && beyond[(c + 2) % 3]) return c;
    }
    double normal[3], outwards[3];
    face_normal(mesh, face, normal);
    for (uint32_t s = 0; s < 3; s++) {
        *out = corner(mesh, face, s);
        subtract(corner(mesh, face, s + 1), *out, along);
        subtract(p, *out, rest);
        cross(along, normal, outwards);
        if (dot(outwards, rest) >= 0 && !before[s] && !beyond[s]) return 3 + s;
    }
    return 6;
}

bool df_sign_normals_inside(const df_sign_normals *normals, const double p[3], uint32_t *nearest) {
    df_face_tree_nearest(&normals->tree, p, nearest);
    const uint32_t face = normals->tree.order[*nearest];
    const double *point;
    double face_n[3], offset[3];
    const uint32_t feature = nearest_feature(normals->mesh, face, p, &point);
    face_normal(normals->mesh, face, face_n);
    const double *normal = feature < 3   ? normals->of_vertex[normals->mesh->faces[(size_t)face * 3 + feature]]
                           : feature < 6 ? normals->of_edge[(size_t)face * 3 + feature - 3]
                                         : face_n;
    subtract(p, point, offset);
    return dot(offset, normal) < 0;
}
