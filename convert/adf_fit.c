/*
 * The samples that are stored, from the exact ones.
 *
 * A sample that is new in a family (not a corner of the divided cell) hangs where a cell of that cell's size beside it
 * is a part of a leaf: there it takes the mean of the corners around it, which is that leaf's interpolation, however
 * much larger the leaf is. All others are free, and shared by the families of one size around them. A free sample is
 * moved by the mean of what the leaves around it want, weighted by the area of surface in them.
 */
#include "common/memory.h"
#include "convert/adf_tree.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* What a leaf may miss at the points tried, of the largest error; the rest is for points between. */
#define TRIED_SHARE 0.8
/* The same in late rounds, in which leaves are divided because of others that were. */
#define LATE_SHARE 0.95
#define LATE_ROUND 4
/* How far a sample may be moved to fit: small leaves must not suffer too much for the wishes of large ones. */
#define FIT_SHARE 0.35
/* Leaves of one voxel are not tried: they are taken to miss half of what the cell missed that they are a part of,
 * between these shares. */
#define UNTRIED_LEAST 0.4
#define UNTRIED_MOST 0.6
/* How much larger than the root mean square that a leaf is divided for its largest error may be. */
#define SLOPE_SHARE 4
/* Rounds in which leaves are divided for the slope as well; the root mean square hardly gains from more. */
#define SLOPE_ROUNDS 3

/* What leaves want of a sample: the sum of weighted moves, and the weights. */
typedef struct wish {
    float move, weight;
} wish;

/* ---- families ---- */

/* Numbers the nodes breadth first, and makes families of them. */
static void order_nodes(adf_tree *t) {
    uint32_t count = 1;
    t->order[0] = 0;
    for (uint32_t f = 0; f < count; f++) {
        adf_node *n = adf_node_at(t, t->order[f]);
        n->family = f;
        t->families[f].first_child = count;
        for (uint32_t c = 0; c < 8; c++) {
            if (n->children[c] == ADF_NONE) continue;
            t->families[f].states |= (uint32_t)DF_CHILD_FAMILY << 2 * c;
            t->families[count].parent = 8 * f + c;
            t->order[count++] = n->children[c];
        }
    }
    assert(count == t->family_count);
}

df_status adf_number(adf_tree *t, df_error *err) {
    free(t->order);
    free(t->families);
    df_neighbours_free(&t->neighbours);
    t->order = NULL;
    t->families = NULL;
    df_status status = df_alloc_raw((void **)&t->order, t->family_count, sizeof *t->order, "octree", err);
    if (status == DF_OK) status = df_alloc((void **)&t->families, t->family_count, sizeof *t->families, "octree", err);
    if (status != DF_OK) return status;
    order_nodes(t);
    return df_neighbours_find(t->families, t->family_count, &t->neighbours, err);
}

/* ---- fitting ---- */

/* Collects what the leaves of a family want, and what the families below want of their own corners. */
static void collect_wishes(const adf_tree *t, uint32_t f, wish (*wishes)[27]) {
    const adf_node *n = adf_node_at(t, t->order[f]);
    float area = (float)adf_side(t, n->level) * (float)adf_side(t, n->level);
    memset(wishes[f], 0, sizeof wishes[f]);
    for (uint32_t c = 0; c < 8; c++) {
        const adf_node *below = n->children[c] == ADF_NONE ? NULL : adf_node_at(t, n->children[c]);
        if (!below && !n->crossed[c]) continue;
        for (uint32_t i = 0; i < 8; i++) {
            wish *to = &wishes[f][df_family_corner(c, i)];
            if (below) {
                to->move += wishes[below->family][df_family_corner(i, i)].move;
                to->weight += wishes[below->family][df_family_corner(i, i)].weight;
            } else {
                to->move += area * n->fit[c][i]; /* 0 where that is not known */
                to->weight += area;
            }
        }
    }
    /* what hangs can only be moved by the corners around it */
    uint32_t hanging = df_hanging_samples(&t->neighbours, f);
    for (uint32_t s = 0; s < 27; s++) {
        const wish *from = &wishes[f][s];
        if (df_family_slot(s) < 0 || from->weight == 0 || !(hanging >> s & 1)) continue;
        float cell[8];
        for (uint32_t i = 0; i < 8; i++) cell[i] = n->exact[df_family_corner(i, i)];
        float excess = from->weight * (n->exact[s] - df_family_predict(cell, s)) + from->move;
        for (uint32_t i = 0; i < 8; i++) {
            float share = 1;
            const uint32_t at[3] = {s % 3, s / 3 % 3, s / 9};
            for (int a = 0; a < 3; a++) share *= at[a] == 1 ? 0.5f : (float)(at[a] == 2 * (i >> a & 1));
            wishes[f][df_family_corner(i, i)].move += share * excess;
            wishes[f][df_family_corner(i, i)].weight += share * from->weight;
        }
    }
}

/* The exact value moved as the leaves want; on its side of zero. */
static float fitted(const adf_tree *t, uint32_t f, uint32_t sample, const wish (*wishes)[27]) {
    const df_sample_cells *cells = &t->neighbours.cells[sample];
    float exact = adf_node_at(t, t->order[f])->exact[sample];
    wish sum = {0, 0};
    for (uint32_t i = 0; i < cells->count; i++) {
        uint32_t other = t->neighbours.around[f][cells->directions[i]];
        if (other == DF_NEIGHBOUR_BEYOND) continue;
        const wish *from = &wishes[other][cells->samples[i]];
        sum.move += from->move;
        sum.weight += from->weight;
    }
    if (sum.weight == 0) return exact;
    const float most = (float)(FIT_SHARE * t->input->max_error), move = sum.move / sum.weight;
    float moved = exact + fmaxf(-most, fminf(most, move)) + 0.0f;
    return (moved < 0) == (exact < 0) ? moved : exact;
}

/* Sets the final values of a node, whose parent's are set. */
static void settle(const adf_tree *t, uint32_t f, const wish (*wishes)[27]) {
    adf_node *n = adf_node_at(t, t->order[f]);
    uint32_t hanging = df_hanging_samples(&t->neighbours, f);
    float cell[8];
    for (uint32_t i = 0; i < 8; i++) {
        uint32_t s = df_family_corner(i, i);
        if (f == 0) n->final[s] = n->exact[s] + 0.0f;
        cell[i] = n->final[s];
    }
    for (uint32_t s = 0; s < 27; s++) {
        if (df_family_slot(s) < 0) continue;
        if (hanging >> s & 1) n->final[s] = df_family_predict(cell, s);
        else n->final[s] = wishes ? fitted(t, f, s, wishes) : n->exact[s] + 0.0f;
    }
    for (uint32_t c = 0; c < 8; c++) {
        if (n->children[c] == ADF_NONE) continue;
        adf_node *below = adf_node_at(t, n->children[c]);
        for (uint32_t i = 0; i < 8; i++) below->final[df_family_corner(i, i)] = n->final[df_family_corner(c, i)];
    }
}

df_status adf_fit(adf_tree *t, df_error *err) {
    wish(*wishes)[27] = NULL;
    df_status status = DF_OK;
    bool fits = t->input->max_error > 0;
    if (fits) status = df_alloc_raw((void **)&wishes, t->family_count, sizeof *wishes, "octree", err);
    if (status != DF_OK) return status;
    for (uint32_t level = t->neighbours.level_count; fits && level-- > 0;) {
#pragma omp parallel for schedule(static)
        for (uint32_t f = t->neighbours.starts[level]; f < t->neighbours.starts[level + 1]; f++)
            collect_wishes(t, f, wishes);
    }
    for (uint32_t level = 0; level < t->neighbours.level_count; level++) {
#pragma omp parallel for schedule(static)
        for (uint32_t f = t->neighbours.starts[level]; f < t->neighbours.starts[level + 1]; f++)
            settle(t, f, (const wish(*)[27])wishes);
    }
    free(wishes);
    return DF_OK;
}

/* ---- what is spoiled ---- */

/* The leaf around the middle of a cell: its node and child. */
static adf_task leaf_around(const adf_tree *t, const uint32_t corner[3], uint32_t side) {
    adf_task leaf = {.parent = 0, .forced = true};
    for (;;) {
        const adf_node *n = adf_node_at(t, leaf.parent);
        uint32_t half = adf_side(t, n->level);
        leaf.child = 0;
        for (int a = 0; a < 3; a++) leaf.child |= (uint32_t)(corner[a] + side / 2 >= n->corner[a] + half) << a;
        if (n->children[leaf.child] == ADF_NONE) return leaf;
        leaf.parent = n->children[leaf.child];
    }
}

/* The leaf on which a sample of a family, or of the one above that it is from, hangs; false where it does not. */
static bool find_imposing(const adf_tree *t, uint32_t f, uint32_t sample, adf_task *leaf) {
    for (; df_family_slot(sample) < 0; f = t->families[f].parent >> 3) {
        if (f == 0) return false;
        sample = df_family_corner(t->families[f].parent & 7, df_family_cell_corner(sample));
    }
    const df_sample_cells *cells = &t->neighbours.cells[sample];
    const adf_node *n = adf_node_at(t, t->order[f]);
    for (uint32_t i = 0; i < cells->count; i++) {
        uint32_t side = 2 * adf_side(t, n->level), d = cells->directions[i], corner[3];
        if (t->neighbours.around[f][d] != DF_NEIGHBOUR_LEAF) continue;
        const uint32_t step[3] = {d % 3, d / 3 % 3, d / 9};
        for (int a = 0; a < 3; a++) corner[a] = n->corner[a] + (step[a] - 1) * side;
        *leaf = leaf_around(t, corner, side);
        return true;
    }
    return false;
}

/* The largest error of a leaf at the points that were tried. moves: by corner, from where it would fit best. */
static double error_of(const adf_node *n, uint32_t child, const float moves[8]) {
    const double unit = (double)n->misfit[child] / 127;
    double local[3];
    for (int a = 0; a < 3; a++) local[a] = n->face[child][a] / 255.0;
    double largest = fabs(unit * n->at_face[child] + (n->at_face[child] ? df_trilinear(moves, local) : 0));
    for (uint32_t s = 0; s < 27; s++) {
        largest = fmax(largest, fabs(unit * n->left[child][s] + (double)df_family_predict(moves, s)));
    }
    return largest;
}

/* The error of children of one voxel. */
static double untried_error(const adf_tree *t, uint32_t f) {
    const uint32_t parent = t->families[f].parent;
    const double whole = f ? (double)adf_node_at(t, t->order[parent >> 3])->misfit[parent & 7] : 0;
    return fmax(UNTRIED_LEAST * t->input->max_error, fmin(whole / 2, UNTRIED_MOST * t->input->max_error));
}

/* Whether a leaf misses more than it may, or far more than the slope asks; then the leaf to divide goes to *task: the
 * one that imposes its value on the corner that is worst off, or the leaf itself. */
static bool is_spoiled(const adf_tree *t, uint32_t f, uint32_t child, int round, adf_task *task) {
    const adf_node *n = adf_node_at(t, t->order[f]);
    uint32_t worst = 0, side = adf_side(t, n->level);
    float moves[8], most = 0, moved = 0;
    int inside = 0;
    if (n->children[child] != ADF_NONE) return false;
    for (uint32_t i = 0; i < 8; i++) {
        uint32_t s = df_family_corner(child, i);
        inside += n->final[s] < 0;
        float change = n->final[s] - n->exact[s];
        moves[i] = change - n->fit[child][i];
        moved = fmaxf(moved, fabsf(moves[i]));
        if (fabsf(change) < most) continue;
        most = fabsf(change);
        worst = s;
    }
    if (!n->crossed[child] && (inside == 0 || inside == 8))
        return false; /* otherwise it is made a leaf at the surface */
    const double bound = (round < LATE_ROUND ? TRIED_SHARE : LATE_SHARE) * t->input->max_error;
    const double least = (double)moved + (n->fitted[child] ? (double)n->misfit[child] : untried_error(t, f));
    const bool steep = round < SLOPE_ROUNDS && least > SLOPE_SHARE * t->slope / side;
    if (!steep && (least <= bound || (n->fitted[child] && error_of(n, child, moves) <= bound))) return false;
    if (find_imposing(t, f, worst, task)) {
        return adf_side(t, adf_node_at(t, task->parent)->level) > 1;
    }
    *task = (adf_task){.parent = t->order[f], .child = child, .forced = true};
    return side > 1;
}

static int compare_tasks(const void *x, const void *y) {
    const adf_task *l = x, *r = y;
    if (l->parent != r->parent) return l->parent < r->parent ? -1 : 1;
    return l->child < r->child ? -1 : l->child > r->child;
}

df_status adf_find_spoiled(const adf_tree *t, int round, adf_task **tasks, uint32_t *count, df_error *err) {
    uint32_t found = 0, unique = 0;
    *count = 0;
    df_status status = df_alloc_raw((void **)tasks, 8 * (uint64_t)t->family_count, sizeof **tasks, "octree", err);
    if (status != DF_OK) return status;
#pragma omp parallel for schedule(static)
    for (uint32_t f = 0; f < t->family_count; f++) {
        for (uint32_t c = 0; c < 8; c++) {
            adf_task task;
            if (!is_spoiled(t, f, c, round, &task)) continue;
            uint32_t at;
#pragma omp atomic capture
            at = found++;
            (*tasks)[at] = task;
        }
    }
    qsort(*tasks, found, sizeof **tasks, compare_tasks);
    for (uint32_t i = 0; i < found; i++) {
        if (i == 0 || compare_tasks(&(*tasks)[i], &(*tasks)[i - 1]) != 0) (*tasks)[unique++] = (*tasks)[i];
    }
    *count = unique;
    return DF_OK;
}
