#include "render/mesh/mc_cell.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

void df_mc_edge_corners(uint32_t edge, uint32_t corners[2]) {
    assert(edge < DF_MC_EDGE_COUNT);
    uint32_t axis = edge / 4, low = axis == 0 ? 1 : 0, high = axis == 2 ? 1 : 2;
    corners[0] = (edge & 1) << low | (edge >> 1 & 1) << high;
    corners[1] = corners[0] | 1u << axis;
}

static uint32_t edge_between(uint32_t a, uint32_t b) {
    uint32_t axis = (uint32_t)__builtin_ctz(a ^ b), low = axis == 0 ? 1 : 0, high = axis == 2 ? 1 : 2;
    return 4 * axis + (a >> low & 1) + 2 * (a >> high & 1);
}

void df_mc_face(uint32_t face, uint32_t corners[4], uint32_t edges[4]) {
    assert(face < 6);
    uint32_t axis = face / 2, upper = face & 1, u = 1u << (axis + 1) % 3, v = 1u << (axis + 2) % 3,
             base = upper << axis;
    corners[0] = base;
    corners[1] = base | (upper ? u : v);
    corners[2] = base | u | v;
    corners[3] = base | (upper ? v : u);
    for (uint32_t i = 0; i < 4; i++) edges[i] = edge_between(corners[i], corners[(i + 1) % 4]);
}

static bool edges_share_face(uint32_t a, uint32_t b) {
    uint32_t ca[2], cb[2];
    df_mc_edge_corners(a, ca);
    df_mc_edge_corners(b, cb);
    /* Bits that all four corners have in common, set or clear. */
    return ((ca[0] & ca[1] & cb[0] & cb[1]) | (~(ca[0] | ca[1] | cb[0] | cb[1]) & 7)) != 0;
}

/* Joins the crossings of one face: next[edge] follows edge in its loop. Walking around the face counter-clockwise,
 * segments run from where the walk enters the inside to where it leaves it. */
static void join_face(uint32_t face, uint32_t inside, bool joins, int8_t next[DF_MC_EDGE_COUNT]) {
    uint32_t corners[4], edges[4], in[4];
    df_mc_face(face, corners, edges);
    for (uint32_t i = 0; i < 4; i++) in[i] = inside >> corners[i] & 1;
    for (uint32_t i = 0; i < 4; i++) {
        if (in[i] || !in[(i + 1) % 4]) continue;
        uint32_t end = (i + 1) % 4; /* edges[i] enters; the first leaving edge after it cuts off the corners between */
        if (joins) end = (i + 3) % 4; /* the segment cuts off the outside corner i instead */
        else
            while (in[(end + 1) % 4]) end = (end + 1) % 4;
        next[edges[i]] = (int8_t)edges[end];
    }
}

static bool face_is_ambiguous(uint32_t face, uint32_t inside, uint32_t corners[4]) {
    uint32_t edges[4];
    df_mc_face(face, corners, edges);
    uint32_t bits = 0;
    for (uint32_t i = 0; i < 4; i++) bits |= (inside >> corners[i] & 1) << i;
    if (bits == 10) { /* turn it so that corners[0] is inside */
        uint32_t first = corners[0];
        memmove(corners, corners + 1, 3 * sizeof *corners);
        corners[3] = first;
    }
    return bits == 5 || bits == 10;
}

/* Loops of edges, one after the other; ends[l] is the end of loop l. Returns their number. */
static uint32_t trace_loops(const int8_t next[DF_MC_EDGE_COUNT], uint32_t loops[DF_MC_EDGE_COUNT], uint32_t ends[4]) {
    uint32_t seen = 0, size = 0, count = 0;
    for (uint32_t first = 0; first < DF_MC_EDGE_COUNT; first++) {
        if (next[first] < 0 || seen >> first & 1) continue;
        for (uint32_t e = first; !(seen >> e & 1); e = (uint32_t)next[e]) {
            seen |= 1u << e;
            loops[size++] = e;
        }
        assert(count < 4);
        ends[count++] = size;
    }
    return count;
}

/* The squared length of a diagonal between the middles of two edges; infinite when it lies in a face. */
static double diagonal_cost(uint32_t a, uint32_t b) {
    if (edges_share_face(a, b)) return INFINITY;
    double sum = 0;
    uint32_t ca[2], cb[2];
    df_mc_edge_corners(a, ca);
    df_mc_edge_corners(b, cb);
    for (int axis = 0; axis < 3; axis++) {
        double d =
            0.5 * ((ca[0] >> axis & 1) + (ca[1] >> axis & 1)) - 0.5 * ((cb[0] >> axis & 1) + (cb[1] >> axis & 1));
        sum += d * d;
    }
    return sum;
}

static uint32_t cut_polygon(const uint32_t *loop, uint8_t split[DF_MC_EDGE_COUNT][DF_MC_EDGE_COUNT], uint32_t from,
                            uint32_t to, uint8_t (*triangles)[3]) {
    if (to - from < 2) return 0;
    uint32_t middle = split[from][to];
    uint32_t count = cut_polygon(loop, split, from, middle, triangles);
    triangles[count][0] = (uint8_t)loop[from];
    triangles[count][1] = (uint8_t)loop[middle];
    triangles[count][2] = (uint8_t)loop[to];
    return count + 1 + cut_polygon(loop, split, middle, to, triangles + count + 1);
}

/* Cuts a loop into triangles with the shortest diagonals, none in a face, by dynamic programming over sub-polygons.
 * Returns their number, 0 when there is no such cut. */
static uint32_t loop_triangles(const uint32_t *loop, uint32_t size, uint8_t (*triangles)[3]) {
    double cost[DF_MC_EDGE_COUNT][DF_MC_EDGE_COUNT] = {{0}};
    uint8_t split[DF_MC_EDGE_COUNT][DF_MC_EDGE_COUNT];
    assert(size >= 3 && size <= DF_MC_EDGE_COUNT);
    for (uint32_t span = 1; span < size; span++) {
        for (uint32_t from = 0; from + span < size; from++) {
            uint32_t to = from + span;
            cost[from][to] = span == 1 ? 0 : (double)INFINITY;
            split[from][to] = (uint8_t)(from + 1);
            for (uint32_t middle = from + 1; middle < to; middle++) {
                double sum = cost[from][middle] + cost[middle][to];
                if (sum < cost[from][to]) {
                    cost[from][to] = sum;
                    split[from][to] = (uint8_t)middle;
                }
            }
            bool diagonal = span > 1 && span + 1 < size;
            if (diagonal) cost[from][to] += diagonal_cost(loop[from], loop[to]);
        }
    }
    if (!isfinite(cost[0][size - 1])) return 0;
    return cut_polygon(loop, split, 0, size - 1, triangles);
}

void df_mc_tables_make(df_mc_tables *tables, bool correct) {
    memset(tables, 0, sizeof *tables);
    for (uint32_t inside = 1; inside < 255; inside++) {
        int8_t next[DF_MC_EDGE_COUNT];
        uint32_t loops[DF_MC_EDGE_COUNT], ends[4], corners[4], first = 0, count = 0;
        memset(next, -1, sizeof next);
        bool ambiguous = false;
        for (uint32_t face = 0; face < 6; face++) {
            ambiguous = ambiguous || face_is_ambiguous(face, inside, corners);
            join_face(face, inside, false, next);
        }
        uint32_t loop_count = trace_loops(next, loops, ends);
        if (correct && (ambiguous || loop_count > 1)) {
            tables->triangle_count[inside] = DF_MC_BY_VALUES;
            continue;
        }
        for (uint32_t l = 0; l < loop_count; l++) {
            uint32_t made = loop_triangles(loops + first, ends[l] - first, tables->triangles[inside] + count);
            assert(made); /* separated inside corners leave no loop that meets a face twice */
            count += made;
            first = ends[l];
        }
        assert(count <= DF_MC_TABLE_MAX);
        tables->triangle_count[inside] = (uint8_t)count;
    }
}

void df_mc_patch_free(df_mc_patch *patch) {
    free(patch->positions);
    free(patch->loops);
    free(patch->loop_ends);
    free(patch->triangles);
    memset(patch, 0, sizeof *patch);
}

static df_status reserve(void **array, uint32_t *capacity, uint32_t count, size_t size, df_error *err) {
    if (count <= *capacity) return DF_OK;
    uint32_t wanted = count < 64 ? 64 : 2 * count;
    void *grown = realloc(*array, wanted * size);
    if (!grown) return df_fail(err, DF_ERROR_MEMORY, "no memory for a cell's surface of %u vertices", count);
    *array = grown;
    *capacity = wanted;
    return DF_OK;
}

df_status df_mc_patch_begin(df_mc_patch *patch, uint32_t boundary_count, df_error *err) {
    /* Loops partition the boundary vertices and have 3 at least; a tunnel adds 6 points and 12 triangles, a centre one
     * point and 2 triangles. */
    uint32_t loop_max = boundary_count / 3 + 1;
    df_status status = reserve((void **)&patch->positions, &patch->position_capacity, boundary_count + loop_max + 6,
                               sizeof *patch->positions, err);
    if (status == DF_OK)
        status = reserve((void **)&patch->loops, &patch->loop_capacity, boundary_count, sizeof *patch->loops, err);
    if (status == DF_OK)
        status =
            reserve((void **)&patch->loop_ends, &patch->loop_end_capacity, loop_max, sizeof *patch->loop_ends, err);
    if (status == DF_OK)
        status = reserve((void **)&patch->triangles, &patch->triangle_capacity, boundary_count + 12,
                         sizeof *patch->triangles, err);
    patch->boundary_count = patch->position_count = boundary_count;
    patch->loop_size = patch->loop_count = patch->triangle_count = 0;
    return status;
}

static void add_triangle(df_mc_patch *patch, uint32_t a, uint32_t b, uint32_t c) {
    assert(patch->triangle_count < patch->triangle_capacity);
    uint32_t *t = patch->triangles[patch->triangle_count++];
    t[0] = a;
    t[1] = b;
    t[2] = c;
}

static double trilinear(const double v[8], const double p[3], double gradient[3]) {
    double x = p[0], y = p[1], z = p[2];
    double x00 = (1 - x) * v[0] + x * v[1], x10 = (1 - x) * v[2] + x * v[3];
    double x01 = (1 - x) * v[4] + x * v[5], x11 = (1 - x) * v[6] + x * v[7];
    double y0 = (1 - y) * x00 + y * x10, y1 = (1 - y) * x01 + y * x11;
    gradient[0] =
        (1 - z) * ((1 - y) * (v[1] - v[0]) + y * (v[3] - v[2])) + z * ((1 - y) * (v[5] - v[4]) + y * (v[7] - v[6]));
    gradient[1] = (1 - z) * (x10 - x00) + z * (x11 - x01);
    gradient[2] = y1 - y0;
    return (1 - z) * y0 + z * y1;
}

/* Moves a point onto the surface when Newton's method along the gradient gets there within the open cell. */
static void pull_to_surface(const double values[8], double point[3]) {
    double p[3] = {point[0], point[1], point[2]}, g[3], scale = 0;
    for (int c = 0; c < 8; c++) scale = fmax(scale, fabs(values[c]));
    for (int i = 0; i < 10; i++) {
        double f = trilinear(values, p, g), square = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
        if (fabs(f) <= 1e-12 * scale) {
            memcpy(point, p, sizeof p);
            return;
        }
        for (int a = 0; a < 3; a++) {
            p[a] -= f * g[a] / square;
            if (!(p[a] > 0.01 && p[a] < 0.99)) return; /* also when square is 0 */
        }
    }
}

/* A fan around a new vertex. */
static void fill_loop(df_mc_patch *patch, const double values[8], const uint32_t *loop, uint32_t size) {
    uint32_t centre = patch->position_count++;
    assert(centre < patch->position_capacity);
    double *point = patch->positions[centre];
    for (int a = 0; a < 3; a++) {
        point[a] = 0;
        for (uint32_t i = 0; i < size; i++) point[a] += patch->positions[loop[i]][a];
        point[a] /= size;
    }
    pull_to_surface(values, point);
    for (uint32_t i = 0; i < size; i++) add_triangle(patch, loop[i], loop[(i + 1) % size], centre);
}

/* The two positions on `axis`, ascending, where slices across it have their saddle on the surface. False unless both
 * lie in (0,1) and the slices between them have proper saddles. saddle: where the first slice has it, on the two next
 * axes. */
static bool slice_roots(const double v[8], uint32_t axis, double roots[2], double saddle[2]) {
    uint32_t n = 1u << axis, u = 1u << (axis + 1) % 3, w = 1u << (axis + 2) % 3;
    /* Corner values of the slice at z: low + z * rise. */
    double a0 = v[0], a1 = v[n] - v[0], b0 = v[u], b1 = v[u | n] - v[u];
    double c0 = v[w], c1 = v[w | n] - v[w], d0 = v[u | w], d1 = v[u | w | n] - v[u | w];
    /* Saddle on the surface: a d - b c = 0. */
    double q2 = a1 * d1 - b1 * c1, q1 = a0 * d1 + a1 * d0 - b0 * c1 - b1 * c0, q0 = a0 * d0 - b0 * c0;
    double discriminant = q1 * q1 - 4 * q2 * q0;
    if (!(discriminant > 0) || q2 == 0) return false;
    double half = -0.5 * (q1 + copysign(sqrt(discriminant), q1));
    if (half == 0) return false;
    roots[0] = fmin(half / q2, q0 / half);
    roots[1] = fmax(half / q2, q0 / half);
    if (!(roots[0] > 0 && roots[1] < 1 && roots[0] < roots[1])) return false;
    double bilinear[2];
    for (int i = 0; i < 2; i++) {
        double z = roots[i];
        bilinear[i] = (a0 + z * a1) + (d0 + z * d1) - (b0 + z * b1) - (c0 + z * c1);
    }
    if (!(bilinear[0] * bilinear[1] > 0)) return false;
    saddle[0] = -((c0 + roots[0] * c1) - (a0 + roots[0] * a1)) / bilinear[0];
    saddle[1] = -((b0 + roots[0] * b1) - (a0 + roots[0] * a1)) / bilinear[0];
    return true;
}

/* The hexagon of lines parallel to the axes in the surface: its corners in order. False when it is no waist within the
 * cell. */
static bool find_waist(const double values[8], double hexagon[6][3]) {
    double roots[3][2], saddle[3][2];
    for (uint32_t axis = 0; axis < 3; axis++) {
        if (!slice_roots(values, axis, roots[axis], saddle[axis])) return false;
    }
    /* The saddle of a slice at one root lies at the other roots of the remaining axes, in an order that the first slice
     * across z tells: s[axis] are the roots so that the corners are those triples that mix 0 and 1. */
    double s[3][2] = {{0}};
    s[2][0] = roots[2][0];
    s[2][1] = roots[2][1];
    for (uint32_t axis = 0; axis < 2; axis++) {
        bool upper = fabs(saddle[2][axis] - roots[axis][1]) < fabs(saddle[2][axis] - roots[axis][0]);
        s[axis][1] = roots[axis][upper];
        s[axis][0] = roots[axis][!upper];
    }
    static const uint8_t order[6][3] = {{1, 1, 0}, {1, 0, 0}, {1, 0, 1}, {0, 0, 1}, {0, 1, 1}, {0, 1, 0}};
    for (int i = 0; i < 6; i++) {
        for (int a = 0; a < 3; a++) hexagon[i][a] = s[a][order[i][a]];
    }
    return true;
}

static double distance2(const double a[3], const double b[3]) {
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
}

/* A ring of triangles between a loop and the six vertices from `waist` on, taken forwards or backwards: starts at the
 * closest pair and takes the shorter diagonal. Returns the diagonals' total; adds the triangles when `add` is set. */
static double join_ring(df_mc_patch *patch, const uint32_t *loop, uint32_t size, uint32_t waist, bool backwards,
                        bool add) {
    uint32_t i0 = 0, j0 = 0;
    assert(size > 0);
    for (uint32_t i = 0; i < size; i++) {
        for (uint32_t j = 0; j < 6; j++) {
            if (distance2(patch->positions[loop[i]], patch->positions[waist + j]) <
                distance2(patch->positions[loop[i0]], patch->positions[waist + j0])) {
                i0 = i;
                j0 = j;
            }
        }
    }
    /* No vertex is joined to the whole of the other side: the first diagonal would come twice. */
    uint32_t i_at_start = 0, j_at_start = 0;
    double total = 0;
    for (uint32_t i = 0, j = 0; i < size || j < 6;) {
        uint32_t a = loop[(i0 + i) % size], a_next = loop[(i0 + i + 1) % size];
        uint32_t b = waist + (j0 + (backwards ? 6 - j : j)) % 6,
                 b_next = waist + (j0 + (backwards ? 5 - j % 6 : j + 1)) % 6;
        double on_loop = i < size ? distance2(patch->positions[a_next], patch->positions[b]) : (double)INFINITY;
        double on_waist = j < 6 ? distance2(patch->positions[a], patch->positions[b_next]) : (double)INFINITY;
        if (j == 0) i_at_start = i;
        if (i == 0) j_at_start = j;
        bool may_loop = i < size && !(i + 1 == size && j == j_at_start),
             may_waist = j < 6 && !(j == 5 && i == i_at_start);
        bool along_loop = may_loop && (!may_waist || on_loop <= on_waist);
        assert(may_loop || may_waist);
        total += along_loop ? on_loop : on_waist;
        if (along_loop) {
            if (add) add_triangle(patch, a, a_next, b);
            i++;
        } else {
            if (add) add_triangle(patch, a, b_next, b);
            j++;
        }
    }
    return total;
}

/* The loop that the waist does not join: with three, the one whose middle is farthest from it. */
static uint32_t loop_apart(const df_mc_patch *patch, const double middle[3]) {
    uint32_t apart = patch->loop_count;
    double farthest = -1;
    for (uint32_t l = 0, first = 0; l < patch->loop_count && patch->loop_count > 2; first = patch->loop_ends[l++]) {
        double mean[3] = {0};
        for (uint32_t i = first; i < patch->loop_ends[l]; i++) {
            for (int a = 0; a < 3; a++) mean[a] += patch->positions[patch->loops[i]][a] / (patch->loop_ends[l] - first);
        }
        if (distance2(mean, middle) > farthest) {
            farthest = distance2(mean, middle);
            apart = l;
        }
    }
    return apart;
}

/* Joins two loops through a waist; sets bit l of *filled for each. */
static void fill_tunnel(df_mc_patch *patch, double hexagon[6][3], uint32_t *filled) {
    double middle[3] = {0};
    uint32_t waist = patch->position_count, pair[2], count = 0;
    assert(waist + 6 <= patch->position_capacity);
    memcpy(patch->positions + waist, hexagon, 6 * sizeof *hexagon);
    patch->position_count += 6;
    for (int i = 0; i < 18; i++) middle[i % 3] += hexagon[i / 3][i % 3] / 6;
    uint32_t apart = loop_apart(patch, middle);
    for (uint32_t l = 0; l < patch->loop_count; l++) {
        if (l == apart) continue;
        *filled |= 1u << l;
        pair[count++] = l;
    }
    const uint32_t *loop[2];
    uint32_t size[2];
    for (int i = 0; i < 2; i++) {
        uint32_t first = pair[i] ? patch->loop_ends[pair[i] - 1] : 0;
        loop[i] = patch->loops + first;
        size[i] = patch->loop_ends[pair[i]] - first;
    }
    double cost[2];
    for (int i = 0; i < 2; i++) {
        cost[i] = join_ring(patch, loop[0], size[0], waist, i == 1, false) +
                  join_ring(patch, loop[1], size[1], waist, i == 0, false);
    }
    bool backwards = cost[1] < cost[0];
    join_ring(patch, loop[0], size[0], waist, backwards, true);
    join_ring(patch, loop[1], size[1], waist, !backwards, true);
}

/* Fills the loops; those of a plain cell are cut without a new vertex where possible. */
static void fill_patch(df_mc_patch *patch, const double values[8], bool plain) {
    double hexagon[6][3];
    uint32_t filled = 0, first = 0;
    /* Rounding in the samples of an octree can leave one loop where the corners ask for two; more than three cannot
     * meet a waist. */
    if ((patch->loop_count == 2 || patch->loop_count == 3) && find_waist(values, hexagon))
        fill_tunnel(patch, hexagon, &filled);
    for (uint32_t l = 0; l < patch->loop_count; first = patch->loop_ends[l++]) {
        const uint32_t *loop = patch->loops + first;
        uint32_t size = patch->loop_ends[l] - first, count = 0;
        uint8_t triangles[DF_MC_TABLE_MAX][3];
        if (l < 32 && filled >> l & 1) continue;
        if (plain) count = loop_triangles(loop, size, triangles);
        for (uint32_t i = 0; i < count; i++) add_triangle(patch, triangles[i][0], triangles[i][1], triangles[i][2]);
        if (!count) fill_loop(patch, values, loop, size);
    }
}

void df_mc_patch_fill(df_mc_patch *patch, const double values[8]) { fill_patch(patch, values, false); }

df_status df_mc_cell_fill(df_mc_patch *patch, const double values[8], df_error *err) {
    df_status status = df_mc_patch_begin(patch, DF_MC_EDGE_COUNT, err);
    if (status != DF_OK) return status;
    int8_t next[DF_MC_EDGE_COUNT];
    memset(next, -1, sizeof next);
    uint32_t inside = 0, corners[4];
    for (uint32_t c = 0; c < 8; c++) inside |= (uint32_t)(values[c] < 0) << c;
    for (uint32_t face = 0; face < 6; face++) {
        bool joins = face_is_ambiguous(face, inside, corners) &&
                     df_mc_face_joins(values[corners[0]], values[corners[1]], values[corners[2]], values[corners[3]]);
        join_face(face, inside, joins, next);
    }
    for (uint32_t e = 0; e < DF_MC_EDGE_COUNT; e++) {
        uint32_t end[2], axis = e / 4;
        df_mc_edge_corners(e, end);
        for (uint32_t a = 0; a < 3; a++) patch->positions[e][a] = end[0] >> a & 1;
        if (next[e] >= 0) patch->positions[e][axis] = values[end[0]] / (values[end[0]] - values[end[1]]);
    }
    patch->loop_count = trace_loops(next, patch->loops, patch->loop_ends);
    patch->loop_size = patch->loop_count ? patch->loop_ends[patch->loop_count - 1] : 0;
    fill_patch(patch, values, true);
    return DF_OK;
}
