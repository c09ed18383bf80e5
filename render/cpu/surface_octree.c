/*
 * The leaves of an octree that a ray from outside can hit (adf.h): those that the surface crosses, and those where a
 * ray may enter inside though it left the leaf before on the outside, because the two interpolate different corners on
 * their common face. Of the first, the surface's surroundings suffice where the leaf fits its neighbours.
 */
#include "common/memory.h"
#include "common/octree_samples.h"
#include "render/cpu/fetch.h"
#include "render/cpu/surface.h"
#include "render/methods/leaf.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Beyond the field's box: no ray visits such cells. A fifth df_child_state. */
#define BEYOND ((df_child_state)4)

/* Cells so large are visited by tasks of their own. */
#define TASK_SIZE_LOG2 5u

/* What is found out about a leaf, by 8 * family + child. */
enum {
    MARK_OPEN = 1,  /* rays may enter inside that come from the outside */
    MARK_FIRST = 2, /* rays may enter inside that come from beyond the box */
    MARK_EDGE = 4,  /* a neighbour is beyond the box: its stencil is not kept */
};

typedef float family_samples[DF_FAMILY_SAMPLE_COUNT];

typedef struct builder {
    const df_scene *scene;
    const df_field *field;
    family_samples *samples; /* by family */
    uint8_t *marks;
    df_surface *surface;
    /* Numbers in a stencil as it is fetched: of the leaf's corners, and of the samples beyond its faces. */
    int8_t corners[8], beyond[3][2][4];
    float margin;
    bool filling; /* the second time, when records are written and not only counted */
    bool open;    /* the current block has records */
    uint32_t block_count;
    uint64_t record_count;
} builder;

typedef struct node {
    uint32_t leaf;   /* 8 * family + child */
    uint32_t family; /* where it is divided: the family that it has become */
    uint32_t corner[3], size_log2;
    df_child_state state;
} node;

static bool divided(const node *n) { return n->state == DF_CHILD_FAMILY; }

static node root_of(const builder *b) { return (node){.size_log2 = b->field->level_count, .state = DF_CHILD_FAMILY}; }

static inline node child_of(const builder *b, const node *parent, uint32_t child) {
    const df_family *family = &b->field->families[parent->family];
    node n = {.leaf = parent->family << 3 | child, .size_log2 = parent->size_log2 - 1};
    n.state = df_family_state(family, child);
    if (divided(&n)) n.family = df_family_child(family, child);
    for (int a = 0; a < 3; a++) {
        n.corner[a] = parent->corner[a] + ((child >> a & 1) << n.size_log2);
        if (n.corner[a] >= b->scene->voxel_count[a]) n.state = BEYOND;
    }
    return n;
}

/* The state of a child, or of the cell where it is not divided; as if nothing were beyond the box. */
static df_child_state child_state(const builder *b, const node *n, uint32_t child) {
    return divided(n) ? df_family_state(&b->field->families[n->family], child) : n->state;
}

static float leaf_corner(const builder *b, const node *n, uint32_t corner) {
    return b->samples[n->leaf >> 3][df_family_corner(n->leaf & 7, corner)];
}

/* Decodes all families, parents first. */
static void decode_samples(builder *b) {
    float cell[8];
    df_adf_cell_corners(b->field, 0, cell);
    df_adf_samples(b->field, 0, cell, b->samples[0]);
    for (uint32_t f = 0; f < b->field->family_count; f++) {
        const df_family *family = &b->field->families[f];
        for (uint32_t child = 0; child < 8; child++) {
            if (df_family_state(family, child) != DF_CHILD_FAMILY) continue;
            for (uint32_t c = 0; c < 8; c++) cell[c] = b->samples[f][df_family_corner(child, c)];
            const uint32_t divided_into = df_family_child(family, child);
            df_adf_samples(b->field, divided_into, cell, b->samples[divided_into]);
        }
    }
}

/* ---- stencils ---- */

static void number_stencil(builder *b) {
    int8_t number[64] = {0};
    for (int i = 0; i < DF_FETCH_STENCIL; i++) number[df_fetch_place(i)] = (int8_t)i;
    for (int c = 0; c < 8; c++) b->corners[c] = number[DF_STENCIL(c & 1, c >> 1 & 1, c >> 2)];
    for (int face = 0; face < 24; face++) {
        const int axis = face >> 3, after = face >> 2 & 1, i = face & 3;
        int at[3];
        at[axis] = after ? 2 : -1;
        at[(axis + 1) % 3] = i & 1;
        at[(axis + 2) % 3] = i >> 1;
        b->beyond[axis][after][i] = number[DF_STENCIL(at[0], at[1], at[2])];
    }
}

static df_status make_stencils(builder *b, df_error *err) {
    const df_field *field = b->field;
    df_leaf_stencils *stencils = &b->surface->stencils;
    uint64_t count = 0;
    number_stencil(b);
    df_status status =
        df_alloc((void **)&stencils->first, field->family_count + 1ull, sizeof *stencils->first, "stencils", err);
    for (uint32_t f = 0; f < field->family_count && status == DF_OK; f++) {
        stencils->first[f] = (uint32_t)count;
        count += df_bit_count(df_leaf_surface_bits(field->families[f].states));
    }
    if (status == DF_OK) {
        stencils->first[field->family_count] = (uint32_t)count;
        status = df_alloc_raw((void **)&stencils->samples, count + 1, sizeof *stencils->samples, "stencils", err);
    }
    b->surface->stencil_bytes =
        (field->family_count + 1ull) * sizeof *stencils->first + count * sizeof *stencils->samples;
    return status;
}

/* The stencil of a leaf that the surface crosses. */
static float *stencil_of(const builder *b, uint32_t leaf) {
    const df_leaf_stencils *stencils = &b->surface->stencils;
    const uint32_t bits = df_leaf_surface_bits(b->field->families[leaf >> 3].states);
    return stencils->samples[stencils->first[leaf >> 3] + df_bit_count(bits & ((1u << 2 * (leaf & 7)) - 1))];
}

/* ---- faces ---- */

static float larger(float a, float b) { return a > b ? a : b; }

static float largest_corner(const builder *b, const node *n) {
    float largest = 0;
    for (uint32_t c = 0; c < 8; c++) largest = larger(largest, fabsf(leaf_corner(b, n, c)));
    return largest;
}

/* What a leaf interpolates at the corners of the part of its face that a leaf no larger than it, `part`, shares.
 * after: the face is its upper one. */
static void face_values(const builder *b, const node *n, const node *part, int axis, int after, float value[4]) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    float corner[4];
    for (uint32_t i = 0; i < 4; i++)
        corner[i] = leaf_corner(b, n, (uint32_t)after << axis | (i & 1) << u | (i >> 1) << v);
    for (uint32_t i = 0; i < 4; i++) {
        if (n->size_log2 == part->size_log2) {
            value[i] = corner[i];
            continue;
        }
        const double size = 1u << n->size_log2, step = 1u << part->size_log2;
        const double x = (part->corner[u] - n->corner[u] + (i & 1) * step) / size;
        const double y = (part->corner[v] - n->corner[v] + (i >> 1) * step) / size;
        value[i] = (float)((1 - y) * ((1 - x) * (double)corner[0] + x * (double)corner[1]) +
                           y * ((1 - x) * (double)corner[2] + x * (double)corner[3]));
    }
}

/* Faces of a leaf are visited by several threads. */
static void set_marks(builder *b, uint32_t leaf, uint8_t marks) {
#pragma omp atomic
    b->marks[leaf] |= marks;
}

/* A ray leaves `from` and enters `to` across a face on which they have these values: may it enter inside, though it
 * came from the outside? What is too near to 0 for a verdict may be either. */
static void mark_entry(builder *b, const node *from, const float before[4], const node *to, const float after[4]) {
    float low = INFINITY, high = -INFINITY, differ = 0;
    if (to->state == DF_CHILD_OUTSIDE || to->state == BEYOND || from->state == DF_CHILD_INSIDE) return;
    for (int i = 0; i < 4; i++) low = after[i] < low ? after[i] : low;
    if (!(low < 0)) return;
    if (from->state == BEYOND) {
        set_marks(b, to->leaf, MARK_OPEN | MARK_FIRST);
        return;
    }
    for (int i = 0; i < 4; i++) {
        high = larger(high, before[i]);
        differ = larger(differ, fabsf(after[i] - before[i]));
    }
    const float largest = largest_corner(b, from);
    if (high < largest * (-1.0f / 64)) return; /* it came from inside */
    /* The box of `to` holds what is within 1e-5 of its largest corner. */
    if (to->size_log2 != from->size_log2) differ += largest * 0x1p-21f;
    if (to->state == DF_CHILD_SURFACE && differ <= 0.8e-5f * largest_corner(b, to)) return;
    set_marks(b, to->leaf, MARK_OPEN);
}

/* Whether two leaves of a size, neither of which is inside, have the same values on the face between them. */
static bool fits(const builder *b, const node *low, const node *high, int axis) {
    const uint32_t u = 1u << (axis + 1) % 3, v = 1u << (axis + 2) % 3;
    if (low->size_log2 != high->size_log2 || low->state == BEYOND || high->state == BEYOND) return false;
    if (low->state == DF_CHILD_INSIDE || high->state == DF_CHILD_INSIDE) return false;
    if (low->leaf >> 3 == high->leaf >> 3) return true;
    for (uint32_t i = 0; i < 4; i++) {
        const uint32_t at = (i & 1 ? u : 0) + (i & 2 ? v : 0);
        if (leaf_corner(b, low, at | 1u << axis) != leaf_corner(b, high, at)) return false;
    }
    return true;
}

/* Of a leaf and the cell across one of its faces that is no smaller: the samples beyond the face. */
static void keep_beyond(builder *b, const node *n, const node *cell, int axis, int after) {
    const uint32_t u = 1u << (axis + 1) % 3, v = 1u << (axis + 2) % 3;
    if (n->state != DF_CHILD_SURFACE) return;
    if (cell->state == BEYOND) {
        set_marks(b, n->leaf, MARK_EDGE);
        return;
    }
    if (cell->size_log2 < n->size_log2) return;
    float *samples = stencil_of(b, n->leaf);
    const int8_t *number = b->beyond[axis][after];
    if (cell->size_log2 == n->size_log2) {
        for (uint32_t i = 0; i < 4; i++) {
            const uint32_t corner = (uint32_t)after << axis | (i & 1 ? u : 0) | (i & 2 ? v : 0);
            samples[number[i]] = leaf_corner(b, cell, corner);
        }
        return;
    }
    const int64_t size = (int64_t)1 << n->size_log2;
    int64_t lower[3] = {n->corner[0], n->corner[1], n->corner[2]};
    float corners[8], value[4];
    for (uint32_t c = 0; c < 8; c++) corners[c] = leaf_corner(b, cell, c);
    lower[axis] += after ? size : -size;
    df_leaf_beyond(lower, n->size_log2, axis, after, cell->corner, 1u << cell->size_log2, corners, value);
    for (int i = 0; i < 4; i++) samples[number[i]] = value[i];
}

/* Two cells that share a part of a face, `low` before it along the axis. */
static void visit_face(builder *b, const node *low, const node *high, int axis) {
    const uint32_t u = 1u << (axis + 1) % 3, v = 1u << (axis + 2) % 3;
    keep_beyond(b, low, high, axis, 1);
    keep_beyond(b, high, low, axis, 0);
    if (!divided(low) && !divided(high)) {
        float before[4] = {0}, after[4] = {0};
        const node *part = low->size_log2 < high->size_log2 ? low : high;
        if (low->state == high->state && low->state != DF_CHILD_SURFACE) return;
        if (fits(b, low, high, axis)) return;
        if (low->state != BEYOND) face_values(b, low, high->state == BEYOND ? low : part, axis, 1, before);
        if (high->state != BEYOND) face_values(b, high, low->state == BEYOND ? high : part, axis, 0, after);
        mark_entry(b, low, before, high, after);
        mark_entry(b, high, after, low, before);
        return;
    }
    for (uint32_t i = 0; i < 4; i++) {
        const uint32_t at = (i & 1 ? u : 0) + (i & 2 ? v : 0);
        if (child_state(b, low, at | 1u << axis) == DF_CHILD_OUTSIDE && child_state(b, high, at) == DF_CHILD_OUTSIDE)
            continue;
        const node first = divided(low) ? child_of(b, low, at | 1u << axis) : *low;
        const node second = divided(high) ? child_of(b, high, at) : *high;
        visit_face(b, &first, &second, axis);
    }
}

/* All faces between leaves in a cell. Large cells are tasks. */
static void visit_faces(builder *b, const node *n) {
    node children[8];
    if (!divided(n)) return;
    for (uint32_t c = 0; c < 8; c++) {
        const node child = children[c] = child_of(b, n, c);
        if (child.size_log2 < TASK_SIZE_LOG2) {
            visit_faces(b, &child);
        } else {
#pragma omp task firstprivate(b, child)
            visit_faces(b, &child);
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        for (uint32_t c = 0; c < 8; c++) {
            const node *low = &children[c], *high = &children[c | 1u << axis];
            if (low != high && !(low->state == DF_CHILD_OUTSIDE && high->state == DF_CHILD_OUTSIDE))
                visit_face(b, low, high, axis);
        }
    }
}

static void mark_leaves(builder *b, uint32_t threads) {
    const node root = root_of(b), beyond = {.state = BEYOND};
#pragma omp parallel num_threads(threads)
#pragma omp single
    visit_faces(b, &root);
    for (int axis = 0; axis < 3; axis++) {
        visit_face(b, &beyond, &root, axis);
        visit_face(b, &root, &beyond, axis);
    }
}

/* ---- records ---- */

static void begin_block(builder *b, const uint32_t corner[3], uint32_t size_log2) {
    const uint32_t block = b->block_count++;
    if (!b->filling) return;
    b->surface->first[block] = (uint32_t)b->record_count;
    b->surface->block_log2[block] = (uint8_t)size_log2;
    for (int a = 0; a < 3; a++) b->surface->corner[a][block] = corner[a];
}

static void fill_record(builder *b, const node *n, const uint32_t low[3]) {
    df_surface *surface = b->surface;
    const uint8_t mark = b->marks[n->leaf];
    float *corner = (float *)surface->corners + 8 * b->record_count;
    uint32_t voxel = n->size_log2 << DF_SURFACE_SIZE;
    for (uint32_t c = 0; c < 8; c++) corner[c] = leaf_corner(b, n, c);
    if (n->state == DF_CHILD_SURFACE) {
        float *samples = stencil_of(b, n->leaf);
        for (int c = 0; c < 8; c++) samples[b->corners[c]] = corner[c];
        if (mark & MARK_EDGE) samples[0] = NAN;
    }
    voxel |= mark & MARK_OPEN ? DF_SURFACE_WHOLE : df_surface_box(corner, b->margin / (float)(1u << n->size_log2));
    for (uint32_t a = 0; a < 3; a++) voxel |= (n->corner[a] - low[a]) << 3 * a;
    if (mark & MARK_FIRST) {
        voxel |= DF_SURFACE_BORDER;
        surface->has_border = true;
    }
    surface->voxels[b->record_count] = voxel;
    surface->leaves[b->record_count] = n->leaf;
}

/* False for leaves that have no record. */
static bool may_hit(const builder *b, uint32_t family, uint32_t child) {
    const df_child_state state = df_family_state(&b->field->families[family], child);
    return state >= DF_CHILD_SURFACE || (state == DF_CHILD_INSIDE && b->marks[family << 3 | child] & MARK_OPEN);
}

/* The records of a cell. block: the cube that it is a part of; NULL: it is larger. */
static void visit_leaves(builder *b, const node *n, const node *block) {
    if (!block && (n->size_log2 <= 3 || !divided(n))) {
        block = n;
        b->open = false;
    }
    if (divided(n)) {
        for (uint32_t c = 0; c < 8; c++) {
            if (!may_hit(b, n->family, c)) continue;
            const node child = child_of(b, n, c);
            visit_leaves(b, &child, block);
        }
        return;
    }
    if (n->state == BEYOND) return;
    if (!b->open) begin_block(b, block->corner, block->size_log2);
    b->open = true;
    if (b->filling) fill_record(b, n, block->corner);
    b->record_count++;
}

static df_status make_records(builder *b, df_error *err) {
    const node root = root_of(b);
    df_surface *surface = b->surface;
    visit_leaves(b, &root, NULL);
    surface->block_count = b->block_count;
    df_status status = df_surface_alloc_blocks(surface, err);
    if (status == DF_OK)
        status = df_alloc((void **)&surface->block_log2, b->block_count, sizeof *surface->block_log2, "blocks", err);
    if (status == DF_OK) status = df_surface_alloc_records(surface, b->record_count, err);
    if (status == DF_OK)
        status = df_alloc((void **)&surface->leaves, b->record_count, sizeof *surface->leaves, "surface records", err);
    if (status != DF_OK) return status;
    surface->first[b->block_count] = (uint32_t)b->record_count;
    b->block_count = 0;
    b->record_count = 0;
    b->filling = true;
    visit_leaves(b, &root, NULL);
    return DF_OK;
}

df_status df_surface_make_octree(const df_scene *scene, uint32_t threads, df_surface *surface, df_error *err) {
    const df_field *field = scene->field;
    builder b = {.scene = scene, .field = field, .surface = surface, .margin = df_surface_margin(scene)};
    surface->k_shift = 3;
    surface->sample_type = DF_SAMPLE_F32;
    df_status status =
        df_alloc_raw((void **)&b.samples, field->family_count, sizeof *b.samples, "decoded samples", err);
    if (status == DF_OK) status = df_alloc((void **)&b.marks, field->family_count, 8, "leaves", err);
    if (status == DF_OK) status = make_stencils(&b, err);
    if (status == DF_OK) {
        decode_samples(&b);
        mark_leaves(&b, threads);
        status = make_records(&b, err);
    }
    free(b.samples);
    free(b.marks);
    return status;
}
