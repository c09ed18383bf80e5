/*
 * A field under measurement, and what it was made from: a surface of the laboratory, a mesh, or nobody knows.
 */
#ifndef DF_TESTS_SUBJECT_H
#define DF_TESTS_SUBJECT_H

#include "mesh_truth.h"
#include "render/scene.h"
#include "surface.h"

typedef struct lab_subject {
    char name[64]; /* the shape's, or the file's without its folder */
    lab_surface surface;
    bool exact;     /* the surface's truth is known */
    lab_mesh *mesh; /* NULL: not made from one, or that is not known */
    df_field field;
    df_scene scene;
    double field_floor; /* voxels; 0: unknown */
} lab_subject;

/* name: a shape, which is made as bricks of size^3 voxels; FIELD.dfield; or FIELD.dfield:MESH.obj. Release with
 * lab_subject_close in any case. */
df_status lab_subject_open(lab_subject *s, const char *name, uint32_t size, df_error *err);
void lab_subject_close(lab_subject *s);

/* Voxels along the longest side. */
uint32_t lab_subject_size(const lab_subject *s);

/* Sets field_floor, what no solver can undo: the median error of the default method against the exact surface or the
 * mesh over so many camera rays, in voxels along the ray; or what the file says of its own error. */
df_status lab_subject_find_floor(lab_subject *s, uint64_t rays, df_error *err);

/* A shape by name as a field of size^3 voxels. parameter: the shape's; 0: its default. */
df_status lab_field_make(const char *shape, uint32_t size, double parameter, df_field_kind kind, lab_surface *surface,
                         df_field *field, df_error *err);

/* What a field holds in memory for tracing. */
uint64_t lab_model_bytes(const df_field *field);

/* The index of a name in a list that NULL ends; -1: it is not there. */
int lab_find_name(const char *const *names, const char *name);

#endif
