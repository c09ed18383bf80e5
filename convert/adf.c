#include "convert/adf.h"

#include "common/memory.h"
#include "common/progress.h"
#include "convert/adf_tree.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const adf_task root_task = {.parent = ADF_NONE, .forced = true};

/* Winding numbers of all rows of samples. */
static df_status count_windings(adf_tree *t, df_error *err) {
    const df_lattice *l = t->input->lattice;
    const df_mesh *mesh = t->input->sign->mesh;
    df_face_slabs faces;
    df_status status = df_face_slabs_make(mesh, l, ADF_SLAB, &faces, err);
    if (status == DF_OK && !t->slabs) {
        t->slab_count = faces.slab_count;
        status = df_alloc((void **)&t->slabs, t->slab_count, sizeof *t->slabs, "signs", err);
    }
    if (status != DF_OK) goto done;
#pragma omp parallel for schedule(dynamic, 1)
    for (uint32_t s = 0; s < t->slab_count; s++) {
        df_error slab_err;
        uint32_t z = s * ADF_SLAB, left = l->voxel_count[2] + 1 - z, count = left < ADF_SLAB ? left : ADF_SLAB;
        df_status found = df_winding_slab_find(&t->slabs[s], mesh, faces.faces + faces.starts[s],
                                               faces.starts[s + 1] - faces.starts[s], l, z, count, &slab_err);
        if (found != DF_OK) {
#pragma omp critical
            status = df_fail(err, found, "%s", slab_err.text);
        }
    }
done:
    df_face_slabs_free(&faces);
    return status;
}

/* The same, and again on an oriented mesh where winding numbers below 0 show that a body may be inside out. */
static df_status find_signs(adf_tree *t, df_error *err) {
    df_sign *sign = t->input->sign;
    bool negative = false;
    df_status status = count_windings(t, err);
    for (uint32_t s = 0; status == DF_OK && s < t->slab_count; s++) {
        negative = negative || df_winding_has_negative(&t->slabs[s]);
    }
    if (status != DF_OK || !negative || !df_sign_may_orient(sign, t->input->mesh)) return status;
    status = df_sign_orient(sign, t->input->mesh, err);
    return status == DF_OK && sign->made.inverted_components ? count_windings(t, err) : status;
}

/* Fits the samples after the tasks first given, and divides what that spoils, until nothing is. */
#define ROUND_MAX 64
static df_status make_continuous(adf_tree *t, const adf_task *first, uint32_t count, df_adf_report *report,
                                 df_error *err) {
    adf_task *tasks = NULL;
    df_status status = adf_fit(t, first, count, err);
    count = 1;
    for (int round = 0; status == DF_OK && count && round < ROUND_MAX; round++) {
        free(tasks);
        tasks = NULL;
        status = adf_find_spoiled(t, round, &tasks, &count, err);
        if (status == DF_OK && count == 0) {
            free(tasks);
            tasks = NULL;
            status = adf_find_ridges(t, &tasks, &count, err);
        }
        if (status == DF_OK && count) status = adf_divide(t, tasks, count, err);
        if (status == DF_OK && count) status = adf_fit(t, tasks, count, err);
        report->divided_for_continuity += count;
    }
    free(tasks);
    return status == DF_OK ? adf_number(t, err) : status;
}

/* ---- the slope ---- */

/* The leaves of a pilot: sums of area, and of error squared by area. */
typedef struct pilot_sum {
    double area, square;
} pilot_sum;

/* rms: that of the node's cell. */
static void sum_pilot(const adf_tree *t, const adf_node *n, double rms, pilot_sum *sum) {
    double side = adf_side(t, n->level);
    for (int c = 0; c < 8; c++) {
        if (n->children[c] != ADF_NONE) {
            sum_pilot(t, adf_node_at(t, n->children[c]), (double)n->rms[c], sum);
        } else if (n->crossed[c] && n->level > ADF_PILOT_LEVEL) {
            double error = n->fitted[c] ? (double)n->rms[c] : rms / 3; /* not known where a side is a voxel */
            sum->area += side * side;
            sum->square += side * side * error * error;
        }
    }
}

static void free_nodes(adf_tree *t) {
    for (uint32_t c = 0; t->chunks && c < t->chunk_count && c < ADF_CHUNK_COUNT; c++) free(t->chunks[c]);
    free(t->chunks);
    t->chunks = NULL;
    t->chunk_count = t->family_count = 0;
}

static df_status divide_from_root(adf_tree *t, df_error *err) {
    df_status status = df_alloc((void **)&t->chunks, ADF_CHUNK_COUNT, sizeof *t->chunks, "octree", err);
    return status == DF_OK ? adf_divide(t, &root_task, 1, err) : status;
}

/* Lists the leaves that the slope asks to divide. tasks: room for 8 a node. */
static uint32_t list_steep(const adf_tree *t, uint32_t number, adf_task *tasks) {
    const adf_node *n = adf_node_at(t, number);
    uint32_t count = 0;
    for (uint32_t c = 0; c < 8; c++) {
        if (n->children[c] != ADF_NONE) count += list_steep(t, n->children[c], tasks + count);
        else if (n->fitted[c] && (double)n->rms[c] * adf_side(t, n->level) > t->slope)
            tasks[count++] = (adf_task){.parent = number, .child = c};
    }
    return count;
}

/* Divides further, after the slope was lowered. *tasks, which is the caller's: where. */
static df_status deepen(adf_tree *t, adf_task **tasks, uint32_t *count, df_error *err) {
    df_status status = df_alloc_raw((void **)tasks, 8 * (uint64_t)t->family_count, sizeof **tasks, "octree", err);
    if (status != DF_OK) return status;
    *count = list_steep(t, 0, *tasks);
    return adf_divide(t, *tasks, *count, err);
}

static df_status deepen_pilot(adf_tree *t, df_error *err) {
    adf_task *tasks;
    uint32_t count;
    df_status status = deepen(t, &tasks, &count, err);
    free(tasks);
    return status;
}

/* What continuity adds to the root mean square of leaves that are fitted on their own, and some room: a second attempt
 * costs more than a few leaves. */
#define PILOT_FACTOR 1.27

/* Finds the slope for the root mean square that is asked: halves it on a part of the octree until that has less, then
 * goes between the last two, along the line through their logarithms. */
static df_status choose_slope(adf_tree *t, df_error *err) {
    double target = t->input->rms_error / PILOT_FACTOR, rms = INFINITY, last = INFINITY;
    t->pilot = true;
    t->slope = 2 * target * adf_side(t, t->level_count > ADF_PILOT_LEVEL ? ADF_PILOT_LEVEL : t->level_count);
    df_status status = DF_OK;
    do {
        pilot_sum sum = {0, 0};
        last = rms;
        t->slope /= 2;
        status = t->chunks ? deepen_pilot(t, err) : divide_from_root(t, err);
        if (status == DF_OK) sum_pilot(t, adf_node_at(t, 0), 0, &sum);
        rms = sum.area > 0 ? sqrt(sum.square / sum.area) : 0;
    } while (status == DF_OK && rms > target && rms < last);
    if (isfinite(last) && rms > 0 && rms < target) t->slope *= exp2(log(target / rms) / log(last / rms));
    t->pilot = false;
    free_nodes(t);
    return status;
}

/* True where the exact distances at the ends of an edge of the child show a wall. */
static bool has_wall(const adf_node *n, uint32_t child, double side) {
    for (uint32_t edge = 0; edge < 12; edge++) {
        const uint32_t steps[3] = {1, 3, 9}, axis = edge / 4, u = (axis + 1) % 3, v = (axis + 2) % 3;
        uint32_t at = (edge & 1) * steps[u] + (edge >> 1 & 1) * steps[v];
        for (int a = 0; a < 3; a++) at += (child >> a & 1) * steps[a];
        if (df_sign_is_wall(side, n->exact[at], n->exact[at + steps[axis]])) return true;
    }
    return false;
}

static void count_walls(const adf_tree *t, df_adf_report *report) {
    const df_lattice *l = t->input->lattice;
    uint64_t count = 0, first = UINT64_MAX;
#pragma omp parallel for schedule(static) reduction(+ : count) reduction(min : first)
    for (uint32_t f = 0; f < t->family_count; f++) {
        const adf_node *n = adf_node_at(t, t->order[f]);
        const double side = adf_side(t, n->level) * l->voxel_size;
        for (uint32_t c = 0; c < 8; c++) {
            if (n->children[c] != ADF_NONE || !has_wall(n, c, side)) continue;
            const uint64_t leaf = 8 * (uint64_t)f + c;
            count++;
            first = leaf < first ? leaf : first;
        }
    }
    report->wall_count = count;
    if (count == 0) return;
    const adf_node *n = adf_node_at(t, t->order[first / 8]);
    for (int a = 0; a < 3; a++) {
        report->wall_place[a] =
            l->origin[a] + (n->corner[a] + (first >> a & 1) * adf_side(t, n->level)) * l->voxel_size;
    }
}

static void set_dimensions(const adf_tree *t, df_field *field) {
    const df_lattice *l = t->input->lattice;
    field->kind = DF_FIELD_ADF;
    field->sample_type = DF_SAMPLE_F32;
    field->error_max = field->error_rms = -1;
    field->level_count = t->level_count;
    field->family_count = t->family_count;
    for (int a = 0; a < 3; a++) {
        field->voxel_count[a] = l->voxel_count[a];
        field->voxel_size[a] = l->voxel_size;
        field->origin[a] = l->origin[a];
    }
}

static df_status store(adf_tree *t, df_field *field, df_error *err) {
    float *samples;
    uint64_t sample_count = 8 + (uint64_t)t->family_count * DF_FAMILY_STORED_COUNT;
    df_status status = df_alloc_raw((void **)&samples, sample_count, sizeof *samples, "octree", err);
    if (status != DF_OK) return status;
    df_field_own(field, samples);
    df_field_own(field, t->families);
#pragma omp parallel for schedule(static)
    for (uint32_t f = 0; f < t->family_count; f++) {
        df_family_store(adf_node_at(t, t->order[f])->final, f, samples);
    }
    set_dimensions(t, field);
    field->families = t->families;
    field->samples = samples;
    t->families = NULL;
    return df_field_finish(field, t->input->name, err);
}

static void free_tree(adf_tree *t) {
    for (uint32_t s = 0; t->slabs && s < t->slab_count; s++) df_winding_slab_free(&t->slabs[s]);
    free_nodes(t);
    free(t->slabs);
    free(t->marks);
    free(t->wishes);
    free(t->order);
    free(t->families);
    df_neighbours_free(&t->neighbours);
}

struct df_adf {
    adf_tree tree;
    df_adf_input input;
};

/* Makes the octree continuous after it was divided at the tasks, and the field. */
static df_status finish(adf_tree *t, const adf_task *tasks, uint32_t count, df_field *field, df_adf_report *report,
                        df_error *err) {
    double start = df_now_ms();
    df_status status = make_continuous(t, tasks, count, report, err);
    double continuous = df_now_ms();
    if (status == DF_OK && !t->input->source->is_signed) count_walls(t, report);
    if (status == DF_OK) status = store(t, field, err);
    report->rms_slope = t->slope;
    report->samples_computed = t->samples_computed;
    report->leaves = 7 * (uint64_t)t->family_count + 1;
    report->continuity_ms += continuous - start;
    report->structure_ms += df_now_ms() - continuous;
    if (status != DF_OK) df_field_free(field);
    return status;
}

df_status df_adf_start(const df_adf_input *input, df_adf **adf, df_field *field, df_adf_report *report, df_error *err) {
    assert(input->tree || (input->source->is_signed && input->crosses));
    *report = (df_adf_report){0};
    df_status status = df_alloc((void **)adf, 1, sizeof **adf, "octree", err);
    if (status != DF_OK) return status;
    (*adf)->input = *input;
    adf_tree *t = &(*adf)->tree;
    *t = (adf_tree){.input = &(*adf)->input, .level_count = 1};
    for (int a = 0; a < 3; a++) {
        while (1u << t->level_count < input->lattice->voxel_count[a]) t->level_count++;
    }
    double start = df_now_ms();
    status = input->source->is_signed ? DF_OK : find_signs(t, err);
    double signs = df_now_ms();
    t->slope = input->rms_slope > 0 ? input->rms_slope : (double)INFINITY;
    if (status == DF_OK && !(input->rms_slope > 0) && isfinite(input->rms_error)) status = choose_slope(t, err);
    if (status == DF_OK) status = divide_from_root(t, err);
    report->sign_ms = signs - start;
    report->divide_ms = df_now_ms() - signs;
    return status == DF_OK ? finish(t, &root_task, 1, field, report, err) : status;
}

df_status df_adf_refine(df_adf *adf, double rms_slope, df_field *field, df_adf_report *report, df_error *err) {
    adf_tree *t = &adf->tree;
    adf_task *tasks;
    uint32_t count;
    double start = df_now_ms();
    t->slope = rms_slope;
    for (uint32_t i = 0; i < t->family_count; i++) t->marks[t->order[i]].check = 1; /* more is asked of all leaves */
    df_status status = deepen(t, &tasks, &count, err);
    report->divide_ms += df_now_ms() - start;
    if (status == DF_OK) status = finish(t, tasks, count, field, report, err);
    free(tasks);
    return status;
}

void df_adf_free(df_adf *adf) {
    if (adf) free_tree(&adf->tree);
    free(adf);
}
