/*
 * Exact surfaces, and fields made of them.
 *
 * A surface is a function in grid space, negative inside, that changes by at most `lipschitz` a voxel. Its first
 * crossing along a ray is found by steps that cannot jump over one, then by bisection: to 1e-12 voxel.
 */
#ifndef DF_TESTS_SURFACE_H
#define DF_TESTS_SURFACE_H

#include "truth.h"

typedef struct lab_surface lab_surface;
struct lab_surface {
    const char *name;
    const char *summary;
    double (*value)(const double grid[3],
                    const void *surface); /* the lab_surface itself: so it fits test_field_from_function */
    double lipschitz;                     /* 0: not a surface whose truth is known, only samples (noise) */
    double size;                          /* voxels along the field that it is made for */
    double parameter;
};

/* The laboratory's surfaces, for a field of `size` voxels along each side: */
typedef enum lab_shape {
    LAB_SPHERE, /* radius 0.375 size, off the grid */
    LAB_TORUS,
    LAB_BOX,         /* faces on grid planes */
    LAB_ROTATED_BOX, /* planar faces at odd angles */
    LAB_GYROID,      /* a slab of the gyroid, in a sphere */
    LAB_SHELL,       /* a sphere's hull, `parameter` voxels thick */
    LAB_NOISE,       /* smooth noise of about `parameter` voxels with steep and shallow crossings; closed by a sphere */
    LAB_PAIRS, /* every corner random: cells full of pairs and triples of crossings; outside at the field's border */
    LAB_SHAPE_COUNT
} lab_shape;
extern const char *const lab_shape_names[LAB_SHAPE_COUNT + 1]; /* ended by NULL */

lab_surface lab_surface_make(lab_shape shape, double size, double parameter);

/* The first crossing on the part of the ray that lies in [0, box]. tangent: the ray turns around or starts within 1e-6
 * voxel, or runs along the surface. */
void lab_surface_trace(const lab_surface *surface, const double box[3], const double origin[3],
                       const double direction[3], df_truth *out);

/* The gradient at a point, by central differences of 1e-5 voxel. */
void lab_surface_gradient(const lab_surface *surface, const double grid[3], double gradient[3]);

#endif
