/*
 * Analytic shapes whose signed distance is known exactly, to convert without a mesh and to measure against:
 * "shape:NAME" or "shape:NAME:key=value,key=value". Lengths are world units; cx, cy, cz place the centre of each.
 *
 *   sphere       radius=1
 *   torus        major=1, minor=0.4; around the z axis
 *   box          x=2, y=2, z=2: its sides
 *   rotated-box  the same, turned by angle=30 (degrees) about the axis (1,2,3)
 *   gyroid       period=1, thickness=0.1, size=2: the points nearer than half the thickness to
 *                sin u cos v + sin v cos w + sin w cos u = 0 with (u,v,w) = 2 pi (x,y,z) / period,
 *                seen in a cube of that size
 *   shell        radius=1, thickness=0.1: a hollow sphere, the radius at the middle of its wall
 */
#ifndef DF_SHAPE_H
#define DF_SHAPE_H

#include "convert/distance.h"

#include <stdbool.h>

typedef enum df_shape_kind {
    DF_SHAPE_SPHERE,
    DF_SHAPE_TORUS,
    DF_SHAPE_BOX,
    DF_SHAPE_ROTATED_BOX,
    DF_SHAPE_GYROID,
    DF_SHAPE_SHELL,
} df_shape_kind;

typedef struct df_shape {
    df_shape_kind kind;
    double centre[3];
    double radius, major, minor, thickness, period, size, angle;
    double side[3];
    double rotation[3][3]; /* of the rotated box: rows are its axes */
} df_shape;

/* True when a name of an input means a shape. */
bool df_shape_is_name(const char *name);

df_status df_shape_parse(const char *name, df_shape *shape, df_error *err);

/* The box around the shape's surface. */
void df_shape_bounds(const df_shape *shape, double low[3], double high[3]);

/* The signed distance of a point, in double. */
double df_shape_distance(const df_shape *shape, const double p[3]);

/* A distance source that asks the shape, which must stay as it is while the source lives. */
void df_distance_shape(const df_shape *shape, df_distance_source *source);

/* For df_cells_select: may a cell, grown by DF_CELL_REACH, touch the surface? */
typedef struct df_shape_cells {
    const df_shape *shape;
    const df_lattice *lattice;
} df_shape_cells;
bool df_shape_keeps_cell(const void *shape_cells, const uint32_t cell[3]);

/* For df_adf_input.crosses. */
bool df_shape_crosses(const void *shape_cells, const uint32_t corner[3], uint32_t side);

#endif
