/*
 * Points between the samples of finished leaves. Where what is nearest changes, distances have a ridge that samples
 * half a side apart may miss; but they show that it is there: their slopes are less than 1.
 */
#include "common/memory.h"
#include "convert/adf_tree.h"

#include <math.h>
#include <stdlib.h>

/* Parts of leaves are looked at where distances with slopes of 1 would be so much further apart over their side, of the
 * largest error. */
#define RIDGE_SHARE 0.15
/* What the leaf may miss at the points tried, of the largest error. */
#define PROBE_SHARE 0.95
/* So many points along each side of a part. */
#define POINTS 4

/* Finds the exact samples of a leaf from its fit and what that left. */
static void recall_samples(const adf_node *n, uint32_t child, float samples[27]) {
    float fit[8];
    const float unit = n->misfit[child] / 127;
    for (uint32_t i = 0; i < 8; i++) fit[i] = n->exact[df_family_corner(child, i)] + n->fit[child][i];
    for (uint32_t s = 0; s < 27; s++) samples[s] = df_family_predict(fit, s) - unit * n->left[child][s];
}

/* How much less than distances with a slope of 1 those of a part of a leaf differ, over its side. */
static double missing_rise(const float samples[27], uint32_t part, double side) {
    double square = 0;
    for (int a = 0; a < 3; a++) {
        double rise = 0;
        for (uint32_t i = 0; i < 8; i++) {
            const double value = (double)samples[df_family_corner(part, i)];
            rise += i >> a & 1 ? value : -value;
        }
        square += rise * rise / 16;
    }
    return side - sqrt(square);
}

/* The distance of a point without its sign. */
static double distance_at(const adf_tree *t, const double p[3], uint32_t *nearest) {
    const df_adf_input *in = t->input;
    if (in->tree_is_source) return sqrt(df_face_tree_nearest(in->tree, p, nearest));
    return fabs(in->source->at(in->source->context, p));
}

/* The largest error of a leaf at points in one of its 8 parts. */
static double error_in(const adf_tree *t, const adf_node *n, uint32_t child, uint32_t part, uint32_t *nearest) {
    const df_lattice *l = t->input->lattice;
    const double side = adf_side(t, n->level);
    float corners[8];
    double largest = 0;
    for (uint32_t i = 0; i < 8; i++) corners[i] = n->final[df_family_corner(child, i)];
    for (uint32_t i = 0; i < POINTS * POINTS * POINTS; i++) {
        const uint32_t at[3] = {i % POINTS, i / POINTS % POINTS, i / POINTS / POINTS};
        double local[3], world[3];
        for (int a = 0; a < 3; a++) {
            local[a] = ((part >> a & 1) + (at[a] + 0.5) / POINTS) / 2;
            world[a] = l->origin[a] + (n->corner[a] + ((child >> a & 1) + local[a]) * side) * l->voxel_size;
        }
        largest = fmax(largest, fabs(fabs(df_trilinear(corners, local)) - distance_at(t, world, nearest)));
    }
    return largest;
}

static bool misses_ridge(const adf_tree *t, const adf_node *n, uint32_t child, uint32_t *nearest) {
    const double half = adf_side(t, n->level) * t->input->lattice->voxel_size / 2, bound = t->input->max_error;
    float samples[27];
    if (n->children[child] != ADF_NONE || !n->fitted[child] || adf_side(t, n->level) == 1) return false;
    recall_samples(n, child, samples);
    for (uint32_t part = 0; part < 8; part++) {
        if (missing_rise(samples, part, half) <= RIDGE_SHARE * bound) continue;
        if (error_in(t, n, child, part, nearest) > PROBE_SHARE * bound) return true;
    }
    return false;
}

/* The leaves of a node that miss a ridge, as bits. */
static uint8_t leaves_that_miss(const adf_tree *t, uint32_t node, uint32_t *nearest) {
    uint8_t leaves = 0;
    for (uint32_t c = 0; c < 8; c++) leaves |= (uint8_t)(misses_ridge(t, adf_node_at(t, node), c, nearest) << c);
    return leaves;
}

df_status adf_find_ridges(adf_tree *t, adf_task **tasks, uint32_t *count, df_error *err) {
    const df_adf_input *in = t->input;
    uint8_t *found; /* by place in the order */
    *count = 0;
    if (!(in->tree_is_source || in->source->at) || !(in->max_error > 0) || isinf(in->max_error)) return DF_OK;
    df_status status = df_alloc((void **)&found, t->family_count, 1, "octree", err);
    if (status != DF_OK) return status;
    uint64_t total = 0;
#pragma omp parallel reduction(+ : total)
    {
        uint32_t nearest = 0;
#pragma omp for schedule(dynamic, 256)
        for (uint32_t i = 0; i < t->family_count; i++) {
            adf_marks *marks = &t->marks[t->order[i]];
            if (marks->probe) found[i] = leaves_that_miss(t, t->order[i], &nearest);
            marks->probe = 0;
            total += (uint64_t)__builtin_popcount(found[i]);
        }
    }
    status = df_alloc_raw((void **)tasks, total, sizeof **tasks, "octree", err);
    for (uint32_t i = 0; status == DF_OK && i < t->family_count; i++) {
        for (uint32_t c = 0; c < 8; c++) {
            if (found[i] >> c & 1) (*tasks)[(*count)++] = (adf_task){.parent = t->order[i], .child = c, .forced = true};
        }
    }
    free(found);
    return status;
}
