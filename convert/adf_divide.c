/*
 * Division of cells by their error, depth first: each thread takes whole subtrees, and down a subtree hands on the list
 * of the faces that can be nearest to a point of the cell, which shrinks on the way.
 */
#include "common/memory.h"
#include "convert/adf_tree.h"
#include "convert/smaller.h"

#include <assert.h>
#include <math.h>
#include <omp.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* What the best fit of a cell may miss at the points tried, of the largest error: the rest is for points between, and
 * for what neighbours ask. */
#define DIVIDE_SHARE 0.7
/* Cells down to this level are put up for any thread. */
#define SHARED_LEVEL ADF_PILOT_LEVEL
/* The longest list; cells with more faces are searched sample by sample. */
#define LIST_MAX 8192
/* Above this the tree is searched all the same: that is quicker. */
#define LIST_SEARCH 2048
/* Above this a list is shrunk by spheres around the faces, below by their distances. */
#define LIST_SPHERES 48

/* The samples at quarters of a divided cell's side, 5 x 5 x 5, that its children share. */
typedef struct quarters {
    float values[125];
    bool known[125];
} quarters;

/* A cell with what its parents know of it. */
typedef struct cell {
    uint32_t corner[3], level; /* of the cell itself: 0 for the root */
    uint32_t parent, child;
    quarters *quarters;    /* of the parent; NULL for the root */
    const uint32_t *faces; /* that can be nearest; NULL: too many */
    uint32_t face_count;
    uint32_t close_count; /* the first so many may cross the cell */
    bool crossed;         /* one of them does; otherwise not known */
    bool clear;           /* no face is near enough to cross it */
    bool forced;
} cell;

/* Which of a cell's children each face of its list matters to, by bit. */
typedef struct selection {
    uint8_t near[LIST_MAX];  /* the face can be nearest to a point of the child */
    uint8_t close[LIST_MAX]; /* it may cross the child */
    uint8_t crossed;         /* by child: a face surely does */
} selection;

/* What a thread works with. */
typedef struct worker {
    adf_tree *tree;
    uint32_t chunk, used; /* nodes used of its chunk */
    uint32_t nearest;     /* a face near the last point */
    uint32_t *active;     /* for sign rules */
    uint64_t samples_computed;
    uint32_t node_count; /* made */
    df_status status;    /* DF_ERROR_MEMORY when memory ran out */
    adf_task *later;     /* cells put up for any thread */
    uint32_t later_count, later_capacity;
    uint32_t lists[DF_LEVEL_COUNT_MAX + 1][LIST_MAX]; /* by level */
    selection selections[DF_LEVEL_COUNT_MAX + 1];     /* by level, of the cell that is being worked at there */
    uint32_t others[LIST_MAX];
    float distances[LIST_MAX * 8];
} worker;

/* ---- samples ---- */

static double side_world(const worker *w, const cell *c) {
    return adf_side(w->tree, c->level) * w->tree->input->lattice->voxel_size;
}

static void centre_of(const worker *w, const cell *c, double centre[3]) {
    const df_lattice *l = w->tree->input->lattice;
    double half = adf_side(w->tree, c->level) / 2.0;
    for (int a = 0; a < 3; a++) centre[a] = l->origin[a] + (c->corner[a] + half) * l->voxel_size;
}

static void sample_at(const cell *c, uint32_t half, uint32_t s, uint32_t at[3]) {
    at[0] = c->corner[0] + s % 3 * half;
    at[1] = c->corner[1] + s / 3 % 3 * half;
    at[2] = c->corner[2] + s / 9 * half;
}

/* The distances of up to 8 samples, by the faces listed or, without a list, by a search. */
static void measure_eight(worker *w, const cell *c, const double points[3][8], uint32_t count, double distances[8]) {
    const df_face_tree *tree = w->tree->input->tree;
    if (c->faces && c->face_count <= LIST_SEARCH) {
        df_face_distances_of_near(tree, c->faces, c->face_count, points, w->distances, w->others, distances);
    } else {
        for (uint32_t i = 0; i < count; i++) {
            distances[i] =
                df_face_tree_nearest(tree, (double[3]){points[0][i], points[1][i], points[2][i]}, &w->nearest);
        }
    }
    for (uint32_t i = 0; i < count; i++) distances[i] = sqrt(distances[i]);
}

/* Gives samples their sign. `which`: their numbers among the 27. */
static void sign_samples(worker *w, const cell *c, const uint8_t *which, uint32_t count, float *values) {
    const adf_tree *t = w->tree;
    const df_lattice *l = t->input->lattice;
    uint32_t half = adf_side(t, c->level) / 2;
    int32_t windings[27];
    double points[27][3], centre[3];
    for (uint32_t i = 0; i < count; i++) {
        uint32_t at[3], slab;
        sample_at(c, half, which[i], at);
        slab = at[2] / ADF_SLAB;
        windings[i] = slab < t->slab_count ? df_winding_at(&t->slabs[slab], at[0], at[1], at[2]) : 0;
        for (int a = 0; a < 3; a++) points[i][a] = df_lattice_at(l, a, at[a]);
    }
    df_sign_rule rule;
    centre_of(w, c, centre);
    df_sign_make_rule(t->input->sign, centre, side_world(w, c) * 0.8660254037844387 * 1.000001, w->active, &rule);
    df_sign_apply(&rule, windings, (const double(*)[3])points, count, values);
}

/* The samples listed, by the tree of faces. */
static void sample_faces(worker *w, const cell *c, const uint8_t *which, uint32_t count, float samples[27]) {
    const df_lattice *l = w->tree->input->lattice;
    uint32_t half = adf_side(w->tree, c->level) / 2;
    float values[27];
    for (uint32_t first = 0; first < count; first += 8) {
        double points[3][8], distances[8];
        uint32_t n = count - first < 8 ? count - first : 8;
        for (uint32_t i = 0; i < 8; i++) {
            uint32_t at[3];
            sample_at(c, half, which[first + (i < n ? i : 0)], at);
            for (int a = 0; a < 3; a++) points[a][i] = df_lattice_at(l, a, at[a]);
        }
        measure_eight(w, c, (const double(*)[8])points, n, distances);
        for (uint32_t i = 0; i < n; i++) values[first + i] = df_distance_round(distances[i]);
    }
    sign_samples(w, c, which, count, values);
    for (uint32_t i = 0; i < count; i++) samples[which[i]] = values[i];
}

/* All samples, by the source: a box of its lattice made coarser. Powers of two scale exactly. */
static void sample_source(worker *w, const cell *c, float samples[27]) {
    static const uint8_t all[27] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13,
                                    14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26};
    const df_adf_input *in = w->tree->input;
    uint32_t half = adf_side(w->tree, c->level) / 2;
    df_lattice coarse = *in->lattice;
    df_sample_box box = {.count = {3, 3, 3}};
    coarse.voxel_size *= half;
    for (int a = 0; a < 3; a++) box.first[a] = c->corner[a] / half;
    in->source->fill(in->source->context, &coarse, &box, samples);
    if (!in->source->is_signed) sign_samples(w, c, all, 27, samples);
}

/* Which of the parent's quarters is a sample of a child. */
static uint32_t quarter_of(uint32_t child, uint32_t sample) {
    return 2 * (child & 1) + sample % 3 +
           5 * (2 * (child >> 1 & 1) + sample / 3 % 3 + 5 * (2 * (child >> 2) + sample / 9));
}

/* Starts with the samples of the cell itself. */
static void start_quarters(quarters *q, const float samples[27]) {
    memset(q->known, 0, sizeof q->known);
    for (uint32_t s = 0; s < 27; s++) {
        const uint32_t at = 2 * (s % 3 + 5 * (s / 3 % 3 + 5 * (s / 9)));
        q->values[at] = samples[s];
        q->known[at] = true;
    }
}

/* The signed distances at the 27 samples of a cell with an even side. */
static void sample_cell(worker *w, const cell *c, float samples[27]) {
    quarters *q = c->quarters;
    uint8_t which[27];
    uint32_t count = 0;
    if (!w->tree->input->tree_is_source) {
        sample_source(w, c, samples);
        w->samples_computed += 27;
        return;
    }
    for (uint32_t s = 0; s < 27; s++) {
        const uint32_t at = quarter_of(c->child, s);
        if (q && q->known[at]) samples[s] = q->values[at];
        else which[count++] = (uint8_t)s;
    }
    sample_faces(w, c, which, count, samples);
    w->samples_computed += count;
    for (uint32_t i = 0; q && i < count; i++) {
        const uint32_t at = quarter_of(c->child, which[i]);
        q->values[at] = samples[which[i]];
        q->known[at] = true;
    }
}

/* ---- error ---- */

/* The line that fits three values best, the middle one with weight 4 (Simpson's rule): its ends. */
static void fit_line(const double v[3], double *low, double *high) {
    *low = (2 * v[0] + 2 * v[1] - v[2]) / 3;
    *high = (-v[0] + 2 * v[1] + 2 * v[2]) / 3;
}

/* The corners of the trilinear function that fits 27 samples best: lines along x, then y, then z. */
static void fit_cell(const float samples[27], float fit[8]) {
    double x[2][9], y[4][3], v[3];
    for (int i = 0; i < 9; i++) {
        for (int n = 0; n < 3; n++) v[n] = (double)samples[3 * i + n];
        fit_line(v, &x[0][i], &x[1][i]);
    }
    for (int i = 0; i < 6; i++) { /* by x and z */
        for (int n = 0; n < 3; n++) v[n] = x[i & 1][(i >> 1) * 3 + n];
        fit_line(v, &y[i & 1][i >> 1], &y[2 | (i & 1)][i >> 1]);
    }
    for (int i = 0; i < 4; i++) {
        double low, high;
        fit_line(y[i], &low, &high);
        fit[i] = (float)low;
        fit[4 | i] = (float)high;
    }
}

/* How well a function fits a cell. */
typedef struct misfit {
    float left[27]; /* errors at the samples */
    double rms, largest;
    double at_face, face[3]; /* the largest error at a point of a face, and where that is, in sides of the cell */
} misfit;

static void find_misfit_at_samples(const float samples[27], const float corners[8], misfit *m) {
    double sum = 0;
    for (uint32_t s = 0; s < 27; s++) {
        double weight = (s % 3 == 1 ? 4 : 1) * (s / 3 % 3 == 1 ? 4 : 1) * (s / 9 == 1 ? 4 : 1);
        m->left[s] = df_family_predict(corners, s) - samples[s];
        m->largest = fmax(m->largest, fabs((double)m->left[s]));
        sum += weight * (double)m->left[s] * (double)m->left[s];
    }
    m->rms = sqrt(sum / 216);
}

/* The same at points of the faces inside a cell, where the distance is 0: their corners, centre and middles of sides.
 */
static void find_misfit_at_faces(const worker *w, const cell *c, const float corners[8], misfit *m) {
    static const double weights[7][2] = {{0, 0}, {1, 0}, {0, 1}, {.5, 0}, {0, .5}, {.5, .5}, {1 / 3., 1 / 3.}};
    const df_lattice *l = w->tree->input->lattice;
    double inverse = 1 / side_world(w, c), low[3];
    for (int a = 0; a < 3; a++) low[a] = l->origin[a] + c->corner[a] * l->voxel_size;
    for (uint32_t i = 0; i < c->close_count; i++) {
        const df_face *f = &w->tree->input->tree->faces[c->faces[i]];
        double at[3], u[3], v[3];
        for (int a = 0; a < 3; a++) {
            at[a] = (f->a[a] - low[a]) * inverse;
            u[a] = f->ab[a] * inverse;
            v[a] = f->ac[a] * inverse;
        }
        for (int n = 0; n < 7; n++) {
            const double p = weights[n][0], q = weights[n][1];
            const double local[3] = {at[0] + p * u[0] + q * v[0], at[1] + p * u[1] + q * v[1],
                                     at[2] + p * u[2] + q * v[2]};
            if (!(local[0] >= 0 && local[0] <= 1 && local[1] >= 0 && local[1] <= 1 && local[2] >= 0 && local[2] <= 1))
                continue;
            double error = df_trilinear(corners, local);
            if (fabs(error) <= fabs(m->at_face)) continue;
            m->at_face = error;
            memcpy(m->face, local, sizeof local);
        }
    }
    m->largest = fmax(m->largest, fabs(m->at_face));
}

/* Leaves a cell's fit with its parent. */
static void keep_fit(adf_node *parent, uint32_t child, const float samples[27], const float fit[8], const misfit *m) {
    const double scale = m->largest > 0 ? 127 / m->largest : 0;
    parent->fitted[child] = 1;
    parent->misfit[child] = (float)m->largest;
    for (uint32_t i = 0; i < 8; i++) parent->fit[child][i] = fit[i] - samples[df_family_corner(i, i)];
    for (uint32_t s = 0; s < 27; s++) parent->left[child][s] = (int8_t)nearbyint((double)m->left[s] * scale);
    parent->at_face[child] = (int8_t)nearbyint(m->at_face * scale);
    for (int a = 0; a < 3; a++) parent->face[child][a] = (uint8_t)nearbyint(m->face[a] * 255);
}

/* Decides whether a cell is divided; where not, its fit goes to the parent. */
static bool judge(const worker *w, const cell *c, const float samples[27]) {
    const double bound = DIVIDE_SHARE * w->tree->input->max_error;
    adf_node *parent = adf_node_at(w->tree, c->parent);
    float fit[8];
    misfit m = {.largest = 0};
    fit_cell(samples, fit);
    find_misfit_at_samples(samples, fit, &m);
    parent->rms[c->child] = (float)m.rms;
    parent->misfit[c->child] = (float)m.largest;
    if (!(m.largest <= bound) || m.rms * adf_side(w->tree, c->level) > w->tree->slope) return true;
    if (c->faces) find_misfit_at_faces(w, c, fit, &m);
    if (m.largest > bound) return true;
    keep_fit(parent, c->child, samples, fit, &m);
    return false;
}

/* ---- faces ---- */

/* Does a face cross a box? By the axes that may separate them: the face's box and plane, and across pairs of edges
 * (Akenine-Moeller 2001). */
static bool face_meets(const df_face *face, const double centre[3], double half) {
    double v[3][3], height = 0, reach = 0;
    for (int a = 0; a < 3; a++) {
        v[0][a] = face->a[a] - centre[a];
        v[1][a] = v[0][a] + face->ab[a];
        v[2][a] = v[0][a] + face->ac[a];
        if (df_smaller(v[0][a], df_smaller(v[1][a], v[2][a])) > half ||
            df_larger(v[0][a], df_larger(v[1][a], v[2][a])) < -half)
            return false;
        height += face->normal[a] * v[0][a];
        reach += fabs(face->normal[a]) * half;
    }
    if (fabs(height) > reach * (1 + 1e-9)) return false;
    for (int n = 0; n < 3; n++) { /* axes across an edge of the face and one of the box */
        const double *p = v[n], *q = v[(n + 1) % 3], *r = v[(n + 2) % 3];
        for (int a = 0; a < 3; a++) {
            int i = (a + 1) % 3, j = (a + 2) % 3;
            double di = q[i] - p[i], dj = q[j] - p[j];
            double edge = di * p[j] - dj * p[i], across = di * r[j] - dj * r[i];
            double radius = (fabs(di) + fabs(dj)) * half * (1 + 1e-9);
            if (df_smaller(edge, across) > radius || df_larger(edge, across) < -radius) return false;
        }
    }
    return true;
}

/* Whether the surface may cross a cell. */
static bool is_crossed(const worker *w, const cell *c) {
    const df_adf_input *in = w->tree->input;
    double centre[3], half = side_world(w, c) / 2;
    if (!in->tree) return in->crosses(in->crosses_context, c->corner, adf_side(w->tree, c->level));
    if (c->clear) return false;
    if (!c->faces || c->crossed) return true;
    centre_of(w, c, centre);
    for (uint32_t i = 0; i < c->close_count; i++) {
        if (face_meets(&in->tree->faces[c->faces[i]], centre, half * (1 + 1e-9))) return true;
    }
    return false;
}

/* Lists the faces that can be nearest to a point of a cell; c->faces stays NULL where they are too many. */
static void list_faces(worker *w, cell *c) {
    const df_face_tree *tree = w->tree->input->tree;
    double centre[3];
    if (!tree) return;
    centre_of(w, c, centre);
    double least = sqrt(df_face_tree_nearest(tree, centre, &w->nearest));
    c->clear = least > side_world(w, c) * 0.8660254037844387 * (1 + 1e-9);
    if (c->clear && !c->forced) return;
    double reach = (least + side_world(w, c) * 1.7320508075688773) * (1 + 1e-9);
    c->face_count = df_face_tree_list(tree, centre, reach, w->lists[c->level], LIST_MAX);
    if (c->face_count <= LIST_MAX) c->faces = w->lists[c->level];
    c->close_count = c->face_count;
}

/* Selects by spheres around the faces, for long lists. */
static void select_by_spheres(worker *w, const cell *c, const df_face_boxes *boxes, double diagonal) {
    const df_face_tree *tree = w->tree->input->tree;
    selection *s = &w->selections[c->level];
    df_face_select(tree, c->faces, c->face_count, boxes, w->distances, s->near);
    for (uint32_t f = 0; f < c->face_count; f++) {
        float reach =
            ((float)(diagonal * tree->scale) + tree->spheres[c->faces[f]].radius + (float)tree->slack) * 1.000001f;
        s->close[f] = 0;
        for (int i = 0; i < 8; i++) s->close[f] |= (uint8_t)((w->distances[f * 8 + i] <= reach * reach) << i);
    }
    s->crossed = 0;
}

/* Selects by the distances of the children's centres. */
static void select_by_distances(worker *w, const cell *c, const df_face_boxes *boxes, double diagonal) {
    selection *s = &w->selections[c->level];
    double distances[LIST_SPHERES][8], least[8], reach[8], touch = diagonal * (1 + 1e-9),
                                                           inside = boxes->half[0][0] * (1 - 1e-9);
    df_face_distances(w->tree->input->tree->faces, c->faces, c->face_count, (const double(*)[8])boxes->centre,
                      distances[0], least);
    s->crossed = 0;
    for (int i = 0; i < 8; i++) {
        reach[i] = (sqrt(least[i]) + 2 * diagonal) * (1 + 1e-9);
        reach[i] *= reach[i];
        s->crossed |= (uint8_t)((least[i] < inside * inside) << i);
    }
    for (uint32_t f = 0; f < c->face_count; f++) {
        s->near[f] = s->close[f] = 0;
        for (int i = 0; i < 8; i++) {
            s->near[f] |= (uint8_t)((distances[f][i] <= reach[i]) << i);
            s->close[f] |= (uint8_t)((distances[f][i] <= touch * touch) << i);
        }
    }
}

/* Finds which faces of a cell's list matter to its children. */
static void select_faces(worker *w, const cell *c) {
    double centre[3], quarter = side_world(w, c) / 4;
    df_face_boxes boxes;
    centre_of(w, c, centre);
    for (int i = 0; i < 8; i++) {
        for (int a = 0; a < 3; a++) {
            boxes.centre[a][i] = centre[a] + (i >> a & 1 ? quarter : -quarter);
            boxes.half[a][i] = quarter;
        }
    }
    if (c->face_count > LIST_SPHERES) select_by_spheres(w, c, &boxes, quarter * 1.7320508075688773);
    else select_by_distances(w, c, &boxes, quarter * 1.7320508075688773);
}

/* Hands a child of a cell its part of the list, the faces that may cross it first. */
static void hand_faces(worker *w, const cell *c, cell *child) {
    const selection *s = &w->selections[c->level];
    uint32_t *list = w->lists[child->level], others = 0, i = child->child;
    for (uint32_t f = 0; f < c->face_count; f++) {
        const uint32_t near = s->near[f] >> i & 1u, close = near & s->close[f] >> i;
        list[child->close_count] = w->others[others] = c->faces[f];
        child->close_count += close;
        others += near ^ close;
    }
    memcpy(list + child->close_count, w->others, others * sizeof *list);
    child->face_count = child->close_count + others;
    child->faces = list;
    child->crossed = s->crossed >> i & 1;
}

/* ---- the walk ---- */

/* A new node; ADF_NONE when memory is short. */
static uint32_t add_node(worker *w, const cell *c) {
    adf_tree *t = w->tree;
    if (w->chunk == ADF_NONE || w->used == ADF_CHUNK) {
        uint32_t chunk;
#pragma omp atomic capture
        chunk = t->chunk_count++;
        if (chunk < ADF_CHUNK_COUNT) t->chunks[chunk] = malloc(ADF_CHUNK * sizeof **t->chunks);
        if (chunk >= ADF_CHUNK_COUNT || !t->chunks[chunk]) {
            w->status = DF_ERROR_MEMORY;
            return ADF_NONE;
        }
        w->chunk = chunk;
        w->used = 0;
    }
    uint32_t number = w->chunk * ADF_CHUNK + w->used++;
    adf_node *n = adf_node_at(t, number);
    memset(n, 0, sizeof *n);
    memcpy(n->corner, c->corner, sizeof n->corner);
    n->level = c->level + 1;
    w->node_count++;
    for (int i = 0; i < 8; i++) n->children[i] = ADF_NONE;
    if (c->parent == ADF_NONE) return number;
    adf_node *parent = adf_node_at(t, c->parent);
    n->parent = 8 * c->parent + c->child;
    parent->children[c->child] = number;
    parent->fitted[c->child] = 0;
    return number;
}

static void put_up(worker *w, uint32_t parent, uint32_t child) {
    if (w->later_count == w->later_capacity) {
        uint32_t capacity = w->later_capacity * 2 + 64;
        adf_task *grown = realloc(w->later, capacity * sizeof *grown);
        if (!grown) {
            w->status = DF_ERROR_MEMORY;
            return;
        }
        w->later = grown;
        w->later_capacity = capacity;
    }
    w->later[w->later_count++] = (adf_task){.parent = parent, .child = child};
}

static void child_of(const worker *w, const adf_node *n, uint32_t number, uint32_t child, cell *c) {
    uint32_t side = adf_side(w->tree, n->level);
    *c = (cell){.level = n->level, .parent = number, .child = child};
    for (int a = 0; a < 3; a++) c->corner[a] = n->corner[a] + (child >> a & 1) * side;
}

/* Divides a cell where that is needed, and what comes of it. */
static void work_at(worker *w, const cell *c) {
    float samples[27];
    const bool crossed = is_crossed(w, c);
    if (!c->forced && !crossed) return;
    if (c->parent != ADF_NONE && crossed) adf_node_at(w->tree, c->parent)->crossed[c->child] = 1;
    if (adf_side(w->tree, c->level) == 1) return;
    sample_cell(w, c, samples);
    if (!c->forced && !judge(w, c, samples)) return;
    uint32_t number = add_node(w, c);
    if (number == ADF_NONE) return;
    adf_node *n = adf_node_at(w->tree, number);
    memcpy(n->exact, samples, sizeof samples);
    bool shared = n->level <= SHARED_LEVEL || (w->tree->input->tree && !c->faces);
    if (c->faces && !shared) select_faces(w, c);
    quarters q;
    start_quarters(&q, n->exact);
    for (uint32_t child = 0; child < 8 && w->status == DF_OK; child++) {
        cell below;
        if (shared) {
            put_up(w, number, child);
            continue;
        }
        child_of(w, n, number, child, &below);
        below.quarters = &q;
        if (c->faces) hand_faces(w, c, &below);
        work_at(w, &below);
    }
}

/* A choice that is even over space and depends on the place alone. */
static bool is_pilot(const worker *w, const cell *c) {
    uint64_t side = adf_side(w->tree, c->level), key = 0;
    for (int a = 0; a < 3; a++) key = key << 16 | c->corner[a] / side;
    return (key + 1) * 0x9E3779B97F4A7C15u >> 40 < (1u << 24) / ADF_PILOT_PART;
}

static void work_at_task(worker *w, const adf_task *task) {
    cell c = {.parent = ADF_NONE};
    quarters q;
    if (task->parent != ADF_NONE) {
        const adf_node *n = adf_node_at(w->tree, task->parent);
        child_of(w, n, task->parent, task->child, &c);
        start_quarters(&q, n->exact);
        c.quarters = &q;
    }
    c.forced = task->forced;
    if (w->tree->pilot && c.level == ADF_PILOT_LEVEL && !is_pilot(w, &c)) return;
    list_faces(w, &c);
    work_at(w, &c);
}

static void free_workers(worker **workers, int count) {
    for (int i = 0; workers && i < count; i++) {
        if (workers[i]) {
            free(workers[i]->later);
            free(workers[i]->active);
        }
        free(workers[i]);
    }
    free(workers);
}

static df_status make_workers(adf_tree *t, int count, worker ***workers, df_error *err) {
    uint64_t caps = t->input->sign ? t->input->sign->made.cap_count : 0;
    df_status status = df_alloc((void **)workers, (uint64_t)count, sizeof **workers, "octree", err);
    for (int i = 0; status == DF_OK && i < count; i++) {
        status = df_alloc_raw((void **)&(*workers)[i], 1, sizeof *(*workers)[i], "octree", err);
        if (status != DF_OK) break;
        memset((*workers)[i], 0, offsetof(worker, lists));
        (*workers)[i]->tree = t;
        (*workers)[i]->chunk = ADF_NONE;
        status = df_alloc_raw((void **)&(*workers)[i]->active, caps + 1, sizeof(uint32_t), "octree", err);
    }
    return status;
}

/* Moves what the workers have put up to a list of its own. */
static df_status collect(worker **workers, int worker_count, adf_task **tasks, uint32_t *count, df_error *err) {
    uint64_t total = 0;
    for (int i = 0; i < worker_count; i++) total += workers[i]->later_count;
    free(*tasks);
    *tasks = NULL;
    *count = 0;
    df_status status = df_alloc_raw((void **)tasks, total, sizeof **tasks, "octree", err);
    for (int i = 0; status == DF_OK && i < worker_count; i++) {
        if (workers[i]->later_count)
            memcpy(*tasks + *count, workers[i]->later, workers[i]->later_count * sizeof **tasks);
        *count += workers[i]->later_count;
        workers[i]->later_count = 0;
    }
    return status;
}

df_status adf_divide(adf_tree *t, const adf_task *tasks, uint32_t count, df_error *err) {
    int worker_count = omp_get_max_threads();
    worker **workers = NULL;
    adf_task *more = NULL;
    df_status status = make_workers(t, worker_count, &workers, err);
    while (status == DF_OK && count) {
        /* neighbours in the list are near each other: their searches help each other */
#pragma omp parallel for schedule(dynamic, count > 4096 ? 16 : 1)
        for (uint32_t i = 0; i < count; i++) {
            worker *w = workers[omp_get_thread_num()];
            if (w->status == DF_OK) work_at_task(w, &tasks[i]);
        }
        for (int i = 0; i < worker_count; i++) {
            if (workers[i]->status != DF_OK)
                status = df_fail(err, DF_ERROR_MEMORY, "%s: octree: out of memory", t->input->name);
        }
        if (status == DF_OK) status = collect(workers, worker_count, &more, &count, err);
        tasks = more;
    }
    for (int i = 0; status == DF_OK && i < worker_count; i++) {
        t->samples_computed += workers[i]->samples_computed;
        t->family_count += workers[i]->node_count;
    }
    free(more);
    free_workers(workers, worker_count);
    return status;
}
