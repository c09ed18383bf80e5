/* The marching-cubes mesh of a scene as the tracers mc-embree and mc-raster draw it: in float, as their libraries want
 * it. */
#ifndef DF_MC_MODEL_H
#define DF_MC_MODEL_H

#include "render/tracer.h"

typedef struct df_mc_model {
    uint32_t vertex_count, triangle_count;
    float *positions;    /* vertex_count * 3, grid space; room for one float more, which Embree may read */
    float *normals;      /* vertex_count * 3, world directions */
    uint32_t *triangles; /* triangle_count * 3 */
    double extract_ms;
} df_mc_model;

df_status df_mc_model_make(const df_scene *scene, uint32_t threads, df_mc_model *model, df_error *err);
void df_mc_model_free(df_mc_model *model);
uint64_t df_mc_model_bytes(const df_mc_model *model);

/* Appends the hit of ray `ray` of a tile at t (as the ray knows it, without t_base), with the mesh's normal there. */
void df_mc_model_hit(const df_scene *scene, const df_rays *rays, uint32_t ray, float t, const float normal[3],
                     bool back, df_hits *hits);

#endif
