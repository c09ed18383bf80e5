#include "render/frame.h"
#include "common/memory.h"
#include "common/progress.h"
#include "render/methods/shade.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>

/* What one thread works with. */
typedef struct frame_worker {
    df_tile tile;
    df_hits hits;
    df_frame_stats stats;
    df_status status;
    df_error error;
} frame_worker;

struct df_renderer {
    const df_scene *scene;
    df_frame_options options;
    uint32_t worker_count;
    uint32_t tile_width, tile_height; /* of the largest tile */
    void *tracer_state;
    double prepare_ms;
    frame_worker *workers;
    uint8_t shade_table[DF_SHADE_LEVELS];
    uint8_t *background_row; /* of a tile's width */
};

void df_shade_table(uint8_t table[]) {
    for (int i = 0; i < DF_SHADE_LEVELS; i++) {
        double linear = (double)i / (DF_SHADE_LEVELS - 1);
        double coded = linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
        table[i] = (uint8_t)(coded * 255 + 0.5);
    }
}

void df_renderer_close(df_renderer *renderer) {
    if (!renderer) return;
    for (uint32_t i = 0; renderer->workers && i < renderer->worker_count; i++) {
        df_rays_free(&renderer->workers[i].tile.rays);
        df_hits_free(&renderer->workers[i].hits);
    }
    renderer->options.tracer->release(renderer->tracer_state);
    free(renderer->background_row);
    free(renderer->workers);
    free(renderer);
}

static df_status make_background(df_renderer *renderer, df_error *err) {
    const float linear[3] = DF_SHADE_BACKGROUND;
    df_status status = df_alloc_raw((void **)&renderer->background_row, renderer->tile_width, 3, "background", err);
    if (status != DF_OK) return status;
    for (uint32_t i = 0; i < 3 * renderer->tile_width; i++) {
        renderer->background_row[i] = renderer->shade_table[df_shade_level(linear[i % 3])];
    }
    return DF_OK;
}

static df_trace_options trace_options(const df_renderer *renderer) {
    const df_frame_options *options = &renderer->options;
    return (df_trace_options){.kernels = options->kernels,
                              .solve = options->solve,
                              .steps = options->steps,
                              .precision = options->precision,
                              .filter = options->filter,
                              .threads = options->threads,
                              .tile_width = renderer->tile_width,
                              .tile_height = renderer->tile_height,
                              .walk = options->walk};
}

df_status df_renderer_open(const df_scene *scene, const df_frame_options *options, uint32_t width, uint32_t height,
                           df_renderer **out, df_error *err) {
    df_renderer *renderer;
    *out = NULL;
    if (options->walk.bounds && !options->tracer->takes_bounds) {
        return df_fail(err, DF_ERROR_USAGE, "--bounds %s: --tracer %s has no use for it: choose dda, dda-packet or cgt",
                       df_bounds_names[options->walk.bounds], options->tracer->name);
    }
    df_status status = df_alloc((void **)&renderer, 1, sizeof *renderer, "renderer", err);
    if (status != DF_OK) return status;
    bool whole = options->tracer->whole_frame;
    renderer->scene = scene;
    renderer->options = *options;
    if (!options->kernels) renderer->options.kernels = &df_kernels_scalar;
    renderer->worker_count = whole ? 1 : options->threads;
    renderer->tile_width = whole || options->tile > width ? width : options->tile;
    renderer->tile_height = whole || options->tile > height ? height : options->tile;
    df_shade_table(renderer->shade_table);
    const uint64_t tile_rays = (uint64_t)renderer->tile_width * renderer->tile_height;
    if (tile_rays > UINT32_MAX - DF_RAY_PADDING) {
        status = df_fail(err, DF_ERROR_MEMORY, "%u x %u pixels in one tile: at most %" PRIu64 " can be traced at once",
                         renderer->tile_width, renderer->tile_height, (uint64_t)UINT32_MAX - DF_RAY_PADDING);
        free(renderer);
        return status;
    }
    const df_trace_options trace = trace_options(renderer);
    const double start = df_now_ms();
    status = options->tracer->prepare(scene, &trace, &renderer->tracer_state, err);
    renderer->prepare_ms = df_now_ms() - start;
    if (status == DF_OK) status = make_background(renderer, err);
    if (status == DF_OK) {
        status =
            df_alloc((void **)&renderer->workers, renderer->worker_count, sizeof *renderer->workers, "renderer", err);
    }
    for (uint32_t i = 0; i < renderer->worker_count && status == DF_OK; i++) {
        status = df_rays_alloc((uint32_t)tile_rays, true, &renderer->workers[i].tile.rays, err);
        if (status == DF_OK) status = df_hits_alloc((uint32_t)tile_rays, &renderer->workers[i].hits, err);
    }
    if (status != DF_OK) df_renderer_close(renderer);
    else *out = renderer;
    return status;
}

df_status df_renderer_set_method(df_renderer *renderer, const df_frame_options *options, df_error *err) {
    df_frame_options *own = &renderer->options;
    assert(options->tracer == own->tracer);
    const bool same =
        options->solve == own->solve && options->steps == own->steps && options->precision == own->precision;
    own->solve = options->solve;
    own->steps = options->steps;
    own->precision = options->precision;
    own->gradient = options->gradient;
    if (same) return DF_OK;
    const df_trace_options trace = trace_options(renderer);
    if (own->tracer->set_method) {
        own->tracer->set_method(renderer->tracer_state, &trace);
        return DF_OK;
    }
    own->tracer->release(renderer->tracer_state);
    renderer->tracer_state = NULL;
    return own->tracer->prepare(renderer->scene, &trace, &renderer->tracer_state, err);
}

void df_renderer_precomputation(const df_renderer *renderer, double *ms, double *extract_ms, uint64_t *bytes) {
    const df_tracer *tracer = renderer->options.tracer;
    *ms = renderer->scene->precompute_ms + renderer->prepare_ms;
    *extract_ms = tracer->extract_ms ? tracer->extract_ms(renderer->tracer_state) : 0;
    *bytes = renderer->scene->precompute_bytes + (tracer->bytes ? tracer->bytes(renderer->tracer_state) : 0);
}

/* Fills a rectangle of the picture with what is seen where nothing is hit. */
static void clear_tile(const df_renderer *renderer, const df_tile *tile, const df_picture *picture) {
    for (uint32_t y = tile->y; y < tile->y + tile->height; y++) {
        size_t first = (size_t)y * picture->width + tile->x;
        if (picture->rgb) memcpy(picture->rgb + 3 * first, renderer->background_row, 3 * (size_t)tile->width);
        if (picture->depth) {
            for (uint32_t x = 0; x < tile->width; x++) picture->depth[first + x] = INFINITY;
        }
        if (picture->normals) memset(picture->normals + 3 * first, 0, 3 * sizeof(float) * tile->width);
    }
}

/* Writes what a ray of the tile cost on average. */
static void put_heat(const df_tile *tile, const df_picture *picture, uint64_t steps, double ms) {
    const double rays = (double)tile->width * tile->height;
    const float heat = (float)((picture->heat_mode == DF_HEAT_TIME ? ms * 1e6 : (double)steps) / rays);
    for (uint32_t y = tile->y; y < tile->y + tile->height; y++) {
        for (uint32_t x = tile->x; x < tile->x + tile->width; x++) picture->heat[(size_t)y * picture->width + x] = heat;
    }
}

static void render_tile(df_renderer *renderer, uint32_t thread, const df_picture *picture) {
    frame_worker *worker = &renderer->workers[thread];
    const df_tracer *tracer = renderer->options.tracer;
    df_tile *tile = &worker->tile;
    double start = df_now_ms(), made = start, traced = start;
    const df_counters *counters = &worker->stats.counters;
    const uint64_t steps = counters->coarse_steps + counters->fine_steps;
    worker->hits.count = 0;
    if (!tracer->touches || tracer->touches(renderer->tracer_state, tile)) {
        df_view_rays(tile->view, renderer->options.kernels, tile->x, tile->y, tile->width, tile->height, &tile->rays);
        made = df_now_ms();
        df_status status =
            tracer->trace(renderer->tracer_state, thread, tile, &worker->hits, &worker->stats.counters, &worker->error);
        if (status != DF_OK) worker->status = status;
        traced = df_now_ms();
    }
    clear_tile(renderer, tile, picture);
    const df_shade_job job = {renderer->scene,
                              tile,
                              renderer->options.gradient,
                              renderer->shade_table,
                              picture->width,
                              picture->rgb,
                              picture->depth,
                              picture->normals};
    if (worker->hits.count) renderer->options.kernels->shade(&job, &worker->hits);
    worker->stats.rays_ms += made - start;
    worker->stats.trace_ms += traced - made;
    worker->stats.shade_ms += df_now_ms() - traced;
    worker->stats.rays_hitting += worker->hits.count;
    if (picture->heat)
        put_heat(tile, picture, counters->coarse_steps + counters->fine_steps - steps, df_now_ms() - start);
}

void df_frame_stats_add(df_frame_stats *sum, const df_frame_stats *part) {
    sum->rays_hitting += part->rays_hitting;
    sum->counters.coarse_steps += part->counters.coarse_steps;
    sum->counters.fine_steps += part->counters.fine_steps;
    sum->counters.cells_tested += part->counters.cells_tested;
    sum->counters.lanes_active += part->counters.lanes_active;
    sum->counters.lanes_total += part->counters.lanes_total;
    sum->counters.solve_ms += part->counters.solve_ms;
    sum->begin_ms += part->begin_ms;
    sum->rays_ms += part->rays_ms;
    sum->trace_ms += part->trace_ms;
    sum->shade_ms += part->shade_ms;
}

df_status df_renderer_rows(df_renderer *renderer, const df_view *view, uint32_t first_row, uint32_t row_count,
                           const df_picture *picture, df_frame_stats *stats, df_error *err) {
    assert(picture->width == view->width && picture->height == view->height);
    assert(first_row <= view->height && row_count <= view->height - first_row);
    assert(!renderer->options.tracer->whole_frame || row_count == view->height);
    const double start = df_now_ms();
    const df_tracer *tracer = renderer->options.tracer;
    if (tracer->suits && !tracer->suits(renderer->scene, view)) {
        return df_fail(err, DF_ERROR_USAGE, "--tracer %s cannot draw this field from here (%s): choose auto",
                       tracer->name,
                       view->rebase                   ? "the eye is too far away"
                       : renderer->scene->levels == 0 ? "an octree"
                                                      : "its structure");
    }
    if (tracer->begin_frame) {
        df_status status = tracer->begin_frame(renderer->tracer_state, view, first_row, row_count, err);
        if (status != DF_OK) return status;
    }
    const double begun = df_now_ms();
    const uint32_t width = renderer->tile_width, height = renderer->tile_height;
    const uint64_t columns = (view->width + width - 1) / width, rows = (row_count + height - 1) / height;
    for (uint32_t i = 0; i < renderer->worker_count; i++) {
        renderer->workers[i].status = DF_OK;
        memset(&renderer->workers[i].stats, 0, sizeof renderer->workers[i].stats);
    }
#pragma omp parallel for schedule(dynamic) num_threads(renderer->worker_count)
    for (uint64_t i = 0; i < columns * rows; i++) {
        uint32_t thread = (uint32_t)omp_get_thread_num();
        df_tile *tile = &renderer->workers[thread].tile;
        tile->view = view;
        tile->x = (uint32_t)(i % columns) * width;
        tile->y = first_row + (uint32_t)(i / columns) * height;
        tile->width = view->width - tile->x < width ? view->width - tile->x : width;
        tile->height = first_row + row_count - tile->y < height ? first_row + row_count - tile->y : height;
        if (renderer->workers[thread].status == DF_OK) render_tile(renderer, thread, picture);
    }
    df_frame_stats sum = {.rays_cast = (uint64_t)view->width * row_count};
    for (uint32_t i = 0; i < renderer->worker_count; i++) {
        if (renderer->workers[i].status != DF_OK) {
            if (err) *err = renderer->workers[i].error;
            return renderer->workers[i].status;
        }
        df_frame_stats_add(&sum, &renderer->workers[i].stats);
    }
    sum.begin_ms = begun - start;
    sum.frame_ms = df_now_ms() - start;
    if (stats) *stats = sum;
    return DF_OK;
}

df_status df_renderer_frame(df_renderer *renderer, const df_view *view, const df_picture *picture,
                            df_frame_stats *stats, df_error *err) {
    return df_renderer_rows(renderer, view, 0, view->height, picture, stats, err);
}

df_status df_count_entering(const df_view *view, uint64_t *entering, df_error *err) {
    df_rays rays;
    df_status status = df_rays_alloc(view->width, true, &rays, err);
    if (status != DF_OK) return status;
    *entering = 0;
    for (uint32_t y = 0; y < view->height; y++) {
        df_view_rays(view, &df_kernels_scalar, 0, y, view->width, 1, &rays);
        *entering += df_rays_entering(&rays, view->box);
    }
    df_rays_free(&rays);
    return DF_OK;
}
