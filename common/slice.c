#include "common/slice.h"
#include "common/memory.h"
#include "common/options.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { DEFAULT_LONGEST = 1024, VOXEL_OUTLINE_PIXELS = 8, CONTOUR_PIXELS = 14 };

df_status df_slice_parse(const char *option, const char *text, df_slice *slice, df_error *err) {
    if (text[0] < 'x' || text[0] > 'z' || text[1] != '=') {
        return df_fail(err, DF_ERROR_USAGE, "%s %s: expected x, y or z, = and a number from 0 to 1, such as z=0.5", option, text);
    }
    slice->axis = (uint32_t)(text[0] - 'x');
    return df_parse_double(option, text + 2, 0, 1, &slice->position, err);
}

/* What a pixel shows. */
typedef struct slice_point {
    bool stored;
    bool inside;
    double voxels;       /* distance in voxels, where stored */
    double slope;        /* of the distance within the plane: 1 where the surface is upright on it */
    uint64_t cell;       /* identifies the cell of the structure; 0: none to outline */
} slice_point;

/* The plane: pixel (u, v) lies at grid position base + u * right + v * up, all in voxels. */
typedef struct plane {
    uint32_t axis, right, up;
    double depth;            /* grid position along the axis */
    double pixels_per_voxel[2]; /* along right and up: differ where voxels are no cubes */
    double voxel_world;      /* the smallest voxel size, the unit of contours */
} plane;

static uint64_t cell_at(const df_field *field, const plane *view, const double grid[3]) {
    uint64_t id = 0;
    if (field->kind == DF_FIELD_ADF) {
        df_adf_cell cell;
        df_adf_find(field, grid, DF_LEVEL_COUNT_MAX, &cell);
        return 1 + (uint64_t)cell.family * 8 + cell.child;
    }
    if (field->kind == DF_FIELD_DENSE && view->pixels_per_voxel[0] < VOXEL_OUTLINE_PIXELS) return 0;
    for (int a = 2; a >= 0; a--) {
        uint32_t voxel = (uint32_t)fmin(grid[a], field->voxel_count[a] - 1.0);
        uint32_t unit = field->kind == DF_FIELD_BRICKS ? field->brick_size : 1;
        id = id * (DF_VOXEL_COUNT_MAX + 1) + voxel / unit;
    }
    return id + 1;
}

static slice_point look(const df_field *field, const plane *view, double u, double v) {
    double grid[3], world[3];
    grid[view->axis] = view->depth;
    grid[view->right] = fmin(fmax(u / view->pixels_per_voxel[0], 0), field->voxel_count[view->right]);
    grid[view->up] = fmin(fmax(v / view->pixels_per_voxel[1], 0), field->voxel_count[view->up]);
    df_point_info info;
    df_field_grid_to_world(field, grid, world);
    for (int a = 0; a < 3; a++) { /* rounding may lead out of the box again */
        double end = field->origin[a] + field->voxel_size[a] * field->voxel_count[a];
        world[a] = fmin(fmax(world[a], field->origin[a]), end);
    }
    df_field_query(field, world, &info);
    double slope = fmax(hypot(info.gradient[view->right], info.gradient[view->up]), 0.2); /* lines grow at most 5 times wide */
    return (slice_point){info.stored, info.side == DF_SIDE_INSIDE, info.value / view->voxel_world, slope, cell_at(field, view, grid)};
}

static void mix(double colour[3], const double other[3], double part) {
    for (int c = 0; c < 3; c++) colour[c] += (other[c] - colour[c]) * part;
}

/* How much of a line of `width` pixels covers a pixel whose centre is `distance` pixels from the line's middle. */
static double line_cover(double distance, double width) {
    return fmin(fmax(width / 2 + 0.5 - distance, 0), 1);
}

static void shade(const slice_point *here, const slice_point *left, const slice_point *below, double contour, double pixels_per_voxel,
                  uint8_t rgb[3]) {
    static const double near[2][3] = {{0.98, 0.68, 0.38}, {0.36, 0.62, 0.92}}; /* outside, inside */
    static const double far[2][3] = {{1.0, 0.95, 0.88}, {0.88, 0.94, 1.0}};
    static const double absent[2][3] = {{0.93, 0.91, 0.89}, {0.80, 0.83, 0.88}};
    static const double black[3] = {0, 0, 0}, grey[3] = {0.35, 0.35, 0.38};
    double colour[3];
    memcpy(colour, here->stored ? near[here->inside] : absent[here->inside], sizeof colour);
    if (here->stored) {
        double size = fabs(here->voxels);
        mix(colour, far[here->inside], size / (size + 8));
        double off = fabs(size - contour * round(size / contour)) * pixels_per_voxel / here->slope;
        if (size > contour / 2) mix(colour, grey, 0.45 * line_cover(off, 1));
    }
    bool edge = here->cell != left->cell || here->cell != below->cell;
    bool stored = here->stored || left->stored || below->stored;
    if (edge) mix(colour, grey, stored ? 0.55 : 0.18);
    if (here->stored) mix(colour, black, line_cover(fabs(here->voxels) * pixels_per_voxel / here->slope, 2.2));
    for (int c = 0; c < 3; c++) rgb[c] = (uint8_t)lrint(255 * colour[c]);
}

df_status df_slice_draw(const df_field *field, const df_slice *slice, uint8_t **rgb, uint32_t *width, uint32_t *height,
                        double *contour_voxels, df_error *err) {
    static const uint32_t rights[3] = {1, 0, 0}, ups[3] = {2, 2, 1};
    plane view = {.axis = slice->axis, .right = rights[slice->axis], .up = ups[slice->axis]};
    view.depth = slice->position * field->voxel_count[view.axis];
    const double *h = field->voxel_size;
    double extent[2] = {h[view.right] * field->voxel_count[view.right], h[view.up] * field->voxel_count[view.up]};
    double pixels_per_world = (slice->longest ? slice->longest : DEFAULT_LONGEST) / fmax(extent[0], extent[1]);
    *width = (uint32_t)fmax(1, ceil(extent[0] * pixels_per_world - 1e-6));
    *height = (uint32_t)fmax(1, ceil(extent[1] * pixels_per_world - 1e-6));
    view.pixels_per_voxel[0] = h[view.right] * pixels_per_world;
    view.pixels_per_voxel[1] = h[view.up] * pixels_per_world;
    view.voxel_world = fmin(h[0], fmin(h[1], h[2]));
    double pixels_per_unit = view.voxel_world * pixels_per_world;
    *contour_voxels = exp2(ceil(log2(CONTOUR_PIXELS / pixels_per_unit)));
    df_status status = df_alloc_raw((void **)rgb, (uint64_t)*width * *height, 3, "slice", err);
    if (status != DF_OK) return status;

    uint32_t columns = *width, rows = *height;
    double contour = *contour_voxels;
    uint8_t *pixels = *rgb;
#pragma omp parallel for schedule(dynamic, 16)
    for (uint32_t row = 0; row < rows; row++) {
        double v = rows - row - 0.5;
        slice_point left = look(field, &view, -0.5, v);
        for (uint32_t column = 0; column < columns; column++) {
            slice_point here = look(field, &view, column + 0.5, v), below = look(field, &view, column + 0.5, v - 1);
            shade(&here, &left, &below, contour, pixels_per_unit, pixels + 3 * ((uint64_t)row * columns + column));
            left = here;
        }
    }
    return DF_OK;
}
