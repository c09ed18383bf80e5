/* What df-convert says about its work: to people, to machines (--json), and in the file (provenance). */
#ifndef DF_REPORT_H
#define DF_REPORT_H

#include "convert/build.h"
#include "convert/mesh_repair.h"

#include <jansson.h>

typedef struct df_convert_report {
    const char *input, *output;
    char input_sha256[65]; /* empty for shapes */
    bool is_shape;
    bool repaired; /* --repair; then the cleaning and edges below are those of the repaired mesh */
    df_mesh_cleaning repair_cleaning;
    df_mesh_repairs repairs;
    uint32_t repair_flips, repair_turned;
    df_mesh_cleaning cleaning;
    df_mesh_edges edges;                       /* borders not kept */
    uint32_t vertices, faces;                  /* after cleaning */
    const char *distance;                      /* "cgal", "openvdb", "shape" */
    const char *sign_method;                   /* "winding", "openvdb", "shape" */
    uint64_t sign_checks, sign_contradictions; /* points asked of CGAL's inside test, and where it disagreed */
    const char *sign_reason;                   /* why the signs are not certain; NULL where they are */
    uint32_t flipped_faces, inverted_components, holes, hole_edges, unorientable_edges; /* see sign_mesh.h */
    df_build_report build;
    uint64_t leaves, divided_for_continuity; /* adf */
    double measure_ms;
    double read_ms, clean_ms, prepare_ms, write_ms, total_ms;
    uint64_t bytes;      /* of the file */
    uint64_t peak_bytes; /* of the process */
    uint32_t resolution; /* voxels along the longest side */
} df_convert_report;

/* The provenance of a field as JSON: input, its checksum, options and versions, how the sign was decided; nothing that
 * differs from run to run. `options`: an object with the options that shaped the field; stolen. free() the result; NULL
 * when memory is short. */
char *df_report_provenance(const df_convert_report *report, const df_field *field, json_t *options);

/* Lines on stdout. */
void df_report_print(const df_convert_report *report, const df_field *field);

/* One JSON object on stdout, with the names of measure.md. */
df_status df_report_print_json(const df_convert_report *report, const df_field *field, df_error *err);

#endif
