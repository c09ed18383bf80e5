#include "storage.h"
#include "render/methods/filter.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static df_status quantise(const df_field *dense, df_sample_type type, df_field *out, df_error *err) {
    const uint64_t count = dense->sample_count;
    const float *samples = dense->samples;
    const int zero = type == DF_SAMPLE_U8 ? 128 : 32768;
    const double largest = fmax(fabs((double)dense->value_min), fabs((double)dense->value_max));
    /* values beyond a few voxels are clamped: no surface voxel has any */
    const double range = fmin(largest, type == DF_SAMPLE_U8 ? 2.0 : 8.0);
    void *codes = malloc(count * df_sample_size(type));
    *out = (df_field){.kind = DF_FIELD_DENSE, .sample_type = type};
    if (!codes) return df_fail(err, DF_ERROR_MEMORY, "no memory for samples");
    df_field_own(out, codes);
    out->samples = codes;
    out->step_exponent = (int)ceil(log2(range / (zero - 1)));
    for (int a = 0; a < 3; a++) {
        out->voxel_count[a] = dense->voxel_count[a];
        out->voxel_size[a] = dense->voxel_size[a];
        out->origin[a] = dense->origin[a];
    }
    for (uint64_t i = 0; i < count; i++) {
        double q = fmin(zero - 1, fmax(-zero, rint(ldexp((double)samples[i], -out->step_exponent))));
        if (q == 0 && samples[i] < 0) q = -1;
        if (type == DF_SAMPLE_U8) ((uint8_t *)codes)[i] = (uint8_t)(q + zero);
        else ((uint16_t *)codes)[i] = (uint16_t)(q + zero);
    }
    return df_field_finish(out, "quantised", err);
}

/* A row about what a field holds, with the tracer and intersection that read it. */
static lab_row storage_row(const char *tracer, const char *intersect, uint64_t rays, const lab_score *score) {
    return (lab_row){.kind = "storage",
                     .tracer = tracer,
                     .intersect = intersect,
                     .precision = "",
                     .gradient = "",
                     .truth = "surface",
                     .family = "camera",
                     .rays = rays,
                     .score = score,
                     .ns_per_ray = -1,
                     .ns_per_hit = -1};
}

/* The error of a stored field against its exact surface: truth against truth, no tracer. */
static df_status measure_storage(lab_session *session, const char *name, const lab_surface *surface,
                                 const df_field *field, uint64_t rays) {
    const double box[3] = {field->voxel_count[0], field->voxel_count[1], field->voxel_count[2]};
    lab_score score = {0};
    lab_subject s = {.surface = *surface, .field = *field};
    snprintf(s.name, sizeof s.name, "%s", name);
    const lab_row r = storage_row("", "", rays, &score);
    if (lab_row_have(session, &s, &r)) return DF_OK;
#pragma omp parallel
    {
        lab_score mine = {0};
#pragma omp for
        for (uint64_t i = 0; i < rays; i++) {
            double o[3], d[3];
            df_truth stored, exact;
            if (!lab_family_ray(field, LAB_CAMERA, LAB_SEED, i, o, d)) continue;
            df_truth_trace(field, 0, o, d, &stored);
            lab_surface_trace(surface, box, o, d, &exact);
            const double off = fabs((double)(stored.t - exact.t)) * sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
            exact.tangent |= stored.tangent;
            lab_score_pair(&mine, i, &exact, stored.hit, off);
        }
#pragma omp critical
        lab_score_merge(&score, &mine);
    }
    return lab_row_write(session, &s, &r);
}

/* The tracer of cubic reconstruction, with its filter decided. */
static df_status prepare_catmull_rom(const df_scene *scene, const df_trace_options *options, void **state,
                                     df_error *err) {
    df_trace_options with_filter = *options;
    with_filter.filter = DF_FILTER_CATMULL_ROM;
    return df_tracer_tricubic.prepare(scene, &with_filter, state, err);
}

/* What the samples of a dense field hold when 64 of them are read for a value and not 8. */
static df_status measure_tricubic(lab_session *session, const char *name, const lab_surface *surface,
                                  const df_field *dense, uint64_t rays) {
    const df_scene_options options = {0};
    df_tracer tracer = df_tracer_tricubic;
    lab_score score = {0};
    lab_subject s = {.surface = *surface, .field = *dense};
    snprintf(s.name, sizeof s.name, "%s", name);
    const lab_row r = storage_row(tracer.name, df_filter_names[DF_FILTER_CATMULL_ROM], rays, &score);
    if (lab_row_have(session, &s, &r)) return DF_OK;
    tracer.prepare = prepare_catmull_rom;
    df_status status = df_scene_prepare(dense, 0, &options, &s.scene, session->err);
    const lab_run run = {.tracer = &tracer,
                         .scene = &s.scene,
                         .surface = surface,
                         .family = LAB_CAMERA,
                         .seed = LAB_SEED,
                         .count = rays};
    if (status == DF_OK) status = lab_measure(&run, &score, session->err);
    if (status == DF_OK) status = lab_row_write(session, &s, &r);
    df_scene_free(&s.scene);
    return status;
}

df_status lab_measure_structures(lab_session *session, const char *name, uint32_t size, uint64_t rays) {
    df_status status = DF_OK;
    df_field dense = {0};
    const df_field_kind kinds[] = {DF_FIELD_DENSE, DF_FIELD_BRICKS, DF_FIELD_ADF};
    for (int k = 0; k < 3 && status == DF_OK; k++) {
        lab_surface surface;
        df_field field = {0};
        if (kinds[k] == DF_FIELD_ADF && size & (size - 1))
            continue; /* the test octree fills a cube of a power of two */
        status = lab_field_make(name, size, 0, kinds[k], &surface, &field, session->err);
        if (status == DF_OK) status = measure_storage(session, name, &surface, &field, rays);
        if (status == DF_OK && kinds[k] == DF_FIELD_DENSE)
            status = measure_tricubic(session, name, &surface, &field, rays);
        for (int t = DF_SAMPLE_U16; t <= DF_SAMPLE_U8 && k == 0 && status == DF_OK; t++) {
            status = quantise(&field, (df_sample_type)t, &dense, session->err);
            if (status == DF_OK) status = measure_storage(session, name, &surface, &dense, rays);
            df_field_free(&dense);
        }
        df_field_free(&field);
    }
    return status;
}
