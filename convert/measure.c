#include "convert/measure.h"

#include "common/memory.h"
#include "convert/winding.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* A surface cell. */
typedef struct cell {
    float corners[8];
    uint32_t corner[3], side; /* voxels */
    uint64_t number;          /* in the order of the field */
    double roughness;
} cell;

/* A point to measure at: a cell's corner values and a position in it, and what was measured. */
typedef struct probe {
    float corners[8];
    double local[3];
    double world[3];
    double edge;  /* of the cell, world units */
    double area;  /* that it stands for in the mean; 0: none */
    double error; /* of the interpolated value */
} probe;

/* Rough cells get so many points each. */
#define ROUGH_POINTS 8

/* Hands out the cells that get probes while all surface cells are counted past it, and keeps the roughest. */
typedef struct picker {
    const df_field *field;
    probe *probes;
    uint64_t cell_total, cell_next, probe_count, probe_next;
    cell *rough; /* room for twice rough_most */
    uint32_t rough_count, rough_most;
    double least_rough; /* cells below this are none of the roughest */
} picker;

static double random_unit(uint64_t seed) {
    uint64_t z = (seed + 1) * 0x9E3779B97F4A7C15u;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

/* Probe i lies in cell floor(i * cells / probes): evenly over all cells. */
static bool is_picked(const picker *p) {
    return p->probe_next < p->probe_count && p->probe_next * p->cell_total / p->probe_count == p->cell_next;
}

/* A random point of a cell. */
static void put_probe(picker *p, const cell *c, bool counts) {
    probe *to = &p->probes[p->probe_next];
    double grid[3];
    memcpy(to->corners, c->corners, sizeof to->corners);
    to->edge = c->side * p->field->voxel_size[0];
    to->area = counts ? to->edge * to->edge : 0;
    for (int a = 0; a < 3; a++) {
        to->local[a] = random_unit(p->probe_next * 3 + (uint64_t)a);
        grid[a] = c->corner[a] + c->side * to->local[a];
    }
    df_field_grid_to_world(p->field, grid, to->world);
    p->probe_next++;
}

/* How far values in the cell may be off by what they say themselves: distances have a gradient of length 1, and the
 * interpolated one is shorter where the surface or what is nearest changes within the cell. */
static double roughness_of(const df_field *f, const float corners[8], uint32_t side) {
    double square = 0;
    for (int a = 0; a < 3; a++) {
        double rise = 0;
        for (int c = 0; c < 8; c++) rise += c >> a & 1 ? (double)corners[c] : -(double)corners[c];
        rise /= 4 * side * f->voxel_size[a];
        square += rise * rise;
    }
    return fabs(1 - sqrt(square)) * side;
}

static int compare_roughness(const void *x, const void *y) {
    const cell *l = x, *r = y;
    if (l->roughness != r->roughness) return l->roughness > r->roughness ? -1 : 1;
    return l->number < r->number ? -1 : l->number > r->number;
}

static void keep_roughest(picker *p) {
    qsort(p->rough, p->rough_count, sizeof *p->rough, compare_roughness);
    if (p->rough_count < p->rough_most) return;
    p->rough_count = p->rough_most;
    p->least_rough = p->rough[p->rough_most - 1].roughness;
}

static void pick(picker *p, const float corners[8], const uint32_t corner[3], uint32_t side) {
    cell c = {.side = side, .number = p->cell_next};
    c.roughness = roughness_of(p->field, corners, side);
    memcpy(c.corners, corners, sizeof c.corners);
    memcpy(c.corner, corner, sizeof c.corner);
    while (is_picked(p)) put_probe(p, &c, true);
    if (c.roughness > p->least_rough && p->rough_most) {
        p->rough[p->rough_count++] = c;
        if (p->rough_count == 2 * p->rough_most) keep_roughest(p);
    }
    p->cell_next++;
}

static void pick_adf(picker *p, uint32_t family, const uint32_t corner[3], uint32_t side) {
    const df_field *f = p->field;
    uint32_t next = f->families[family].first_child;
    for (uint32_t c = 0; c < 8; c++) {
        df_child_state state = (df_child_state)(f->families[family].states >> 2 * c & 3);
        uint32_t at[3] = {corner[0] + (c & 1) * side, corner[1] + (c >> 1 & 1) * side, corner[2] + (c >> 2) * side};
        if (state == DF_CHILD_FAMILY) {
            pick_adf(p, next++, at, side / 2);
        } else if (state == DF_CHILD_SURFACE) {
            float corners[8];
            df_adf_corners(f, family, c, corners);
            pick(p, corners, at, side);
        }
    }
}

static void pick_bricks(picker *p) {
    const df_field *f = p->field;
    uint32_t k = f->brick_size, words = df_brick_mask_words(k);
    for (uint32_t b = 0; b < f->brick_count; b++) {
        uint32_t at = f->brick_cells[b], voxel[3];
        for (uint32_t i = 0; i < k * k * k; i++) {
            if (!(f->brick_masks[(size_t)b * words + i / 64] >> i % 64 & 1)) continue;
            float corners[8];
            voxel[0] = at % f->cell_count[0] * k + i % k;
            voxel[1] = at / f->cell_count[0] % f->cell_count[1] * k + i / k % k;
            voxel[2] = at / f->cell_count[0] / f->cell_count[1] * k + i / k / k;
            df_field_corners(f, voxel, corners);
            pick(p, corners, voxel, 1);
        }
    }
}

static void pick_dense(picker *p) {
    const df_field *f = p->field;
    uint32_t v[3];
    for (v[2] = 0; v[2] < f->voxel_count[2]; v[2]++) {
        for (v[1] = 0; v[1] < f->voxel_count[1]; v[1]++) {
            for (v[0] = 0; v[0] < f->voxel_count[0]; v[0]++) {
                float corners[8];
                df_field_corners(f, v, corners);
                if (df_corners_straddle(corners, 0)) pick(p, corners, v, 1);
            }
        }
    }
}

/* The signed distance of a point. */
static double true_distance(const df_truth *truth, const df_face_tree *tree, uint32_t *active, const double p[1][3]) {
    double distance = truth->source->at(truth->source->context, p[0]);
    if (truth->source->is_signed) return distance;
    int32_t winding = df_face_tree_winding(tree, p[0]);
    df_sign_rule rule;
    float side = 1;
    df_sign_make_rule(truth->sign, p[0], 0, active, &rule);
    df_sign_apply(&rule, &winding, p, 1, &side);
    return side < 0 ? -distance : distance;
}

/* True where the sign changes along an edge of the cell although the distances at its ends leave no room for a surface:
 * a wall across a hole. The conversion counts walls; how far off the distance is there says nothing about the field
 * elsewhere. The margin is for rounded samples. */
static bool is_wall(const probe *p) {
    for (int c = 0; c < 8; c++) {
        for (int bit = 1; bit < 8; bit <<= 1) {
            const double a = (double)p->corners[c & ~bit], b = (double)p->corners[c | bit];
            if ((a < 0) != (b < 0) && fabs(a) + fabs(b) > 1.05 * p->edge) return true;
        }
    }
    return false;
}

static df_status compare(const df_truth *truth, const df_face_tree *tree, probe *probes, uint64_t count,
                         df_field *field, df_error *err) {
    double largest = 0, sum = 0, area = 0;
    const bool has_holes = truth->sign && truth->sign->made.cap_count > 0;
    bool short_of_memory = false;
#pragma omp parallel reduction(|| : short_of_memory)
    {
        uint32_t *active = malloc(((truth->sign ? truth->sign->made.cap_count : 0) + 1) * sizeof *active);
        short_of_memory = !active;
#pragma omp for schedule(dynamic, 64) reduction(max : largest)
        for (uint64_t i = 0; i < count; i++) {
            if (!active) continue;
            probe *p = &probes[i];
            p->error = 0;
            if (has_holes && is_wall(p)) {
                p->area = 0;
                continue;
            }
            p->error = df_trilinear(p->corners, p->local) - true_distance(truth, tree, active, &p->world);
            largest = fmax(largest, fabs(p->error));
        }
        free(active);
    }
    if (short_of_memory) return df_fail(err, DF_ERROR_MEMORY, "error measurement: out of memory");
    for (uint64_t i = 0; i < count; i++) { /* in order: the same sum for any threads */
        sum += probes[i].area * probes[i].error * probes[i].error;
        area += probes[i].area;
    }
    if (isnan(sum)) return df_fail(err, DF_ERROR_MEMORY, "error measurement: out of memory");
    field->error_max = largest;
    field->error_rms = area > 0 ? sqrt(sum / area) : 0;
    return DF_OK;
}

df_status df_measure_error(const df_truth *truth, uint32_t point_count, df_field *field, df_error *err) {
    assert(truth->source->at);
    df_face_tree made = {0};
    picker p = {.field = field, .cell_total = df_field_surface_voxel_count(field)};
    p.probe_count = p.cell_total ? point_count : 0;
    p.rough_most = (uint32_t)(p.probe_count / 2 / ROUGH_POINTS);
    df_status status = df_alloc_raw((void **)&p.probes, p.probe_count + ROUGH_POINTS * (uint64_t)p.rough_most,
                                    sizeof *p.probes, "error measurement", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&p.rough, 2 * p.rough_most, sizeof *p.rough, "error measurement", err);
    if (status != DF_OK) goto done;
    uint32_t root[3] = {0, 0, 0};
    if (field->kind == DF_FIELD_ADF) pick_adf(&p, 0, root, 1u << (field->level_count - 1));
    else if (field->kind == DF_FIELD_BRICKS) pick_bricks(&p);
    else pick_dense(&p);
    assert(p.probe_next == p.probe_count);
    keep_roughest(&p);
    for (uint32_t i = 0; i < ROUGH_POINTS * p.rough_count; i++) put_probe(&p, &p.rough[i / ROUGH_POINTS], false);
    const df_face_tree *tree = truth->tree;
    if (!tree && !truth->source->is_signed) {
        status = df_face_tree_make(truth->sign->mesh, &made, err);
        tree = &made;
    }
    if (status == DF_OK) status = compare(truth, tree, p.probes, p.probe_next, field, err);
done:
    df_face_tree_free(&made);
    free(p.probes);
    free(p.rough);
    return status;
}
