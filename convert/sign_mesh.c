#include "convert/sign_mesh.h"

#include "common/memory.h"
#include "convert/isa.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define FOUR_PI 12.566370614359172

/* A forest of sets of faces, with a parity: whether a face must be flipped when its parent is not. */
typedef struct forest {
    uint32_t *parent;
    uint8_t *flip;
} forest;

/* The root of a face; *flip gets the parity against it. Paths are halved, which keeps parities right. */
static uint32_t find(forest *f, uint32_t face, uint8_t *flip) {
    uint8_t parity = 0;
    while (f->parent[face] != face) {
        uint32_t up = f->parent[face];
        f->flip[face] ^= f->parent[up] != up ? f->flip[up] : 0;
        f->parent[face] = f->parent[up];
        parity ^= f->flip[face];
        face = f->parent[face];
    }
    *flip = parity;
    return face;
}

/* Joins two faces that need (flip = 1) or need not be flipped against each other. Returns false where that contradicts
 * what is known. */
static bool join(forest *f, uint32_t a, uint32_t b, uint8_t flip) {
    uint8_t flip_a, flip_b;
    uint32_t root_a = find(f, a, &flip_a), root_b = find(f, b, &flip_b);
    if (root_a == root_b) return (flip_a ^ flip_b) == flip;
    if (root_a > root_b) {
        uint32_t swap = root_a;
        root_a = root_b;
        root_b = swap;
    }
    f->parent[root_b] =
        root_a; /* the smaller face number is the root: the result does not depend on the order of joins */
    f->flip[root_b] = flip_a ^ flip_b ^ flip;
    return true;
}

static df_status make_forest(uint32_t count, forest *f, df_error *err) {
    *f = (forest){0};
    df_status status = df_alloc_raw((void **)&f->parent, count, sizeof *f->parent, "orientation", err);
    if (status == DF_OK) status = df_alloc((void **)&f->flip, count, 1, "orientation", err);
    for (uint32_t i = 0; status == DF_OK && i < count; i++) f->parent[i] = i;
    return status;
}

static void free_forest(forest *f) {
    free(f->parent);
    free(f->flip);
}

/* A side of a face, in the bucket of its lower vertex. */
typedef struct side {
    uint32_t high, face;
    bool upward; /* runs from the lower to the higher vertex */
} side;

static int compare_sides(const void *a, const void *b) {
    const side *l = a, *r = b;
    if (l->high != r->high) return l->high < r->high ? -1 : 1;
    return l->face < r->face ? -1 : l->face > r->face;
}

static df_status list_sides(const df_mesh *mesh, uint32_t **starts, side **sides, df_error *err) {
    size_t count = (size_t)mesh->face_count * 3;
    df_status status = df_alloc((void **)starts, (uint64_t)mesh->vertex_count + 2, sizeof **starts, "orientation", err);
    if (status == DF_OK) status = df_alloc_raw((void **)sides, count, sizeof **sides, "orientation", err);
    if (status != DF_OK) return status;
    uint32_t *at = *starts + 1;
    for (int pass = 0; pass < 2; pass++) {
        for (size_t i = 0; i < count; i++) {
            uint32_t from = mesh->faces[i], to = mesh->faces[i % 3 == 2 ? i - 2 : i + 1];
            uint32_t low = from < to ? from : to, high = from < to ? to : from;
            if (pass == 0) at[low + 1]++;
            else (*sides)[at[low]++] = (side){high, (uint32_t)(i / 3), from < to};
        }
        for (uint32_t v = 0; pass == 0 && v < mesh->vertex_count; v++) at[v + 1] += at[v];
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        qsort(*sides + (*starts)[v], (*starts)[v + 1] - (*starts)[v], sizeof **sides, compare_sides);
    }
    return DF_OK;
}

/* Joins faces over edges: `patches` over edges of two faces with what it takes to agree, `components` over all. */
static void join_faces(const side *sides, uint32_t count, forest *patches, forest *components,
                       uint32_t *contradictions) {
    for (uint32_t i = 0, next; i < count; i = next) {
        for (next = i + 1; next < count && sides[next].high == sides[i].high; next++)
            join(components, sides[i].face, sides[next].face, 0);
        if (next - i != 2) continue;
        *contradictions += !join(patches, sides[i].face, sides[i + 1].face, sides[i].upward == sides[i + 1].upward);
    }
}

static void flip_face(df_mesh *mesh, uint32_t face) {
    uint32_t *f = mesh->faces + (size_t)face * 3, swap = f[1];
    f[1] = f[2];
    f[2] = swap;
}

/* Flips the faces of each patch that are the minority in it. */
static df_status flip_minorities(df_sign_mesh *sign, forest *patches, df_error *err) {
    uint32_t count = sign->mesh.face_count, *sums;
    df_status status = df_alloc((void **)&sums, 2 * (uint64_t)count, sizeof *sums, "orientation", err);
    if (status != DF_OK) return status;
    uint8_t flip;
    for (uint32_t f = 0; f < count; f++) {
        uint32_t root = find(patches, f, &flip);
        sums[2 * root + flip]++;
    }
    for (uint32_t f = 0; f < count; f++) {
        uint32_t root = find(patches, f, &flip);
        if ((sums[2 * root] < sums[2 * root + 1]) == flip) continue;
        flip_face(&sign->mesh, f);
        sign->flipped_faces++;
    }
    free(sums);
    return DF_OK;
}

/* The solid angle of a face seen from p, over 4 pi (van Oosterom, Strackee 1983). */
static double solid_angle(const df_mesh *mesh, uint32_t face, const double p[3]) {
    double v[3][3], length[3], d[3];
    for (int c = 0; c < 3; c++) {
        const double *q = mesh->positions + (size_t)mesh->faces[(size_t)face * 3 + (size_t)c] * 3;
        for (int a = 0; a < 3; a++) v[c][a] = q[a] - p[a];
        length[c] = sqrt(v[c][0] * v[c][0] + v[c][1] * v[c][1] + v[c][2] * v[c][2]);
    }
    for (int c = 0; c < 3; c++) {
        const double *a = v[c], *b = v[(c + 1) % 3];
        d[c] = (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) * length[(c + 2) % 3];
    }
    double det = v[0][0] * (v[1][1] * v[2][2] - v[1][2] * v[2][1]) + v[0][1] * (v[1][2] * v[2][0] - v[1][0] * v[2][2]) +
                 v[0][2] * (v[1][0] * v[2][1] - v[1][1] * v[2][0]);
    return 2 * atan2(det, length[0] * length[1] * length[2] + d[0] + d[1] + d[2]) / FOUR_PI;
}

/* A piece of the mesh connected by edges. */
typedef struct component {
    double volume; /* signed, times 6 */
    bool closed;
    bool turned;
    uint32_t face; /* one of its faces */
} component;

/* The winding number at p of the faces whose component equals (or, with others = true, does not equal) c. */
static double winding_of(const df_mesh *mesh, const uint32_t *component_of, uint32_t c, bool others,
                         const double p[3]) {
    double sum = 0;
#pragma omp parallel for schedule(static) reduction(+ : sum)
    for (uint32_t f = 0; f < mesh->face_count; f++) {
        if ((component_of[f] != c) == others) sum += solid_angle(mesh, f, p);
    }
    return sum;
}

/* Turns closed components with a negative volume that lie in no other, together with those inside them. Bodies beyond
 * the first INVERTED_MAX are left as they are: the search looks at every face for each. */
#define INVERTED_MAX 200
static void turn_inverted(df_sign_mesh *sign, const uint32_t *component_of, component *components) {
    df_mesh *mesh = &sign->mesh;
    uint32_t looked = 0;
    for (uint32_t c = 0; c < sign->component_count && looked < INVERTED_MAX; c++) {
        if (!components[c].closed || components[c].volume >= 0) continue;
        looked++;
        const double *p = mesh->positions + (size_t)mesh->faces[(size_t)components[c].face * 3] * 3;
        if (fabs(winding_of(mesh, component_of, c, true, p)) > 0.5) {
            sign->cavities++;
            continue;
        }
        for (uint32_t inner = 0; inner < sign->component_count; inner++) {
            const double *q = mesh->positions + (size_t)mesh->faces[(size_t)components[inner].face * 3] * 3;
            if (inner == c || fabs(winding_of(mesh, component_of, c, false, q)) > 0.5) components[inner].turned = true;
        }
    }
    for (uint32_t c = 0; c < sign->component_count; c++) sign->inverted_components += components[c].turned;
    for (uint32_t f = 0; f < mesh->face_count; f++) {
        if (components[component_of[f]].turned) flip_face(mesh, f);
    }
}

/* Numbers the components and measures their volumes about the mesh's first vertex. */
static df_status measure_components(df_sign_mesh *sign, forest *joined, const df_mesh_edges *edges, df_error *err) {
    const df_mesh *mesh = &sign->mesh;
    uint32_t *component_of = NULL, *of_vertex = NULL;
    component *components = NULL;
    df_status status = df_alloc_raw((void **)&component_of, mesh->face_count, sizeof *component_of, "orientation", err);
    if (status == DF_OK)
        status = df_alloc((void **)&components, mesh->face_count, sizeof *components, "orientation", err);
    if (status == DF_OK)
        status = df_alloc((void **)&of_vertex, mesh->vertex_count, sizeof *of_vertex, "orientation", err);
    if (status != DF_OK) goto done;
    const double *o = mesh->positions;
    bool any_negative = false;
    for (uint32_t f = 0; f < mesh->face_count; f++) {
        uint8_t flip;
        uint32_t root = find(joined, f, &flip);
        if (root == f) {
            components[sign->component_count] = (component){.closed = true, .face = f};
            component_of[f] = sign->component_count++;
        }
        component *c = &components[component_of[f] = component_of[root]];
        double v[3][3];
        for (int i = 0; i < 3; i++) {
            uint32_t vertex = mesh->faces[(size_t)f * 3 + (size_t)i];
            of_vertex[vertex] = component_of[f];
            for (int a = 0; a < 3; a++) v[i][a] = mesh->positions[(size_t)vertex * 3 + (size_t)a] - o[a];
        }
        c->volume += v[0][0] * (v[1][1] * v[2][2] - v[1][2] * v[2][1]) +
                     v[0][1] * (v[1][2] * v[2][0] - v[1][0] * v[2][2]) +
                     v[0][2] * (v[1][0] * v[2][1] - v[1][1] * v[2][0]);
    }
    for (uint32_t i = 0; i < edges->border_count; i++) components[of_vertex[edges->borders[i].from]].closed = false;
    for (uint32_t c = 0; c < sign->component_count; c++)
        any_negative = any_negative || (components[c].closed && components[c].volume < 0);
    if (any_negative) turn_inverted(sign, component_of, components);
done:
    free(component_of);
    free(components);
    free(of_vertex);
    return status;
}

static df_status copy_mesh(const df_mesh *from, df_mesh *to, df_error *err) {
    *to = (df_mesh){.vertex_count = from->vertex_count, .face_count = from->face_count};
    df_status status =
        df_alloc_raw((void **)&to->positions, from->vertex_count, 3 * sizeof *to->positions, "orientation", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&to->faces, from->face_count, 3 * sizeof *to->faces, "orientation", err);
    if (status != DF_OK) return status;
    memcpy(to->positions, from->positions, (size_t)from->vertex_count * 3 * sizeof *to->positions);
    memcpy(to->faces, from->faces, (size_t)from->face_count * 3 * sizeof *to->faces);
    return DF_OK;
}

/* Makes all faces agree as far as they can. */
static df_status orient(df_sign_mesh *sign, df_mesh_edges *edges, df_error *err) {
    uint32_t *starts = NULL, contradictions = 0;
    side *sides = NULL;
    forest patches = {0}, joined = {0};
    df_status status = list_sides(&sign->mesh, &starts, &sides, err);
    if (status == DF_OK) status = make_forest(sign->mesh.face_count, &patches, err);
    if (status == DF_OK) status = make_forest(sign->mesh.face_count, &joined, err);
    if (status != DF_OK) goto done;
    for (uint32_t v = 0; v < sign->mesh.vertex_count; v++) {
        join_faces(sides + starts[v], starts[v + 1] - starts[v], &patches, &joined, &contradictions);
    }
    sign->unorientable_edges = contradictions;
    if (edges->misoriented) {
        status = flip_minorities(sign, &patches, err);
        free(edges->borders);
        if (status == DF_OK) status = df_mesh_find_edges(&sign->mesh, edges, err);
        else edges->borders = NULL;
    }
    if (status == DF_OK) status = measure_components(sign, &joined, edges, err);
done:
    free(starts);
    free(sides);
    free_forest(&patches);
    free_forest(&joined);
    return status;
}

/* Sorts border edges by the piece they belong to; piece_of[i] is the smallest edge number of i's piece. */
static df_status find_pieces(const df_mesh *mesh, const df_mesh_edges *edges, forest *pieces, df_error *err) {
    uint32_t *of_vertex;
    df_status status = make_forest(edges->border_count, pieces, err);
    if (status != DF_OK) return status;
    status = df_alloc((void **)&of_vertex, mesh->vertex_count, sizeof *of_vertex, "border", err);
    if (status != DF_OK) return status;
    for (uint32_t i = 0; i < edges->border_count; i++) {
        const uint32_t ends[2] = {edges->borders[i].from, edges->borders[i].to};
        for (int e = 0; e < 2; e++) {
            if (of_vertex[ends[e]]) join(pieces, i, of_vertex[ends[e]] - 1, 0);
            else of_vertex[ends[e]] = i + 1;
        }
    }
    free(of_vertex);
    return DF_OK;
}

/* Centres of the pieces, and room in the mesh for their fans. */
static df_status place_caps(df_sign_mesh *sign, const df_mesh_edges *edges, forest *pieces, uint32_t *cap_of,
                            df_error *err) {
    df_mesh *mesh = &sign->mesh;
    uint64_t fan_faces = 0;
    uint8_t flip;
    for (uint32_t i = 0; i < edges->border_count; i++) {
        uint32_t root = find(pieces, i, &flip);
        if (root == i) cap_of[i] = sign->cap_count++;
        df_cap *cap = &sign->caps[cap_of[i] = cap_of[root]];
        for (int a = 0; a < 3; a++) {
            cap->centre[a] += (mesh->positions[(size_t)edges->borders[i].from * 3 + (size_t)a] +
                               mesh->positions[(size_t)edges->borders[i].to * 3 + (size_t)a]) /
                              2;
        }
        cap->edge_count++;
        cap->face_count += edges->borders[i].count;
        fan_faces += edges->borders[i].count;
    }
    double *positions =
        realloc(mesh->positions, ((size_t)mesh->vertex_count + sign->cap_count) * 3 * sizeof *positions);
    if (positions) mesh->positions = positions;
    uint32_t *faces = realloc(mesh->faces, (mesh->face_count + fan_faces) * 3 * sizeof *faces);
    if (faces) mesh->faces = faces;
    if (!positions || !faces) return df_fail(err, DF_ERROR_MEMORY, "border: out of memory");
    uint32_t at = mesh->face_count;
    for (uint32_t c = 0; c < sign->cap_count; c++) {
        df_cap *cap = &sign->caps[c];
        for (int a = 0; a < 3; a++)
            mesh->positions[((size_t)mesh->vertex_count + c) * 3 + (size_t)a] = cap->centre[a] /= cap->edge_count;
        cap->first_face = at;
        at += cap->face_count;
        cap->face_count = 0;
    }
    return DF_OK;
}

static double fan_area(const double *p, const double *q, const double *r) {
    double u[3], v[3], n[3];
    for (int a = 0; a < 3; a++) u[a] = q[a] - p[a], v[a] = r[a] - p[a];
    for (int a = 0; a < 3; a++) n[a] = u[(a + 1) % 3] * v[(a + 2) % 3] - u[(a + 2) % 3] * v[(a + 1) % 3];
    return sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
}

/* Closes every border edge with a triangle to the centre of its piece. */
static df_status add_caps(df_sign_mesh *sign, const df_mesh_edges *edges, df_error *err) {
    forest pieces = {0};
    uint32_t *cap_of = NULL;
    df_mesh *mesh = &sign->mesh;
    df_status status = find_pieces(mesh, edges, &pieces, err);
    if (status == DF_OK)
        status = df_alloc((void **)&sign->caps, edges->border_count, sizeof *sign->caps, "border", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&cap_of, edges->border_count, sizeof *cap_of, "border", err);
    if (status == DF_OK) status = place_caps(sign, edges, &pieces, cap_of, err);
    if (status != DF_OK) goto done;
    for (uint32_t i = 0; i < edges->border_count; i++) {
        const df_mesh_border *b = &edges->borders[i];
        df_cap *cap = &sign->caps[cap_of[i]];
        const double *from = mesh->positions + (size_t)b->from * 3, *to = mesh->positions + (size_t)b->to * 3;
        double u[3] = {from[0] - cap->centre[0], from[1] - cap->centre[1], from[2] - cap->centre[2]};
        cap->radius = fmax(cap->radius, sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]));
        cap->area += b->count * fan_area(cap->centre, from, to);
        for (uint32_t n = 0; n < b->count; n++) {
            uint32_t *face = mesh->faces + (size_t)(cap->first_face + cap->face_count++) * 3;
            face[0] = b->to, face[1] = b->from, face[2] = mesh->vertex_count + cap_of[i];
        }
        sign->border_edges++;
    }
    for (uint32_t c = 0; c < sign->cap_count; c++) mesh->face_count += sign->caps[c].face_count;
    mesh->vertex_count += sign->cap_count;
done:
    free_forest(&pieces);
    free(cap_of);
    return status;
}

df_status df_sign_mesh_make(const df_mesh *mesh, df_sign_mesh *sign, df_error *err) {
    *sign = (df_sign_mesh){0};
    df_mesh_edges edges = {0};
    df_status status = copy_mesh(mesh, &sign->mesh, err);
    if (status == DF_OK) status = df_mesh_find_edges(mesh, &edges, err);
    if (status == DF_OK) status = orient(sign, &edges, err);
    sign->real_face_count = sign->mesh.face_count;
    if (status == DF_OK && sign->inverted_components) { /* what was turned has its borders the other way round */
        free(edges.borders);
        status = df_mesh_find_edges(&sign->mesh, &edges, err);
    }
    if (status == DF_OK && edges.border_count) status = add_caps(sign, &edges, err);
    free(edges.borders);
    if (status != DF_OK) df_sign_mesh_free(sign);
    return status;
}

void df_sign_mesh_free(df_sign_mesh *sign) {
    df_mesh_free(&sign->mesh);
    free(sign->caps);
    *sign = (df_sign_mesh){0};
}

/* The half solid angles are the arguments of complex numbers (van Oosterom, Strackee), which are multiplied up; `turns`
 * counts where the product's argument passes from pi to -pi, so that only one arc tangent a point is left at the end.
 */
DF_FOR_EACH_ISA
void df_sign_mesh_corrections(const df_sign_mesh *sign, const uint32_t *active, uint32_t active_count,
                              const double points[3][8], double out[8]) {
    double re[8], im[8], turns[8];
    for (int p = 0; p < 8; p++) re[p] = 1, im[p] = 0, turns[p] = 0;
    for (uint32_t i = 0; i < active_count; i++) {
        const df_cap *cap = &sign->caps[active[i]];
        for (uint32_t f = cap->first_face; f < cap->first_face + cap->face_count; f++) {
            const uint32_t *face = sign->mesh.faces + (size_t)f * 3;
            const double *a = sign->mesh.positions + (size_t)face[0] * 3,
                         *b = sign->mesh.positions + (size_t)face[1] * 3,
                         *c = sign->mesh.positions + (size_t)face[2] * 3;
            const double a0 = a[0], a1 = a[1], a2 = a[2], b0 = b[0], b1 = b[1], b2 = b[2], c0 = c[0], c1 = c[1],
                         c2 = c[2];
#pragma omp simd
            for (int p = 0; p < 8; p++) {
                double x = points[0][p], y = points[1][p], z = points[2][p];
                double ux = a0 - x, uy = a1 - y, uz = a2 - z, vx = b0 - x, vy = b1 - y, vz = b2 - z;
                double wx = c0 - x, wy = c1 - y, wz = c2 - z;
                double u = sqrt(ux * ux + uy * uy + uz * uz), v = sqrt(vx * vx + vy * vy + vz * vz),
                       w = sqrt(wx * wx + wy * wy + wz * wz);
                double det = ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx);
                double den = u * v * w + (ux * vx + uy * vy + uz * vz) * w + (vx * wx + vy * wy + vz * wz) * u +
                             (wx * ux + wy * uy + wz * uz) * v;
                double size = 1 / (fabs(det) + fabs(den) + 1e-300);
                det *= size;
                den *= size;
                double r = re[p] * den - im[p] * det, m = re[p] * det + im[p] * den,
                       norm = 1 / (fabs(r) + fabs(m) + 1e-300);
                double was_upper = im[p] >= 0 ? 1.0 : 0.0, is_upper = m >= 0 ? 1.0 : 0.0;
                double turn_up = det > 0 ? 1.0 : 0.0, turn_down = det < 0 ? 1.0 : 0.0;
                turns[p] += was_upper * (1 - is_upper) * turn_up - (1 - was_upper) * is_upper * turn_down;
                re[p] = r * norm;
                im[p] = m * norm;
            }
        }
    }
    for (int p = 0; p < 8; p++) out[p] = atan2(im[p], re[p]) / 6.283185307179586 + turns[p];
}

/* At distance d from its ball a fan covers at most area / d^2 of the 4 pi around a point. */
uint32_t df_sign_mesh_near(const df_sign_mesh *sign, const double p[3], double radius, uint32_t *active) {
    uint32_t count = 0;
    double rest = 0;
    for (uint32_t c = 0; c < sign->cap_count; c++) {
        const df_cap *cap = &sign->caps[c];
        double u[3] = {p[0] - cap->centre[0], p[1] - cap->centre[1], p[2] - cap->centre[2]};
        double d = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]) - radius - cap->radius;
        double share = d > 0 ? cap->area / (d * d * FOUR_PI) : 1;
        if (share > 0.0001 || rest + share > 0.001) active[count++] = c;
        else rest += share;
    }
    return count;
}
