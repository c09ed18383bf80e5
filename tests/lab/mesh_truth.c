#include "mesh_truth.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LEAF_TRIANGLES 4u

/* The children of a node follow it: the first at once, the second at `next`. A leaf has count > 0. */
typedef struct node {
    double low[3], high[3];
    uint32_t first, count, next;
} node;

struct lab_mesh {
    double *positions;
    uint32_t *triangles, *order;
    uint32_t vertex_count, triangle_count, node_count;
    node *nodes;
};

static const double *corner_of(const lab_mesh *mesh, uint32_t triangle, int corner) {
    return mesh->positions + 3 * (size_t)mesh->triangles[3 * (size_t)triangle + (size_t)corner];
}

static double middle_of(const lab_mesh *mesh, uint32_t triangle, int axis) {
    return corner_of(mesh, triangle, 0)[axis] + corner_of(mesh, triangle, 1)[axis] + corner_of(mesh, triangle, 2)[axis];
}

static void bound(const lab_mesh *mesh, node *n) {
    for (int a = 0; a < 3; a++) {
        n->low[a] = INFINITY;
        n->high[a] = -INFINITY;
        for (uint32_t i = 0; i < 3 * n->count; i++) {
            const double p = corner_of(mesh, mesh->order[n->first + i / 3], (int)(i % 3))[a];
            n->low[a] = fmin(n->low[a], p);
            n->high[a] = fmax(n->high[a], p);
        }
        const double slack = 1e-9 * (1 + fabs(n->low[a]) + fabs(n->high[a])); /* so that rounding loses nothing */
        n->low[a] -= slack;
        n->high[a] += slack;
    }
}

/* Halves order[first .. first + count) at the middle of the longest axis of the triangles' middles. */
static uint32_t split(lab_mesh *mesh, const node *n) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t i = 0; i < n->count; i++) {
        for (int a = 0; a < 3; a++) {
            const double m = middle_of(mesh, mesh->order[n->first + i], a);
            low[a] = fmin(low[a], m);
            high[a] = fmax(high[a], m);
        }
    }
    int axis = high[0] - low[0] >= high[1] - low[1] ? 0 : 1;
    if (high[2] - low[2] > high[axis] - low[axis]) axis = 2;
    uint32_t left = 0;
    for (uint32_t i = 0; i < n->count; i++) {
        const uint32_t t = mesh->order[n->first + i];
        if (middle_of(mesh, t, axis) >= (low[axis] + high[axis]) / 2) continue;
        mesh->order[n->first + i] = mesh->order[n->first + left];
        mesh->order[n->first + left++] = t;
    }
    return left == 0 || left == n->count ? n->count / 2 : left;
}

static void build(lab_mesh *mesh, uint32_t first, uint32_t count) {
    node *n = &mesh->nodes[mesh->node_count++];
    *n = (node){.first = first, .count = count};
    bound(mesh, n);
    if (count <= LEAF_TRIANGLES) return;
    const uint32_t left = split(mesh, n);
    n->count = 0;
    build(mesh, first, left);
    n->next = mesh->node_count;
    build(mesh, first + left, count - left);
}

df_status lab_mesh_make(const double *positions, uint32_t vertex_count, const uint32_t *triangles,
                        uint32_t triangle_count, lab_mesh **out, df_error *err) {
    lab_mesh *mesh = *out = calloc(1, sizeof *mesh);
    if (!mesh || triangle_count == 0) return df_fail(err, DF_ERROR_INPUT, "no mesh");
    mesh->vertex_count = vertex_count;
    mesh->triangle_count = triangle_count;
    mesh->positions = malloc(3 * sizeof(double) * vertex_count);
    mesh->triangles = malloc(3 * sizeof(uint32_t) * triangle_count);
    mesh->order = malloc(sizeof(uint32_t) * triangle_count);
    mesh->nodes = malloc(sizeof(node) * 2 * triangle_count);
    if (!mesh->positions || !mesh->triangles || !mesh->order || !mesh->nodes) {
        lab_mesh_free(mesh);
        *out = NULL;
        return df_fail(err, DF_ERROR_MEMORY, "no memory for %u triangles", triangle_count);
    }
    memcpy(mesh->positions, positions, 3 * sizeof(double) * vertex_count);
    memcpy(mesh->triangles, triangles, 3 * sizeof(uint32_t) * triangle_count);
    for (uint32_t i = 0; i < triangle_count; i++) mesh->order[i] = i;
    build(mesh, 0, triangle_count);
    return DF_OK;
}

void lab_mesh_free(lab_mesh *mesh) {
    if (!mesh) return;
    free(mesh->positions);
    free(mesh->triangles);
    free(mesh->order);
    free(mesh->nodes);
    free(mesh);
}

/* Room for one more group of three. */
static void *grow(void *array, size_t size, uint32_t count, uint32_t *capacity) {
    if (count < *capacity) return array;
    *capacity = *capacity ? 2 * *capacity : 1024;
    void *larger = realloc(array, 3 * size * *capacity);
    if (!larger) free(array);
    return larger;
}

df_status lab_mesh_read(const char *path, const df_field *field, lab_mesh **out, df_error *err) {
    char line[1024];
    double *positions = NULL;
    uint32_t *triangles = NULL, vertex_count = 0, triangle_count = 0, vertex_capacity = 0, triangle_capacity = 0;
    FILE *file = fopen(path, "r");
    *out = NULL;
    if (!file) return df_fail(err, DF_ERROR_IO, "%s: %s", path, strerror(errno));
    while (fgets(line, sizeof line, file)) {
        if (line[0] == 'v' && line[1] == ' ') {
            double world[3];
            if (sscanf(line + 2, "%lf %lf %lf", &world[0], &world[1], &world[2]) != 3) continue;
            if (!(positions = grow(positions, sizeof *positions, vertex_count, &vertex_capacity))) break;
            df_field_world_to_grid(field, world, positions + 3 * (size_t)vertex_count++);
        } else if (line[0] == 'f' && line[1] == ' ') {
            uint32_t corners[2] = {0, 0}, seen = 0;
            for (char *word = strtok(line + 2, " \t\r\n"); word; word = strtok(NULL, " \t\r\n")) {
                const long index = strtol(word, NULL, 10);
                const uint32_t corner = (uint32_t)(index < 0 ? (long)vertex_count + index : index - 1);
                if (corner >= vertex_count) break;
                if (seen >= 2) {
                    if (!(triangles = grow(triangles, sizeof *triangles, triangle_count, &triangle_capacity))) break;
                    memcpy(triangles + 3 * (size_t)triangle_count++, (uint32_t[]){corners[0], corners[1], corner},
                           3 * sizeof corner);
                    corners[1] = corner;
                } else {
                    corners[seen] = corner;
                }
                seen++;
            }
        }
    }
    fclose(file);
    df_status status = positions && triangles
                           ? lab_mesh_make(positions, vertex_count, triangles, triangle_count, out, err)
                           : df_fail(err, DF_ERROR_FORMAT, "%s: no triangles", path);
    free(positions);
    free(triangles);
    return status;
}

/* A ray turned so that it runs along z: axis k[2] is its largest, sheared. */
typedef struct turned {
    double origin[3], inverse[3], shear[3];
    int k[3];
} turned;

static turned turn(const double origin[3], const double direction[3]) {
    turned r;
    int z = fabs(direction[0]) >= fabs(direction[1]) ? 0 : 1;
    if (fabs(direction[2]) > fabs(direction[z])) z = 2;
    int x = (z + 1) % 3, y = (z + 2) % 3;
    if (direction[z] < 0) {
        int swap = x;
        x = y;
        y = swap;
    }
    r.k[0] = x;
    r.k[1] = y;
    r.k[2] = z;
    r.shear[0] = direction[x] / direction[z];
    r.shear[1] = direction[y] / direction[z];
    r.shear[2] = 1 / direction[z];
    for (int a = 0; a < 3; a++) {
        r.origin[a] = origin[a];
        r.inverse[a] = 1 / direction[a];
    }
    return r;
}

static void try_triangle(const lab_mesh *mesh, uint32_t triangle, const turned *r, df_truth *out) {
    double p[3][3];
    for (int c = 0; c < 3; c++) {
        const double *v = corner_of(mesh, triangle, c);
        const double z = v[r->k[2]] - r->origin[r->k[2]];
        p[c][0] = (v[r->k[0]] - r->origin[r->k[0]]) - r->shear[0] * z;
        p[c][1] = (v[r->k[1]] - r->origin[r->k[1]]) - r->shear[1] * z;
        p[c][2] = r->shear[2] * z;
    }
    const double u = p[2][0] * p[1][1] - p[2][1] * p[1][0], v = p[0][0] * p[2][1] - p[0][1] * p[2][0],
                 w = p[1][0] * p[0][1] - p[1][1] * p[0][0];
    if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0)) return;
    const double sum = u + v + w;
    if (sum == 0) return;
    const double t = (u * p[0][2] + v * p[1][2] + w * p[2][2]) / sum;
    if (!(t > 0) || (out->hit && (df_quad)t >= out->t)) return;
    out->hit = true;
    out->t = t;
    out->back = sum < 0;
    out->triangle = triangle;
}

static bool meets(const node *n, const turned *r, double t_max) {
    double t_in = 0, t_out = t_max;
    for (int a = 0; a < 3; a++) {
        const double low = (n->low[a] - r->origin[a]) * r->inverse[a],
                     high = (n->high[a] - r->origin[a]) * r->inverse[a];
        t_in = fmax(t_in, fmin(low, high)); /* fmax and fmin leave a NaN, of a plane that the ray lies in, aside */
        t_out = fmin(t_out, fmax(low, high));
    }
    return t_in <= t_out * (1 + 1e-12);
}

void lab_mesh_normal(const lab_mesh *mesh, uint32_t triangle, double normal[3]) {
    const double *p = corner_of(mesh, triangle, 0), *q = corner_of(mesh, triangle, 1),
                 *r = corner_of(mesh, triangle, 2);
    double length = 0;
    for (int a = 0; a < 3; a++) {
        const int u = (a + 1) % 3, v = (a + 2) % 3;
        normal[a] = (q[u] - p[u]) * (r[v] - p[v]) - (q[v] - p[v]) * (r[u] - p[u]);
        length += normal[a] * normal[a];
    }
    for (int a = 0; a < 3; a++) normal[a] /= sqrt(length);
}

void lab_mesh_trace(const lab_mesh *mesh, const double origin[3], const double direction[3], df_truth *out) {
    uint32_t stack[128], depth = 0;
    const turned r = turn(origin, direction);
    *out = (df_truth){.hit = false};
    stack[depth++] = 0;
    while (depth) {
        const uint32_t at = stack[--depth];
        const node *n = &mesh->nodes[at];
        if (!meets(n, &r, out->hit ? (double)out->t : (double)INFINITY)) continue;
        for (uint32_t i = 0; i < n->count; i++) try_triangle(mesh, mesh->order[n->first + i], &r, out);
        if (n->count == 0) {
            stack[depth++] = n->next;
            stack[depth++] = at + 1;
        }
    }
}
