#include "convert/adf.h"

#include "common/memory.h"
#include "common/progress.h"
#include "convert/build.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Shares of the bound: what a cell's own corners may miss at the points tried, and what continuity may move them. The rest is for the
 * points between. */
#define DIVIDE_SHARE 0.7
#define IMPOSE_SHARE 0.3

#define NO_FAMILY UINT32_MAX

/* A divided cell. */
typedef struct node {
    uint32_t corner[3];
    uint32_t level;        /* of its children: 1 for those of the root */
    uint32_t children[8];  /* nodes, or NO_FAMILY */
    uint32_t crossed;      /* bit c: the surface may cross child c */
    float exact[27];       /* signed distances */
    float final[27];       /* the same, or what a larger leaf imposes; see settle */
} node;

/* A cell that may be divided, in the order of its level, and the faces that may cross it. */
typedef struct candidate {
    uint32_t corner[3];
    uint32_t parent, child; /* the node whose child it is; parent NO_FAMILY for the root */
    uint32_t *faces;        /* owned; NULL without a mesh */
    uint32_t face_count;
    bool divide;
    float samples[27];
} candidate;

typedef struct builder {
    const df_adf_input *input;
    const df_lattice *lattice;
    uint32_t level_count;
    df_winding_slab rows; /* winding numbers of all samples; empty for signed sources */
    node *nodes;
    uint32_t node_count, node_capacity;
    uint64_t samples_computed;
} builder;

/* Sides of cells on a level, in voxels. */
static uint32_t side_of(const builder *b, uint32_t level) { return 1u << (b->level_count - level); }

static void position_of(const builder *b, const uint32_t at[3], double p[3]) {
    for (int a = 0; a < 3; a++) p[a] = df_lattice_at(b->lattice, a, at[a]);
}

/* The signed distances at the 27 samples of a cell with an even side. */
static void evaluate(const builder *b, const uint32_t corner[3], uint32_t side, float out[27]) {
    uint32_t half = side / 2;
    df_lattice coarse = *b->lattice; /* powers of two scale exactly: its samples lie where the finest level's do */
    coarse.voxel_size *= half;
    df_sample_box box = {.count = {3, 3, 3}};
    for (int a = 0; a < 3; a++) box.first[a] = corner[a] / half;
    b->input->source->fill(b->input->source->context, &coarse, &box, out);
    if (b->input->source->is_signed) return;
    int32_t windings[27];
    double points[27][3], centre[3];
    for (uint32_t i = 0; i < 27; i++) {
        uint32_t at[3] = {corner[0] + i % 3 * half, corner[1] + i / 3 % 3 * half, corner[2] + i / 9 * half};
        windings[i] = df_winding_at(&b->rows, at[0], at[1], at[2]);
        position_of(b, at, points[i]);
        if (i == 13) memcpy(centre, points[i], sizeof centre);
    }
    df_sign_rule rule;
    uint32_t cap_count = b->input->sign->made.cap_count, few[64];
    uint32_t *active = cap_count <= 64 ? few : malloc(cap_count * sizeof *active);
    if (!active) abort(); /* a few kilobytes */
    df_sign_make_rule(b->input->sign, centre, side * 0.8660254037844387 * 1.000001 * b->lattice->voxel_size, active, &rule);
    df_sign_apply(&rule, windings, (const double(*)[3])points, 27, out);
    if (active != few) free(active);
}

static void corners_of(const float samples[27], float corners[8]) {
    for (int c = 0; c < 8; c++) corners[c] = samples[(c & 1) * 2 + 3 * ((c >> 1 & 1) * 2) + 9 * ((c >> 2) * 2)];
}

/* True where the corners miss one of the 27 samples by more than `bound`. */
static bool misses_samples(const float samples[27], double bound) {
    float corners[8];
    corners_of(samples, corners);
    for (int i = 0; i < 27; i++) {
        double local[3] = {(i % 3) * 0.5, (i / 3 % 3) * 0.5, (i / 9) * 0.5};
        if (fabs(df_trilinear(corners, local) - (double)samples[i]) > bound) return true;
    }
    return false;
}

/* True where they miss the zero of the distance at a point of a face by more: the face's corners, centre and middles of sides, those that lie inside. */
static bool misses_faces(const builder *b, const candidate *c, uint32_t side, double bound) {
    float corners[8];
    corners_of(c->samples, corners);
    for (uint32_t i = 0; i < c->face_count; i++) {
        const double *v[3];
        for (int n = 0; n < 3; n++) v[n] = b->input->mesh->positions + (size_t)b->input->mesh->faces[(size_t)c->faces[i] * 3 + (size_t)n] * 3;
        static const double weights[7][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {.5, .5, 0}, {0, .5, .5}, {.5, 0, .5}, {1 / 3., 1 / 3., 1 / 3.}};
        for (int w = 0; w < 7; w++) {
            double local[3];
            bool inside = true;
            for (int a = 0; a < 3; a++) {
                double x = weights[w][0] * v[0][a] + weights[w][1] * v[1][a] + weights[w][2] * v[2][a];
                local[a] = ((x - b->lattice->origin[a]) / b->lattice->voxel_size - c->corner[a]) / side;
                inside = inside && local[a] >= 0 && local[a] <= 1;
            }
            if (inside && fabs(df_trilinear(corners, local)) > bound) return true;
        }
    }
    return false;
}

/* Does a face cross a box? By the axes that may separate them: the face's box and plane, and across pairs of edges (Akenine-Moeller 2001). */
static bool face_meets(const df_mesh *mesh, uint32_t face, const double centre[3], double half) {
    const double *v[3];
    for (int n = 0; n < 3; n++) v[n] = mesh->positions + (size_t)mesh->faces[(size_t)face * 3 + (size_t)n] * 3;
    double height = 0, reach = 0;
    for (int a = 0; a < 3; a++) {
        if (fmin(v[0][a], fmin(v[1][a], v[2][a])) > centre[a] + half || fmax(v[0][a], fmax(v[1][a], v[2][a])) < centre[a] - half) return false;
    }
    for (int a = 0; a < 3; a++) {
        int i = (a + 1) % 3, j = (a + 2) % 3;
        double n = (v[1][i] - v[0][i]) * (v[2][j] - v[0][j]) - (v[1][j] - v[0][j]) * (v[2][i] - v[0][i]);
        height += n * (centre[a] - v[0][a]);
        reach += fabs(n) * half;
    }
    if (fabs(height) > reach * (1 + 1e-9)) return false;
    for (int n = 0; n < 3; n++) { /* axes across an edge of the face and one of the box */
        const double *p = v[n], *q = v[(n + 1) % 3], *r = v[(n + 2) % 3];
        for (int a = 0; a < 3; a++) {
            int i = (a + 1) % 3, j = (a + 2) % 3;
            double di = q[i] - p[i], dj = q[j] - p[j];
            double edge = di * (p[j] - centre[j]) - dj * (p[i] - centre[i]);
            double across = di * (r[j] - centre[j]) - dj * (r[i] - centre[i]);
            double radius = (fabs(di) + fabs(dj)) * half * (1 + 1e-9);
            if (fmin(edge, across) > radius || fmax(edge, across) < -radius) return false;
        }
    }
    return true;
}

/* Whether the surface may cross child `c` of a cell; with a mesh its faces go to *faces. */
static bool child_crossed(const builder *b, const candidate *parent, uint32_t side, uint32_t child, uint32_t *faces, uint32_t *count) {
    double centre[3], half = side * 0.25 * b->lattice->voxel_size;
    *count = 0;
    for (int a = 0; a < 3; a++) {
        centre[a] = b->lattice->origin[a] + (parent->corner[a] + side * (child >> a & 1 ? 0.75 : 0.25)) * b->lattice->voxel_size;
    }
    if (b->input->mesh) {
        double grown = half * (1 + 1e-9);
        for (uint32_t i = 0; i < parent->face_count; i++) {
            if (face_meets(b->input->mesh, parent->faces[i], centre, grown)) faces[(*count)++] = parent->faces[i];
        }
        return *count > 0;
    }
    double value = b->input->source->at(b->input->source->context, centre);
    return fabs(value) <= half * 1.7320508075688773 * (1 + 1e-9);
}

/* Adds the node of a cell. Returns its number, NO_FAMILY when memory is short. */
static uint32_t add_node(builder *b, const uint32_t corner[3], uint32_t level, const float samples[27]) {
    if (b->node_count == b->node_capacity) {
        uint32_t capacity = b->node_capacity * 2 + 1024;
        node *grown = capacity < DF_BRICK_COUNT_MAX ? realloc(b->nodes, capacity * sizeof *grown) : NULL;
        if (!grown) return NO_FAMILY;
        b->nodes = grown;
        b->node_capacity = capacity;
    }
    node *n = &b->nodes[b->node_count];
    memcpy(n->corner, corner, sizeof n->corner);
    n->level = level;
    n->crossed = 0;
    for (int c = 0; c < 8; c++) n->children[c] = NO_FAMILY;
    memcpy(n->exact, samples, sizeof n->exact);
    return b->node_count++;
}

/* The candidates of one level, all of one side. */
typedef struct frontier {
    candidate *cells;
    uint32_t count;
} frontier;

static void free_frontier(frontier *f) {
    for (uint32_t i = 0; i < f->count; i++) free(f->cells[i].faces);
    free(f->cells);
    *f = (frontier){0};
}

/* Decides which candidates are divided. The root always is. */
static void judge(builder *b, frontier *f, uint32_t side) {
    double bound = DIVIDE_SHARE * b->input->max_error;
#pragma omp parallel for schedule(dynamic, 8)
    for (uint32_t i = 0; i < f->count; i++) {
        candidate *c = &f->cells[i];
        evaluate(b, c->corner, side, c->samples);
        c->divide = c->parent == NO_FAMILY || misses_samples(c->samples, bound) || (b->input->mesh && misses_faces(b, c, side, bound));
    }
    b->samples_computed += 27 * (uint64_t)f->count;
}

/* Makes nodes of the divided candidates and candidates of their crossed children. */
static df_status divide_level(builder *b, frontier *f, uint32_t level, frontier *next, df_error *err) {
    uint32_t side = side_of(b, level - 1), divided = 0;
    for (uint32_t i = 0; i < f->count; i++) divided += f->cells[i].divide;
    *next = (frontier){0};
    df_status status = df_alloc((void **)&next->cells, 8 * (uint64_t)divided, sizeof *next->cells, "octree", err);
    if (status != DF_OK) return status;
    for (uint32_t i = 0; i < f->count; i++) {
        const candidate *c = &f->cells[i];
        if (!c->divide) continue;
        uint32_t number = add_node(b, c->corner, level, c->samples);
        if (number == NO_FAMILY) return df_fail(err, DF_ERROR_MEMORY, "%s: octree: out of memory", b->input->name);
        if (c->parent != NO_FAMILY) b->nodes[c->parent].children[c->child] = number;
        for (uint32_t n = 0; n < 8; n++) {
            candidate *to = &next->cells[next->count + n];
            *to = (candidate){.parent = number, .child = n};
            to->face_count = i; /* for now: the parent among the candidates */
            for (int a = 0; a < 3; a++) to->corner[a] = c->corner[a] + (n >> a & 1 ? side / 2 : 0);
        }
        next->count += 8;
    }
    bool short_of_memory = false;
#pragma omp parallel for schedule(dynamic, 64) reduction(|| : short_of_memory)
    for (uint32_t i = 0; i < next->count; i++) {
        candidate *to = &next->cells[i];
        const candidate *parent = &f->cells[to->face_count];
        to->face_count = 0;
        to->faces = b->input->mesh ? malloc((parent->face_count + 1) * sizeof *to->faces) : NULL;
        if (b->input->mesh && !to->faces) {
            short_of_memory = true;
            continue;
        }
        to->divide = child_crossed(b, parent, side, to->child, to->faces, &to->face_count); /* for now: crossed */
        uint32_t *fitted = to->faces ? realloc(to->faces, (to->face_count + 1) * sizeof *fitted) : NULL;
        if (fitted) to->faces = fitted;
    }
    uint32_t kept = 0;
    for (uint32_t i = 0; i < next->count; i++) {
        candidate *c = &next->cells[i];
        if (c->divide) {
            b->nodes[c->parent].crossed |= 1u << c->child;
            next->cells[kept++] = *c;
        } else {
            free(c->faces);
        }
    }
    next->count = kept;
    return short_of_memory ? df_fail(err, DF_ERROR_MEMORY, "%s: octree: out of memory", b->input->name) : DF_OK;
}

static df_status divide_all(builder *b, df_error *err) {
    frontier f = {0}, next = {0};
    df_status status = df_alloc((void **)&f.cells, 1, sizeof *f.cells, "octree", err);
    if (status != DF_OK) return status;
    f.count = 1;
    f.cells[0].parent = NO_FAMILY;
    if (b->input->mesh) {
        f.cells[0].face_count = b->input->mesh->face_count;
        status = df_alloc_raw((void **)&f.cells[0].faces, b->input->mesh->face_count, sizeof(uint32_t), "octree", err);
        for (uint32_t i = 0; status == DF_OK && i < b->input->mesh->face_count; i++) f.cells[0].faces[i] = i;
    }
    df_progress progress;
    df_progress_begin(&progress, "octree", b->level_count, b->input->quiet);
    for (uint32_t level = 1; status == DF_OK && level <= b->level_count && f.count; level++) {
        judge(b, &f, side_of(b, level - 1));
        status = divide_level(b, &f, level, &next, err);
        free_frontier(&f);
        f = next;
        next = (frontier){0};
        df_progress_add(&progress, 1);
    }
    df_progress_end(&progress);
    free_frontier(&f);
    return status;
}

/* A leaf: child `child` of a node. */
typedef struct leaf {
    uint32_t node, child;
    uint32_t corner[3], side;
} leaf;

/* The leaf that holds the octant of a point whose direction has bit a set for upwards; false beyond the root. */
static bool find_leaf(const builder *b, const uint32_t p[3], int octant, leaf *out) {
    uint32_t root = 1u << b->level_count;
    for (int a = 0; a < 3; a++) {
        bool up = octant >> a & 1;
        if ((up && p[a] >= root) || (!up && p[a] == 0)) return false;
    }
    *out = (leaf){.side = root};
    for (uint32_t at = 0;;) {
        const node *n = &b->nodes[at];
        out->node = at;
        out->side /= 2;
        out->child = 0;
        for (int a = 0; a < 3; a++) {
            uint32_t middle = n->corner[a] + out->side;
            bool up = p[a] > middle || (p[a] == middle && (octant >> a & 1));
            out->child |= (uint32_t)up << a;
            out->corner[a] = n->corner[a] + (up ? out->side : 0);
        }
        at = n->children[out->child];
        if (at == NO_FAMILY) return true;
    }
}

static bool is_corner(const leaf *l, const uint32_t p[3]) {
    for (int a = 0; a < 3; a++) {
        if (p[a] != l->corner[a] && p[a] != l->corner[a] + l->side) return false;
    }
    return true;
}

/* The largest leaf that touches p, a sample of node n, without having it as a corner; false where there is none. The node's own cells have all its
 * samples as corners or are finer. */
static bool find_imposing(const builder *b, const node *n, const uint32_t p[3], leaf *out) {
    bool found = false;
    uint32_t side = 2 * side_of(b, n->level);
    for (int octant = 0; octant < 8; octant++) {
        leaf l;
        bool own = true;
        for (int a = 0; a < 3; a++) own = own && (octant >> a & 1 ? p[a] < n->corner[a] + side : p[a] > n->corner[a]);
        if (own || !find_leaf(b, p, octant, &l) || is_corner(&l, p) || (found && l.side <= out->side)) continue;
        *out = l;
        found = true;
    }
    return found;
}

/* The index among a node's samples of corner `corner` of its child. */
static uint32_t corner_index(uint32_t child, uint32_t corner) {
    return (child & 1) + (corner & 1) + 3 * ((child >> 1 & 1) + (corner >> 1 & 1)) + 9 * ((child >> 2) + (corner >> 2));
}

static void sample_position(const builder *b, const node *n, uint32_t i, uint32_t p[3]) {
    uint32_t half = side_of(b, n->level);
    p[0] = n->corner[0] + i % 3 * half;
    p[1] = n->corner[1] + i / 3 % 3 * half;
    p[2] = n->corner[2] + i / 9 * half;
}

/* The leaf of at least the size of node n's cell beside it in a direction (-1, 0, 1 an axis); false where there is none, because the cell there is divided or
 * beyond the root. */
static bool find_beside(const builder *b, const node *n, const int direction[3], leaf *out) {
    uint32_t side = 2 * side_of(b, n->level), root = 1u << b->level_count, p[3];
    for (int a = 0; a < 3; a++) {
        if ((direction[a] < 0 && n->corner[a] == 0) || (direction[a] > 0 && n->corner[a] + side >= root)) return false;
        p[a] = n->corner[a] + (uint32_t)direction[a] * side;
    }
    *out = (leaf){.side = root};
    for (uint32_t at = 0; out->side > side;) {
        const node *m = &b->nodes[at];
        out->node = at;
        out->side /= 2;
        out->child = 0;
        for (int a = 0; a < 3; a++) {
            bool up = p[a] >= m->corner[a] + out->side;
            out->child |= (uint32_t)up << a;
            out->corner[a] = m->corner[a] + (up ? out->side : 0);
        }
        at = m->children[out->child];
        if (at == NO_FAMILY) return true;
    }
    return false;
}

/* Sets the final values of a node: on the border of a larger leaf, that leaf's, and of several the largest's. Such leaves belong to nodes of lower levels,
 * which must be settled. */
static void settle_node(const builder *b, node *n) {
    leaf beside[27];
    uint32_t towards[27][3], count = 0; /* 0, 1, 2 an axis for -1, 0, 1 */
    for (uint32_t d = 0; d < 27; d++) {
        const int direction[3] = {(int)(d % 3) - 1, (int)(d / 3 % 3) - 1, (int)(d / 9) - 1};
        if (d == 13 || !find_beside(b, n, direction, &beside[count])) continue;
        for (int a = 0; a < 3; a++) towards[count][a] = (uint32_t)(direction[a] + 1);
        count++;
    }
    memcpy(n->final, n->exact, sizeof n->final);
    for (uint32_t i = 0; i < 27 && count; i++) {
        const uint32_t at[3] = {i % 3, i / 3 % 3, i / 9}; /* 0 and 2 are on the cell's border, towards -1 and 1 */
        uint32_t p[3];
        const leaf *l = NULL;
        sample_position(b, n, i, p);
        for (uint32_t d = 0; d < count; d++) {
            bool touches = true;
            for (int a = 0; a < 3; a++) touches = touches && (towards[d][a] == 1 || towards[d][a] == at[a]);
            if (touches && !is_corner(&beside[d], p) && (!l || beside[d].side > l->side)) l = &beside[d];
        }
        if (!l) continue;
        float corners[8];
        double local[3];
        for (uint32_t c = 0; c < 8; c++) corners[c] = b->nodes[l->node].final[corner_index(l->child, c)];
        for (int a = 0; a < 3; a++) local[a] = (double)(p[a] - l->corner[a]) / l->side;
        n->final[i] = (float)df_trilinear(corners, local) + 0.0f;
    }
}

/* Settles all nodes, level by level. order: room for all nodes. */
static void settle(builder *b, uint32_t *order) {
    uint32_t starts[DF_LEVEL_COUNT_MAX + 2] = {0}, at[DF_LEVEL_COUNT_MAX + 2];
    for (uint32_t n = 0; n < b->node_count; n++) starts[b->nodes[n].level + 1]++;
    for (uint32_t l = 0; l <= DF_LEVEL_COUNT_MAX; l++) starts[l + 1] += starts[l];
    memcpy(at, starts, sizeof at);
    for (uint32_t n = 0; n < b->node_count; n++) order[at[b->nodes[n].level]++] = n;
    for (uint32_t level = 1; level <= b->level_count; level++) {
#pragma omp parallel for schedule(dynamic, 256)
        for (uint32_t i = starts[level]; i < starts[level + 1]; i++) settle_node(b, &b->nodes[order[i]]);
    }
}

/* Whether continuity spoils a corner of the leaf `child` of a node; then *imposing is the leaf to divide. */
static bool find_spoiled(const builder *b, const node *n, uint32_t child, double bound, leaf *imposing) {
    for (uint32_t c = 0; c < 8; c++) {
        uint32_t i = corner_index(child, c), p[3];
        if (fabs((double)n->final[i] - (double)n->exact[i]) <= bound) continue;
        sample_position(b, n, i, p);
        return find_imposing(b, n, p, imposing);
    }
    return false;
}

typedef struct leaf_key {
    uint32_t node, child;
} leaf_key;

static int compare_keys(const void *x, const void *y) {
    const leaf_key *l = x, *r = y;
    if (l->node != r->node) return l->node < r->node ? -1 : 1;
    return l->child < r->child ? -1 : l->child > r->child;
}

/* Lists the leaves that must be divided, without repetition, in order. keys: room for 8 a node. */
static uint32_t list_spoiling(const builder *b, leaf_key *keys) {
    double bound = IMPOSE_SHARE * b->input->max_error;
    uint32_t count = 0;
#pragma omp parallel for schedule(dynamic, 256)
    for (uint32_t n = 0; n < b->node_count; n++) {
        for (uint32_t c = 0; c < 8; c++) {
            leaf imposing = {0};
            if (!(b->nodes[n].crossed >> c & 1) || b->nodes[n].children[c] != NO_FAMILY) continue;
            if (!find_spoiled(b, &b->nodes[n], c, bound, &imposing) || imposing.side < 2) continue;
            uint32_t at;
#pragma omp atomic capture
            at = count++;
            keys[at] = (leaf_key){imposing.node, imposing.child};
        }
    }
    qsort(keys, count, sizeof *keys, compare_keys);
    uint32_t unique = 0;
    for (uint32_t i = 0; i < count; i++) {
        if (i == 0 || compare_keys(&keys[i], &keys[i - 1]) != 0) keys[unique++] = keys[i];
    }
    return unique;
}

/* The children of a new node that the surface may cross: no corner of theirs is further from it than their diagonal. */
static uint32_t guess_crossed(const builder *b, const node *n) {
    double diagonal = side_of(b, n->level) * 1.7320508075688773 * 1.000001 * b->lattice->voxel_size;
    uint32_t crossed = 0;
    for (uint32_t c = 0; c < 8; c++) {
        bool near = true;
        for (uint32_t i = 0; i < 8; i++) near = near && fabs((double)n->exact[corner_index(c, i)]) <= diagonal;
        crossed |= (uint32_t)near << c;
    }
    return crossed;
}

/* Divides leaves. */
static df_status divide_leaves(builder *b, const leaf_key *keys, uint32_t count, df_error *err) {
    float(*samples)[27];
    df_status status = df_alloc_raw((void **)&samples, count, sizeof *samples, "octree", err);
    if (status != DF_OK) return status;
#pragma omp parallel for schedule(dynamic, 16)
    for (uint32_t i = 0; i < count; i++) {
        const node *n = &b->nodes[keys[i].node];
        uint32_t side = side_of(b, n->level), corner[3];
        for (int a = 0; a < 3; a++) corner[a] = n->corner[a] + (keys[i].child >> a & 1 ? side : 0);
        evaluate(b, corner, side, samples[i]);
    }
    for (uint32_t i = 0; status == DF_OK && i < count; i++) {
        uint32_t from = keys[i].node, child = keys[i].child, side = side_of(b, b->nodes[from].level), corner[3];
        for (int a = 0; a < 3; a++) corner[a] = b->nodes[from].corner[a] + (child >> a & 1 ? side : 0);
        uint32_t number = add_node(b, corner, b->nodes[from].level + 1, samples[i]);
        if (number == NO_FAMILY) status = df_fail(err, DF_ERROR_MEMORY, "%s: octree: out of memory", b->input->name);
        else b->nodes[from].children[child] = number;
        if (status == DF_OK && (b->nodes[from].crossed >> child & 1)) b->nodes[number].crossed = guess_crossed(b, &b->nodes[number]);
    }
    b->samples_computed += 27 * (uint64_t)count;
    free(samples);
    return status;
}

static df_status make_continuous(builder *b, df_adf_report *report, df_error *err) {
    for (;;) {
        leaf_key *keys;
        df_status status = df_alloc_raw((void **)&keys, 8 * (uint64_t)b->node_count, sizeof *keys, "octree", err);
        if (status != DF_OK) return status;
        settle(b, (uint32_t *)keys); /* the list comes after */
        uint32_t count = list_spoiling(b, keys);
        if (count) status = divide_leaves(b, keys, count, err);
        free(keys);
        report->divided_for_continuity += count;
        if (status != DF_OK || count == 0) return status;
    }
}

/* Writes nodes as families, breadth first: order[i] is the node of family i. */
static void number_families(const builder *b, uint32_t *order, df_family *families) {
    uint32_t count = 1;
    order[0] = 0;
    for (uint32_t f = 0; f < count; f++) {
        const node *n = &b->nodes[order[f]];
        families[f] = (df_family){0, 0};
        for (uint32_t c = 0; c < 8; c++) {
            if (n->children[c] == NO_FAMILY) continue;
            if (families[f].first_child == 0) families[f].first_child = count;
            families[f].states |= (uint32_t)DF_CHILD_FAMILY << 2 * c;
            order[count++] = n->children[c];
        }
    }
    assert(count == b->node_count);
}

/* The final samples of one family, and the states of its leaves. Returns the number of leaves. */
static uint32_t finish_family(const builder *b, uint32_t number, float samples[27], df_family *family) {
    const node *n = &b->nodes[number];
    uint32_t leaves = 0;
    memcpy(samples, n->final, sizeof n->final);
    for (uint32_t c = 0; c < 8; c++) {
        if (n->children[c] != NO_FAMILY) continue;
        int inside = 0;
        for (uint32_t i = 0; i < 8; i++) inside += samples[corner_index(c, i)] < 0;
        df_child_state state = inside == 0 ? DF_CHILD_OUTSIDE : inside == 8 ? DF_CHILD_INSIDE : DF_CHILD_SURFACE;
        family->states |= (uint32_t)state << 2 * c;
        leaves++;
    }
    return leaves;
}

static df_status store(const builder *b, df_field *field, df_adf_report *report, df_error *err) {
    uint32_t *order = NULL;
    df_family *families = NULL;
    float *samples = NULL;
    uint64_t leaves = 0;
    df_status status = df_alloc_raw((void **)&order, b->node_count, sizeof *order, "octree", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&families, b->node_count, sizeof *families, "octree", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&samples, b->node_count, 27 * sizeof *samples, "octree", err);
    if (status != DF_OK) goto done;
    number_families(b, order, families);
#pragma omp parallel for schedule(dynamic, 256) reduction(+ : leaves)
    for (uint32_t f = 0; f < b->node_count; f++) leaves += finish_family(b, order[f], samples + (size_t)f * 27, &families[f]);
    report->leaves = leaves;
    field->kind = DF_FIELD_ADF;
    field->sample_type = DF_SAMPLE_F32;
    field->error_max = field->error_rms = -1;
    for (int a = 0; a < 3; a++) {
        field->voxel_count[a] = b->lattice->voxel_count[a];
        field->voxel_size[a] = b->lattice->voxel_size;
        field->origin[a] = b->lattice->origin[a];
    }
    field->level_count = b->level_count;
    field->family_count = b->node_count;
    field->families = families;
    field->samples = samples;
    df_field_own(field, families);
    df_field_own(field, samples);
    families = NULL;
    samples = NULL;
    status = df_field_finish(field, b->input->name, err);
done:
    free(order);
    free(families);
    free(samples);
    return status;
}

/* Winding numbers of all rows; on an oriented mesh where one below 0 shows that a body may be inside out. */
static df_status find_rows(builder *b, df_error *err) {
    df_sign *sign = b->input->sign;
    const df_lattice *l = b->lattice;
    for (int turn = 0; turn < 2; turn++) {
        df_status status = df_winding_slab_find(&b->rows, sign->mesh, NULL, sign->mesh->face_count, l, 0, l->voxel_count[2] + 1, err);
        if (status != DF_OK || turn == 1 || sign->mesh != b->input->mesh || sign->method == DF_SIGN_PARITY ||
            !df_winding_has_negative(&b->rows)) {
            return status;
        }
        status = df_sign_orient(sign, b->input->mesh, err);
        if (status != DF_OK || sign->made.inverted_components == 0) return status;
    }
    return DF_OK;
}

df_status df_adf_build(const df_adf_input *input, df_field *field, df_adf_report *report, df_error *err) {
    builder b = {.input = input, .lattice = input->lattice, .level_count = 1};
    *report = (df_adf_report){0};
    for (int a = 0; a < 3; a++) {
        while (1u << b.level_count < input->lattice->voxel_count[a]) b.level_count++;
    }
    double start = df_now_ms();
    df_status status = input->source->is_signed ? DF_OK : find_rows(&b, err);
    double signs = df_now_ms();
    if (status == DF_OK) status = divide_all(&b, err);
    double divided = df_now_ms();
    if (status == DF_OK) status = make_continuous(&b, report, err);
    double continuous = df_now_ms();
    if (status == DF_OK) status = store(&b, field, report, err);
    report->samples_computed = b.samples_computed;
    report->sign_ms = signs - start;
    report->divide_ms = divided - signs;
    report->continuity_ms = continuous - divided;
    report->structure_ms = df_now_ms() - continuous;
    if (status != DF_OK) df_field_free(field);
    df_winding_slab_free(&b.rows);
    free(b.nodes);
    return status;
}
