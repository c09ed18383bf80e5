/*
 * Exact distances, fast: for a box of samples, the faces that can be nearest to any of its samples are listed (distance
 * to its centre at most the smallest plus twice the half diagonal); the list shrinks as the box is divided into
 * eighths, down to eight samples, whose distances to the few faces left are computed at once.
 */
#include "common/memory.h"
#include "convert/distance.h"
#include "convert/face_tree.h"

#include <assert.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>

/* The longest list; where even eight samples have a longer one, the tree is searched sample by sample. */
#define LIST_MAX 8192
/* A box with a longer list is divided, and its parts ask the tree for lists of their own. */
#define LIST_LONG 4096
/* Above this a list is first shrunk by spheres around the faces, which is cheaper and less sharp than their distances.
 */
#define LIST_SPHERES 48
#define LEVEL_MAX 4 /* of boxes of 9 samples: 9, 8, 4, 2 */

/* What one thread works with. */
typedef struct scratch {
    uint32_t lists[LEVEL_MAX + 1][LIST_MAX];
    double distances[LEVEL_MAX][LIST_MAX][8];
    uint8_t masks[LEVEL_MAX][LIST_MAX];
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

/* Cuts a part into up to eight: each side of more than two samples at the largest power of two below it. Returns a bit
 * for each that exists. */
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

/* The distances of the faces listed on a level to the eight centres; `least` gets the smallest of each. */
static void measure_faces(const job *j, uint32_t level, uint32_t count, const double centres[3][8], double least[8]) {
    scratch *s = j->scratch;
    df_face_distances(j->context->tree.faces, s->lists[level], count, centres, s->distances[level][0], least);
    for (int i = 0; i < 8; i++) least[i] = sqrt(least[i]);
}

/* Keeps the faces whose mask has bit i in the list of the next level. Returns their number. */
static uint32_t keep_selected(scratch *s, uint32_t level, uint32_t count, int i) {
    uint32_t kept = 0;
    for (uint32_t f = 0; f < count; f++) {
        s->lists[level + 1][kept] = s->lists[level][f];
        kept += s->masks[level][f] >> i & 1u;
    }
    return kept;
}

/* The same for the faces nearer than `reach` to centre i. */
static uint32_t keep_near(scratch *s, uint32_t level, uint32_t count, int i, double reach) {
    double limit = reach * (1 + 1e-9) * reach * (1 + 1e-9);
    uint32_t kept = 0;
    for (uint32_t f = 0; f < count; f++) {
        s->lists[level + 1][kept] = s->lists[level][f];
        kept += s->distances[level][f][i] <= limit;
    }
    return kept;
}

/* Fills a part whose faces are in the list of its level. */
static void fill_part(const job *j, const part *p, uint32_t level, uint32_t count) {
    if (level >= LEVEL_MAX || (p->count[0] <= 2 && p->count[1] <= 2 && p->count[2] <= 2)) {
        assert(level < LEVEL_MAX);
        fill_eight(j, p, j->scratch->lists[level], count);
        return;
    }
    part children[8];
    uint32_t exist = divide(p, children);
    df_face_boxes boxes;
    for (int i = 0; i < 8; i++) {
        const part *child = exist >> i & 1 ? &children[i] : p;
        double centre[3];
        centre_of(j, child, centre);
        for (int a = 0; a < 3; a++) {
            boxes.centre[a][i] = centre[a];
            boxes.half[a][i] = (child->count[a] - 1) * 0.5 * j->lattice->voxel_size;
        }
    }
    scratch *s = j->scratch;
    double least[8];
    bool by_spheres = count > LIST_SPHERES;
    if (by_spheres)
        df_face_select(&j->context->tree, s->lists[level], count, &boxes, (float *)s->distances[level],
                       s->masks[level]);
    else measure_faces(j, level, count, (const double(*)[8])boxes.centre, least);
    for (int i = 0; i < 8; i++) {
        if (!(exist >> i & 1)) continue;
        uint32_t kept = by_spheres ? keep_selected(s, level, count, i)
                                   : keep_near(s, level, count, i,
                                               least[i] + 2 * half_diagonal(&children[i], j->lattice->voxel_size));
        fill_part(j, &children[i], level + 1, kept);
    }
}

static void search_part(const job *j, const part *p) {
    for (uint32_t z = 0; z < p->count[2]; z++) {
        for (uint32_t y = 0; y < p->count[1]; y++) {
            for (uint32_t x = 0; x < p->count[0]; x++) {
                uint32_t at[3] = {p->first[0] + x, p->first[1] + y, p->first[2] + z};
                double point[3];
                for (int a = 0; a < 3; a++) point[a] = df_lattice_at(j->lattice, a, j->box->first[a] + at[a]);
                double d = df_face_tree_nearest(&j->context->tree, point, &j->scratch->nearest);
                *sample_of(j, at[0], at[1], at[2]) = df_distance_round(sqrt(d));
            }
        }
    }
}

/* Fills a part with a list from the tree; where that is long, its parts with their own. */
static void list_part(const job *j, const part *p, uint32_t level) {
    const df_face_tree *tree = &j->context->tree;
    double centre[3];
    centre_of(j, p, centre);
    double least = sqrt(df_face_tree_nearest(tree, centre, &j->scratch->nearest));
    double reach = (least + 2 * half_diagonal(p, j->lattice->voxel_size)) * (1 + 1e-9);
    bool smallest = level >= LEVEL_MAX || (p->count[0] <= 2 && p->count[1] <= 2 && p->count[2] <= 2);
    uint32_t limit = smallest ? LIST_MAX : LIST_LONG;
    uint32_t count = df_face_tree_list(tree, centre, reach, j->scratch->lists[level], limit);
    if (count <= limit) {
        fill_part(j, p, level, count);
    } else if (smallest) {
        search_part(j, p);
    } else {
        part children[8];
        uint32_t exist = divide(p, children);
        for (int i = 0; i < 8; i++) {
            if (exist >> i & 1) list_part(j, &children[i], level + 1);
        }
    }
}

static void fill(const void *user, const df_lattice *lattice, const df_sample_box *box, float *out) {
    const context *c = user;
    assert(omp_get_thread_num() < c->thread_count);
    job j = {c, lattice, box, c->scratches[omp_get_thread_num()], out};
    part all = {{0, 0, 0}, {box->count[0], box->count[1], box->count[2]}};
    list_part(&j, &all, 0);
}

static double at(const void *user, const double p[3]) {
    const context *c = user;
    return sqrt(df_face_tree_nearest(&c->tree, p, &c->scratches[omp_get_thread_num()]->nearest));
}

static void release(void *user) {
    context *c = user;
    for (int t = 0; c->scratches && t < c->thread_count; t++) free(c->scratches[t]);
    free(c->scratches);
    df_face_tree_free(&c->tree);
    free(c);
}

const df_face_tree *df_distance_exact_tree(const df_distance_source *source) {
    const context *c = source->context;
    return &c->tree;
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
    if (status == DF_OK) *source = (df_distance_source){c, false, fill, at, release};
    else release(c);
    return status;
}
