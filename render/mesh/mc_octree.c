/*
 * Marching cubes over the leaves of an ADF.
 *
 * Where leaves of different size meet, the coarser one follows the finer: a crossing lies on the shortest edge that any
 * leaf has there, and a coarse leaf's face is cut where the leaves beyond it are, so that both sides draw the same
 * line. The values at hanging corners are the coarse leaf's interpolated ones (field.h), so an edge is crossed once
 * however it is divided. A leaf with such a face gets a fan around a vertex in its interior.
 *
 * A vertex is numbered by its family, then by the leaf that owns its edge, then by the edge; a family's interior
 * vertices come last.
 */
#include "common/memory.h"
#include "render/mesh/mc_cell.h"
#include "render/mesh/mc_private.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

typedef struct family_record {
    uint16_t corner[3];  /* of the parent cell */
    uint16_t child_side; /* voxels */
    uint16_t owned[8];   /* by child: the edges on which it owns a vertex, as bits */
    uint32_t vertex_first, edge_count;
    uint32_t triangle_first;
} family_record;

typedef struct octree {
    const df_field *field;
    const char *name;
    df_mc_params params;
    family_record *records;
} octree;

/* An edge of the octree: from a grid corner along an axis, with the values at its ends, minus iso. */
typedef struct edge {
    uint32_t corner[3], axis, length;
    uint32_t family; /* of a leaf on it: from where those around it are found */
    double low, high;
} edge;

/* A vertex on the boundary of a leaf: where it lies, and who owns it. */
typedef struct crossing {
    edge at;
    uint32_t family, child, local_edge; /* family DF_MC_NONE: nobody */
    uint32_t next;                      /* the crossing that follows in its loop */
} crossing;

typedef struct leaf {
    df_adf_cell cell;
    float corners[8];
    double values[8]; /* minus iso */
    uint32_t inside;  /* signs as bits */
    bool in_box;      /* part of it lies within the field's box */
} leaf;

/* What a thread works with. */
typedef struct scratch {
    crossing *crossings;
    uint32_t count, capacity;
    df_mc_patch patch;
} scratch;

static bool cell_in_box(const octree *o, const df_adf_cell *cell) {
    const uint32_t *end = o->field->voxel_count;
    return cell->corner[0] < end[0] && cell->corner[1] < end[1] && cell->corner[2] < end[2];
}

/* The leaf around a voxel, or the cell of `side` where the tree is deeper there. False outside the root. The way leads
 * from `family`, which is near and whose children are no smaller than `side`, up as far as it must and down again. */
static bool find_cell(const octree *o, uint32_t family, const uint32_t voxel[3], uint32_t side, df_adf_cell *cell) {
    const uint32_t root = 1u << o->field->level_count;
    const df_family *families = o->field->families;
    const family_record *r = &o->records[family];
    assert(side <= r->child_side);
    if (voxel[0] >= root || voxel[1] >= root || voxel[2] >= root) return false; /* also below 0 */
    for (;; r = &o->records[family]) {
        const uint32_t length = 2u * r->child_side;
        if (voxel[0] - r->corner[0] < length && voxel[1] - r->corner[1] < length && voxel[2] - r->corner[2] < length)
            break; /* the root's in any case */
        family = families[family].parent >> 3;
    }
    for (;; r = &o->records[family]) {
        uint32_t child = 0;
        for (uint32_t a = 0; a < 3; a++) child |= (uint32_t)(voxel[a] - r->corner[a] >= r->child_side) << a;
        const df_child_state state = df_family_state(&families[family], child);
        if (state == DF_CHILD_FAMILY && r->child_side > side) {
            family = df_family_child(&families[family], child);
            continue;
        }
        *cell = (df_adf_cell){.side = r->child_side, .family = family, .child = child, .state = state};
        for (uint32_t a = 0; a < 3; a++) cell->corner[a] = r->corner[a] + (child >> a & 1) * cell->side;
        return true;
    }
}

/* The voxel at `corner` in quadrant 0..3 around a line along an axis: bits 0 and 1 set: below on the first, second of
 * the other axes. */
static void quadrant_voxel(const uint32_t corner[3], uint32_t axis, uint32_t quadrant, uint32_t voxel[3]) {
    uint32_t low = axis == 0 ? 1 : 0, high = axis == 2 ? 1 : 2;
    memcpy(voxel, corner, 3 * sizeof *voxel);
    voxel[low] -= quadrant & 1;
    voxel[high] -= quadrant >> 1;
}

/* The corner of the cell in a quadrant that touches the line: at its lower end. */
static uint32_t quadrant_corner(uint32_t axis, uint32_t quadrant) {
    uint32_t low = axis == 0 ? 1 : 0, high = axis == 2 ? 1 : 2;
    return (quadrant & 1) << low | (quadrant >> 1) << high;
}

/* Halves an edge towards its crossing until no leaf around it has a shorter one. */
static void refine_edge(const octree *o, edge *e) {
    for (uint32_t quadrant = 0; e->length > 1 && quadrant < 4; quadrant++) {
        df_adf_cell cell;
        uint32_t voxel[3];
        quadrant_voxel(e->corner, e->axis, quadrant, voxel);
        if (!find_cell(o, e->family, voxel, e->length, &cell) || cell.state != DF_CHILD_FAMILY ||
            cell.side != e->length)
            continue;
        float corners[8];
        e->length /= 2;
        voxel[e->axis] += e->length;
        find_cell(o, e->family, voxel, e->length, &cell);
        df_adf_corners(o->field, cell.family, cell.child, corners);
        double middle = (double)corners[quadrant_corner(e->axis, quadrant)] - (double)o->params.iso;
        if ((middle < 0) == (e->low < 0)) {
            e->corner[e->axis] += e->length;
            e->low = middle;
        } else {
            e->high = middle;
        }
        quadrant = (uint32_t)-1; /* again from the first */
    }
}

/* The leaf that owns a vertex on an edge that no leaf divides: the first around it that is as short. Sets *used when a
 * leaf around it reaches into the field's box. */
static void find_owner(const octree *o, const edge *e, uint32_t *family, uint32_t *child, uint32_t *local_edge,
                       bool *used) {
    *family = DF_MC_NONE;
    *used = false;
    for (uint32_t quadrant = 0; quadrant < 4; quadrant++) {
        df_adf_cell cell;
        uint32_t voxel[3];
        quadrant_voxel(e->corner, e->axis, quadrant, voxel);
        if (!find_cell(o, e->family, voxel, e->length, &cell)) continue;
        *used = *used || cell_in_box(o, &cell);
        if (*family != DF_MC_NONE || cell.side != e->length) continue;
        *family = cell.family;
        *child = cell.child;
        *local_edge = 4 * e->axis + quadrant;
    }
}

static void set_edge(const leaf *l, uint32_t local_edge, edge *e) {
    uint32_t ends[2];
    df_mc_edge_corners(local_edge, ends);
    for (uint32_t a = 0; a < 3; a++) e->corner[a] = l->cell.corner[a] + (ends[0] >> a & 1) * l->cell.side;
    e->axis = local_edge / 4;
    e->family = l->cell.family;
    e->length = l->cell.side;
    e->low = l->values[ends[0]];
    e->high = l->values[ends[1]];
}

static void load_leaf(const octree *o, const df_adf_cell *cell, leaf *l) {
    l->cell = *cell;
    l->inside = 0;
    l->in_box = cell_in_box(o, cell);
    df_adf_corners(o->field, cell->family, cell->child, l->corners);
    for (uint32_t c = 0; c < 8; c++) {
        l->values[c] = (double)l->corners[c] - (double)o->params.iso;
        l->inside |= (uint32_t)(l->values[c] < 0) << c;
    }
}

static void family_child(const octree *o, uint32_t family, uint32_t child, df_adf_cell *cell) {
    const family_record *r = &o->records[family];
    *cell = (df_adf_cell){.side = r->child_side,
                          .family = family,
                          .child = child,
                          .state = df_family_state(&o->field->families[family], child)};
    for (uint32_t a = 0; a < 3; a++) cell->corner[a] = r->corner[a] + (child >> a & 1) * cell->side;
}

/* The cell as large as the leaf beyond one of its faces. */
static bool beyond_face(const octree *o, const df_adf_cell *cell, uint32_t face, df_adf_cell *beyond) {
    uint32_t voxel[3] = {cell->corner[0], cell->corner[1], cell->corner[2]};
    voxel[face / 2] += face & 1 ? cell->side : (uint32_t)-1;
    return find_cell(o, cell->family, voxel, cell->side, beyond);
}

/* True when the surface meets a face of the leaf that finer leaves divide. */
static bool leaf_is_divided(const octree *o, const leaf *l) {
    for (uint32_t face = 0; face < 6; face++) {
        uint32_t corners[4], edges[4], in = 0;
        df_adf_cell beyond;
        df_mc_face(face, corners, edges);
        for (int i = 0; i < 4; i++) in += l->inside >> corners[i] & 1;
        if (in == 0 || in == 4) continue;
        if (beyond_face(o, &l->cell, face, &beyond) && beyond.state == DF_CHILD_FAMILY) return true;
    }
    return false;
}

/* The number of the crossing on an edge, which is added when it is new. */
static df_status find_crossing(const octree *o, scratch *s, edge e, uint32_t *number, df_error *err) {
    refine_edge(o, &e);
    for (*number = 0; *number < s->count; ++*number) {
        const edge *other = &s->crossings[*number].at;
        if (other->axis == e.axis && memcmp(other->corner, e.corner, sizeof e.corner) == 0) return DF_OK;
    }
    if (s->count == s->capacity) {
        uint32_t capacity = s->capacity ? 2 * s->capacity : 64;
        crossing *grown = realloc(s->crossings, capacity * sizeof *grown);
        if (!grown) return df_fail(err, DF_ERROR_MEMORY, "no memory for a leaf's surface of %u vertices", capacity);
        s->crossings = grown;
        s->capacity = capacity;
    }
    crossing *c = &s->crossings[s->count++];
    bool used;
    *c = (crossing){.at = e, .next = DF_MC_NONE};
    find_owner(o, &e, &c->family, &c->child, &c->local_edge, &used);
    return DF_OK;
}

/* Joins two edges of a face, numbered as in df_mc_face, of the cell `l` that lies on the near side of the face. */
static df_status join_edges(const octree *o, scratch *s, const leaf *l, uint32_t from_edge, uint32_t to_edge,
                            df_error *err) {
    edge e;
    uint32_t from, to;
    set_edge(l, from_edge, &e);
    df_status status = find_crossing(o, s, e, &from, err);
    set_edge(l, to_edge, &e);
    if (status == DF_OK) status = find_crossing(o, s, e, &to, err);
    if (status == DF_OK) s->crossings[from].next = to;
    return status;
}

/* The segments on an undivided piece of a face. `l` is the leaf whose face it is: the near one, or (mirrored) the finer
 * one beyond. */
static df_status join_piece(const octree *o, scratch *s, const leaf *l, uint32_t face, bool mirrored, df_error *err) {
    uint32_t corners[4], edges[4], in[4], count = 0;
    df_mc_face(face, corners, edges);
    for (uint32_t i = 0; i < 4; i++) count += in[i] = l->inside >> corners[i] & 1;
    bool joins = false;
    if (count == 2 && in[0] == in[2]) {
        uint32_t first = in[0] ? 0 : 1;
        const double *v = l->values;
        joins = df_mc_face_joins(v[corners[first]], v[corners[first + 1]], v[corners[first + 2]],
                                 v[corners[(first + 3) % 4]]);
    }
    for (uint32_t i = 0; i < 4; i++) {
        if (in[i] || !in[(i + 1) % 4]) continue;
        uint32_t end =
            (i + 1) %
            4; /* as in mc_cell.c: from where the walk around the face enters the inside to where it leaves it */
        if (joins) end = (i + 3) % 4;
        else
            while (in[(end + 1) % 4]) end = (end + 1) % 4;
        uint32_t from = mirrored ? edges[end] : edges[i], to = mirrored ? edges[i] : edges[end];
        df_status status = join_edges(o, s, l, from, to, err);
        if (status != DF_OK) return status;
    }
    return DF_OK;
}

/* The segments on the part of a face beyond which `cell` lies; `face` is the face of `cell` that touches it. */
static df_status join_beyond(const octree *o, scratch *s, const df_adf_cell *cell, uint32_t face, df_error *err) {
    if (cell->state != DF_CHILD_FAMILY) {
        leaf l;
        load_leaf(o, cell, &l);
        return join_piece(o, s, &l, face, true, err);
    }
    uint32_t axis = face / 2, half = cell->side / 2;
    for (uint32_t child = 0; child < 8; child++) {
        df_adf_cell part = {0};
        uint32_t voxel[3];
        if ((child >> axis & 1) != (face & 1)) continue;
        for (uint32_t a = 0; a < 3; a++) voxel[a] = cell->corner[a] + (child >> a & 1) * half;
        find_cell(o, cell->family, voxel, half, &part);
        df_status status = join_beyond(o, s, &part, face, err);
        if (status != DF_OK) return status;
    }
    return DF_OK;
}

/* Turns crossings into the loops of the patch. Fails where the samples of neighbours contradict each other. */
static df_status close_loops(const octree *o, scratch *s, const leaf *l, df_error *err) {
    df_mc_patch *patch = &s->patch;
    df_status status = df_mc_patch_begin(patch, s->count, err);
    if (status != DF_OK) return status;
    for (uint32_t i = 0; i < s->count; i++) {
        const edge *e = &s->crossings[i].at;
        for (uint32_t a = 0; a < 3; a++) {
            double along = a == e->axis ? e->low / (e->low - e->high) * e->length : 0;
            patch->positions[i][a] = ((double)e->corner[a] - l->cell.corner[a] + along) / l->cell.side;
        }
    }
    for (uint32_t first = 0; first < s->count; first++) {
        uint32_t begin = patch->loop_size;
        for (uint32_t i = first, next; s->crossings[i].next != i; i = next) {
            next = s->crossings[i].next;
            if (next == DF_MC_NONE)
                return df_fail(err, DF_ERROR_FORMAT, "%s: leaves that share a face differ in its samples", o->name);
            patch->loops[patch->loop_size++] = i;
            s->crossings[i].next = i; /* done */
            if (next == first) break;
        }
        if (patch->loop_size == begin) continue;
        if (patch->loop_size - begin < 3)
            return df_fail(err, DF_ERROR_FORMAT, "%s: leaves that share a face differ in its samples", o->name);
        patch->loop_ends[patch->loop_count++] = patch->loop_size;
    }
    return DF_OK;
}

/* The surface of a leaf: s->crossings are the boundary vertices of s->patch. */
static df_status fill_leaf(const octree *o, scratch *s, const leaf *l, df_error *err) {
    df_status status = DF_OK;
    s->count = 0;
    if (leaf_is_divided(o, l)) {
        for (uint32_t face = 0; face < 6 && status == DF_OK; face++) {
            df_adf_cell beyond;
            bool divided = beyond_face(o, &l->cell, face, &beyond) && beyond.state == DF_CHILD_FAMILY;
            status = divided ? join_beyond(o, s, &beyond, face ^ 1, err) : join_piece(o, s, l, face, false, err);
        }
        if (status == DF_OK) status = close_loops(o, s, l, err);
        if (status == DF_OK) df_mc_patch_fill(&s->patch, l->values);
        return status;
    }
    status = df_mc_cell_fill(&s->patch, l->values, err);
    if (status != DF_OK) return status;
    if (s->capacity < DF_MC_EDGE_COUNT) {
        crossing *grown = realloc(s->crossings, 64 * sizeof *grown);
        if (!grown) return df_fail(err, DF_ERROR_MEMORY, "no memory for a leaf's surface");
        s->crossings = grown;
        s->capacity = 64;
    }
    for (s->count = 0; s->count < DF_MC_EDGE_COUNT; s->count++) {
        crossing *c = &s->crossings[s->count];
        bool used;
        c->family = DF_MC_NONE;
        set_edge(l, s->count, &c->at);
        if ((c->at.low < 0) == (c->at.high < 0)) continue;
        refine_edge(o, &c->at);
        find_owner(o, &c->at, &c->family, &c->child, &c->local_edge, &used);
    }
    return DF_OK;
}

/* The edges of a leaf on which it owns a vertex. */
static uint32_t owned_edges(const octree *o, const leaf *l) {
    uint32_t owned = 0;
    for (uint32_t local = 0; local < DF_MC_EDGE_COUNT; local++) {
        edge e;
        uint32_t family, child, owner_edge;
        bool used;
        set_edge(l, local, &e);
        if ((e.low < 0) == (e.high < 0)) continue;
        refine_edge(o, &e);
        if (e.length != l->cell.side) continue;
        find_owner(o, &e, &family, &child, &owner_edge, &used);
        if (used && family == l->cell.family && child == l->cell.child) owned |= 1u << local;
    }
    return owned;
}

/* First pass over a family: which vertices it owns, and how many it makes. */
static df_status count_family(const octree *o, uint32_t family, scratch *s, df_error *err) {
    family_record *r = &o->records[family];
    for (uint32_t child = 0; child < 8; child++) {
        df_adf_cell cell;
        leaf l;
        family_child(o, family, child, &cell);
        if (cell.state != DF_CHILD_SURFACE) continue;
        load_leaf(o, &cell, &l);
        r->owned[child] = (uint16_t)owned_edges(o, &l);
        r->edge_count += df_bit_count(r->owned[child]);
        if (!l.in_box) continue;
        df_status status = fill_leaf(o, s, &l, err);
        if (status != DF_OK) return status;
        r->triangle_first += s->patch.triangle_count;
        r->vertex_first += s->patch.position_count - s->patch.boundary_count;
    }
    r->vertex_first += r->edge_count;
    return DF_OK;
}

/* The number of the vertex that a leaf owns on one of its edges. */
static uint32_t vertex_number(const octree *o, uint32_t family, uint32_t child, uint32_t local_edge) {
    if (family == DF_MC_NONE || !(o->records[family].owned[child] >> local_edge & 1)) return DF_MC_NONE;
    const family_record *r = &o->records[family];
    uint32_t number = r->vertex_first;
    for (uint32_t c = 0; c < child; c++) number += df_bit_count(r->owned[c]);
    return number + df_bit_count(r->owned[child] & ((1u << local_edge) - 1));
}

static double value_at(const octree *o, const double grid[3]) {
    df_adf_cell cell;
    float corners[8];
    double local[3];
    df_adf_find(o->field, grid, DF_LEVEL_COUNT_MAX, &cell);
    df_adf_corners(o->field, cell.family, cell.child, corners);
    for (int a = 0; a < 3; a++) local[a] = (grid[a] - cell.corner[a]) / cell.side;
    return df_trilinear(corners, local);
}

/* Central differences over `width` voxels, within the root. */
static void vertex_normal(const octree *o, const double position[3], double width, const double fallback[3],
                          float normal[3]) {
    double gradient[3], root = 1u << o->field->level_count;
    for (int a = 0; a < 3; a++) {
        double low[3], high[3];
        memcpy(low, position, sizeof low);
        memcpy(high, position, sizeof high);
        low[a] = fmax(0, low[a] - 0.5 * width);
        high[a] = fmin(root, high[a] + 0.5 * width);
        gradient[a] = (value_at(o, high) - value_at(o, low)) / (high[a] - low[a]);
    }
    df_mc_normal(o->field, gradient, fallback, normal);
}

static void write_owned(const octree *o, const leaf *l, uint32_t owned, uint64_t *vertex, df_mc_mesh *mesh) {
    for (; owned; owned &= owned - 1, ++*vertex) {
        edge e;
        double *position = mesh->positions + 3 * *vertex, fallback[3] = {0};
        set_edge(l, (uint32_t)__builtin_ctz(owned), &e);
        for (uint32_t a = 0; a < 3; a++)
            position[a] = e.corner[a] + (a == e.axis ? e.low / (e.low - e.high) * e.length : 0);
        fallback[e.axis] = e.high - e.low;
        if (mesh->normals) vertex_normal(o, position, e.length, fallback, mesh->normals + 3 * *vertex);
    }
}

/* Writes the triangles of a leaf and its interior vertices. Returns false where a vertex is nobody's. */
static bool write_leaf(const octree *o, const scratch *s, const leaf *l, uint64_t *vertex, uint32_t **triangles,
                       df_mc_mesh *mesh) {
    const df_mc_patch *patch = &s->patch;
    uint32_t missing = 0;
    for (uint32_t t = 0; t < patch->triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            uint32_t local = patch->triangles[t][i], number = (uint32_t)*vertex + local - patch->boundary_count;
            if (local < patch->boundary_count) {
                const crossing *c = &s->crossings[local];
                number = vertex_number(o, c->family, c->child, c->local_edge);
            }
            missing += number == DF_MC_NONE;
            *(*triangles)++ = number;
        }
    }
    for (uint32_t p = patch->boundary_count; p < patch->position_count; p++, ++*vertex) {
        double *out = mesh->positions + 3 * *vertex, up[3] = {0, 0, 1};
        for (int a = 0; a < 3; a++) out[a] = l->cell.corner[a] + patch->positions[p][a] * l->cell.side;
        if (mesh->normals) vertex_normal(o, out, l->cell.side, up, mesh->normals + 3 * *vertex);
    }
    return !missing;
}

/* Second pass over a family. */
static df_status write_family(const octree *o, uint32_t family, scratch *s, df_mc_mesh *mesh, df_error *err) {
    const family_record *r = &o->records[family];
    uint64_t edge_vertex = r->vertex_first, vertex = edge_vertex + r->edge_count;
    uint32_t *triangles = mesh->triangles + 3 * (uint64_t)r->triangle_first;
    for (uint32_t child = 0; child < 8; child++) {
        df_adf_cell cell;
        leaf l;
        family_child(o, family, child, &cell);
        if (cell.state != DF_CHILD_SURFACE) continue;
        load_leaf(o, &cell, &l);
        write_owned(o, &l, r->owned[child], &edge_vertex, mesh);
        if (!l.in_box) continue;
        df_status status = fill_leaf(o, s, &l, err);
        if (status != DF_OK) return status;
        if (!write_leaf(o, s, &l, &vertex, &triangles, mesh)) {
            return df_fail(err, DF_ERROR_FORMAT, "%s: leaves that share an edge differ in its samples", o->name);
        }
    }
    return DF_OK;
}

/* Where the families lie: parents come before their children. */
static void place_families(const octree *o) {
    const df_field *field = o->field;
    o->records[0].child_side = (uint16_t)(1u << field->level_count >> 1);
    for (uint32_t f = 0; f < field->family_count; f++) {
        uint32_t next = field->families[f].first_child;
        for (uint32_t child = 0; child < 8; child++) {
            df_adf_cell cell;
            family_child(o, f, child, &cell);
            if (cell.state != DF_CHILD_FAMILY) continue;
            family_record *r = &o->records[next++];
            for (int a = 0; a < 3; a++) r->corner[a] = (uint16_t)cell.corner[a];
            r->child_side = (uint16_t)(cell.side / 2);
        }
    }
}

/* Runs a pass over all families; mesh NULL: the first. On failure *err holds one of the messages. */
static df_status run_pass(const octree *o, scratch *all, df_mc_mesh *mesh, df_error *err) {
    df_status status = DF_OK;
#pragma omp parallel for schedule(dynamic, 64) num_threads(df_mc_threads(&o->params))
    for (uint32_t f = 0; f < o->field->family_count; f++) {
        scratch *s = &all[omp_get_thread_num()];
        df_error local = {0};
        df_status made = mesh ? write_family(o, f, s, mesh, &local) : count_family(o, f, s, &local);
        if (made != DF_OK) {
#pragma omp critical
            {
                status = made;
                if (err) *err = local;
            }
        }
        df_progress_add(o->params.progress, 1);
    }
    return status;
}

static df_status extract(octree *o, scratch *all, df_mc_mesh *mesh, df_error *err) {
    uint64_t vertex_count = 0, triangle_count = 0;
    place_families(o);
    df_status status = run_pass(o, all, NULL, err);
    if (status != DF_OK) return status;
    for (uint32_t f = 0; f < o->field->family_count; f++) {
        family_record *r = &o->records[f];
        uint32_t vertices = r->vertex_first, triangles = r->triangle_first;
        r->vertex_first = (uint32_t)vertex_count;
        r->triangle_first = (uint32_t)triangle_count;
        vertex_count += vertices;
        triangle_count += triangles;
    }
    if (!triangle_count) return DF_OK;
    status = df_mc_mesh_allocate(mesh, o->name, vertex_count, triangle_count, !o->params.skip_normals, err);
    if (status == DF_OK) status = run_pass(o, all, mesh, err);
    if (status != DF_OK) df_mc_mesh_free(mesh);
    return status;
}

df_status df_mc_extract_octree(const df_field *field, const char *name, const df_mc_params *params, df_mc_mesh *mesh,
                               df_error *err) {
    octree o = {.field = field, .name = name, .params = *params};
    scratch *all = NULL;
    int threads = df_mc_threads(params);
    df_status status = df_alloc((void **)&o.records, field->family_count, sizeof *o.records, "octree families", err);
    if (status == DF_OK) status = df_alloc((void **)&all, (uint64_t)threads, sizeof *all, "marching cubes", err);
    if (status == DF_OK) status = extract(&o, all, mesh, err);
    for (int i = 0; all && i < threads; i++) {
        free(all[i].crossings);
        df_mc_patch_free(&all[i].patch);
    }
    free(all);
    free(o.records);
    return status;
}
