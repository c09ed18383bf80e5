#include "subject.h"
#include "common/field_file.h"
#include "fields.h"
#include "measure.h"
#include "render/methods/solve_methods.h"

#include <stdio.h>
#include <string.h>

uint64_t lab_model_bytes(const df_field *field) {
    uint64_t bytes = field->sample_count * df_sample_size(field->sample_type);
    if (field->kind == DF_FIELD_BRICKS) {
        uint64_t cells = (uint64_t)field->cell_count[0] * field->cell_count[1] * field->cell_count[2];
        bytes += 4 * cells + field->brick_count * (uint64_t)(4 + 8 + 8 * df_brick_mask_words(field->brick_size));
    }
    if (field->kind == DF_FIELD_ADF) bytes = df_adf_sample_bytes(field) + field->family_count * sizeof(df_family);
    return bytes;
}

int lab_find_name(const char *const *names, const char *name) {
    for (int i = 0; names[i]; i++) {
        if (strcmp(names[i], name) == 0) return i;
    }
    return -1;
}

df_status lab_field_make(const char *shape, uint32_t size, double parameter, df_field_kind kind, lab_surface *surface,
                         df_field *field, df_error *err) {
    const uint32_t count[3] = {size, size, size};
    const int index = lab_find_name(lab_shape_names, shape);
    if (index < 0) return df_fail(err, DF_ERROR_USAGE, "%s: not a shape of the laboratory", shape);
    *surface = lab_surface_make((lab_shape)index, size, parameter);
    return test_field_from_function(field, kind, 8, count, surface->value, surface, err);
}

df_status lab_subject_open(lab_subject *s, const char *name, uint32_t size, df_error *err) {
    const df_scene_options options = {0};
    const char *base = strrchr(name, '/') ? strrchr(name, '/') + 1 : name;
    df_status status;
    memset(s, 0, sizeof *s);
    snprintf(s->name, sizeof s->name, "%.60s", base);
    if (strstr(name, ".dfield")) {
        char path[1024];
        const char *mesh = strchr(name, ':');
        snprintf(path, sizeof path, "%.*s", mesh ? (int)(mesh - name) : (int)strlen(name), name);
        base = strrchr(path, '/') ? strrchr(path, '/') + 1 : path;
        snprintf(s->name, sizeof s->name, "%.60s", base);
        status = df_field_read(path, DF_READ_COPY, &s->field, err);
        if (status == DF_OK && mesh) status = lab_mesh_read(mesh + 1, &s->field, &s->mesh, err);
    } else {
        status = lab_field_make(name, size, 0, DF_FIELD_BRICKS, &s->surface, &s->field, err);
        s->exact = s->surface.lipschitz > 0;
    }
    if (status == DF_OK) status = df_scene_prepare(&s->field, 0, &options, &s->scene, err);
    return status;
}

void lab_subject_close(lab_subject *s) {
    lab_mesh_free(s->mesh);
    df_scene_free(&s->scene);
    df_field_free(&s->field);
}

uint32_t lab_subject_size(const lab_subject *s) {
    uint32_t longest = 0;
    for (int a = 0; a < 3; a++) longest = s->field.voxel_count[a] > longest ? s->field.voxel_count[a] : longest;
    return longest;
}

df_status lab_subject_find_floor(lab_subject *s, uint64_t rays, df_error *err) {
    lab_score score = {0};
    if (!s->exact && !s->mesh) {
        s->field_floor = s->field.error_rms > 0 ? s->field.error_rms / s->field.voxel_size[0] : 0;
        return DF_OK;
    }
    const lab_run run = {.tracer = &df_tracer_dda,
                         .scene = &s->scene,
                         .solve = DF_SOLVE_ROBUST,
                         .surface = s->exact ? &s->surface : NULL,
                         .mesh = s->mesh,
                         .family = LAB_CAMERA,
                         .seed = LAB_SEED,
                         .count = rays};
    df_status status = lab_measure(&run, &score, err);
    s->field_floor = lab_histogram_quantile(&score.depth, 0.5);
    return status;
}
