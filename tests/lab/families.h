/*
 * Families of rays, in grid space. Ray i of a family depends on the field, the family's seed and i alone, so that any
 * part of a run can be repeated.
 */
#ifndef DF_TESTS_FAMILIES_H
#define DF_TESTS_FAMILIES_H

#include "common/field.h"

typedef enum lab_family {
    LAB_RANDOM,    /* from around the field to random points of its box */
    LAB_GRAZING,   /* past a point of the surface along it, 1e-1 to 1e-7 voxel off */
    LAB_LATTICE,   /* along axes, edges and diagonals, through corners, edges and faces of voxels */
    LAB_CAMERA,    /* pixels of cameras that turn around the field, eye at 1.6 times the longest side */
    LAB_SECONDARY, /* from just off the surface, evenly into the half space before it */
    LAB_INSIDE,    /* from inside in all directions; every other one through a corner, an edge or a face */
    LAB_FAMILY_COUNT
} lab_family;
extern const char *const lab_family_names[LAB_FAMILY_COUNT + 1]; /* ended by NULL */

#define LAB_SEED 20261122u

/* Returns false where the field has no such ray: no surface, no inside. */
bool lab_family_ray(const df_field *field, lab_family family, uint64_t seed, uint64_t index, double origin[3],
                    double direction[3]);

/* From an eye to a random point of the field's box: a ray of some pixel that the field may be seen in. */
void lab_eye_ray(const df_field *field, const double eye[3], uint64_t seed, uint64_t index, double origin[3],
                 double direction[3]);

#endif
