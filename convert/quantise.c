#include "convert/quantise.h"

#include "common/memory.h"
#include "convert/neighbours.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define FAMILY DF_FAMILY_SAMPLE_COUNT
#define EXPONENT_MIN (-126)
#define EXPONENT_MAX 100

/* Values of bricks end here, in voxels: no sample of the 4x4x4 around a surface voxel, which gradients and cubic
 * filters look at, is further from the surface than 2 sqrt(3). With u16 no step is longer than 2 * 4 / 32767 voxels
 * then, and no sample moves by more than that: 2.45e-4. */
#define BRICK_REACH 4

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
        uint64_t index =
            exists ? (uint64_t)p[0] + f->cell_count[0] * ((uint64_t)p[1] + f->cell_count[1] * (uint64_t)p[2]) : 0;
        uint32_t other = exists ? f->cells[index] : DF_CELL_OUTSIDE;
        around[i] = other < DF_CELL_INSIDE ? q->exponents[other] : EXPONENT_MIN;
    }
    for (int i = 0; i < 27; i++) {
        coarsest[i] = EXPONENT_MIN;
        for (int n = 0; n < 27; n++) { /* neighbours in the direction of the sample or none, along each axis */
            bool shares = (n % 3 == 1 || n % 3 == i % 3) && (n / 3 % 3 == 1 || n / 3 % 3 == i / 3 % 3) &&
                          (n / 9 == 1 || n / 9 == i / 9);
            if (shares && around[n] > coarsest[i]) coarsest[i] = around[n];
        }
    }
}

static double brick_reach(const df_field *f) {
    return BRICK_REACH * fmax(f->voxel_size[0], fmax(f->voxel_size[1], f->voxel_size[2]));
}

/* The rounded samples of a brick; returns the largest magnitude. */
static double round_brick(const quantiser *q, uint32_t brick, double *rounded) {
    uint32_t k = q->from->brick_size, side = k + 1;
    const float *values = (const float *)q->from->samples + (size_t)brick * df_brick_sample_count(k);
    int coarsest[27];
    double largest = 0;
    const double reach = brick_reach(q->from);
    coarsest_of_brick(q, brick, coarsest);
    for (uint32_t i = 0; i < df_brick_sample_count(k); i++) {
        uint32_t place = place_of(i % side, k) + 3 * (place_of(i / side % side, k) + 3 * place_of(i / side / side, k));
        rounded[i] = round_to(fmax(-reach, fmin(reach, (double)values[i])), coarsest[place]);
        largest = fmax(largest, fabs(rounded[i]));
    }
    return largest;
}

static void quantise_bricks(const quantiser *q) {
    const df_field *f = q->from;
    const double reach = brick_reach(f);
    uint32_t per_brick = df_brick_sample_count(f->brick_size);
    double rounded[729];
    for (uint32_t b = 0; b < f->brick_count; b++) {
        double largest = largest_of((const float *)f->samples + (size_t)b * per_brick, per_brick);
        q->exponents[b] = (int8_t)exponent_for(q, fmin(largest, reach));
    }
    /* Rounding to a neighbour's step may lead out of a brick's range; its step then grows, which its neighbours must
     * follow. */
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

/* ---- octrees: residuals, level by level ---- */

/* A part of the families small enough to be stored as floats: 1 of so many. */
#define EXACT_PART 128

typedef struct octree {
    df_neighbours neighbours;
    float (*cells)[8]; /* by family: the corners of its cell, decoded */
    df_field *to;
} octree;

/* What the samples of a family differ from the means of its cell's corners; 0 where they hang. */
static void find_residuals(const quantiser *q, const octree *o, uint32_t family, double residuals[FAMILY]) {
    float cell[8], targets[FAMILY];
    uint32_t hanging = df_hanging_samples(&o->neighbours, family);
    df_adf_cell_corners(q->from, family, cell);
    df_adf_samples(q->from, family, cell, targets);
    for (uint32_t s = 0; s < FAMILY; s++) {
        bool is_free = df_family_slot(s) >= 0 && !(hanging >> s & 1);
        residuals[s] = is_free ? (double)targets[s] - (double)df_family_predict(o->cells[family], s) : 0;
    }
}

static void choose_family_step(const quantiser *q, const octree *o, uint32_t family) {
    double residuals[FAMILY], largest = 0;
    find_residuals(q, o, family, residuals);
    for (uint32_t s = 0; s < FAMILY; s++) largest = fmax(largest, fabs(residuals[s]));
    q->exponents[family - o->to->exact_count] = (int8_t)exponent_for(q, largest);
}

/* A residual in steps of the coarsest exponent of the families that share the sample, small enough for the finest; the
 * value keeps its side. */
static int round_residual(const quantiser *q, double residual, float mean, int coarsest, int finest) {
    float step = df_power_of_two(coarsest);
    double limit = floor(ldexp(q->limit, finest - coarsest));
    int steps = (int)fmax(-limit, fmin(limit, nearbyint(residual / (double)step)));
    bool inside = (double)mean + residual < 0;
    if (inside && mean + (float)steps * step >= 0 && steps > -limit) steps--;
    if (!inside && mean + (float)steps * step < 0 && steps < limit) steps++;
    return steps;
}

static void put_family(const quantiser *q, const octree *o, uint32_t family) {
    double residuals[FAMILY];
    const uint32_t exact = o->to->exact_count;
    const int own = q->exponents[family - exact];
    find_residuals(q, o, family, residuals);
    for (uint32_t s = 0; s < FAMILY; s++) {
        const df_sample_cells *cells = &o->neighbours.cells[s];
        const int slot = df_family_slot(s);
        int coarsest = own, finest = own, steps = 0;
        for (uint32_t i = 0; i < cells->count; i++) {
            uint32_t other = o->neighbours.around[family][cells->directions[i]];
            if (other >= DF_NEIGHBOUR_LEAF) continue;
            int exponent = q->exponents[other - exact];
            coarsest = exponent > coarsest ? exponent : coarsest;
            finest = exponent < finest ? exponent : finest;
        }
        if (slot < 0) continue;
        if (residuals[s] != 0) {
            steps = round_residual(q, residuals[s], df_family_predict(o->cells[family], s), coarsest, finest);
        }
        put(q, (uint64_t)(family - exact) * DF_FAMILY_STORED_COUNT + (uint64_t)slot, ldexp(steps, coarsest), own);
    }
}

/* Hands the decoded corners of a family's children to the families that they have become. */
static void hand_down(const octree *o, uint32_t family) {
    float samples[FAMILY];
    df_adf_samples(o->to, family, o->cells[family], samples);
    for (uint32_t c = 0; c < 8; c++) {
        const df_family *f = &o->to->families[family];
        if (df_family_state(f, c) != DF_CHILD_FAMILY) continue;
        for (uint32_t i = 0; i < 8; i++) o->cells[df_family_child(f, c)][i] = samples[df_family_corner(c, i)];
    }
}

static df_status allocate_octree(quantiser *q, octree *o, df_error *err) {
    const df_field *f = q->from;
    df_field *to = o->to;
    df_status status = df_neighbours_find(f->families, f->family_count, &o->neighbours, err);
    if (status == DF_OK) status = df_alloc_raw((void **)&o->cells, f->family_count, sizeof *o->cells, "octree", err);
    if (status != DF_OK) return status;
    for (uint32_t level = 0; level < o->neighbours.level_count; level++) {
        if (o->neighbours.starts[level + 1] <= f->family_count / EXACT_PART)
            to->exact_count = o->neighbours.starts[level + 1];
    }
    uint8_t *samples;
    to->sample_type = q->type;
    status = df_alloc_raw((void **)&samples, df_adf_sample_bytes(to), 1, "samples", err);
    if (status != DF_OK) return status;
    df_field_own(to, samples);
    status = df_alloc_raw((void **)&q->exponents, f->family_count - to->exact_count, 1, "steps", err);
    if (status != DF_OK) return status;
    df_field_own(to, q->exponents);
    uint64_t exact_bytes = (8 + (uint64_t)to->exact_count * DF_FAMILY_STORED_COUNT) * sizeof(float);
    memcpy(samples, f->samples, exact_bytes);
    memcpy(o->cells[0], f->samples, sizeof o->cells[0]);
    to->samples = samples;
    to->brick_exponents = q->exponents;
    q->samples = samples + exact_bytes;
    return DF_OK;
}

static df_status quantise_adf(quantiser *q, df_field *to, df_error *err) {
    octree o = {.to = to};
    df_status status = allocate_octree(q, &o, err);
    for (uint32_t level = 0; status == DF_OK && level < o.neighbours.level_count; level++) {
        const uint32_t first = o.neighbours.starts[level], end = o.neighbours.starts[level + 1];
        const bool exact = first < to->exact_count;
#pragma omp parallel
        {
#pragma omp for schedule(static)
            for (uint32_t f = exact ? end : first; f < end; f++) choose_family_step(q, &o, f);
#pragma omp for schedule(static)
            for (uint32_t f = exact ? end : first; f < end; f++) put_family(q, &o, f);
#pragma omp for schedule(static)
            for (uint32_t f = first; f < end; f++) hand_down(&o, f);
        }
    }
    df_neighbours_free(&o.neighbours);
    free(o.cells);
    return status;
}

/* A copy of what the structure is, with the new samples. */
static df_status copy_structure(const df_field *from, df_field *to, df_error *err) {
    *to = (df_field){.kind = from->kind,
                     .brick_size = from->brick_size,
                     .brick_count = from->brick_count,
                     .verdict = from->verdict,
                     .level_count = from->level_count,
                     .family_count = from->family_count,
                     .error_max = from->error_max,
                     .error_rms = from->error_rms};
    memcpy(to->voxel_count, from->voxel_count, sizeof to->voxel_count);
    memcpy(to->voxel_size, from->voxel_size, sizeof to->voxel_size);
    memcpy(to->origin, from->origin, sizeof to->origin);
    uint64_t cell_total = (uint64_t)from->cell_count[0] * from->cell_count[1] * from->cell_count[2];
    size_t size =
        from->kind == DF_FIELD_BRICKS ? cell_total * sizeof *from->cells : from->family_count * sizeof *from->families;
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

static df_status quantise_lattice(quantiser *q, df_field *to, df_error *err) {
    const df_field *from = q->from;
    df_status status = df_alloc_raw(&q->samples, from->sample_count, df_sample_size(q->type), "samples", err);
    if (status != DF_OK) return status;
    df_field_own(to, q->samples);
    to->sample_type = q->type;
    to->samples = q->samples;
    if (from->kind == DF_FIELD_DENSE) {
        to->step_exponent = quantise_dense(q);
        return DF_OK;
    }
    status = df_alloc_raw((void **)&q->exponents, from->brick_count, 1, "steps", err);
    if (status != DF_OK) return status;
    df_field_own(to, q->exponents);
    to->brick_exponents = q->exponents;
    quantise_bricks(q);
    return DF_OK;
}

df_status df_quantise(const df_field *from, df_sample_type type, df_field *to, df_error *err) {
    assert(from->sample_type == DF_SAMPLE_F32 && type != DF_SAMPLE_F32);
    quantiser q = {.from = from, .type = type, .limit = type == DF_SAMPLE_U16 ? 32767 : 127};
    df_status status = copy_structure(from, to, err);
    if (status != DF_OK) goto done;
    if (from->kind == DF_FIELD_ADF) status = quantise_adf(&q, to, err);
    else status = quantise_lattice(&q, to, err);
    if (status == DF_OK) status = df_field_finish(to, "quantised field", err);
done:
    if (status != DF_OK) df_field_free(to);
    return status;
}
