#include "octree.h"
#include "common/memory.h"
#include "random.h"

#include <string.h>

enum { FAMILY_MAX = 1 << 18 };

typedef struct place {
    uint32_t corner[3], side; /* of the divided cell */
} place;

static bool is_mixed(const lab_surface *surface, const place *cell) {
    bool any[2] = {false, false};
    for (uint32_t k = 0; k <= cell->side; k++) {
        for (uint32_t j = 0; j <= cell->side; j++) {
            for (uint32_t i = 0; i <= cell->side; i++) {
                const double p[3] = {cell->corner[0] + i, cell->corner[1] + j, cell->corner[2] + k};
                any[surface->value(p, surface) < 0] = true;
                if (any[0] && any[1]) return true;
            }
        }
    }
    return false;
}

static void sample_family(const lab_surface *surface, const place *cell, float samples[27]) {
    const double half = cell->side / 2.0;
    for (uint32_t s = 0; s < 27; s++) {
        const double p[3] = {cell->corner[0] + half * (s % 3), cell->corner[1] + half * (s / 3 % 3),
                             cell->corner[2] + half * (s / 9)};
        samples[s] = (float)surface->value(p, surface) + 0.0f;
    }
}

df_status lab_octree_make(const lab_surface *surface, uint32_t level_count, double keep, uint64_t seed, df_field *field,
                          df_error *err) {
    df_family *families;
    float *samples;
    place *places;
    uint32_t count = 1;
    memset(field, 0, sizeof *field);
    field->kind = DF_FIELD_ADF;
    field->sample_type = DF_SAMPLE_F32;
    field->level_count = level_count;
    df_status status = df_alloc((void **)&families, FAMILY_MAX, sizeof *families, "families", err);
    if (status != DF_OK) return status;
    df_field_own(field, families);
    status = df_alloc_raw((void **)&samples, 8 + (uint64_t)FAMILY_MAX * DF_FAMILY_STORED_COUNT, sizeof *samples,
                          "samples", err);
    if (status != DF_OK) return status;
    df_field_own(field, samples);
    status = df_alloc_raw((void **)&places, FAMILY_MAX, sizeof *places, "places", err);
    if (status != DF_OK) return status;
    df_field_own(field, places);
    places[0] = (place){.side = 1u << level_count};
    for (uint32_t f = 0; f < count; f++) {
        const uint32_t half = places[f].side / 2;
        float family[27];
        sample_family(surface, &places[f], family);
        df_family_store(family, f, samples);
        for (uint32_t c = 0; c < 8; c++) {
            const place child = {{places[f].corner[0] + half * (c & 1), places[f].corner[1] + half * (c >> 1 & 1),
                                  places[f].corner[2] + half * (c >> 2)},
                                 half};
            if (half > 1 && is_mixed(surface, &child) && (half > 8 || lab_random(&seed, 0, 1) >= keep)) {
                if (count == FAMILY_MAX) return df_fail(err, DF_ERROR_MEMORY, "more than %d families", FAMILY_MAX);
                places[count++] = child;
                families[f].states |= (uint32_t)DF_CHILD_FAMILY << 2 * c;
            }
        }
    }
    for (int a = 0; a < 3; a++) {
        field->voxel_count[a] = 1u << level_count;
        field->voxel_size[a] = 1;
    }
    field->families = families;
    field->family_count = count;
    field->samples = samples;
    return df_field_finish(field, "octree", err);
}
