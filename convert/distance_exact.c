/*
 * Exact distances, fast: for a box of samples, the faces that can be nearest to any of its samples are listed (distance to
 * its centre at most the smallest plus twice the half diagonal); the list shrinks as the box is divided into eighths, down to
 * eight samples, whose distances to the few faces left are computed at once.
 */
#include "common/memory.h"
#include "convert/distance.h"
#include "convert/face_tree.h"

#include <assert.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>

/* With more faces than this around a box, searching the tree sample by sample is faster. */
#define LIST_MAX 8192
#define LEVEL_MAX 4 /* of boxes of 9 samples: 9, 8, 4, 2 */

/* What one thread works with. */
typedef struct scratch {
    uint32_t lists[LEVEL_MAX + 1][LIST_MAX];
    double distances[LEVEL_MAX][LIST_MAX][8];
    uint32_t nearest; /* a face near the last box */
} scratch;

typedef struct context {
    df_face_tree tree;
    scratch **scratches; /* by thread */
    int thread_count;
} context;

/* A part of the box that is to be filled. */
typedef struct part {
    uint32_t first[3], count[3];
} part;

typedef struct job {
    const context *context;
    const df_lattice *lattice;
    const df_sample_box *box;
    scratch *scratch;
    float *out;
} job;

static double half_diagonal(const part *p, double voxel_size) {
    double sum = 0;
    for (int a = 0; a < 3; a++) sum += (p->count[a] - 1.0) * (p->count[a] - 1.0);
    return sqrt(sum) / 2 * voxel_size;
}

static void centre_of(const job *j, const part *p, double centre[3]) {
    for (int a = 0; a < 3; a++) {
        uint32_t first = j->box->first[a] + p->first[a];
        centre[a] = (df_lattice_at(j->lattice, a, first) + df_lattice_at(j->lattice, a, first + p->count[a] - 1)) / 2;
    }
}

static float *sample_of(const job *j, uint32_t x, uint32_t y, uint32_t z) {
    return j->out + x + (size_t)j->box->count[0] * (y + (size_t)j->box->count[1] * z);
}

/* The distances of up to 2x2x2 samples to the faces of a list. */
static void fill_eight(const job *j, const part *p, const uint32_t *list, uint32_t count) {
    double points[3][8], least[8];
    for (uint32_t i = 0; i < 8; i++) {
        for (uint32_t a = 0; a < 3; a++) {
            uint32_t step = (i >> a & 1) && p->count[a] > 1; /* where there are fewer, some are computed twice */
            points[a][i] = df_lattice_at(j->lattice, (int)a, j->box->first[a] + p->first[a] + step);
        }
    }
    df_face_distances(j->context->tree.faces, list, count, (const double(*)[8])points, NULL, least);
    for (uint32_t i = 0; i < 8; i++) {
        uint32_t x = i & 1, y = i >> 1 & 1, z = i >> 2;
        if (x >= p->count[0] || y >= p->count[1] || z >= p->count[2]) continue;
        *sample_of(j, p->first[0] + x, p->first[1] + y, p->first[2] + z) = df_distance_round(sqrt(least[i]));
    }
}

/* Cuts a part into up to eight: each side of more than two samples at the largest power of two below it. Returns a bit for each that exists. */
static uint32_t divide(const part *p, part children[8]) {
    uint32_t exist = 0, cut[3];
    for (int a = 0; a < 3; a++) {
        cut[a] = 1;
        while (cut[a] * 2 < p->count[a]) cut[a] *= 2;
        if (p->count[a] <= 2) cut[a] = p->count[a];
    }
    for (uint32_t i = 0; i < 8; i++) {
        bool empty = false;
        for (uint32_t a = 0; a < 3; a++) {
            bool upper = i >> a & 1;
            children[i].first[a] = p->first[a] + (upper ? cut[a] : 0);
            children[i].count[a] = upper ? p->count[a] - cut[a] : cut[a];
            empty = empty || children[i].count[a] == 0;
        }
        if (!empty) exist |= 1u << i;
    }
    return exist;
}

static void fill_part(const job *j, const part *p, uint32_t level, uint32_t count) {
    const uint32_t *list = j->scratch->lists[level];
    if (p->count[0] <= 2 && p->count[1] <= 2 && p->count[2] <= 2) {
        fill_eight(j, p, list, count);
        return;
    }
    assert(level < LEVEL_MAX);
    part children[8];
    uint32_t exist = divide(p, children);
    double centres[3][8] = {{0}}, least[8];
    for (int i = 0; i < 8; i++) {
        double centre[3];
        centre_of(j, exist >> i & 1 ? &children[i] : p, centre);
        for (int a = 0; a < 3; a++) centres[a][i] = centre[a];
    }
    double(*distances)[8] = j->scratch->distances[level];
    df_face_distances(j->context->tree.faces, list, count, (const double(*)[8])centres, distances[0], least);
    for (int i = 0; i < 8; i++) {
        if (!(exist >> i & 1)) continue;
        double reach = (sqrt(least[i]) + 2 * half_diagonal(&children[i], j->lattice->voxel_size)) * (1 + 1e-9);
        double limit = reach * reach;
        uint32_t *kept = j->scratch->lists[level + 1], kept_count = 0;
        for (uint32_t f = 0; f < count; f++) {
            kept[kept_count] = list[f];
            kept_count += distances[f][i] <= limit;
        }
        fill_part(j, &children[i], level + 1, kept_count);
    }
}

static void fill_by_search(const job *j) {
    for (uint32_t z = 0; z < j->box->count[2]; z++) {
        for (uint32_t y = 0; y < j->box->count[1]; y++) {
            for (uint32_t i = 0; i < j->box->count[0]; i++) {
                uint32_t x = y & 1 ? j->box->count[0] - 1 - i : i; /* back and forth: each starts beside the last */
                double p[3] = {df_lattice_at(j->lattice, 0, j->box->first[0] + x), df_lattice_at(j->lattice, 1, j->box->first[1] + y),
                               df_lattice_at(j->lattice, 2, j->box->first[2] + z)};
                double d = df_face_tree_nearest(&j->context->tree, p, &j->scratch->nearest);
                *sample_of(j, x, y, z) = df_distance_round(sqrt(d));
            }
        }
    }
}

static void fill(const void *user, const df_lattice *lattice, const df_sample_box *box, float *out) {
    const context *c = user;
    assert(omp_get_thread_num() < c->thread_count);
    job j = {c, lattice, box, c->scratches[omp_get_thread_num()], out};
    part all = {{0, 0, 0}, {box->count[0], box->count[1], box->count[2]}};
    double centre[3];
    centre_of(&j, &all, centre);
    double least = sqrt(df_face_tree_nearest(&c->tree, centre, &j.scratch->nearest));
    double reach = (least + 2 * half_diagonal(&all, lattice->voxel_size)) * (1 + 1e-9);
    uint32_t count = df_face_tree_list(&c->tree, centre, reach, j.scratch->lists[0], LIST_MAX);
    if (count > LIST_MAX) fill_by_search(&j);
    else fill_part(&j, &all, 0, count);
}

static void release(void *user) {
    context *c = user;
    for (int t = 0; c->scratches && t < c->thread_count; t++) free(c->scratches[t]);
    free(c->scratches);
    df_face_tree_free(&c->tree);
    free(c);
}

df_status df_distance_exact(const df_mesh *mesh, df_distance_source *source, df_error *err) {
    *source = (df_distance_source){0};
    context *c;
    df_status status = df_alloc((void **)&c, 1, sizeof *c, "distances", err);
    if (status != DF_OK) return status;
    c->thread_count = omp_get_max_threads();
    status = df_alloc((void **)&c->scratches, (uint64_t)c->thread_count, sizeof *c->scratches, "distances", err);
    for (int t = 0; t < c->thread_count && status == DF_OK; t++) {
        status = df_alloc_raw((void **)&c->scratches[t], 1, sizeof **c->scratches, "distances", err);
        if (status == DF_OK) c->scratches[t]->nearest = 0;
    }
    if (status == DF_OK) status = df_face_tree_make(mesh, &c->tree, err);
    if (status == DF_OK) *source = (df_distance_source){c, false, fill, release};
    else release(c);
    return status;
}
