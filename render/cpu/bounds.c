#include "render/cpu/bounds.h"
#include "common/memory.h"
#ifdef DF_HAVE_EGL
#include "render/gl/bounds_gl.h"
#endif

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- boxes ---- */

/* The surface voxels of a block as rows of bits, and where it lies. */
typedef struct block_rows {
    uint32_t corner[3], k;
    uint8_t rows[64]; /* row y + k z, bit x */
} block_rows;

/* Blocks to look through: those of the scene, or all cubes of 8 voxels of a uniform one. */
static uint64_t block_total(const df_scene *scene, uint32_t count[3]) {
    for (int a = 0; a < 3; a++) count[a] = (scene->voxel_count[a] + 7) / 8;
    return scene->levels == 2 ? scene->block_count : (uint64_t)count[0] * count[1] * count[2];
}

/* Returns whether there is any. */
static bool get_rows(const df_scene *scene, const uint32_t count[3], uint64_t block, block_rows *out) {
    const bool uniform = scene->levels == 1;
    const uint32_t k = uniform ? 8 : scene->k, *counts = uniform ? count : scene->coarse_count;
    const uint64_t cell = uniform ? block : scene->block_cells[block];
    uint32_t any = 0;
    out->k = k;
    out->corner[0] = (uint32_t)(cell % counts[0]) * k;
    out->corner[1] = (uint32_t)(cell / counts[0] % counts[1]) * k;
    out->corner[2] = (uint32_t)(cell / counts[0] / counts[1]) * k;
    for (uint32_t row = 0; row < k * k; row++) {
        const uint32_t y = out->corner[1] + row % k, z = out->corner[2] + row / k;
        uint64_t bits = 0;
        if (!uniform) {
            bits = scene->masks[block * df_brick_mask_words(k) + row * k / 64] >> (row * k % 64);
        } else if (y < scene->voxel_count[1] && z < scene->voxel_count[2]) {
            const uint64_t *words = scene->rows + scene->row_words * (y + (uint64_t)scene->voxel_count[1] * z);
            bits = words[out->corner[0] / 64] >> (out->corner[0] % 64);
        }
        out->rows[row] = (uint8_t)(bits & ((1u << k) - 1));
        any |= out->rows[row];
    }
    return any != 0;
}

static void grow(df_bounds_box *box, const uint32_t low[3], const uint32_t last[3]) {
    for (int a = 0; a < 3; a++) {
        if (low[a] < box->low[a]) box->low[a] = (uint16_t)low[a];
        if (last[a] > box->last[a]) box->last[a] = (uint16_t)last[a];
    }
}

/* Appends the boxes of a block; with boxes NULL only counts them. */
static uint64_t put_boxes(const block_rows *block, int mode, df_bounds_box *boxes) {
    df_bounds_box whole = {{UINT16_MAX, UINT16_MAX, UINT16_MAX}, {0, 0, 0}};
    uint64_t count = 0;
    for (uint32_t row = 0; row < block->k * block->k; row++) {
        for (uint32_t bits = block->rows[row]; bits; bits &= bits - 1) {
            const uint32_t voxel[3] = {block->corner[0] + (uint32_t)__builtin_ctz(bits),
                                       block->corner[1] + row % block->k, block->corner[2] + row / block->k};
            if (mode != DF_BOUNDS_VOXELS) {
                grow(&whole, voxel, voxel);
                continue;
            }
            if (boxes) {
                boxes[count] = (df_bounds_box){{UINT16_MAX, UINT16_MAX, UINT16_MAX}, {0, 0, 0}};
                grow(&boxes[count], voxel, voxel);
            }
            count++;
        }
    }
    if (mode == DF_BOUNDS_VOXELS) return count;
    if (boxes) *boxes = whole;
    return 1;
}

/* What DF_BOUNDS_GL needs; not there where there is no EGL. */
static df_status open_gl(df_bounds *bounds, df_error *err) {
#ifdef DF_HAVE_EGL
    static_assert(sizeof(df_bounds_box) == 6 * sizeof(uint16_t), "boxes are uploaded as they are");
    return df_bounds_gl_open((const uint16_t(*)[6])bounds->boxes, bounds->box_count, &bounds->gl, err);
#else
    (void)bounds;
    return df_fail(err, DF_ERROR_UNSUPPORTED, "--bounds gl: built without EGL");
#endif
}

static void close_gl(df_bounds *bounds) {
#ifdef DF_HAVE_EGL
    df_bounds_gl_close(bounds->gl);
#else
    (void)bounds;
#endif
}

df_status df_bounds_prepare(const df_scene *scene, int mode, df_bounds *bounds, df_error *err) {
    uint32_t count[3];
    const uint64_t total = block_total(scene, count);
    block_rows block;
    for (uint64_t i = 0; i < total; i++) {
        if (get_rows(scene, count, i, &block)) bounds->box_count += put_boxes(&block, mode, NULL);
    }
    df_status status = df_alloc_raw((void **)&bounds->boxes, bounds->box_count, sizeof *bounds->boxes, "bounds", err);
    df_bounds_box *next = bounds->boxes;
    for (uint64_t i = 0; i < total && status == DF_OK; i++) {
        if (get_rows(scene, count, i, &block)) next += put_boxes(&block, mode, next);
    }
    if (status == DF_OK && mode == DF_BOUNDS_GL) status = open_gl(bounds, err);
    return status;
}

void df_bounds_free(df_bounds *bounds) {
    close_gl(bounds);
    free(bounds->boxes);
    free(bounds->least);
    free(bounds->greatest);
    memset(bounds, 0, sizeof *bounds);
}

uint64_t df_bounds_bytes(const df_bounds *bounds) { return bounds->box_count * sizeof *bounds->boxes; }

/* ---- projection ---- */

/* What projects a point p of grid space: with q = p - eye, w = rows[0] . q is its t along the ray through it, and
 * rows[1] . q / w, rows[2] . q / w is its pixel. */
typedef struct projection {
    double rows[3][3], eye[3];
    double pad;       /* by which boxes are widened, voxels */
    double w_near;    /* boxes are cut off before this t ... */
    double near_size; /* ... unless they come this near to the eye, voxels */
    uint32_t width, first_row, end_row;
} projection;

static projection make_projection(const df_view *view, uint32_t first_row, uint32_t row_count) {
    const double *m[3] = {view->corner, view->right, view->down};
    projection p = {.width = view->width, .first_row = first_row, .end_row = first_row + row_count, .w_near = 0.01};
    double determinant = 0, scale = 0, afar = 0;
    for (int i = 0; i < 3; i++) {
        const double *b = m[(i + 1) % 3], *c = m[(i + 2) % 3];
        for (int a = 0; a < 3; a++) p.rows[i][a] = b[(a + 1) % 3] * c[(a + 2) % 3] - b[(a + 2) % 3] * c[(a + 1) % 3];
    }
    for (int a = 0; a < 3; a++) determinant += m[0][a] * p.rows[0][a];
    for (int i = 0; i < 3; i++) {
        for (int a = 0; a < 3; a++) p.rows[i][a] /= determinant;
    }
    for (int a = 0; a < 3; a++) {
        /* the largest component of a direction in the picture, which is linear in x and y */
        const double right = view->right[a] * view->width, down = view->down[a] * view->height;
        const double first = view->corner[a];
        p.near_size += p.w_near * fmax(fmax(fabs(first), fabs(first + right)),
                                       fmax(fabs(first + down), fabs(first + right + down)));
        p.eye[a] = view->eye[a];
        scale = fmax(scale, fmax(view->box[a], view->rebase ? 0 : fabs(view->eye[a])));
        afar = fmax(afar, fabs(view->eye[a]));
    }
    /* Coordinates of rays and of the walk are floats up to `scale`, a few roundings each; a far eye is a double. */
    p.pad = 1e-3 + 4e-6 * scale + 1e-12 * afar;
    return p;
}

/* Lets OpenGL draw all boxes; those that reach behind the eye it draws in part. */
static df_status draw_gl(df_bounds *bounds, const df_view *view, const projection *p, df_error *err) {
#ifdef DF_HAVE_EGL
    return df_bounds_gl_draw(bounds->gl, view, p->first_row, p->end_row - p->first_row, p->pad, DF_BOUNDS_SQUARE,
                             bounds->least, bounds->greatest, err);
#else
    (void)bounds;
    (void)view;
    (void)p;
    return df_fail(err, DF_ERROR_UNSUPPORTED, "--bounds gl: built without EGL");
#endif
}

/* What a box covers: pixels x0 to x1, y0 to y1, not clamped, and t. */
typedef struct cover {
    double x0, y0, x1, y1, least, greatest;
} cover;

static void cover_point(cover *c, const double q[3]) {
    const double x = q[1] / q[0], y = q[2] / q[0];
    c->x0 = fmin(c->x0, x);
    c->x1 = fmax(c->x1, x);
    c->y0 = fmin(c->y0, y);
    c->y1 = fmax(c->y1, y);
}

/* The pixels of a box that reaches behind w_near, from its edges cut off there; q: its corners, projected. */
static void cover_cut(const projection *p, double q[8][3], cover *c) {
    *c = (cover){INFINITY, INFINITY, -INFINITY, -INFINITY, c->least, c->greatest};
    for (int i = 0; i < 8; i++) {
        if (q[i][0] >= p->w_near) cover_point(c, q[i]);
        for (int axis = 0; axis < 3; axis++) {
            const int j = i ^ 1 << axis;
            if (!(q[i][0] >= p->w_near && q[j][0] < p->w_near)) continue;
            const double s = (p->w_near - q[i][0]) / (q[j][0] - q[i][0]);
            const double cut[3] = {p->w_near, q[i][1] + s * (q[j][1] - q[i][1]), q[i][2] + s * (q[j][2] - q[i][2])};
            cover_point(c, cut);
        }
    }
}

/* Projects a box; false where no ray can meet it. */
static bool cover_box(const projection *p, const df_bounds_box *box, cover *c) {
    double half[3], middle[3], centre[3] = {0, 0, 0}, reach[3] = {0, 0, 0};
    for (int a = 0; a < 3; a++) {
        half[a] = (box->last[a] + 1 - box->low[a]) / 2.0 + p->pad;
        middle[a] = (box->last[a] + 1 + box->low[a]) / 2.0 - p->eye[a];
    }
    for (int i = 0; i < 3; i++) {
        for (int a = 0; a < 3; a++) centre[i] += p->rows[i][a] * middle[a];
    }
    for (int a = 0; a < 3; a++) reach[0] += half[a] * fabs(p->rows[0][a]);
    c->least = centre[0] - reach[0];
    c->greatest = centre[0] + reach[0];
    if (!(c->greatest >= 0)) return false;
    if (c->least >= p->w_near) {
        const double x = centre[1] / centre[0], y = centre[2] / centre[0];
        for (int a = 0; a < 3; a++) {
            reach[1] += half[a] * fabs(p->rows[1][a] - x * p->rows[0][a]);
            reach[2] += half[a] * fabs(p->rows[2][a] - y * p->rows[0][a]);
        }
        *c = (cover){x - reach[1] / c->least,
                     y - reach[2] / c->least,
                     x + reach[1] / c->least,
                     y + reach[2] / c->least,
                     c->least,
                     c->greatest};
        return true;
    }
    bool near = true;
    for (int a = 0; a < 3; a++) near = near && fabs(middle[a]) <= half[a] + p->near_size;
    if (near) {
        *c = (cover){-INFINITY, -INFINITY, INFINITY, INFINITY, c->least, c->greatest};
        return true;
    }
    double q[8][3];
    for (int corner = 0; corner < 8; corner++) {
        for (int i = 0; i < 3; i++) {
            q[corner][i] = centre[i];
            for (int a = 0; a < 3; a++) q[corner][i] += (corner >> a & 1 ? half[a] : -half[a]) * p->rows[i][a];
        }
    }
    cover_cut(p, q, c);
    return c->x0 <= c->x1;
}

/* Squares first to last that the pixels low to high meet, of those before `end`; false for none. A little is added for
 * the rounding of the division by w. */
static bool squares(double low, double high, double start, double end, uint32_t *first, uint32_t *last) {
    const double slack = 1e-3;
    low = fmax(low - slack, start);
    high = fmin(high + slack, end - 1);
    if (!(low <= high)) return false;
    *first = (uint32_t)(low - start) / DF_BOUNDS_SQUARE;
    *last = (uint32_t)(high - start) / DF_BOUNDS_SQUARE;
    return true;
}

static void project_box(const df_bounds *bounds, const projection *p, const df_bounds_box *box, double *least,
                        double *greatest) {
    cover c;
    uint32_t x0, x1, y0, y1;
    if (!cover_box(p, box, &c) || (bounds->gl && c.least >= p->w_near)) return; /* OpenGL has drawn it */
    if (!squares(c.x0, c.x1, 0, p->width, &x0, &x1) || !squares(c.y0, c.y1, p->first_row, p->end_row, &y0, &y1)) return;
    for (uint32_t y = y0; y <= y1; y++) {
        for (uint32_t x = x0; x <= x1; x++) {
            const uint64_t at = x + (uint64_t)bounds->columns * y;
            if (c.least < least[at]) least[at] = c.least;
            if (c.greatest > greatest[at]) greatest[at] = c.greatest;
        }
    }
}

static df_status reserve(df_bounds *bounds, uint64_t squares_wanted, df_error *err) {
    if (squares_wanted <= bounds->capacity) return DF_OK;
    free(bounds->least);
    free(bounds->greatest);
    bounds->least = bounds->greatest = NULL;
    bounds->capacity = 0;
    df_status status = df_alloc_raw((void **)&bounds->least, squares_wanted, sizeof *bounds->least, "bounds", err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&bounds->greatest, squares_wanted, sizeof *bounds->greatest, "bounds", err);
    if (status == DF_OK) bounds->capacity = squares_wanted;
    return status;
}

df_status df_bounds_project(df_bounds *bounds, const df_view *view, uint32_t first_row, uint32_t row_count,
                            uint32_t threads, df_error *err) {
    const projection p = make_projection(view, first_row, row_count);
    bounds->columns = (view->width + DF_BOUNDS_SQUARE - 1) / DF_BOUNDS_SQUARE;
    bounds->rows = (row_count + DF_BOUNDS_SQUARE - 1) / DF_BOUNDS_SQUARE;
    bounds->first_row = first_row;
    const uint64_t count = (uint64_t)bounds->columns * bounds->rows;
    const uint64_t share = (bounds->box_count + threads - 1) / threads;
    df_status status = reserve(bounds, count * threads, err);
    if (status != DF_OK) return status;
#pragma omp parallel for schedule(static, 1) num_threads(threads)
    for (uint32_t part = 0; part < threads; part++) { /* each into squares of its own */
        double *least = bounds->least + count * part, *greatest = bounds->greatest + count * part;
        const uint64_t end = share * (part + 1) < bounds->box_count ? share * (part + 1) : bounds->box_count;
        for (uint64_t i = 0; i < count; i++) {
            least[i] = INFINITY;
            greatest[i] = -INFINITY;
        }
        for (uint64_t i = share * part; i < end; i++) project_box(bounds, &p, &bounds->boxes[i], least, greatest);
    }
    for (uint32_t part = 1; part < threads; part++) {
        for (uint64_t i = 0; i < count; i++) {
            bounds->least[i] = fmin(bounds->least[i], bounds->least[count * part + i]);
            bounds->greatest[i] = fmax(bounds->greatest[i], bounds->greatest[count * part + i]);
        }
    }
    return bounds->gl ? draw_gl(bounds, view, &p, err) : DF_OK;
}

bool df_bounds_touch(const df_bounds *bounds, uint32_t x, uint32_t y, uint32_t width, uint32_t height) {
    const uint32_t top = y - bounds->first_row;
    for (uint32_t row = top / DF_BOUNDS_SQUARE; row <= (top + height - 1) / DF_BOUNDS_SQUARE; row++) {
        for (uint32_t column = x / DF_BOUNDS_SQUARE; column <= (x + width - 1) / DF_BOUNDS_SQUARE; column++) {
            const uint64_t at = column + (uint64_t)bounds->columns * row;
            if (bounds->least[at] <= bounds->greatest[at]) return true;
        }
    }
    return false;
}
