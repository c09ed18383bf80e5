#include "convert/quantise.h"

#include "common/memory.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define FAMILY DF_FAMILY_SAMPLE_COUNT
#define EXPONENT_MIN (-126)
#define EXPONENT_MAX 100

typedef struct quantiser {
    const df_field *from;
    df_sample_type type;
    int32_t limit;     /* the largest |q|, less its middle */
    void *samples;     /* those of the new field */
    int8_t *exponents; /* by brick or family */
} quantiser;

/* The smallest exponent whose step holds a magnitude. */
static int exponent_for(const quantiser *q, double magnitude) {
    int exponent;
    frexp(magnitude / q->limit, &exponent); /* magnitude / limit < 2^exponent */
    if (magnitude <= ldexp(q->limit, exponent - 1)) exponent--;
    return exponent < EXPONENT_MIN ? EXPONENT_MIN : exponent > EXPONENT_MAX ? EXPONENT_MAX : exponent;
}

/* A value rounded to a step; below zero it stays there. */
static double round_to(double value, int exponent) {
    double steps = nearbyint(ldexp(value, -exponent));
    if (value < 0 && steps > -1) steps = -1;
    return ldexp(steps, exponent);
}

static double largest_of(const float *values, size_t count) {
    double largest = 0;
    for (size_t i = 0; i < count; i++) largest = fmax(largest, fabs((double)values[i]));
    return largest;
}

/* Stores a value that is a multiple of the step. */
static void put(const quantiser *q, uint64_t index, double value, int exponent) {
    double steps = ldexp(value, -exponent);
    assert(steps == floor(steps) && fabs(steps) <= q->limit);
    if (q->type == DF_SAMPLE_U16) ((uint16_t *)q->samples)[index] = (uint16_t)(32768 + (int)steps);
    else ((uint8_t *)q->samples)[index] = (uint8_t)(128 + (int)steps);
}

static int quantise_dense(const quantiser *q) {
    const float *values = q->from->samples;
    int exponent = exponent_for(q, fmax(fabs((double)q->from->value_min), fabs((double)q->from->value_max)));
#pragma omp parallel for schedule(static)
    for (uint64_t i = 0; i < q->from->sample_count; i++) put(q, i, round_to((double)values[i], exponent), exponent);
    return exponent;
}

/* Where a sample lies along an axis of its brick: 0 at the lower face, 2 at the upper, 1 between. */
static uint32_t place_of(uint32_t at, uint32_t k) { return at == 0 ? 0 : at == k ? 2 : 1; }

/* The coarsest exponent among the bricks that share a sample, by its place in the brick: x + 3 (y + 3 z). */
static void coarsest_of_brick(const quantiser *q, uint32_t brick, int coarsest[27]) {
    const df_field *f = q->from;
    uint32_t cell = f->brick_cells[brick], at[3] = {cell % f->cell_count[0], cell / f->cell_count[0] % f->cell_count[1],
                                                    cell / f->cell_count[0] / f->cell_count[1]};
    int around[27];
    for (int i = 0; i < 27; i++) {
        int64_t p[3] = {(int64_t)at[0] + i % 3 - 1, (int64_t)at[1] + i / 3 % 3 - 1, (int64_t)at[2] + i / 9 - 1};
        bool exists = true;
        for (int a = 0; a < 3; a++) exists = exists && p[a] >= 0 && p[a] < f->cell_count[a];
        uint64_t index = exists ? (uint64_t)p[0] + f->cell_count[0] * ((uint64_t)p[1] + f->cell_count[1] * (uint64_t)p[2]) : 0;
        uint32_t other = exists ? f->cells[index] : DF_CELL_OUTSIDE;
        around[i] = other < DF_CELL_INSIDE ? q->exponents[other] : EXPONENT_MIN;
    }
    for (int i = 0; i < 27; i++) {
        coarsest[i] = EXPONENT_MIN;
        for (int n = 0; n < 27; n++) { /* neighbours in the direction of the sample or none, along each axis */
            bool shares = (n % 3 == 1 || n % 3 == i % 3) && (n / 3 % 3 == 1 || n / 3 % 3 == i / 3 % 3) && (n / 9 == 1 || n / 9 == i / 9);
            if (shares && around[n] > coarsest[i]) coarsest[i] = around[n];
        }
    }
}

/* The rounded samples of a brick; returns the largest magnitude. */
static double round_brick(const quantiser *q, uint32_t brick, double *rounded) {
    uint32_t k = q->from->brick_size, side = k + 1;
    const float *values = (const float *)q->from->samples + (size_t)brick * df_brick_sample_count(k);
    int coarsest[27];
    double largest = 0;
    coarsest_of_brick(q, brick, coarsest);
    for (uint32_t i = 0; i < df_brick_sample_count(k); i++) {
        uint32_t place = place_of(i % side, k) + 3 * (place_of(i / side % side, k) + 3 * place_of(i / side / side, k));
        rounded[i] = round_to((double)values[i], coarsest[place]);
        largest = fmax(largest, fabs(rounded[i]));
    }
    return largest;
}

static void quantise_bricks(const quantiser *q) {
    const df_field *f = q->from;
    uint32_t per_brick = df_brick_sample_count(f->brick_size);
    double rounded[729];
    for (uint32_t b = 0; b < f->brick_count; b++) {
        q->exponents[b] = (int8_t)exponent_for(q, largest_of((const float *)f->samples + (size_t)b * per_brick, per_brick));
    }
    /* Rounding to a neighbour's step may lead out of a brick's range; its step then grows, which its neighbours must follow. */
    for (bool grown = true; grown;) {
        grown = false;
        for (uint32_t b = 0; b < f->brick_count; b++) {
            int exponent = exponent_for(q, round_brick(q, b, rounded));
            if (exponent <= q->exponents[b]) continue;
            q->exponents[b] = (int8_t)exponent;
            grown = true;
        }
    }
#pragma omp parallel for schedule(dynamic, 64) private(rounded)
    for (uint32_t b = 0; b < f->brick_count; b++) {
        round_brick(q, b, rounded);
        for (uint32_t i = 0; i < per_brick; i++) put(q, (uint64_t)b * per_brick + i, rounded[i], q->exponents[b]);
    }
}

/* The families of an octree with what the file does not say. */
typedef struct family_place {
    uint32_t corner[3], side; /* of the divided cell */
    uint32_t parent, child;
    uint32_t level;
} family_place;

/* Steps by sample: keys are the sample's position and the group that agrees on it. Open addressing; never full. */
typedef struct step_table {
    uint64_t *keys; /* 0: empty */
    int8_t *exponents;
    uint64_t mask;
} step_table;

typedef struct octree {
    family_place *places;
    double *values; /* by family: 27 rounded samples */
    double *targets; /* by family: 27 samples to round */
    step_table steps;
} octree;

#define GROUP_LEAVES 31u

/* Samples that are corners of a leaf agree with all of those; others with those of their level. */
static uint64_t key_of(const df_field *f, const octree *o, uint32_t family, uint32_t sample) {
    const family_place *p = &o->places[family];
    uint32_t at[3] = {sample % 3, sample / 3 % 3, sample / 9};
    uint64_t key = p->level;
    for (uint32_t c = 0; c < 8; c++) {
        bool corner = true;
        for (uint32_t a = 0; a < 3; a++) corner = corner && at[a] - (c >> a & 1) <= 1;
        if (corner && (f->families[family].states >> 2 * c & 3) != DF_CHILD_FAMILY) key = GROUP_LEAVES;
    }
    for (int a = 0; a < 3; a++) key = key << 17 | (p->corner[a] + (uint64_t)at[a] * (p->side / 2));
    return key + 1;
}

/* The slot of a key, claimed where it is new. */
static uint64_t slot_of(step_table *t, uint64_t key) {
    uint64_t slot = key * 0x9E3779B97F4A7C15u;
    for (slot = (slot ^ slot >> 29) & t->mask; t->keys[slot] != 0 && t->keys[slot] != key;) slot = (slot + 1) & t->mask;
    if (t->keys[slot] == 0) {
        t->keys[slot] = key;
        t->exponents[slot] = EXPONENT_MIN;
    }
    return slot;
}

static void free_octree(octree *o) {
    free(o->places);
    free(o->values);
    free(o->targets);
    free(o->steps.keys);
    free(o->steps.exponents);
}

static df_status make_octree(const quantiser *q, octree *o, df_error *err) {
    const df_field *f = q->from;
    uint64_t capacity = 64;
    while (capacity < (uint64_t)f->family_count * 48) capacity *= 2;
    o->steps.mask = capacity - 1;
    df_status status = df_alloc((void **)&o->places, f->family_count, sizeof *o->places, "octree", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&o->values, f->family_count, FAMILY * sizeof *o->values, "octree", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&o->targets, f->family_count, FAMILY * sizeof *o->targets, "octree", err);
    if (status == DF_OK) status = df_alloc((void **)&o->steps.keys, capacity, sizeof *o->steps.keys, "octree", err);
    if (status == DF_OK) status = df_alloc((void **)&o->steps.exponents, capacity, 1, "octree", err);
    if (status != DF_OK) return status;
    o->places[0] = (family_place){.side = 1u << f->level_count};
    for (uint32_t n = 0; n < f->family_count; n++) {
        uint32_t next = f->families[n].first_child;
        for (uint32_t c = 0; c < 8; c++) {
            if ((f->families[n].states >> 2 * c & 3) != DF_CHILD_FAMILY) continue;
            family_place *child = &o->places[next++];
            *child = (family_place){.side = o->places[n].side / 2, .parent = n, .child = c, .level = o->places[n].level + 1};
            for (int a = 0; a < 3; a++) child->corner[a] = o->places[n].corner[a] + (c >> a & 1) * child->side;
        }
    }
    return DF_OK;
}

/* Chooses the exponents of all families: that of the values, and more where rounding to a coarser step of the same sample needs it. One step of
 * room is left for what hangs on rounded values. */
static void choose_family_steps(const quantiser *q, octree *o) {
    const df_field *f = q->from;
    const float *values = f->samples;
    for (uint32_t n = 0; n < f->family_count; n++) q->exponents[n] = (int8_t)exponent_for(q, largest_of(values + (size_t)n * FAMILY, FAMILY));
    for (bool grown = true; grown;) {
        grown = false;
        for (uint32_t n = 0; n < f->family_count; n++) {
            for (uint32_t s = 0; s < FAMILY; s++) {
                uint64_t slot = slot_of(&o->steps, key_of(f, o, n, s));
                if (q->exponents[n] > o->steps.exponents[slot]) o->steps.exponents[slot] = q->exponents[n];
            }
        }
        for (uint32_t n = 0; n < f->family_count; n++) {
            double largest = 0;
            for (uint32_t s = 0; s < FAMILY; s++) {
                double step = ldexp(1, o->steps.exponents[slot_of(&o->steps, key_of(f, o, n, s))]);
                largest = fmax(largest, fabs((double)values[(size_t)n * FAMILY + s]) + 2 * step);
            }
            int exponent = exponent_for(q, largest);
            if (exponent <= q->exponents[n]) continue;
            q->exponents[n] = (int8_t)exponent;
            grown = true;
        }
    }
}

/* The rounded value of the leaf at a grid position, if it is at least as large as `side`; false where the cell there is divided. */
static bool coarser_leaf(const df_field *f, const octree *o, const double inside[3], uint32_t level, uint32_t side, const double at[3],
                         uint32_t *leaf_side, double *value) {
    df_adf_cell cell;
    df_adf_find(f, inside, level, &cell);
    if (cell.state == DF_CHILD_FAMILY || cell.side < side) return false;
    float corners[8];
    double local[3];
    for (uint32_t c = 0; c < 8; c++) {
        uint32_t x = (cell.child & 1) + (c & 1), y = (cell.child >> 1 & 1) + (c >> 1 & 1), z = (cell.child >> 2) + (c >> 2);
        corners[c] = (float)o->values[(size_t)cell.family * FAMILY + x + 3 * (y + 3 * z)];
    }
    for (int a = 0; a < 3; a++) local[a] = (at[a] - cell.corner[a]) / cell.side;
    *leaf_side = cell.side;
    *value = df_trilinear(corners, local);
    return true;
}

/* What a sample of a family is to be before it is rounded: its parent's where that has it, the interpolated value of the largest leaf that it hangs on, or
 * its own. */
static double target_of(const df_field *f, const octree *o, uint32_t family, uint32_t sample) {
    const family_place *p = &o->places[family];
    uint32_t place[3] = {sample % 3, sample / 3 % 3, sample / 9}, largest = 0;
    double value = (double)((const float *)f->samples)[(size_t)family * FAMILY + sample], at[3], root = ldexp(1, (int)f->level_count);
    if (family == 0) return value;
    if (place[0] != 1 && place[1] != 1 && place[2] != 1) {
        uint32_t of_parent = 0, weight[3] = {1, 3, 9};
        for (uint32_t a = 0; a < 3; a++) of_parent += ((p->child >> a & 1) + place[a] / 2) * weight[a];
        return o->targets[(size_t)p->parent * FAMILY + of_parent];
    }
    for (int a = 0; a < 3; a++) at[a] = p->corner[a] + place[a] * (p->side / 2.0);
    for (uint32_t d = 1; d < 8; d++) { /* the cells beyond the faces that the sample lies on */
        double inside[3], found;
        bool exists = true;
        uint32_t side;
        for (int a = 0; a < 3; a++) {
            bool beyond = d >> a & 1;
            exists = exists && !(beyond && place[a] == 1);
            double within = p->corner[a] + p->side / 2.0;
            inside[a] = !beyond ? within : place[a] == 0 ? within - p->side : within + p->side;
            exists = exists && inside[a] > 0 && inside[a] < root;
        }
        if (!exists || !coarser_leaf(f, o, inside, p->level, p->side, at, &side, &found) || side <= largest) continue;
        largest = side;
        value = found;
    }
    return value;
}

static df_status quantise_adf(const quantiser *q, df_error *err) {
    const df_field *f = q->from;
    octree o = {0};
    df_status status = make_octree(q, &o, err);
    if (status != DF_OK) goto done;
    choose_family_steps(q, &o);
    for (uint32_t first = 0, end; first < f->family_count; first = end) {
        for (end = first; end < f->family_count && o.places[end].level == o.places[first].level;) end++;
#pragma omp parallel for schedule(dynamic, 64)
        for (uint32_t n = first; n < end; n++) {
            double reach = ldexp(q->limit, q->exponents[n]);
            for (uint32_t s = 0; s < FAMILY; s++) {
                uint64_t at = (uint64_t)n * FAMILY + s;
                int exponent = o.steps.exponents[slot_of(&o.steps, key_of(f, &o, n, s))]; /* known: nothing is claimed */
                o.targets[at] = target_of(f, &o, n, s);
                o.values[at] = round_to(o.targets[at], exponent);
                if (fabs(o.values[at]) > reach) o.values[at] = copysign(reach, o.values[at]);
                put(q, at, o.values[at], q->exponents[n]);
            }
        }
    }
done:
    free_octree(&o);
    return status;
}

/* A copy of what the structure is, with the new samples. */
static df_status copy_structure(const df_field *from, df_field *to, df_error *err) {
    *to = (df_field){.kind = from->kind, .brick_size = from->brick_size, .brick_count = from->brick_count, .verdict = from->verdict,
                     .level_count = from->level_count, .family_count = from->family_count, .error_max = from->error_max, .error_rms = from->error_rms};
    memcpy(to->voxel_count, from->voxel_count, sizeof to->voxel_count);
    memcpy(to->voxel_size, from->voxel_size, sizeof to->voxel_size);
    memcpy(to->origin, from->origin, sizeof to->origin);
    uint64_t cell_total = (uint64_t)from->cell_count[0] * from->cell_count[1] * from->cell_count[2];
    size_t size = from->kind == DF_FIELD_BRICKS ? cell_total * sizeof *from->cells : from->family_count * sizeof *from->families;
    void *copy;
    if (from->kind == DF_FIELD_DENSE) return DF_OK;
    df_status status = df_alloc_raw(&copy, size, 1, "structure", err);
    if (status != DF_OK) return status;
    df_field_own(to, copy);
    memcpy(copy, from->kind == DF_FIELD_BRICKS ? (const void *)from->cells : (const void *)from->families, size);
    if (from->kind == DF_FIELD_BRICKS) to->cells = copy;
    else to->families = copy;
    return DF_OK;
}

/* Leaves whose corners a re-rounded sample brought to the other side. */
static void set_states(const quantiser *q, df_family *families) {
    int32_t middle = q->limit + 1;
    for (uint32_t n = 0; n < q->from->family_count; n++) {
        for (uint32_t c = 0; c < 8; c++) {
            if ((families[n].states >> 2 * c & 3) == DF_CHILD_FAMILY) continue;
            uint32_t inside = 0;
            for (uint32_t i = 0; i < 8; i++) {
                uint32_t x = (c & 1) + (i & 1), y = (c >> 1 & 1) + (i >> 1 & 1), z = (c >> 2) + (i >> 2);
                uint64_t at = (uint64_t)n * FAMILY + x + 3 * (y + 3 * z);
                inside += (q->type == DF_SAMPLE_U16 ? ((uint16_t *)q->samples)[at] : ((uint8_t *)q->samples)[at]) < middle;
            }
            df_child_state state = inside == 0 ? DF_CHILD_OUTSIDE : inside == 8 ? DF_CHILD_INSIDE : DF_CHILD_SURFACE;
            families[n].states = (families[n].states & ~(3u << 2 * c)) | (uint32_t)state << 2 * c;
        }
    }
}

df_status df_quantise(const df_field *from, df_sample_type type, df_field *to, df_error *err) {
    assert(from->sample_type == DF_SAMPLE_F32 && type != DF_SAMPLE_F32);
    quantiser q = {.from = from, .type = type, .limit = type == DF_SAMPLE_U16 ? 32767 : 127};
    df_status status = copy_structure(from, to, err);
    if (status == DF_OK) status = df_alloc_raw(&q.samples, from->sample_count, df_sample_size(type), "samples", err);
    if (status == DF_OK) df_field_own(to, q.samples);
    if (status == DF_OK && from->kind != DF_FIELD_DENSE) {
        uint32_t blocks = from->kind == DF_FIELD_BRICKS ? from->brick_count : from->family_count;
        status = df_alloc_raw((void **)&q.exponents, blocks, 1, "steps", err);
        if (status == DF_OK) df_field_own(to, q.exponents);
    }
    if (status != DF_OK) goto done;
    if (from->kind == DF_FIELD_DENSE) to->step_exponent = quantise_dense(&q);
    if (from->kind == DF_FIELD_BRICKS) quantise_bricks(&q);
    if (from->kind == DF_FIELD_ADF) {
        status = quantise_adf(&q, err);
        if (status == DF_OK) set_states(&q, (df_family *)(uintptr_t)to->families);
    }
    to->sample_type = type;
    to->samples = q.samples;
    to->brick_exponents = q.exponents;
    if (status == DF_OK) status = df_field_finish(to, "quantised field", err);
done:
    if (status != DF_OK) df_field_free(to);
    return status;
}
