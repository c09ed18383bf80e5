#include "convert/adf.h"

#include "common/memory.h"
#include "common/progress.h"
#include "convert/adf_tree.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

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

/* Fits the samples, and divides what that spoils, until nothing is. */
#define ROUND_MAX 64
static df_status make_continuous(adf_tree *t, df_adf_report *report, df_error *err) {
    for (int round = 0;; round++) {
        adf_task *tasks = NULL;
        uint32_t count = 0;
        df_status status = adf_number(t, err);
        if (status == DF_OK) status = adf_fit(t, err);
        if (status == DF_OK && round < ROUND_MAX) status = adf_find_spoiled(t, &tasks, &count, err);
        if (status == DF_OK && count) status = adf_divide(t, tasks, count, err);
        free(tasks);
        report->divided_for_continuity += count;
        if (status != DF_OK || count == 0) return status;
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
    for (uint32_t c = 0; t->chunks && c < t->chunk_count && c < ADF_CHUNK_COUNT; c++) free(t->chunks[c]);
    free(t->slabs);
    free(t->chunks);
    free(t->order);
    free(t->families);
    df_neighbours_free(&t->neighbours);
}

df_status df_adf_build(const df_adf_input *input, df_field *field, df_adf_report *report, df_error *err) {
    assert(input->tree || (input->source->is_signed && input->crosses));
    adf_tree t = {.input = input, .level_count = 1};
    const adf_task root = {ADF_NONE, 0, true};
    *report = (df_adf_report){0};
    for (int a = 0; a < 3; a++) {
        while (1u << t.level_count < input->lattice->voxel_count[a]) t.level_count++;
    }
    double start = df_now_ms();
    df_status status = df_alloc((void **)&t.chunks, ADF_CHUNK_COUNT, sizeof *t.chunks, "octree", err);
    if (status == DF_OK && !input->source->is_signed) status = find_signs(&t, err);
    double signs = df_now_ms();
    if (status == DF_OK) status = adf_divide(&t, &root, 1, err);
    double divided = df_now_ms();
    if (status == DF_OK) status = make_continuous(&t, report, err);
    double continuous = df_now_ms();
    if (status == DF_OK) status = store(&t, field, err);
    report->samples_computed = t.samples_computed;
    report->leaves = 7 * (uint64_t)t.family_count + 1;
    report->sign_ms = signs - start;
    report->divide_ms = divided - signs;
    report->continuity_ms = continuous - divided;
    report->structure_ms = df_now_ms() - continuous;
    if (status != DF_OK) df_field_free(field);
    free_tree(&t);
    return status;
}
