/* df-render --export-mesh: a field's surface to a mesh file, with progress and a report. */
#ifndef DF_EXPORT_H
#define DF_EXPORT_H

#include "render/mesh/mesh_file.h"

typedef struct df_export_options {
    const char *path;       /* .ply, .obj or .stl */
    const char *field_path; /* for messages */
    float iso;
    df_mc_method method;
    int gradient; /* DF_GRADIENT_..., methods/gradient.h: of the normals */
    uint32_t threads;
    bool quiet;
    bool stats, json; /* print vertices, triangles, bytes and times to stdout, as text or as one JSON object */
} df_export_options;

/* Names of df_mc_method for options, by number, ended by NULL. */
extern const char *const df_mc_method_names[];

df_status df_export_mesh(const df_field *field, const df_export_options *options, df_error *err);

#endif
