#include "convert/face_tree.h"

#include "common/memory.h"
#include "convert/isa.h"
#include "convert/smaller.h"
#include "convert/winding.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static double inverse(double square) { return square > 0 ? 1 / square : 0; }

static void prepare_face(const double *const corner[3], df_face *face) {
    int longest = 0;
    double length[3];
    for (int e = 0; e < 3; e++) {
        double d[3];
        for (int i = 0; i < 3; i++) d[i] = corner[(e + 1) % 3][i] - corner[e][i];
        length[e] = dot(d, d);
        if (length[e] > length[longest]) longest = e;
    }
    const double *a = corner[longest], *b = corner[(longest + 1) % 3], *c = corner[(longest + 2) % 3];
    double bc[3];
    for (int i = 0; i < 3; i++) {
        face->a[i] = a[i];
        face->ab[i] = b[i] - a[i];
        face->ac[i] = c[i] - a[i];
        bc[i] = face->ac[i] - face->ab[i];
    }
    face->inverse_ab = inverse(dot(face->ab, face->ab));
    face->inverse_ac = inverse(dot(face->ac, face->ac));
    face->inverse_bc = inverse(dot(bc, bc));
    face->foot = fmin(1, fmax(0, dot(face->ac, face->ab) * face->inverse_ab));
    for (int i = 0; i < 3; i++) face->h[i] = face->ac[i] - face->foot * face->ab[i];
    face->inverse_h = inverse(dot(face->h, face->h));
    double normal[3], area = 0;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        normal[i] = face->ab[j] * face->h[k] - face->ab[k] * face->h[j];
        area += normal[i] * normal[i];
    }
    area = sqrt(area);
    bool has_area = area > 0 && isfinite(face->inverse_h);
    if (!has_area) face->inverse_h = 0;
    for (int i = 0; i < 3; i++) face->normal[i] = has_area ? normal[i] / area : 0;
}

/* The squared distance of a point to a face: the nearest of its sides and, where the foot of the perpendicular lies
 * inside, its plane. */
static inline __attribute__((always_inline)) double face_distance(const df_face *f, double px, double py, double pz) {
    double x = px - f->a[0], y = py - f->a[1], z = pz - f->a[2];
    double s = (x * f->ab[0] + y * f->ab[1] + z * f->ab[2]) * f->inverse_ab;
    double t = (x * f->h[0] + y * f->h[1] + z * f->h[2]) * f->inverse_h;
    double u = (x * f->ac[0] + y * f->ac[1] + z * f->ac[2]) * f->inverse_ac;
    double bx = x - f->ab[0], by = y - f->ab[1], bz = z - f->ab[2];
    double cx = f->ac[0] - f->ab[0], cy = f->ac[1] - f->ab[1], cz = f->ac[2] - f->ab[2];
    double v = (bx * cx + by * cy + bz * cz) * f->inverse_bc;
    double height = x * f->normal[0] + y * f->normal[1] + z * f->normal[2], plane = height * height;
    /* inside all three sides, from which t <= 1 follows; never for a face without area */
    double left = s - t * f->foot, right = 1 - s - t * (1 - f->foot);
    double least = left < right ? left : right;
    least = t < least ? t : least;
    least = f->inverse_h > 0 ? least : -1;
    double s1 = s < 0 ? 0 : s, u1 = u < 0 ? 0 : u, v1 = v < 0 ? 0 : v;
    s1 = s1 > 1 ? 1 : s1;
    u1 = u1 > 1 ? 1 : u1;
    v1 = v1 > 1 ? 1 : v1;
    double ex = x - s1 * f->ab[0], ey = y - s1 * f->ab[1], ez = z - s1 * f->ab[2];
    double best = ex * ex + ey * ey + ez * ez;
    double gx = x - u1 * f->ac[0], gy = y - u1 * f->ac[1], gz = z - u1 * f->ac[2];
    double side = gx * gx + gy * gy + gz * gz;
    best = side < best ? side : best;
    double kx = bx - v1 * cx, ky = by - v1 * cy, kz = bz - v1 * cz;
    side = kx * kx + ky * ky + kz * kz;
    best = side < best ? side : best;
    plane = least < 0 ? best : plane;
    return plane < best ? plane : best;
}

DF_FOR_EACH_ISA
void df_face_distances(const df_face *faces, const uint32_t *list, uint32_t count, const double points[3][8],
                       double *out, double least[8]) {
    double low[8];
    for (int p = 0; p < 8; p++) low[p] = INFINITY;
    for (uint32_t i = 0; i < count; i++) {
        const df_face face = faces[list[i]];
        double d[8];
        for (int p = 0; p < 8; p++) {
            d[p] = face_distance(&face, points[0][p], points[1][p], points[2][p]);
            low[p] = d[p] < low[p] ? d[p] : low[p];
        }
        if (out) memcpy(out + (size_t)i * 8, d, sizeof d);
    }
    memcpy(least, low, sizeof low);
}

/* A coordinate along an axis in units of the tree. */
static inline float to_tree(const df_face_tree *tree, double world, int axis) {
    return (float)((world - tree->origin[axis]) * tree->scale);
}

/* Squared distances of 8 points to the centres of the spheres around faces; low: the smallest of each point. */
static inline __attribute__((always_inline)) void sphere_distances(const df_face_tree *tree, const uint32_t *list,
                                                                   uint32_t count, const float points[3][8],
                                                                   float *distances, float low[8]) {
    for (int p = 0; p < 8; p++) low[p] = INFINITY;
    for (uint32_t i = 0; i < count; i++) {
        const df_face_sphere s = tree->spheres[list[i]];
        float *d = distances + (size_t)i * 8;
#pragma omp simd
        for (int p = 0; p < 8; p++) {
            float x = points[0][p] - s.centre[0], y = points[1][p] - s.centre[1], z = points[2][p] - s.centre[2];
            float square = x * x + y * y + z * z;
            low[p] = square < low[p] ? square : low[p];
            d[p] = square;
        }
    }
}

/* The nearest face is no further than the nearest centre, which is a point of its face, and reaches no further from its
 * own centre than its radius. */
DF_FOR_EACH_ISA
static uint32_t keep_near(const df_face_tree *tree, const uint32_t *list, uint32_t count, const double points[3][8],
                          float *distances, uint32_t *kept) {
    float local[3][8], low[8], slack = 2 * (float)tree->slack;
    uint32_t kept_count = 0;
    for (int p = 0; p < 8; p++) {
        for (int a = 0; a < 3; a++) local[a][p] = to_tree(tree, points[a][p], a);
    }
    sphere_distances(tree, list, count, (const float(*)[8])local, distances, low);
    for (int p = 0; p < 8; p++) low[p] = sqrtf(low[p]) * (1 + 1e-6f) + slack;
    for (uint32_t i = 0; i < count; i++) {
        const float *d = distances + (size_t)i * 8, radius = tree->spheres[list[i]].radius;
        int32_t near = 0;
#pragma omp simd reduction(| : near)
        for (int p = 0; p < 8; p++) {
            float reach = low[p] + radius;
            near |= d[p] <= reach * reach * (1 + 1e-6f);
        }
        kept[kept_count] = list[i];
        kept_count += near != 0;
    }
    return kept_count;
}

/* Below this, spheres cost more than they save. */
#define LIST_SHORT 6

void df_face_distances_of_near(const df_face_tree *tree, const uint32_t *list, uint32_t count,
                               const double points[3][8], float *distances, uint32_t *kept, double least[8]) {
    if (count > LIST_SHORT) {
        count = keep_near(tree, list, count, points, distances, kept);
        list = kept;
    }
    df_face_distances(tree->faces, list, count, points, NULL, least);
}

DF_FOR_EACH_ISA
void df_face_select(const df_face_tree *tree, const uint32_t *list, uint32_t count, const df_face_boxes *boxes,
                    float *distances, uint8_t *masks) {
    float centre[3][8], half[3][8], low[8];
    uint32_t nearest[8] = {0};
    for (int b = 0; b < 8; b++) {
        for (int a = 0; a < 3; a++) {
            centre[a][b] = to_tree(tree, boxes->centre[a][b], a);
            half[a][b] = (float)(boxes->half[a][b] * tree->scale);
        }
    }
    sphere_distances(tree, list, count, (const float(*)[8])centre, distances, low);
    for (uint32_t i = 0; i < count; i++) {
        for (int b = 0; b < 8; b++) nearest[b] = distances[(size_t)i * 8 + (size_t)b] == low[b] ? i : nearest[b];
    }
    /* the nearest centre of each box is the witness; `far` bounds its distance from the box's points */
    float witness[3][8], far[8], slack = (float)tree->slack;
    for (int b = 0; b < 8; b++) {
        const df_face_sphere s = tree->spheres[list[nearest[b]]];
        float x = half[0][b], y = half[1][b], z = half[2][b];
        for (int a = 0; a < 3; a++) witness[a][b] = s.centre[a];
        far[b] = sqrtf(low[b]) + sqrtf(x * x + y * y + z * z) + slack;
    }
    for (uint32_t i = 0; i < count; i++) {
        const df_face_sphere s = tree->spheres[list[i]];
        const float *d = distances + (size_t)i * 8;
        float radius = s.radius + slack;
        int32_t keep[8];
#pragma omp simd
        for (int b = 0; b < 8; b++) {
            float x = fabsf(s.centre[0] - witness[0][b]), y = fabsf(s.centre[1] - witness[1][b]),
                  z = fabsf(s.centre[2] - witness[2][b]);
            float margin = d[b] - low[b] - 2 * (half[0][b] * x + half[1][b] * y + half[2][b] * z);
            keep[b] = margin <= radius * (2 * far[b] + radius) ? 1 << b : 0;
        }
        int32_t mask = 0;
#pragma omp simd reduction(| : mask)
        for (int b = 0; b < 8; b++) mask |= keep[b];
        masks[i] = (uint8_t)mask;
    }
}

/* Spreads the low 16 bits of x to every third bit. */
static uint64_t spread(uint64_t x) {
    x = (x | x << 16) & 0x0000FF0000FFu;
    x = (x | x << 8) & 0x00F00F00F00Fu;
    x = (x | x << 4) & 0x0C30C30C30C3u;
    return (x | x << 2) & 0x249249249249u;
}

typedef struct key {
    uint64_t code;
    uint32_t face;
} key;

/* Sorts by the 48 bits of the code, in three passes of 16. `other` has room for as many. */
static void sort_keys(key *keys, key *other, uint32_t count, uint32_t *histogram) {
    for (int shift = 0; shift < 48; shift += 16) {
        memset(histogram, 0, 65537 * sizeof *histogram);
        for (uint32_t i = 0; i < count; i++) histogram[(keys[i].code >> shift & 0xFFFF) + 1]++;
        for (uint32_t i = 0; i < 65536; i++) histogram[i + 1] += histogram[i];
        for (uint32_t i = 0; i < count; i++) other[histogram[keys[i].code >> shift & 0xFFFF]++] = keys[i];
        key *swap = keys;
        keys = other;
        other = swap;
    }
    memcpy(other, keys, count * sizeof *keys); /* after an odd number of passes: back to where they came from */
}

static df_status order_faces(const df_mesh *mesh, const double low[3], const double high[3], df_face_tree *tree,
                             df_error *err) {
    key *keys = NULL;
    uint32_t *histogram = NULL;
    double scale[3];
    for (int a = 0; a < 3; a++) scale[a] = high[a] > low[a] ? 65535 / (high[a] - low[a]) : 0;
    df_status status = df_alloc_raw((void **)&keys, 2 * (uint64_t)mesh->face_count, sizeof *keys, "tree of faces", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&histogram, 65537, sizeof *histogram, "tree of faces", err);
    if (status != DF_OK) goto done;
#pragma omp parallel for schedule(static)
    for (uint32_t f = 0; f < mesh->face_count; f++) {
        uint64_t code = 0;
        for (int a = 0; a < 3; a++) {
            double sum = 0;
            for (int c = 0; c < 3; c++)
                sum += mesh->positions[(size_t)mesh->faces[(size_t)f * 3 + (size_t)c] * 3 + (size_t)a];
            code |= spread((uint64_t)((sum / 3 - low[a]) * scale[a])) << a;
        }
        keys[f] = (key){code, f};
    }
    sort_keys(keys, keys + mesh->face_count, mesh->face_count, histogram);
    for (uint32_t f = 0; f < mesh->face_count; f++) tree->order[f] = keys[f].face;
done:
    free(keys);
    free(histogram);
    return status;
}

static void empty_node(df_face_node *node) {
    for (int a = 0; a < 3; a++) {
        for (int c = 0; c < 8; c++) node->low[a][c] = INFINITY, node->high[a][c] = -INFINITY;
    }
}

/* The smaller of the spheres around the centroid and around the middle of the longest side. */
static df_face_sphere make_sphere(const df_face_tree *tree, const double *const corner[3], const df_face *face) {
    df_face_sphere sphere = {{0}, INFINITY};
    for (int choice = 0; choice < 2; choice++) {
        double centre[3], square = 0;
        for (int a = 0; a < 3; a++) {
            centre[a] = choice ? face->a[a] + face->ab[a] / 2 : (corner[0][a] + corner[1][a] + corner[2][a]) / 3;
        }
        for (int c = 0; c < 3; c++) {
            double d[3] = {corner[c][0] - centre[0], corner[c][1] - centre[1], corner[c][2] - centre[2]};
            square = df_larger(square, dot(d, d));
        }
        const float radius = (float)(sqrt(square) * tree->scale);
        if (radius >= sphere.radius) continue;
        sphere.radius = radius;
        for (int a = 0; a < 3; a++) sphere.centre[a] = to_tree(tree, centre[a], a);
    }
    return sphere;
}

/* Prepares the faces of one lowest node and their boxes. */
static void make_leaf(const df_mesh *mesh, df_face_tree *tree, uint32_t n) {
    df_face_node *node = &tree->levels[0][n];
    empty_node(node);
    for (uint32_t c = 0; c < 8 && n * 8 + c < tree->face_count; c++) {
        const uint32_t *f = mesh->faces + (size_t)tree->order[n * 8 + c] * 3;
        const double *corner[3];
        for (int i = 0; i < 3; i++) corner[i] = mesh->positions + (size_t)f[i] * 3;
        prepare_face(corner, &tree->faces[n * 8 + c]);
        tree->spheres[n * 8 + c] = make_sphere(tree, corner, &tree->faces[n * 8 + c]);
        for (int a = 0; a < 3; a++) {
            double low = df_smaller(corner[0][a], df_smaller(corner[1][a], corner[2][a]));
            double high = df_larger(corner[0][a], df_larger(corner[1][a], corner[2][a]));
            node->low[a][c] = nextafterf(to_tree(tree, low, a), -INFINITY);
            node->high[a][c] = nextafterf(to_tree(tree, high, a), INFINITY);
        }
    }
}

/* The boxes of the up to eight nodes below. */
static void make_node(df_face_tree *tree, uint32_t level, uint32_t n) {
    df_face_node *node = &tree->levels[level][n];
    empty_node(node);
    for (uint32_t c = 0; c < 8 && n * 8 + c < tree->node_counts[level - 1]; c++) {
        const df_face_node *below = &tree->levels[level - 1][n * 8 + c];
        for (int a = 0; a < 3; a++) {
            for (int i = 0; i < 8; i++) {
                if (below->low[a][i] < node->low[a][c]) node->low[a][c] = below->low[a][i];
                if (below->high[a][i] > node->high[a][c]) node->high[a][c] = below->high[a][i];
            }
        }
    }
}

df_status df_face_tree_make(const df_mesh *mesh, df_face_tree *tree, df_error *err) {
    *tree = (df_face_tree){.face_count = mesh->face_count};
    double low[3], high[3], extent = 0;
    df_mesh_bounds(mesh, low, high);
    for (int a = 0; a < 3; a++) {
        tree->origin[a] = (low[a] + high[a]) / 2;
        extent = df_larger(extent, high[a] - low[a]);
    }
    tree->scale = extent > 0 ? ldexp(1, -ilogb(extent)) : 1;
    tree->slack = 4e-6 * extent * tree->scale;
    df_status status = df_alloc_raw((void **)&tree->order, mesh->face_count, sizeof *tree->order, "tree of faces", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&tree->faces, mesh->face_count, sizeof *tree->faces, "tree of faces", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&tree->spheres, mesh->face_count, sizeof *tree->spheres, "tree of faces", err);
    if (status == DF_OK) status = order_faces(mesh, low, high, tree, err);
    uint32_t count = mesh->face_count;
    while (status == DF_OK && (count > 1 || tree->level_count == 0)) {
        uint32_t level = tree->level_count++;
        assert(level < DF_FACE_LEVEL_MAX);
        count = (count + 7) / 8;
        tree->node_counts[level] = count;
        status = df_alloc_raw((void **)&tree->levels[level], count, sizeof **tree->levels, "tree of faces", err);
        if (status != DF_OK) break;
#pragma omp parallel for schedule(static, 64)
        for (uint32_t n = 0; n < count; n++) {
            if (level == 0) make_leaf(mesh, tree, n);
            else make_node(tree, level, n);
        }
    }
    if (status != DF_OK) df_face_tree_free(tree);
    return status;
}

void df_face_tree_free(df_face_tree *tree) {
    free(tree->faces);
    free(tree->spheres);
    free(tree->order);
    for (int l = 0; l < DF_FACE_LEVEL_MAX; l++) free(tree->levels[l]);
    *tree = (df_face_tree){0};
}

/* Lower bounds, squared, of the distances of p (relative to the origin) to the eight boxes of a node, without the
 * slack. */
static inline void box_distances(const df_face_node *node, const float p[3], float out[8]) {
    for (int c = 0; c < 8; c++) {
        float sum = 0;
        for (int a = 0; a < 3; a++) {
            float below = node->low[a][c] - p[a], above = p[a] - node->high[a][c];
            float d = below > above ? below : above;
            d = d > 0 ? d : 0;
            sum += d * d;
        }
        out[c] = sum;
    }
}

/* How many children node n of a level has: their boxes are all that may be looked at, as an empty box is no further
 * than a limit beyond the range of float. */
static inline uint32_t child_count(const df_face_tree *tree, uint32_t level, uint32_t n) {
    const uint32_t left = (level ? tree->node_counts[level - 1] : tree->face_count) - n * 8;
    return left < 8 ? left : 8;
}

/* A search for the nearest face in progress. */
typedef struct search {
    const df_face_tree *tree;
    const double *p;
    float local[3];
    double best; /* squared distance */
    float limit; /* squared: boxes beyond cannot hold anything nearer */
    uint32_t nearest;
} search;

static void set_limit(search *s) {
    double reach = (sqrt(s->best) * s->tree->scale + s->tree->slack) * (1 + 1e-6);
    s->limit = (float)(reach * reach * (1 + 1e-6));
}

static void search_faces(search *s, uint32_t n, uint32_t count, const float bounds[8]) {
    for (uint32_t c = 0; c < count; c++) {
        if (bounds[c] > s->limit) continue;
        double d = face_distance(&s->tree->faces[n * 8 + c], s->p[0], s->p[1], s->p[2]);
        if (d >= s->best) continue;
        s->best = d;
        s->nearest = n * 8 + c;
        set_limit(s);
    }
}

static void search_node(search *s, uint32_t level, uint32_t n) {
    float bounds[8];
    const uint32_t count = child_count(s->tree, level, n);
    box_distances(&s->tree->levels[level][n], s->local, bounds);
    if (level == 0) {
        search_faces(s, n, count, bounds);
        return;
    }
    for (uint32_t tried = 0; tried < count; tried++) { /* the nearest child first */
        uint32_t next = 0;
        for (uint32_t c = 1; c < count; c++) next = bounds[c] < bounds[next] ? c : next;
        if (!(bounds[next] <= s->limit)) return;
        bounds[next] = INFINITY;
        search_node(s, level - 1, n * 8 + next);
    }
}

double df_face_tree_nearest(const df_face_tree *tree, const double p[3], uint32_t *nearest) {
    search s = {.tree = tree, .p = p, .nearest = *nearest};
    for (int a = 0; a < 3; a++) s.local[a] = to_tree(tree, p[a], a);
    s.best = face_distance(&tree->faces[s.nearest], p[0], p[1], p[2]);
    set_limit(&s);
    search_node(&s, tree->level_count - 1, 0);
    *nearest = s.nearest;
    return s.best;
}

/* A list in progress. */
typedef struct listing {
    const df_face_tree *tree;
    float local[3];
    float limit; /* squared */
    uint32_t *list;
    uint32_t count, capacity;
} listing;

static void list_node(listing *l, uint32_t level, uint32_t n) {
    float bounds[8];
    const uint32_t count = child_count(l->tree, level, n);
    box_distances(&l->tree->levels[level][n], l->local, bounds);
    for (uint32_t c = 0; c < count; c++) {
        if (!(bounds[c] <= l->limit)) continue;
        if (level > 0) {
            list_node(l, level - 1, n * 8 + c);
        } else {
            if (l->count < l->capacity) l->list[l->count] = n * 8 + c;
            l->count++;
        }
        if (l->count > l->capacity) return;
    }
}

uint32_t df_face_tree_list(const df_face_tree *tree, const double p[3], double distance, uint32_t *list,
                           uint32_t capacity) {
    listing l = {.tree = tree, .list = list, .capacity = capacity};
    for (int a = 0; a < 3; a++) l.local[a] = to_tree(tree, p[a], a);
    double reach = (distance * tree->scale + tree->slack) * (1 + 1e-6);
    l.limit = (float)(reach * reach * (1 + 1e-6));
    list_node(&l, tree->level_count - 1, 0);
    return l.count;
}

static int32_t cross_faces(const df_face_tree *tree, uint32_t face, const double p[3]) {
    const df_face *f = &tree->faces[face];
    double b[3], c[3];
    for (int a = 0; a < 3; a++) {
        b[a] = f->a[a] + f->ab[a];
        c[a] = f->a[a] + f->ac[a];
    }
    return df_winding_cross(f->a, b, c, p);
}

static int32_t cross_node(const df_face_tree *tree, uint32_t level, uint32_t n, const double p[3],
                          const float local[3]) {
    const df_face_node *node = &tree->levels[level][n];
    const uint32_t count = child_count(tree, level, n);
    float slack = (float)tree->slack;
    int32_t sum = 0;
    for (uint32_t c = 0; c < count; c++) {
        bool meets = node->low[0][c] - slack <= local[0];
        for (int a = 1; a < 3; a++)
            meets = meets && node->low[a][c] - slack <= local[a] && local[a] <= node->high[a][c] + slack;
        if (meets) sum += level ? cross_node(tree, level - 1, n * 8 + c, p, local) : cross_faces(tree, n * 8 + c, p);
    }
    return sum;
}

int32_t df_face_tree_winding(const df_face_tree *tree, const double p[3]) {
    float local[3];
    for (int a = 0; a < 3; a++) local[a] = to_tree(tree, p[a], a);
    return cross_node(tree, tree->level_count - 1, 0, p, local);
}
