/*
 * Object-order first hits of primary rays (Neubauer's cell-based first-hit casting): bricks are sorted from front to
 * back and binned to tiles; a tile projects the surface voxels of its bricks and keeps the nearest accepted one of each
 * ray.
 */
#include "common/memory.h"
#include "render/cpu/fetch.h"
#include "render/methods/solve_methods.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Steps of depth by which blocks are sorted. */
#define DEPTH_BUCKETS 2048u

/* What one thread works with: one entry a ray of a tile. */
typedef struct splat_worker {
    float *depth;
    uint32_t *record, *block;
} splat_worker;

typedef struct splat_state {
    const df_scene *scene;
    df_trace_options options;
    df_surface surface;
    uint32_t *first;
    uint32_t *voxels;
    uint8_t *corners;
    uint32_t *corner; /* surface.corner, one axis after the other */
    splat_worker *workers;

    /* Of the current view. */
    df_projection projection;
    df_block_rect *rects; /* by block */
    uint32_t *order;      /* the visible blocks from front to back */
    uint32_t *tile_first; /* by tile: its first entry; one more at the end */
    uint32_t *entries;    /* blocks in order, by tile */
    uint32_t tile_capacity, entry_capacity;
    uint32_t tile_columns;
    uint32_t first_row, end_row; /* of the picture: what is drawn */
} splat_state;

static void splat_release(void *opaque) {
    splat_state *state = opaque;
    if (!state) return;
    for (uint32_t i = 0; state->workers && i < state->options.threads; i++) {
        free(state->workers[i].depth);
        free(state->workers[i].record);
        free(state->workers[i].block);
    }
    free(state->workers);
    free(state->first);
    free(state->voxels);
    free(state->corners);
    free(state->corner);
    free(state->rects);
    free(state->order);
    free(state->tile_first);
    free(state->entries);
    free(state);
}

/* How far from one of a voxel's faces the surface begins: the largest s in [0,1] such that within s of the face no
 * value comes within `least` of 0. face: the bit of the axis, or 0, as in a corner's number. */
static inline float surface_begin(const float corner[8], int axis, int face, float least) {
    const float sign = corner[face] < 0 ? -1 : 1;
    const int u = axis == 1 ? 2 : 1, v = axis == 4 ? 2 : 4;
    float begin = 1;
    for (int i = 0; i < 4; i++) {
        const int c = face + (i & 1 ? u : 0) + (i & 2 ? v : 0);
        const float low = sign * corner[c], high = sign * corner[c ^ axis];
        const float crossing = low <= least ? 0 : (low - least) / (low - (high < least ? high : least));
        begin = crossing < begin ? crossing : begin;
    }
    return begin;
}

/*
 * The record of a voxel. The box holds all points where the field's magnitude is not far above what rounding makes of
 * 0, widened by what rounding does to places: no ray that any arithmetic lets hit the voxel passes it by.
 */
static uint32_t surface_voxel(uint32_t bit, const float corner[8], float margin) {
    uint32_t voxel = bit;
    float largest = 0;
    for (int c = 0; c < 8; c++) {
        const float magnitude = corner[c] < 0 ? -corner[c] : corner[c];
        largest = magnitude > largest ? magnitude : largest;
    }
    for (int a = 0; a < 3; a++) {
        const float low = surface_begin(corner, 1 << a, 0, 1e-5f * largest) - margin;
        const float high = 1 - surface_begin(corner, 1 << a, 1 << a, 1e-5f * largest) + margin;
        voxel |= (low > 0 ? (uint32_t)(8 * low) : 0) << (DF_SURFACE_LOW + 3 * a);
        voxel |= (high < 1 ? (uint32_t)(8 * high) : 7) << (DF_SURFACE_HIGH + 3 * a);
    }
    return voxel;
}

static void copy_corners(splat_state *state, const uint32_t voxel[3], uint32_t block, uint32_t record) {
    const df_field *field = state->scene->field;
    const df_fetch f = df_fetch_corner(state->scene, voxel, block);
    const size_t size = df_sample_size(field->sample_type);
    for (uint32_t i = 0; i < 4; i++) { /* rows of two */
        const size_t from = f.corner + (i & 1 ? f.row : 0) + (i & 2 ? f.slice : 0);
        memcpy(state->corners + (8 * (size_t)record + 2 * i) * size, (const uint8_t *)field->samples + from * size,
               2 * size);
    }
}

static void fill_records(splat_state *state, uint32_t block) {
    const df_scene *scene = state->scene;
    const uint32_t words = df_brick_mask_words(scene->k), k_mask = scene->k - 1;
    const uint32_t *count = scene->voxel_count;
    const uint32_t longest =
        count[0] > count[1] ? (count[0] > count[2] ? count[0] : count[2]) : (count[1] > count[2] ? count[1] : count[2]);
    const float margin = 1.0f / 64 + (float)longest * 0x1p-20f;
    uint32_t record = state->first[block], low[3];
    low[0] = scene->block_cells[block] % scene->coarse_count[0] * scene->k;
    low[1] = scene->block_cells[block] / scene->coarse_count[0] % scene->coarse_count[1] * scene->k;
    low[2] = scene->block_cells[block] / scene->coarse_count[0] / scene->coarse_count[1] * scene->k;
    for (int a = 0; a < 3; a++) state->corner[(uint32_t)a * scene->block_count + block] = low[a];
    for (uint32_t w = 0; w < words; w++) {
        for (uint64_t mask = scene->masks[(uint64_t)block * words + w]; mask; mask &= mask - 1, record++) {
            const uint32_t bit = 64 * w + (uint32_t)__builtin_ctzll(mask);
            const uint32_t voxel[3] = {low[0] + (bit & k_mask), low[1] + (bit >> scene->k_shift & k_mask),
                                       low[2] + (bit >> 2 * scene->k_shift)};
            float corner[8];
            df_scene_corners(scene, voxel, block, corner);
            state->voxels[record] = surface_voxel(bit, corner, margin);
            copy_corners(state, voxel, block, record);
        }
    }
    assert(record == state->first[block + 1]);
}

static df_status make_records(splat_state *state, df_error *err) {
    const df_scene *scene = state->scene;
    const uint32_t words = df_brick_mask_words(scene->k);
    df_status status =
        df_alloc((void **)&state->first, scene->block_count + 1ull, sizeof *state->first, "surface records", err);
    if (status != DF_OK) return status;
    uint64_t count = 0;
    for (uint32_t block = 0; block < scene->block_count; block++) {
        state->first[block] = (uint32_t)count;
        for (uint32_t w = 0; w < words; w++)
            count += (uint64_t)__builtin_popcountll(scene->masks[(uint64_t)block * words + w]);
        if (count > INT32_MAX / 8) {
            return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer splat: more than %d surface voxels; choose dda",
                           INT32_MAX / 8);
        }
    }
    state->first[scene->block_count] = (uint32_t)count;
    status = df_alloc((void **)&state->voxels, count + DF_RAY_PADDING, sizeof *state->voxels, "surface records", err);
    if (status == DF_OK)
        status = df_alloc((void **)&state->corners, count * 8, df_sample_size(scene->field->sample_type),
                          "surface records", err);
    if (status == DF_OK)
        status =
            df_alloc((void **)&state->corner, scene->block_count * 3ull, sizeof *state->corner, "surface records", err);
    if (status != DF_OK) return status;
#pragma omp parallel for schedule(dynamic, 64) num_threads(state->options.threads)
    for (uint32_t block = 0; block < scene->block_count; block++) fill_records(state, block);
    const uint32_t blocks = scene->block_count;
    state->surface = (df_surface){state->first,
                                  state->voxels,
                                  state->corners,
                                  {state->corner, state->corner + blocks, state->corner + 2 * blocks},
                                  (uint32_t)count};
    return DF_OK;
}

static df_status make_workers(splat_state *state, df_error *err) {
    const uint64_t rays = (uint64_t)state->options.tile_width * state->options.tile_height;
    df_status status =
        df_alloc((void **)&state->workers, state->options.threads, sizeof *state->workers, "tracer", err);
    for (uint32_t i = 0; i < state->options.threads && status == DF_OK; i++) {
        splat_worker *worker = &state->workers[i];
        status = df_alloc_raw((void **)&worker->depth, rays + DF_RAY_PADDING, sizeof *worker->depth, "depths", err);
        if (status == DF_OK)
            status =
                df_alloc_raw((void **)&worker->record, rays + DF_RAY_PADDING, sizeof *worker->record, "depths", err);
        if (status == DF_OK)
            status = df_alloc_raw((void **)&worker->block, rays + DF_RAY_PADDING, sizeof *worker->block, "depths", err);
    }
    return status;
}

static df_status splat_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    splat_state *state;
    *out = NULL;
    if (scene->levels != 2)
        return df_fail(err, DF_ERROR_USAGE, "--tracer splat works on two levels: leave out --levels 1");
    df_status status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status != DF_OK) return status;
    state->scene = scene;
    state->options = *options;
    status = make_records(state, err);
    if (status == DF_OK) status = make_workers(state, err);
    if (status == DF_OK)
        status = df_alloc((void **)&state->rects, scene->block_count, sizeof *state->rects, "blocks", err);
    if (status == DF_OK)
        status = df_alloc((void **)&state->order, scene->block_count, sizeof *state->order, "blocks", err);
    if (status != DF_OK) splat_release(state);
    else *out = state;
    return status;
}

static uint64_t splat_bytes(const void *opaque) {
    const splat_state *state = opaque;
    return state->surface.record_count *
               (8 * df_sample_size(state->scene->field->sample_type) + sizeof *state->voxels) +
           state->scene->block_count *
               (sizeof *state->first + 3 * sizeof *state->corner + sizeof *state->rects + sizeof *state->order);
}

static bool splat_suits(const df_scene *scene, const df_view *view) {
    return scene->levels == 2 && view && !view->rebase;
}

/* ---- per view ---- */

/* Inverts the matrix with the columns corner, right, down. */
static void make_projection(const df_view *view, df_projection *projection) {
    const double *m[3] = {view->corner, view->right, view->down};
    double rows[3][3], determinant = 0;
    for (int i = 0; i < 3; i++) {
        const double *b = m[(i + 1) % 3], *c = m[(i + 2) % 3];
        for (int a = 0; a < 3; a++) rows[i][a] = b[(a + 1) % 3] * c[(a + 2) % 3] - b[(a + 2) % 3] * c[(a + 1) % 3];
    }
    for (int a = 0; a < 3; a++) determinant += m[0][a] * rows[0][a];
    for (int i = 0; i < 3; i++) {
        for (int a = 0; a < 3; a++) projection->rows[i][a] = (float)(rows[i][a] / determinant);
    }
    for (int a = 0; a < 3; a++) projection->eye[a] = (float)view->eye[a];
}

/* Clamps to low <= x < end. */
static uint16_t clamp_pixel(double x, uint32_t low, uint32_t end) {
    return (uint16_t)(x < low ? low : x > end - 1.0 ? end - 1 : (uint32_t)x);
}

static df_block_rect block_rect(const splat_state *state, const df_view *view, uint32_t block) {
    const df_projection *p = &state->projection;
    const double half = state->scene->k / 2.0, margin = 0.05;
    df_block_rect rect = {.x0 = 1};
    double centre[3] = {0, 0, 0}, reach[3] = {0, 0, 0};
    if (state->first[block] == state->first[block + 1]) return rect;
    for (int i = 0; i < 3; i++) {
        for (int a = 0; a < 3; a++)
            centre[i] += (double)p->rows[i][a] * (state->surface.corner[a][block] + half - view->eye[a]);
    }
    for (int a = 0; a < 3; a++) reach[0] += half * fabs((double)p->rows[0][a]);
    const double w = centre[0], nearest = w - reach[0];
    if (w + reach[0] < 0) return rect;
    if (nearest < 0.01) {
        return (df_block_rect){0, (uint16_t)state->first_row, (uint16_t)(view->width - 1),
                               (uint16_t)(state->end_row - 1), 0};
    }
    for (int i = 1; i < 3; i++) {
        for (int a = 0; a < 3; a++)
            reach[i] += half * fabs((double)p->rows[i][a] - centre[i] / w * (double)p->rows[0][a]);
        reach[i] = reach[i] / nearest + margin;
    }
    const double x0 = ceil(centre[1] / w - reach[1]), x1 = floor(centre[1] / w + reach[1]);
    const double y0 = ceil(centre[2] / w - reach[2]), y1 = floor(centre[2] / w + reach[2]);
    if (x1 < 0 || y1 < state->first_row || x0 > view->width - 1.0 || y0 > state->end_row - 1.0 || x1 < x0 || y1 < y0)
        return rect;
    rect.x0 = clamp_pixel(x0, 0, view->width);
    rect.x1 = clamp_pixel(x1, 0, view->width);
    rect.y0 = clamp_pixel(y0, state->first_row, state->end_row);
    rect.y1 = clamp_pixel(y1, state->first_row, state->end_row);
    rect.t_near = (float)(nearest * 0.99999);
    return rect;
}

static bool visible(const df_block_rect *rect) { return rect->x0 <= rect->x1; }

/* Orders the visible blocks by depth, nearly; returns how many. */
static uint32_t sort_blocks(splat_state *state) {
    const uint32_t total = state->scene->block_count;
    uint32_t place[DEPTH_BUCKETS + 1] = {0}, count = 0;
    float low = INFINITY, high = 0;
    for (uint32_t i = 0; i < total; i++) {
        if (!visible(&state->rects[i])) continue;
        low = fminf(low, state->rects[i].t_near);
        high = fmaxf(high, state->rects[i].t_near);
    }
    const float scale = high > low ? (float)(DEPTH_BUCKETS - 1) / (high - low) : 0;
    for (uint32_t i = 0; i < total; i++) {
        if (visible(&state->rects[i])) place[1 + (uint32_t)((state->rects[i].t_near - low) * scale)]++;
    }
    for (uint32_t b = 0; b < DEPTH_BUCKETS; b++) place[b + 1] += place[b];
    for (uint32_t i = 0; i < total; i++) {
        if (!visible(&state->rects[i])) continue;
        state->order[place[(uint32_t)((state->rects[i].t_near - low) * scale)]++] = i;
        count++;
    }
    return count;
}

/* The tiles that a rectangle of pixels meets, inclusive. */
typedef struct tile_range {
    uint32_t x0, y0, x1, y1;
} tile_range;

static tile_range tiles_of(const splat_state *state, const df_block_rect *rect) {
    const uint32_t w = state->options.tile_width, h = state->options.tile_height, y0 = state->first_row;
    return (tile_range){rect->x0 / w, (rect->y0 - y0) / h, rect->x1 / w, (rect->y1 - y0) / h};
}

static df_status reserve(uint32_t **array, uint32_t *capacity, uint64_t count, df_error *err) {
    if (count <= *capacity) return DF_OK;
    free(*array);
    *capacity = 0;
    df_status status = df_alloc_raw((void **)array, count + count / 4, sizeof **array, "tile lists", err);
    if (status == DF_OK) *capacity = (uint32_t)(count + count / 4);
    return status;
}

/* Lists the blocks of every tile, in order. */
static df_status bin_blocks(splat_state *state, const df_view *view, uint32_t block_count, df_error *err) {
    const uint32_t columns = (view->width + state->options.tile_width - 1) / state->options.tile_width;
    const uint32_t rows =
        (state->end_row - state->first_row + state->options.tile_height - 1) / state->options.tile_height;
    state->tile_columns = columns;
    df_status status = reserve(&state->tile_first, &state->tile_capacity, (uint64_t)columns * rows + 2, err);
    if (status != DF_OK) return status;
    uint32_t *first = state->tile_first;
    memset(first, 0, ((size_t)columns * rows + 2) * sizeof *first);
    for (uint32_t i = 0; i < block_count; i++) { /* counts, two places ahead */
        const tile_range range = tiles_of(state, &state->rects[state->order[i]]);
        for (uint32_t y = range.y0; y <= range.y1; y++) {
            for (uint32_t x = range.x0; x <= range.x1; x++) first[x + columns * y + 2]++;
        }
    }
    uint64_t total = 0;
    for (uint32_t i = 0; i < columns * rows; i++) {
        total += first[i + 2];
        if (total > UINT32_MAX)
            return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer splat: too many blocks in this view");
        first[i + 2] += first[i + 1];
    }
    status = reserve(&state->entries, &state->entry_capacity, total, err);
    if (status != DF_OK) return status;
    for (uint32_t i = 0; i < block_count;
         i++) { /* fills, which moves first[t + 1] from the start to the end of tile t */
        const tile_range range = tiles_of(state, &state->rects[state->order[i]]);
        for (uint32_t y = range.y0; y <= range.y1; y++) {
            for (uint32_t x = range.x0; x <= range.x1; x++)
                state->entries[first[x + columns * y + 1]++] = state->order[i];
        }
    }
    return DF_OK;
}

static df_status splat_begin_frame(void *opaque, const df_view *view, uint32_t first_row, uint32_t row_count,
                                   df_error *err) {
    splat_state *state = opaque;
    state->first_row = first_row;
    state->end_row = first_row + row_count;
    make_projection(view, &state->projection);
#pragma omp parallel for schedule(static) num_threads(state->options.threads)
    for (uint32_t block = 0; block < state->scene->block_count; block++)
        state->rects[block] = block_rect(state, view, block);
    return bin_blocks(state, view, sort_blocks(state), err);
}

static uint32_t tile_index(const splat_state *state, const df_tile *tile) {
    const uint32_t y = tile->y - state->first_row;
    assert(tile->x % state->options.tile_width == 0 && y % state->options.tile_height == 0);
    return tile->x / state->options.tile_width + state->tile_columns * (y / state->options.tile_height);
}

static bool splat_touches(const void *opaque, const df_tile *tile) {
    const splat_state *state = opaque;
    const uint32_t t = tile_index(state, tile);
    return state->tile_first[t] < state->tile_first[t + 1];
}

static df_status splat_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                             df_error *err) {
    (void)err;
    const splat_state *state = opaque;
    splat_worker *worker = &state->workers[thread];
    const uint32_t t = tile_index(state, tile), rays = tile->rays.count;
    for (uint32_t i = 0; i < rays + DF_RAY_PADDING; i++) worker->depth[i] = INFINITY;
    const df_splat_job job = {state->scene,
                              &state->surface,
                              &state->projection,
                              tile,
                              state->rects,
                              state->entries + state->tile_first[t],
                              state->tile_first[t + 1] - state->tile_first[t],
                              DF_SOLVE_ISOLATES(state->options.solve),
                              worker->depth,
                              worker->record,
                              worker->block};
    state->options.kernels->splat(&job, counters);
    state->options.kernels->splat_solve(&job, &state->options, hits);
    return DF_OK;
}

const df_tracer df_tracer_splat = {
    .name = "splat",
    .summary = "object order: surface voxels are projected to their pixels; for pictures",
    .prepare = splat_prepare,
    .release = splat_release,
    .bytes = splat_bytes,
    .suits = splat_suits,
    .begin_frame = splat_begin_frame,
    .touches = splat_touches,
    .trace = splat_trace,
};
