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

/* ---- new nodes ---- */

static df_status grow(void **array, uint64_t count, size_t size, df_error *err) {
    void *grown = realloc(*array, count * size);
    if (!grown) return df_fail(err, DF_ERROR_MEMORY, "octree: no memory for %llu nodes", (unsigned long long)count);
    *array = grown;
    return DF_OK;
}

/* Room for all nodes in what is kept by node. */
static df_status make_room(adf_tree *t, df_error *err) {
    const uint32_t chunks = t->chunk_count < ADF_CHUNK_COUNT ? t->chunk_count : ADF_CHUNK_COUNT;
    const uint64_t room = (uint64_t)chunks * ADF_CHUNK;
    if (room == t->room) return DF_OK;
    df_status status = grow((void **)&t->marks, room, sizeof *t->marks, err);
    if (status == DF_OK) status = grow((void **)&t->order, room, sizeof *t->order, err);
    if (status == DF_OK) status = grow((void **)&t->neighbours.around, room, sizeof *t->neighbours.around, err);
    if (status == DF_OK && t->input->max_error > 0) status = grow((void **)&t->wishes, room, sizeof *t->wishes, err);
    if (status == DF_OK) t->room = (uint32_t)room;
    return status;
}

/* Lists the nodes that were made at the tasks, and below. */
static uint32_t list_fresh(const adf_tree *t, const adf_task *tasks, uint32_t count, uint32_t *list) {
    uint32_t listed = 0;
    for (uint32_t i = 0; i < count; i++) {
        const adf_task *task = &tasks[i];
        const uint32_t node = task->parent == ADF_NONE ? 0 : adf_node_at(t, task->parent)->children[task->child];
        if (node != ADF_NONE) list[listed++] = node;
    }
    for (uint32_t i = 0; i < listed; i++) {
        const adf_node *n = adf_node_at(t, list[i]);
        for (int c = 0; c < 8; c++) {
            if (n->children[c] != ADF_NONE) list[listed++] = n->children[c];
        }
    }
    return listed;
}

/* Puts new nodes into the order, behind the others of their levels. fresh: where they begin on each level. */
static void insert(adf_tree *t, const uint32_t *list, uint32_t count, uint32_t *fresh) {
    uint32_t *starts = t->neighbours.starts, *level_count = &t->neighbours.level_count, shift = count;
    uint32_t added[DF_LEVEL_COUNT_MAX + 1] = {0}, next[DF_LEVEL_COUNT_MAX + 1];
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t level = adf_node_at(t, list[i])->level - 1;
        added[level]++;
        for (; *level_count <= level; ++*level_count) starts[*level_count + 1] = starts[*level_count];
    }
    for (uint32_t level = *level_count; level-- > 0;) { /* the last level first, as all move up */
        const uint32_t first = starts[level], last = starts[level + 1];
        starts[level + 1] = last + shift;
        shift -= added[level];
        memmove(t->order + first + shift, t->order + first, (last - first) * sizeof *t->order);
        fresh[level] = next[level] = last + shift;
    }
    for (uint32_t i = 0; i < count; i++) t->order[next[adf_node_at(t, list[i])->level - 1]++] = list[i];
}

/* What the cell of the children's size of a node at `place` has become, -1 to 2 along each axis in units of the
 * children. */
static uint32_t node_beside(const adf_tree *t, uint32_t node, const int place[3]) {
    uint32_t towards = 0, child = 0, weight = 1;
    for (int a = 0; a < 3; a++, weight *= 3) {
        towards += weight * (uint32_t)(place[a] < 0 ? 0 : place[a] > 1 ? 2 : 1);
        child |= (uint32_t)(place[a] & 1) << a;
    }
    const uint32_t other = t->neighbours.around[node][towards];
    if (other >= DF_NEIGHBOUR_LEAF) return other;
    const uint32_t below = adf_node_at(t, other)->children[child];
    return below == ADF_NONE ? DF_NEIGHBOUR_LEAF : below;
}

static void find_around(const adf_tree *t, uint32_t node) {
    uint32_t *around = t->neighbours.around[node], parent = adf_node_at(t, node)->parent;
    for (int d = 0; d < 27; d++) {
        const int place[3] = {(int)(parent & 1) + d % 3 - 1, (int)(parent >> 1 & 1) + d / 3 % 3 - 1,
                              (int)(parent >> 2 & 1) + d / 9 - 1};
        if (node) around[d] = node_beside(t, parent >> 3, place);
        else around[d] = d == 13 ? 0 : DF_NEIGHBOUR_BEYOND;
    }
}

/* Tells the nodes around a new one of it: what hung on a leaf there may be free now. */
static void tell_around(const adf_tree *t, uint32_t node) {
    adf_marks *parent = &t->marks[adf_node_at(t, node)->parent >> 3];
    parent->wishes = parent->final = parent->check = 1;
    for (uint32_t d = 0; d < 27; d++) {
        const uint32_t other = t->neighbours.around[node][d];
        if (other >= DF_NEIGHBOUR_LEAF || t->marks[other].fresh) continue;
        t->neighbours.around[other][26 - d] = node;
        t->marks[other].wishes = t->marks[other].final = 1;
    }
}

/* Takes in the nodes that were made at the tasks. */
static df_status take_in(adf_tree *t, const adf_task *tasks, uint32_t count, df_error *err) {
    const uint32_t *starts = t->neighbours.starts;
    uint32_t *list, fresh[DF_LEVEL_COUNT_MAX + 1] = {0};
    df_status status = make_room(t, err);
    if (status == DF_OK) status = df_alloc_raw((void **)&list, t->family_count, sizeof *list, "octree", err);
    if (status != DF_OK) return status;
    count = list_fresh(t, tasks, count, list);
    insert(t, list, count, fresh);
    for (uint32_t i = 0; i < count; i++) t->marks[list[i]] = (adf_marks){1, 1, 1, 1, 1};
    free(list);
    assert(starts[t->neighbours.level_count] == t->family_count);
    df_neighbours_list_cells(&t->neighbours);
    for (uint32_t level = 0; level < t->neighbours.level_count; level++) {
#pragma omp parallel for schedule(static)
        for (uint32_t i = fresh[level]; i < starts[level + 1]; i++) find_around(t, t->order[i]);
        if (count == t->family_count) continue; /* there are no others */
        for (uint32_t i = fresh[level]; i < starts[level + 1]; i++) tell_around(t, t->order[i]);
    }
    return DF_OK;
}

/* ---- fitting ---- */

/* Of floats: what is computed again from the same is the same to the bit. */
static bool same_bits(const void *x, const void *y, size_t size) { return memcmp(x, y, size) == 0; }

/* Collects what the leaves of a node want, and what the nodes below want of their own corners. */
static void collect_wishes(const adf_tree *t, uint32_t node) {
    adf_wish *own = t->wishes[node];
    const adf_node *n = adf_node_at(t, node);
    float area = (float)adf_side(t, n->level) * (float)adf_side(t, n->level);
    memset(own, 0, sizeof t->wishes[node]);
    for (uint32_t c = 0; c < 8; c++) {
        const adf_wish *below = n->children[c] == ADF_NONE ? NULL : t->wishes[n->children[c]];
        if (!below && !n->crossed[c]) continue;
        for (uint32_t i = 0; i < 8; i++) {
            adf_wish *to = &own[df_family_corner(c, i)];
            if (below) {
                to->move += below[df_family_corner(i, i)].move;
                to->weight += below[df_family_corner(i, i)].weight;
            } else {
                to->move += area * n->fit[c][i]; /* 0 where that is not known */
                to->weight += area;
            }
        }
    }
    /* what hangs can only be moved by the corners around it */
    uint32_t hanging = df_hanging_samples(&t->neighbours, node);
    for (uint32_t s = 0; s < 27; s++) {
        const adf_wish *from = &own[s];
        if (df_family_slot(s) < 0 || from->weight == 0 || !(hanging >> s & 1)) continue;
        float cell[8];
        for (uint32_t i = 0; i < 8; i++) cell[i] = n->exact[df_family_corner(i, i)];
        float excess = from->weight * (n->exact[s] - df_family_predict(cell, s)) + from->move;
        for (uint32_t i = 0; i < 8; i++) {
            float share = 1;
            const uint32_t at[3] = {s % 3, s / 3 % 3, s / 9};
            for (int a = 0; a < 3; a++) share *= at[a] == 1 ? 0.5f : (float)(at[a] == 2 * (i >> a & 1));
            own[df_family_corner(i, i)].move += share * excess;
            own[df_family_corner(i, i)].weight += share * from->weight;
        }
    }
}

/* The exact value moved as the leaves want; on its side of zero. */
static float fitted(const adf_tree *t, uint32_t node, uint32_t sample) {
    const df_sample_cells *cells = &t->neighbours.cells[sample];
    float exact = adf_node_at(t, node)->exact[sample];
    adf_wish sum = {0, 0};
    for (uint32_t i = 0; i < cells->count; i++) {
        uint32_t other = t->neighbours.around[node][cells->directions[i]];
        if (other == DF_NEIGHBOUR_BEYOND) continue;
        const adf_wish *from = &t->wishes[other][cells->samples[i]];
        sum.move += from->move;
        sum.weight += from->weight;
    }
    if (sum.weight == 0) return exact;
    const float most = (float)(FIT_SHARE * t->input->max_error), move = sum.move / sum.weight;
    float moved = exact + fmaxf(-most, fminf(most, move)) + 0.0f;
    return (moved < 0) == (exact < 0) ? moved : exact;
}

/* Sets the final values of a node, whose parent's are set. Returns whether they changed. */
static bool settle(const adf_tree *t, uint32_t node) {
    adf_node *n = adf_node_at(t, node);
    const uint32_t hanging = df_hanging_samples(&t->neighbours, node);
    float cell[8], before[27];
    memcpy(before, n->final, sizeof before);
    for (uint32_t i = 0; i < 8; i++) {
        uint32_t s = df_family_corner(i, i);
        if (node == 0) n->final[s] = n->exact[s] + 0.0f;
        cell[i] = n->final[s];
    }
    for (uint32_t s = 0; s < 27; s++) {
        if (df_family_slot(s) < 0) continue;
        if (hanging >> s & 1) n->final[s] = df_family_predict(cell, s);
        else n->final[s] = t->wishes ? fitted(t, node, s) : n->exact[s] + 0.0f;
    }
    return !same_bits(before, n->final, sizeof before);
}

/* Hands the nodes among a node's children the values at their corners. */
static void hand_down(const adf_tree *t, uint32_t node) {
    const adf_node *n = adf_node_at(t, node);
    for (uint32_t c = 0; c < 8; c++) {
        const uint32_t number = n->children[c];
        bool changed = false;
        if (number == ADF_NONE) continue;
        adf_node *below = adf_node_at(t, number);
        for (uint32_t i = 0; i < 8; i++) {
            float *to = &below->final[df_family_corner(i, i)], value = n->final[df_family_corner(c, i)];
            changed = changed || !same_bits(to, &value, sizeof value);
            *to = value;
        }
        if (changed) t->marks[number].final = t->marks[number].check = t->marks[number].probe = 1;
    }
}

/* Sets a mark that other threads may set as well. */
static void set(uint8_t *mark) {
#pragma omp atomic write
    *mark = 1;
}

/* Collects the wishes of a node again, and marks the nodes that a change concerns. */
static void renew_wishes(const adf_tree *t, uint32_t node) {
    const bool fresh = t->marks[node].fresh;
    bool changed = fresh, corners = fresh;
    adf_wish before[27];
    if (!fresh) memcpy(before, t->wishes[node], sizeof before);
    collect_wishes(t, node);
    for (uint32_t s = 0; !fresh && s < 27; s++) {
        const bool differs = !same_bits(&before[s], &t->wishes[node][s], sizeof *before);
        changed = changed || differs;
        corners = corners || (differs && df_family_slot(s) < 0);
    }
    if (corners) set(&t->marks[adf_node_at(t, node)->parent >> 3].wishes);
    for (uint32_t d = 0; changed && d < 27; d++) {
        const uint32_t other = t->neighbours.around[node][d];
        if (other < DF_NEIGHBOUR_LEAF) set(&t->marks[other].final);
    }
    t->marks[node].wishes = 0;
}

df_status adf_fit(adf_tree *t, const adf_task *tasks, uint32_t count, df_error *err) {
    const uint32_t *starts = t->neighbours.starts;
    df_status status = take_in(t, tasks, count, err);
    if (status != DF_OK) return status;
    for (uint32_t level = t->neighbours.level_count; t->wishes && level-- > 0;) {
#pragma omp parallel for schedule(static)
        for (uint32_t i = starts[level]; i < starts[level + 1]; i++) {
            if (t->marks[t->order[i]].wishes) renew_wishes(t, t->order[i]);
        }
    }
    for (uint32_t level = 0; level < t->neighbours.level_count; level++) {
#pragma omp parallel for schedule(static)
        for (uint32_t i = starts[level]; i < starts[level + 1]; i++) {
            const uint32_t node = t->order[i];
            if (!t->marks[node].final) continue;
            if (settle(t, node)) t->marks[node].check = t->marks[node].probe = 1;
            hand_down(t, node);
            t->marks[node].final = 0;
        }
    }
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

/* The leaf on which a sample of a node, or of the one above that it is from, hangs; false where it does not. */
static bool find_imposing(const adf_tree *t, uint32_t node, uint32_t sample, adf_task *leaf) {
    const adf_node *n = adf_node_at(t, node);
    for (; df_family_slot(sample) < 0; n = adf_node_at(t, node)) {
        if (node == 0) return false;
        sample = df_family_corner(n->parent & 7, df_family_cell_corner(sample));
        node = n->parent >> 3;
    }
    const df_sample_cells *cells = &t->neighbours.cells[sample];
    for (uint32_t i = 0; i < cells->count; i++) {
        uint32_t side = 2 * adf_side(t, n->level), d = cells->directions[i], corner[3];
        if (t->neighbours.around[node][d] != DF_NEIGHBOUR_LEAF) continue;
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
static double untried_error(const adf_tree *t, uint32_t node) {
    const uint32_t parent = adf_node_at(t, node)->parent;
    const double whole = node ? (double)adf_node_at(t, parent >> 3)->misfit[parent & 7] : 0;
    return fmax(UNTRIED_LEAST * t->input->max_error, fmin(whole / 2, UNTRIED_MOST * t->input->max_error));
}

/* Whether a leaf misses more than it may, or far more than the slope asks; then the leaf to divide goes to *task: the
 * one that imposes its value on the corner that is worst off, or the leaf itself. Such a leaf is looked at again in the
 * next round; the others only where their values change, as no round asks more than the last. */
static bool is_spoiled(const adf_tree *t, uint32_t node, uint32_t child, int round, adf_task *task) {
    const adf_node *n = adf_node_at(t, node);
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
    const double least = (double)moved + (n->fitted[child] ? (double)n->misfit[child] : untried_error(t, node));
    const bool steep = round < SLOPE_ROUNDS && least > SLOPE_SHARE * t->slope / side;
    if (!steep && (least <= bound || (n->fitted[child] && error_of(n, child, moves) <= bound))) return false;
    t->marks[node].check = 1;
    if (find_imposing(t, node, worst, task)) {
        return adf_side(t, adf_node_at(t, task->parent)->level) > 1;
    }
    *task = (adf_task){.parent = node, .child = child, .forced = true};
    return side > 1;
}

static int compare_tasks(const void *x, const void *y) {
    const adf_task *l = x, *r = y;
    if (l->parent != r->parent) return l->parent < r->parent ? -1 : 1;
    return l->child < r->child ? -1 : l->child > r->child;
}

df_status adf_find_spoiled(adf_tree *t, int round, adf_task **tasks, uint32_t *count, df_error *err) {
    uint32_t found = 0, unique = 0;
    *count = 0;
    df_status status = df_alloc_raw((void **)tasks, 8 * (uint64_t)t->family_count, sizeof **tasks, "octree", err);
    if (status != DF_OK) return status;
#pragma omp parallel for schedule(static)
    for (uint32_t i = 0; i < t->family_count; i++) {
        const uint32_t node = t->order[i];
        adf_marks *marks = &t->marks[node];
        marks->fresh = 0;
        if (!marks->check) continue;
        marks->check = 0;
        for (uint32_t c = 0; c < 8; c++) {
            adf_task task;
            if (!is_spoiled(t, node, c, round, &task)) continue;
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

/* ---- families ---- */

df_status adf_number(adf_tree *t, df_error *err) {
    uint32_t count = 1;
    df_status status = df_alloc((void **)&t->families, t->family_count, sizeof *t->families, "octree", err);
    if (status != DF_OK) return status;
    t->order[0] = 0;
    for (uint32_t f = 0; f < count; f++) {
        const adf_node *n = adf_node_at(t, t->order[f]);
        t->families[f].first_child = count;
        for (uint32_t c = 0; c < 8; c++) {
            if (n->children[c] == ADF_NONE) continue;
            t->families[f].states |= (uint32_t)DF_CHILD_FAMILY << 2 * c;
            t->families[count].parent = 8 * f + c;
            t->order[count++] = n->children[c];
        }
    }
    assert(count == t->family_count);
    return DF_OK;
}
