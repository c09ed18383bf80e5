/* What df-convert's command line asks for: its options, read and checked against each other. */
#ifndef DF_REQUEST_H
#define DF_REQUEST_H

#include "common/field.h"

typedef enum df_distance_method { DF_DISTANCE_EXACT, DF_DISTANCE_CGAL, DF_DISTANCE_OPENVDB } df_distance_method;
enum { DF_SAMPLES_F32, DF_SAMPLES_U16, DF_SAMPLES_U8, DF_SAMPLES_AUTO };
extern const char *const df_request_distance_names[];
extern const char *const df_request_sign_names[];
extern const char *const df_request_sample_names[];

/* How large an error may be. */
typedef struct df_error_bound {
    double value;  /* negative: not given */
    bool in_world; /* world units, otherwise voxels */
} df_error_bound;

/* What the command line asks for. */
typedef struct df_request {
    const char *input;
    const char *output;  /* as given; NULL: derived from the input */
    uint32_t resolution; /* 0: not given */
    double voxel_size;   /* 0: not given */
    double padding;      /* voxels */
    df_error_bound max_error, rms_error;
    bool max_error_auto; /* what a picture of view_height pixels shows from view_distance (multiples of the longest
                            side) */
    uint32_t view_width, view_height; /* 0: not given */
    double view_distance;             /* 0: not given */
    uint32_t measure;                 /* points to measure the error at */
    uint32_t samples;                 /* into df_request_sample_names */
    df_field_kind structure;
    uint32_t brick_size;
    uint32_t distance; /* df_distance_method */
    uint32_t sign;     /* df_sign_method */
    uint32_t threads;  /* 0: as OpenMP chooses */
    bool check, repair, allow_partial, fill, json, quiet;
    bool strict; /* uncertain signs are a failure */
    bool structure_given, brick_given, samples_given, measure_given;
    const char *grid;         /* of a .vdb; NULL: the only one */
    double band;              /* voxels; 0: not given */
    const char *mesh_option;  /* an option that shapes a field of a mesh, where one was given */
    const char *error_option; /* one that bounds the error */
    df_error *err;
} df_request;

/* Reads and checks the command line; ends the process, as argp does, after --help and --version and where options are
 * unknown. */
df_status df_request_parse(int argc, char **argv, df_request *request, df_error *err);

/* The bound on the largest error; octrees always have one. */
df_error_bound df_request_max_error(const df_request *request);

/* In world units; INFINITY where there is none. */
double df_error_bound_in_world(const df_error_bound *bound, double voxel_size);

#endif
