/*
 * The truth about a ray and a triangle mesh, in double: watertight after Woop, Benthin and Wald 2013 (the edge
 * functions of two triangles along a shared edge are the same numbers with opposite signs, and zero counts for both). A
 * tree of boxes over the triangles makes it fast enough; it does not decide anything.
 */
#ifndef DF_TESTS_MESH_TRUTH_H
#define DF_TESTS_MESH_TRUTH_H

#include "truth.h"

typedef struct lab_mesh lab_mesh;

/* Reads the vertices and faces of an .obj (faces of more than three vertices as fans; texture and normal indices are
 * ignored) and moves them into the grid of a field. */
df_status lab_mesh_read(const char *path, const df_field *field, lab_mesh **out, df_error *err);

/* From arrays: 3 doubles a vertex, in grid space; 3 indices a triangle. Copies them. */
df_status lab_mesh_make(const double *positions, uint32_t vertex_count, const uint32_t *triangles,
                        uint32_t triangle_count, lab_mesh **out, df_error *err);
void lab_mesh_free(lab_mesh *mesh);

/* The unit normal of a triangle, in grid space. */
void lab_mesh_normal(const lab_mesh *mesh, uint32_t triangle, double normal[3]);

/* The first triangle with t > 0. back: it is seen from behind (counter-clockwise is the outside). tangent is never set:
 * the mesh and a field of it differ by more than any band. */
void lab_mesh_trace(const lab_mesh *mesh, const double origin[3], const double direction[3], df_truth *out);

#endif
