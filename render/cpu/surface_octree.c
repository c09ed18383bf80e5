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

/* Levels of fewer families are decoded by one thread. */
#define PARALLEL_FAMILIES 256u

/* What is found out about a leaf, by 8 * family + child. */
enum {
    MARK_OPEN = 1,  /* rays may enter inside that come from the outside */
    MARK_FIRST = 2, /* rays may enter inside that come from beyond the box */
    MARK_EDGE = 4,  /* a neighbour is beyond the box: its stencil is not known */
};

typedef struct builder {
    const df_scene *scene;
    const df_field *field;
    uint8_t *marks;
    df_surface *surface;
    df_leaf_stencils *stencils; /* the surface's */
    float margin;
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

static inline float leaf_corner(const builder *b, const node *n, uint32_t corner) {
    return b->stencils->samples[n->leaf >> 3][df_family_corner(n->leaf & 7, corner)];
}

/* ---- samples ---- */

/* Decodes the families that a family's children have become. */
static void decode_children(const builder *b, uint32_t family) {
    const df_family *of = &b->field->families[family];
    for (uint32_t child = 0; child < 8; child++) {
        if (df_family_state(of, child) != DF_CHILD_FAMILY) continue;
        const uint32_t divided_into = df_family_child(of, child);
        float cell[8];
        df_leaf_corners_kept(b->stencils, family << 3 | child, cell);
        df_adf_samples(b->field, divided_into, cell, b->stencils->samples[divided_into]);
    }
}

/* Where the level ends that follows the families first .. end - 1. */
static uint32_t next_level_end(const df_field *field, uint32_t first, uint32_t end) {
    for (uint32_t f = end; f-- > first;) {
        const uint32_t divided = df_family_divided_count(&field->families[f]);
        if (divided) return field->families[f].first_child + divided;
    }
    return end;
}

static void decode_samples(const builder *b, uint32_t threads) {
    const df_field *field = b->field;
    float root[8];
    df_adf_cell_corners(field, 0, root);
    df_adf_samples(field, 0, root, b->stencils->samples[0]);
    for (uint32_t first = 0, end = 1, next; first < end; first = end, end = next) {
        next = next_level_end(field, first, end);
#pragma omp parallel for schedule(static) num_threads(threads) if (end - first > PARALLEL_FAMILIES)
        for (uint32_t f = first; f < end; f++) decode_children(b, f);
    }
}

static df_status alloc_stencils(builder *b, df_error *err) {
    const df_field *field = b->field;
    df_leaf_stencils *stencils = b->stencils;
    const uint64_t families = field->family_count;
    uint64_t count = 0;
    df_status status = df_alloc_raw((void **)&stencils->first, families, sizeof *stencils->first, "stencils", err);
    for (uint32_t f = 0; f < families && status == DF_OK; f++) {
        stencils->first[f] = (uint32_t)count;
        count += df_even_bit_count(df_leaf_surface_bits(field->families[f].states));
    }
    if (status == DF_OK)
        status = df_alloc_raw((void **)&stencils->outer, count + 1, sizeof *stencils->outer, "stencils", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&stencils->samples, families, sizeof *stencils->samples, "decoded samples", err);
    b->surface->stencil_bytes =
        families * (sizeof *stencils->first + sizeof *stencils->samples) + count * sizeof *stencils->outer;
    return status;
}

/* ---- faces ---- */

static float larger(float a, float b) { return a > b ? a : b; }

static float largest_corner(const builder *b, const node *n) {
    float largest = 0;
    for (uint32_t c = 0; c < 8; c++) largest = larger(largest, fabsf(leaf_corner(b, n, c)));
    return largest;
}

/* The corners of a leaf's face. after: it is the upper one. */
static inline void face_corners(const builder *b, const node *n, int axis, int after, float value[4]) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    for (uint32_t i = 0; i < 4; i++)
        value[i] = leaf_corner(b, n, (uint32_t)after << axis | (i & 1) << u | (i >> 1) << v);
}

static inline bool any_inside(const float value[4]) {
    return value[0] < 0 || value[1] < 0 || value[2] < 0 || value[3] < 0;
}

/* From the corners of a leaf's face to what it interpolates at those of the part that a leaf no larger shares. */
static void narrow_face(const node *n, const node *part, int axis, float value[4]) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    const double corner[4] = {(double)value[0], (double)value[1], (double)value[2], (double)value[3]};
    if (n->size_log2 == part->size_log2) return;
    const double scale = 1.0 / (1u << n->size_log2), step = 1u << part->size_log2;
    for (uint32_t i = 0; i < 4; i++) {
        const double x = (part->corner[u] - n->corner[u] + (i & 1) * step) * scale;
        const double y = (part->corner[v] - n->corner[v] + (i >> 1) * step) * scale;
        value[i] = (float)((1 - y) * ((1 - x) * corner[0] + x * corner[1]) + y * ((1 - x) * corner[2] + x * corner[3]));
    }
}

/* Faces of a leaf are visited by several threads. */
static void set_marks(const builder *b, uint32_t leaf, uint8_t marks) {
#pragma omp atomic
    b->marks[leaf] |= marks;
}

/* A ray leaves `from` and enters `to` across a face on which they have these values: may it enter inside, though it
 * came from the outside? What is too near to 0 for a verdict may be either. */
static void mark_entry(const builder *b, const node *from, const float before[4], const node *to,
                       const float after[4]) {
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

/* The samples of a leaf beyond a face across which a larger leaf is. The axis is a constant. */
static inline void read_larger(const builder *b, const node *n, const node *cell, int axis, int after, float value[4]) {
    const int64_t size = (int64_t)1 << n->size_log2;
    int64_t lower[3] = {n->corner[0], n->corner[1], n->corner[2]};
    float corners[8];
    lower[axis] += after ? size : -size;
    df_leaf_corners_kept(b->stencils, cell->leaf, corners);
    df_leaf_beyond(lower, n->size_log2, axis, after, cell->corner, 1u << cell->size_log2, corners, value);
}

/* Of a leaf and a cell across one of its faces: keeps the samples beyond it. after: it is the upper one. */
static void keep_beyond(const builder *b, const node *n, const node *cell, int axis, int after) {
    if (n->state != DF_CHILD_SURFACE) return;
    if (cell->state == BEYOND) {
        set_marks(b, n->leaf, MARK_EDGE);
        return;
    }
    if (cell->size_log2 < n->size_log2 || cell->leaf >> 3 == n->leaf >> 3) return;
    float *value = b->stencils->outer[df_leaf_stencil_number(b->stencils, b->field, n->leaf)][axis];
    if (cell->size_log2 == n->size_log2) face_corners(b, cell, axis, after, value);
    else if (axis == 0) read_larger(b, n, cell, 0, after, value);
    else if (axis == 1) read_larger(b, n, cell, 1, after, value);
    else read_larger(b, n, cell, 2, after, value);
}

/* Two cells that share a part of a face, `low` before it along the axis. */
static void visit_face(const builder *b, const node *low, const node *high, int axis) {
    const uint32_t u = 1u << (axis + 1) % 3, v = 1u << (axis + 2) % 3;
    keep_beyond(b, low, high, axis, 1);
    keep_beyond(b, high, low, axis, 0);
    if (!divided(low) && !divided(high)) {
        float before[4] = {0}, after[4] = {0};
        const node *part = low->size_log2 < high->size_log2 ? low : high;
        if (low->state == high->state && low->state != DF_CHILD_SURFACE) return;
        if (fits(b, low, high, axis)) return;
        if (low->state != BEYOND) face_corners(b, low, axis, 1, before);
        if (high->state != BEYOND) face_corners(b, high, axis, 0, after);
        if (!any_inside(before) && !any_inside(after)) return; /* nor between the corners */
        if (low->state != BEYOND && high->state != BEYOND) {
            narrow_face(low, part, axis, before);
            narrow_face(high, part, axis, after);
        }
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
static void visit_faces(const builder *b, const node *n) {
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

static void mark_leaves(const builder *b, uint32_t threads) {
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

/* Parts of the octree, in its order, whose records are made side by side. */
enum { PART_LEVELS = 3, PART_COUNT_MAX = 1 << 3 * PART_LEVELS };

typedef struct part {
    const builder *b;
    node cell;
    bool filling; /* the second time, when records are written and not only counted */
    bool open;    /* the current block has records */
    bool has_border;
    uint32_t block; /* the next one */
    uint64_t record;
} part;

typedef struct parts {
    uint32_t count;
    part of[PART_COUNT_MAX];
} parts;

static void begin_block(part *p, const uint32_t corner[3], uint32_t size_log2) {
    const df_surface *surface = p->b->surface;
    const uint32_t block = p->block++;
    if (!p->filling) return;
    surface->first[block] = (uint32_t)p->record;
    surface->block_log2[block] = (uint8_t)size_log2;
    for (int a = 0; a < 3; a++) surface->corner[a][block] = corner[a];
}

static void fill_record(part *p, const node *n, const uint32_t low[3]) {
    const builder *b = p->b;
    const df_surface *surface = b->surface;
    const uint8_t mark = b->marks[n->leaf];
    float *corner = (float *)surface->corners + 8 * p->record;
    uint32_t voxel = n->size_log2 << DF_SURFACE_SIZE;
    df_leaf_corners_kept(b->stencils, n->leaf, corner);
    if (n->state == DF_CHILD_SURFACE && mark & MARK_EDGE)
        b->stencils->outer[df_leaf_stencil_number(b->stencils, b->field, n->leaf)][0][0] = NAN;
    voxel |= mark & MARK_OPEN ? DF_SURFACE_WHOLE : df_surface_box(corner, b->margin / (float)(1u << n->size_log2));
    for (uint32_t a = 0; a < 3; a++) voxel |= (n->corner[a] - low[a]) << 3 * a;
    if (mark & MARK_FIRST) {
        voxel |= DF_SURFACE_BORDER;
        p->has_border = true;
    }
    surface->voxels[p->record] = voxel;
    surface->leaves[p->record] = n->leaf;
}

/* False for leaves that have no record. */
static bool may_hit(const builder *b, uint32_t family, uint32_t child) {
    const df_child_state state = df_family_state(&b->field->families[family], child);
    return state >= DF_CHILD_SURFACE || (state == DF_CHILD_INSIDE && b->marks[family << 3 | child] & MARK_OPEN);
}

/* The records of a cell. block: the cube that it is a part of; NULL: it is larger. */
static void visit_leaves(part *p, const node *n, const node *block) {
    const bool is_divided = divided(n);
    if (!block && (n->size_log2 <= 3 || !is_divided)) {
        block = n;
        p->open = false;
    }
    if (is_divided) {
        for (uint32_t c = 0; c < 8; c++) {
            if (!may_hit(p->b, n->family, c)) continue;
            const node child = child_of(p->b, n, c);
            visit_leaves(p, &child, block);
        }
        return;
    }
    if (n->state == BEYOND) return;
    if (!p->open) begin_block(p, block->corner, block->size_log2);
    p->open = true;
    if (p->filling) fill_record(p, n, block->corner);
    p->record++;
}

/* Divides a cell so far that its parts are many, but no smaller than blocks. */
static void collect_parts(parts *all, const builder *b, const node *n, uint32_t levels) {
    if (levels == 0 || n->size_log2 <= 3 || !divided(n)) {
        all->of[all->count++] = (part){.b = b, .cell = *n};
        return;
    }
    for (uint32_t c = 0; c < 8; c++) {
        if (!may_hit(b, n->family, c)) continue;
        const node child = child_of(b, n, c);
        collect_parts(all, b, &child, levels - 1);
    }
}

static void visit_parts(parts *all, uint32_t threads) {
#pragma omp parallel for schedule(dynamic) num_threads(threads)
    for (uint32_t i = 0; i < all->count; i++) {
        part *p = &all->of[i];
        visit_leaves(p, &p->cell, NULL);
    }
}

/* From what was counted in each part to where it begins; the sums are the surface's. */
static uint64_t place_parts(parts *all, df_surface *surface) {
    uint64_t records = 0;
    uint32_t blocks = 0;
    for (uint32_t i = 0; i < all->count; i++) {
        part *p = &all->of[i];
        const uint32_t own_blocks = p->block;
        const uint64_t own_records = p->record;
        p->block = blocks;
        p->record = records;
        p->filling = true;
        blocks += own_blocks;
        records += own_records;
    }
    surface->block_count = blocks;
    return records;
}

static df_status make_records(const builder *b, uint32_t threads, df_error *err) {
    const node root = root_of(b);
    df_surface *surface = b->surface;
    parts *all;
    df_status status = df_alloc((void **)&all, 1, sizeof *all, "octree", err);
    if (status != DF_OK) return status;
    collect_parts(all, b, &root, PART_LEVELS);
    visit_parts(all, threads);
    const uint64_t records = place_parts(all, surface);
    status = df_surface_alloc_blocks(surface, err);
    if (status == DF_OK)
        status =
            df_alloc((void **)&surface->block_log2, surface->block_count, sizeof *surface->block_log2, "blocks", err);
    if (status == DF_OK) status = df_surface_alloc_records(surface, records, err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&surface->leaves, records, sizeof *surface->leaves, "surface records", err);
    if (status == DF_OK) {
        surface->first[surface->block_count] = (uint32_t)records;
        visit_parts(all, threads);
        for (uint32_t i = 0; i < all->count; i++) surface->has_border = surface->has_border || all->of[i].has_border;
    }
    free(all);
    return status;
}

df_status df_surface_make_octree(const df_scene *scene, uint32_t threads, df_surface *surface, df_error *err) {
    const df_field *field = scene->field;
    builder b = {.scene = scene,
                 .field = field,
                 .surface = surface,
                 .stencils = &surface->stencils,
                 .margin = df_surface_margin(scene)};
    surface->k_shift = 3;
    surface->sample_type = DF_SAMPLE_F32;
    df_status status = df_alloc((void **)&b.marks, field->family_count, 8, "leaves", err);
    if (status == DF_OK) status = alloc_stencils(&b, err);
    if (status == DF_OK) {
        decode_samples(&b, threads);
        mark_leaves(&b, threads);
        status = make_records(&b, threads, err);
    }
    free(b.marks);
    return status;
}
