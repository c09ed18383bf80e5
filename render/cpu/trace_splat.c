/*
 * Object-order first hits of primary rays (Neubauer's cell-based first-hit casting): blocks of cells are binned to
 * tiles; a tile sorts its blocks from front to back, projects their surface voxels or leaves and keeps the nearest
 * accepted one of each ray.
 *
 * A leaf of an octree is accepted as well where a ray enters it inside (adf.h): of rays that start outside the nearest
 * such leaf is the hit. Rays that start inside are walked.
 */
#include "common/memory.h"
#include "common/progress.h"
#include "render/cpu/surface.h"
#include "render/cpu/walk.h"
#include "render/methods/adf.h"
#include "render/methods/solve_methods.h"

#include <assert.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

/* Steps of depth by which the blocks of a tile are sorted. */
#define DEPTH_BUCKETS 256u

/* What one thread works with: one entry a ray of a tile. */
typedef struct splat_worker {
    float *depth;
    uint32_t *record, *block;
} splat_worker;

typedef struct splat_state {
    const df_scene *scene;
    df_trace_options options;
    df_surface surface;
    splat_worker *workers;
    df_walk *walk; /* octrees: for rays that may start inside; otherwise NULL */

    /* Of the current view. */
    df_projection projection;
    df_block_rect *rects; /* by block */
    uint32_t *tile_first; /* by tile: its first entry; one more at the end */
    uint32_t *counts;     /* by thread and tile: blocks of its share of them, then where its next entry goes */
    uint32_t *entries;    /* the visible blocks, by tile; then as many again: from front to back, where traced */
    uint64_t tile_capacity, count_capacity, entry_capacity;
    uint32_t tile_columns;
    uint32_t first_row, end_row; /* of the picture: what is drawn */
    bool walks;                  /* all rays may start inside */
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
    df_surface_free(&state->surface);
    df_walk_release(state->walk);
    free(state->rects);
    free(state->tile_first);
    free(state->counts);
    free(state->entries);
    free(state);
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
    if (scene->levels == 1)
        return df_fail(err, DF_ERROR_USAGE, "--tracer splat works on two levels: leave out --levels 1");
    if (scene->levels == 0 && options->walk.lod > 0)
        return df_fail(err, DF_ERROR_USAGE, "--tracer splat looks into every leaf: leave out --lod, or choose adf");
    if (scene->levels == 0 && scene->iso != 0)
        return df_fail(err, DF_ERROR_USAGE, "--tracer splat draws octrees at iso 0: choose adf");
    df_status status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status != DF_OK) return status;
    state->scene = scene;
    state->options = *options;
    status = df_surface_make(scene, options->kernels, options->threads, &state->surface, err);
    if (status == DF_OK) status = make_workers(state, err);
    const uint32_t blocks = state->surface.block_count;
    if (status == DF_OK) status = df_alloc((void **)&state->rects, blocks, sizeof *state->rects, "blocks", err);
    if (status == DF_OK && scene->levels == 0) status = df_walk_prepare(scene, options, (void **)&state->walk, err);
    if (status != DF_OK) splat_release(state);
    else *out = state;
    return status;
}

static void splat_set_method(void *opaque, const df_trace_options *options) {
    splat_state *state = opaque;
    state->options = *options;
    if (state->walk) state->walk->options = *options;
}

static uint64_t splat_bytes(const void *opaque) {
    const splat_state *state = opaque;
    return df_surface_bytes(&state->surface) + state->surface.block_count * sizeof *state->rects;
}

static bool splat_suits(const df_scene *scene, const df_view *view) {
    return (scene->levels == 2 || (scene->levels == 0 && scene->iso == 0)) && view && !view->rebase;
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

/* The tiles that a rectangle of pixels meets; x1 and y1 are one too many. */
typedef struct tile_range {
    uint32_t x0, y0, x1, y1;
} tile_range;

static tile_range tiles_of(const splat_state *state, const df_block_rect *rect) {
    const uint32_t w = state->options.tile_width, h = state->options.tile_height, y0 = state->first_row;
    if (rect->x0 > rect->x1) return (tile_range){0};
    return (tile_range){rect->x0 / w, (rect->y0 - y0) / h, rect->x1 / w + 1, (rect->y1 - y0) / h + 1};
}

static df_status reserve(uint32_t **array, uint64_t *capacity, uint64_t count, df_error *err) {
    if (count <= *capacity) return DF_OK;
    free(*array);
    *capacity = 0;
    df_status status = df_alloc_raw((void **)array, count + count / 4, sizeof **array, "tile lists", err);
    if (status == DF_OK) *capacity = count + count / 4;
    return status;
}

/* Makes room for the entries that the threads have counted, and turns counts into places: of a tile thread after
 * thread, so that its blocks come in one order whatever the number of threads. */
static df_status place_entries(splat_state *state, uint32_t tiles, df_error *err) {
    uint64_t total = 0;
    for (uint32_t t = 0; t < tiles; t++) {
        state->tile_first[t] = (uint32_t)total;
        for (uint32_t thread = 0; thread < state->options.threads; thread++) {
            uint32_t *count = &state->counts[(size_t)thread * tiles + t], here = *count;
            *count = (uint32_t)total;
            total += here;
        }
        if (total > UINT32_MAX)
            return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer splat: too many blocks in this view");
    }
    state->tile_first[tiles] = (uint32_t)total;
    return reserve(&state->entries, &state->entry_capacity, 2 * total, err);
}

/* Blocks that a thread looks at in one go. */
#define BLOCK_SHARE 256u
static uint32_t end_of_share(uint32_t first, uint32_t blocks) {
    return blocks - first < BLOCK_SHARE ? blocks : first + BLOCK_SHARE;
}

/* Adds the blocks of a share to the counts of the tiles that they may be seen in. */
static void count_blocks(const splat_state *state, uint32_t first, uint32_t end, uint32_t *count) {
    for (uint32_t block = first; block < end; block++) {
        const tile_range range = tiles_of(state, &state->rects[block]);
        for (uint32_t y = range.y0; y < range.y1; y++) {
            for (uint32_t x = range.x0; x < range.x1; x++) count[x + state->tile_columns * y]++;
        }
    }
}

/* Lists them, from the places in `next` on. */
static void list_blocks(const splat_state *state, uint32_t first, uint32_t end, uint32_t *next) {
    for (uint32_t block = first; block < end; block++) {
        const tile_range range = tiles_of(state, &state->rects[block]);
        for (uint32_t y = range.y0; y < range.y1; y++) {
            for (uint32_t x = range.x0; x < range.x1; x++) state->entries[next[x + state->tile_columns * y]++] = block;
        }
    }
}

/* Lists the visible blocks of every tile. */
static df_status bin_blocks(splat_state *state, const df_view *view, df_error *err) {
    const uint32_t columns = (view->width + state->options.tile_width - 1) / state->options.tile_width;
    const uint32_t rows =
        (state->end_row - state->first_row + state->options.tile_height - 1) / state->options.tile_height;
    const uint32_t tiles = columns * rows, blocks = state->surface.block_count;
    const uint32_t shares = blocks / BLOCK_SHARE + (blocks % BLOCK_SHARE != 0);
    const df_tile picture = {
        .view = view, .y = state->first_row, .width = view->width, .height = state->end_row - state->first_row};
    const uint64_t counts = (uint64_t)tiles * state->options.threads;
    state->tile_columns = columns;
    df_status status = reserve(&state->tile_first, &state->tile_capacity, (uint64_t)tiles + 1, err);
    if (status == DF_OK) status = reserve(&state->counts, &state->count_capacity, counts, err);
    if (status != DF_OK) return status;
    memset(state->counts, 0, counts * sizeof *state->counts);
#pragma omp parallel num_threads(state->options.threads)
    {
        uint32_t *count = state->counts + (size_t)tiles * (uint32_t)omp_get_thread_num();
#pragma omp for schedule(static)
        for (uint32_t share = 0; share < shares; share++) {
            const uint32_t first = share * BLOCK_SHARE, end = end_of_share(first, blocks);
            state->options.kernels->block_rects(&state->surface, &state->projection, &picture, first, end - first,
                                                state->rects);
            count_blocks(state, first, end, count);
        }
#pragma omp single
        status = place_entries(state, tiles, err);
        if (status == DF_OK) {
#pragma omp for schedule(static) /* the same shares to each thread as above */
            for (uint32_t share = 0; share < shares; share++) {
                const uint32_t first = share * BLOCK_SHARE;
                list_blocks(state, first, end_of_share(first, blocks), count);
            }
        }
    }
    return status;
}

/* Orders blocks by depth, nearly. */
static void sort_blocks(const df_block_rect *rects, const uint32_t *blocks, uint32_t count, uint32_t *sorted) {
    uint32_t place[DEPTH_BUCKETS + 1] = {0};
    float low = INFINITY, high = 0;
    for (uint32_t i = 0; i < count; i++) {
        const float t_near = rects[blocks[i]].t_near;
        low = t_near < low ? t_near : low;
        high = t_near > high ? t_near : high;
    }
    const float scale = high > low ? (float)(DEPTH_BUCKETS - 1) / (high - low) : 0;
    for (uint32_t i = 0; i < count; i++) place[1 + (uint32_t)((rects[blocks[i]].t_near - low) * scale)]++;
    for (uint32_t b = 0; b < DEPTH_BUCKETS; b++) place[b + 1] += place[b];
    for (uint32_t i = 0; i < count; i++)
        sorted[place[(uint32_t)((rects[blocks[i]].t_near - low) * scale)]++] = blocks[i];
}

/* Whether rays of an octree's view may start inside: the eye is in a leaf that is, or near a place that is. */
static bool starts_inside(const df_scene *scene, const df_view *view) {
    const double side = (double)(1u << scene->field->level_count), near = 1e-3 + side * 0x1p-22;
    for (int i = 0; i < 8; i++) {
        double at[3], within[3];
        float corner[8], largest = 0;
        df_adf_cell cell;
        bool outside = false;
        for (int a = 0; a < 3; a++) {
            at[a] = view->eye[a] + (i >> a & 1 ? near : -near);
            outside = outside || at[a] < 0 || at[a] > side;
        }
        if (outside) continue;
        df_adf_find(scene->field, at, DF_LEVEL_COUNT_MAX, &cell);
        df_adf_corners(scene->field, cell.family, cell.child, corner);
        for (int a = 0; a < 3; a++) within[a] = (at[a] - cell.corner[a]) / cell.side;
        for (int c = 0; c < 8; c++) largest = fmaxf(largest, fabsf(corner[c]));
        if (df_trilinear(corner, within) <= 2 * near * (double)largest) return true;
    }
    return false;
}

static df_status splat_begin_frame(void *opaque, const df_view *view, uint32_t first_row, uint32_t row_count,
                                   df_error *err) {
    splat_state *state = opaque;
    state->first_row = first_row;
    state->end_row = first_row + row_count;
    state->walks = state->scene->levels == 0 && starts_inside(state->scene, view);
    if (state->walks) return DF_OK;
    make_projection(view, &state->projection);
    return bin_blocks(state, view, err);
}

static uint32_t tile_index(const splat_state *state, const df_tile *tile) {
    const uint32_t y = tile->y - state->first_row;
    assert(tile->x % state->options.tile_width == 0 && y % state->options.tile_height == 0);
    return tile->x / state->options.tile_width + state->tile_columns * (y / state->options.tile_height);
}

static bool splat_touches(const void *opaque, const df_tile *tile) {
    const splat_state *state = opaque;
    if (state->walks) return true;
    const uint32_t t = tile_index(state, tile);
    return state->tile_first[t] < state->tile_first[t + 1];
}

/* Rays of an octree whose first leaf they may enter inside, what no record tells: walks them instead. */
static void walk_rays(const splat_state *state, uint32_t thread, const df_tile *tile, df_hits *hits,
                      df_counters *counters) {
    const splat_worker *worker = &state->workers[thread];
    const bool isolate = DF_SOLVE_ISOLATES(state->options.solve);
    df_candidate *candidates = state->walk->candidates[thread];
    uint32_t count = 0;
    for (uint32_t i = 0; i < tile->rays.count; i++) {
        dda_ray ray;
        if (!(worker->depth[i] < INFINITY && state->surface.voxels[worker->record[i]] & DF_SURFACE_BORDER)) continue;
        worker->depth[i] = INFINITY;
        df_walk_ray(NULL, 0, tile, i, &ray);
        candidates[count].ray = i;
        count += adf_walk_scene(state->scene, isolate, &ray, &candidates[count], counters);
    }
    df_walk_solve(state->walk, thread, tile, count, hits, counters);
}

static df_status splat_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                             df_error *err) {
    const splat_state *state = opaque;
    splat_worker *worker = &state->workers[thread];
    hits->stencils = state->surface.stencils.samples ? &state->surface.stencils : NULL;
    if (state->walks) return df_tracer_adf_packet.trace(state->walk, thread, tile, hits, counters, err);
    const uint32_t t = tile_index(state, tile), rays = tile->rays.count;
    const uint32_t first = state->tile_first[t], count = state->tile_first[t + 1] - first;
    uint32_t *order = state->entries + state->entry_capacity / 2 + first;
    sort_blocks(state->rects, state->entries + first, count, order);
    for (uint32_t i = 0; i < rays + DF_RAY_PADDING; i++) worker->depth[i] = INFINITY;
    const df_splat_job job = {state->scene,
                              &state->surface,
                              &state->projection,
                              tile,
                              state->rects,
                              order,
                              count,
                              DF_SOLVE_ISOLATES(state->options.solve),
                              worker->depth,
                              worker->record,
                              worker->block};
    state->options.kernels->splat(&job, counters);
    if (state->surface.has_border) walk_rays(state, thread, tile, hits, counters);
    const double start = df_now_ms();
    state->options.kernels->splat_solve(&job, &state->options, hits);
    counters->solve_ms += df_now_ms() - start;
    return DF_OK;
}

const df_tracer df_tracer_splat = {
    .name = "splat",
    .summary = "object order: surface voxels and leaves are projected to their pixels; for pictures",
    .prepare = splat_prepare,
    .release = splat_release,
    .set_method = splat_set_method,
    .bytes = splat_bytes,
    .suits = splat_suits,
    .begin_frame = splat_begin_frame,
    .touches = splat_touches,
    .trace = splat_trace,
};
