#include "convert/build_private.h"

#include "common/memory.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

double df_available_memory(void) {
    double available = 1e18;
    FILE *file = fopen("/proc/meminfo", "re");
    char line[256];
    unsigned long long kib;
    while (file && fgets(line, sizeof line, file)) {
        if (sscanf(line, "MemAvailable: %llu", &kib) == 1) available = (double)kib * 1024;
    }
    if (file) fclose(file);
    struct rlimit limit;
    unsigned long long pages = 0;
    if (getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY) {
        file = fopen("/proc/self/statm", "re");
        if (file && fscanf(file, "%llu", &pages) != 1) pages = 0;
        if (file) fclose(file);
        available = fmin(available, (double)limit.rlim_cur - (double)pages * 4096);
    }
    return available;
}

df_status df_build_check_memory(const char *name, double bytes, uint32_t longest, double exponent, df_error *err) {
    double available = df_available_memory();
    if (bytes <= available) return DF_OK;
    double fits = floor(longest * pow(fmax(available, 0) / bytes, 1 / exponent) * 0.95);
    return df_fail(err, DF_ERROR_MEMORY,
                   "%s: needs about %.3g GB at %u voxels along the longest side, %.3g GB are available: "
                   "--resolution %.0f would fit",
                   name, bytes / 1e9, longest, available / 1e9, fmax(fits, 1));
}

uint32_t df_build_longest_side(const df_lattice *l) {
    uint32_t longest = 0;
    for (int a = 0; a < 3; a++) longest = l->voxel_count[a] > longest ? l->voxel_count[a] : longest;
    return longest;
}

void df_build_set_dimensions(const builder *b, df_field *field) {
    field->kind = b->input->kind;
    field->sample_type = DF_SAMPLE_F32;
    field->error_max = field->error_rms = -1;
    for (int a = 0; a < 3; a++) {
        field->voxel_count[a] = b->lattice->voxel_count[a];
        field->voxel_size[a] = b->lattice->voxel_size;
        field->origin[a] = b->lattice->origin[a];
    }
}

/* Computes the samples of one block of k^3 of a dense field. */
static void fill_block(const builder *b, uint32_t index) {
    const df_lattice *l = b->lattice;
    uint32_t cell[3];
    df_cell_position(l, index, cell);
    df_sample_box box;
    for (int a = 0; a < 3; a++) {
        box.first[a] = cell[a] * l->brick_size;
        box.count[a] = cell[a] + 1 == l->cell_count[a] ? l->voxel_count[a] - box.first[a] + 1 : l->brick_size;
    }
    float values[BRICK_SAMPLES_MAX];
    b->input->source->fill(b->input->source->context, l, &box, values);
    const float *from = values;
    size_t row = (size_t)l->voxel_count[0] + 1, layer = row * ((size_t)l->voxel_count[1] + 1);
    for (uint32_t z = 0; z < box.count[2]; z++) {
        for (uint32_t y = 0; y < box.count[1]; y++, from += box.count[0]) {
            float *to = b->samples + box.first[0] + row * (box.first[1] + y) + layer * (box.first[2] + z);
            memcpy(to, from, box.count[0] * sizeof *from);
        }
    }
}

/* Counts the pairs of neighbours along an axis whose signs differ although no surface can lie between them. */
static void count_walls(const builder *b, df_build_report *report) {
    const df_lattice *l = b->lattice;
    const size_t row = (size_t)l->voxel_count[0] + 1, layer = row * ((size_t)l->voxel_count[1] + 1);
    const size_t steps[3] = {1, row, layer};
    uint64_t count = 0, first = UINT64_MAX;
#pragma omp parallel for schedule(static) reduction(+ : count) reduction(min : first)
    for (uint32_t z = 0; z <= l->voxel_count[2]; z++) {
        for (uint32_t y = 0; y <= l->voxel_count[1]; y++) {
            for (uint32_t x = 0; x <= l->voxel_count[0]; x++) {
                const uint32_t p[3] = {x, y, z};
                const size_t at = x + row * y + layer * z;
                for (int a = 0; a < 3; a++) {
                    if (p[a] == l->voxel_count[a] ||
                        !df_sign_is_wall(l->voxel_size, b->samples[at], b->samples[at + steps[a]]))
                        continue;
                    count++;
                    first = at < first ? at : first;
                }
            }
        }
    }
    report->wall_count = count;
    if (count == 0) return;
    const size_t place[3] = {first % row, first % layer / row, first / layer};
    for (int a = 0; a < 3; a++) report->wall_place[a] = df_lattice_at(l, a, (uint32_t)place[a]);
}

df_status df_build_dense(builder *b, df_field *field, df_build_report *report, df_error *err) {
    double start = df_now_ms();
    uint64_t count = df_dense_sample_count(b->lattice->voxel_count);
    df_status status =
        df_build_check_memory(b->input->name, (double)count * sizeof(float), df_build_longest_side(b->lattice), 3, err);
    if (status == DF_OK) status = df_alloc_raw((void **)&b->samples, count, sizeof(float), "samples", err);
    if (status != DF_OK) return status;
    uint32_t total = (uint32_t)df_lattice_cell_total(b->lattice);
    df_progress_begin(&b->progress, "distances", total, b->input->quiet);
#pragma omp parallel for schedule(dynamic, 16)
    for (uint32_t i = 0; i < total; i++) {
        fill_block(b, i);
        df_progress_add(&b->progress, 1);
    }
    df_progress_end(&b->progress);
    double filled = df_now_ms();
    if (!b->input->source->is_signed) status = df_build_sign_dense(b, err);
    if (status != DF_OK) return status;
    if (!b->input->source->is_signed) count_walls(b, report);
    double with_signs = df_now_ms();
    df_build_set_dimensions(b, field);
    field->samples = b->samples;
    df_field_own(field, b->samples);
    b->samples = NULL;
    status = df_field_finish(field, b->input->name, err);
    report->samples_computed = count;
    report->distance_ms = filled - start;
    report->sign_ms = with_signs - filled;
    report->structure_ms = df_now_ms() - with_signs;
    return status;
}

df_status df_build(const df_build_input *input, df_field *field, df_build_report *report, df_error *err) {
    assert(input->mesh || input->source->is_signed);
    uint32_t side = input->lattice->brick_size + 1;
    builder b = {.input = input, .lattice = input->lattice, .side = side, .brick_samples = (size_t)side * side * side};
    *report = (df_build_report){0};
    df_status status = input->kind == DF_FIELD_DENSE ? df_build_dense(&b, field, report, err)
                                                     : df_build_bricks(&b, field, report, err);
    if (status != DF_OK) df_field_free(field);
    df_cells_free(&b.cells);
    free(b.samples);
    return status;
}
