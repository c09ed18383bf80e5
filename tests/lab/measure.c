#include "measure.h"

#include <inttypes.h>
#include <math.h>
#include <omp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHUNK_RAYS 2048u

void lab_histogram_add(lab_histogram *histogram, double value) {
    histogram->count++;
    histogram->max = fmax(histogram->max, value);
    double bin = floor((log10(value) + 18) * 50);
    if (!(bin >= 0)) histogram->zeros++;
    else histogram->bins[bin < LAB_BIN_COUNT ? (int)bin : LAB_BIN_COUNT - 1]++;
}

void lab_histogram_merge(lab_histogram *into, const lab_histogram *from) {
    into->count += from->count;
    into->zeros += from->zeros;
    into->max = fmax(into->max, from->max);
    for (int i = 0; i < LAB_BIN_COUNT; i++) into->bins[i] += from->bins[i];
}

double lab_histogram_quantile(const lab_histogram *histogram, double part) {
    double wanted = part * (double)histogram->count, sum = (double)histogram->zeros;
    if (sum >= wanted) return 0;
    for (int i = 0; i < LAB_BIN_COUNT; i++) {
        sum += (double)histogram->bins[i];
        if (sum >= wanted) return fmin(histogram->max, pow(10, (i + 1) / 50.0 - 18));
    }
    return histogram->max;
}

static void keep_failure(lab_score *score, uint64_t ray, lab_failure_kind kind) {
    uint32_t at = score->failure_count < LAB_FAILURES_KEPT ? score->failure_count++ : LAB_FAILURES_KEPT;
    if (at == LAB_FAILURES_KEPT) {
        for (uint32_t i = 0, largest = 0; i < LAB_FAILURES_KEPT; i++) {
            if (score->failures[i].ray >= score->failures[largest].ray) largest = at = i;
        }
        if (score->failures[at].ray <= ray) return;
    }
    score->failures[at] = (struct lab_failure){ray, kind};
}

void lab_score_merge(lab_score *into, const lab_score *from) {
    into->rays += from->rays;
    into->tangent += from->tangent;
    into->true_positive += from->true_positive;
    into->false_positive += from->false_positive;
    into->false_negative += from->false_negative;
    into->true_negative += from->true_negative;
    into->leaks += from->leaks;
    into->wrong_face += from->wrong_face;
    lab_histogram_merge(&into->depth, &from->depth);
    lab_histogram_merge(&into->residual, &from->residual);
    for (uint32_t i = 0; i < from->failure_count; i++)
        keep_failure(into, from->failures[i].ray, from->failures[i].kind);
}

void lab_score_pair(lab_score *score, uint64_t ray, const df_truth *truth, bool hit, double off) {
    score->rays++;
    if (truth->tangent) score->tangent++;
    else if (hit != truth->hit) {
        score->false_positive += hit;
        score->false_negative += truth->hit;
        keep_failure(score, ray, hit ? LAB_FALSE_POSITIVE : LAB_FALSE_NEGATIVE);
    } else if (!hit) score->true_negative++;
    else {
        score->true_positive++;
        lab_histogram_add(&score->depth, off);
        if (off <= LAB_LEAK_VOXELS) return;
        score->leaks++;
        keep_failure(score, ray, LAB_LEAK);
    }
}

uint64_t lab_score_errors(const lab_score *score) {
    return score->false_positive + score->false_negative + score->leaks + score->wrong_face;
}

/* A chunk of rays as a tracer takes them, and what it answers. */
typedef struct chunk {
    df_rays rays;
    df_hits hits;
    uint32_t hit_of[CHUNK_RAYS]; /* by ray: the number of its hit, UINT32_MAX for none */
    uint64_t number[CHUNK_RAYS]; /* by ray: its index in the family */
} chunk;

static df_status chunk_open(chunk **out, df_error *err) {
    *out = calloc(1, sizeof **out);
    if (!*out) return df_fail(err, DF_ERROR_MEMORY, "no memory for rays");
    df_status status = df_rays_alloc(CHUNK_RAYS, true, &(*out)->rays, err);
    return status == DF_OK ? df_hits_alloc(CHUNK_RAYS, &(*out)->hits, err) : status;
}

static void chunk_close(chunk *c) {
    if (!c) return;
    df_rays_free(&c->rays);
    df_hits_free(&c->hits);
    free(c);
}

static void make_ray(const lab_run *run, uint64_t index, lab_known *ray) {
    const df_field *field = run->scene->field;
    ray->made = true;
    if (run->eye) lab_eye_ray(field, run->eye, run->seed, index, ray->origin, ray->direction);
    else ray->made = lab_family_ray(field, run->family, run->seed, index, ray->origin, ray->direction);
}

static void chunk_fill(chunk *c, const lab_run *run, uint64_t first, uint64_t end) {
    const uint32_t *voxels = run->scene->voxel_count;
    const double box[3] = {voxels[0], voxels[1], voxels[2]};
    c->rays.count = 0;
    for (uint64_t i = first; i < end; i++) {
        lab_known own = {0}, *known = run->known ? &run->known[i - run->first] : &own;
        double scale;
        if (!run->is_known) make_ray(run, i, known);
        if (!known->made) continue;
        if (!df_rays_set(&c->rays, c->rays.count, box, known->origin, known->direction, &scale)) continue;
        c->number[c->rays.count++] = i;
    }
    if (c->rays.count) df_rays_pad(&c->rays);
}

static df_status chunk_trace(chunk *c, const lab_run *run, void *state, df_error *err) {
    df_counters counters = {0};
    df_tile tile = {.width = c->rays.count, .height = 1, .rays = c->rays};
    c->hits.count = 0;
    df_status status = run->tracer->trace(state, (uint32_t)omp_get_thread_num(), &tile, &c->hits, &counters, err);
    memset(c->hit_of, 0xFF, sizeof c->hit_of);
    for (uint32_t i = 0; i < c->hits.count; i++) c->hit_of[c->hits.ray[i]] = i;
    return status;
}

static void judge(const lab_run *run, const chunk *c, uint32_t i, lab_score *score) {
    const uint32_t hit = c->hit_of[i], *voxels = run->scene->voxel_count;
    const double box[3] = {voxels[0], voxels[1], voxels[2]};
    double origin[3], direction[3], length = 0;
    df_truth truth;
    for (int a = 0; a < 3; a++) {
        origin[a] = (double)c->rays.origin[a][i];
        direction[a] = (double)c->rays.direction[a][i];
        length += direction[a] * direction[a];
    }
    lab_known *known = run->known ? &run->known[c->number[i] - run->first] : NULL;
    if (known && run->is_known) truth = known->truth;
    else if (run->mesh) lab_mesh_trace(run->mesh, origin, direction, &truth);
    else if (run->surface) lab_surface_trace(run->surface, box, origin, direction, &truth);
    else df_truth_trace(run->scene->field, run->scene->iso, origin, direction, &truth);
    if (known) known->truth = truth;
    score->rays++;
    if (truth.tangent) {
        score->tangent++;
    } else if (hit == UINT32_MAX) {
        score->false_negative += truth.hit;
        score->true_negative += !truth.hit;
        if (truth.hit) keep_failure(score, c->number[i], LAB_FALSE_NEGATIVE);
    } else if (!truth.hit) {
        score->false_positive++;
        keep_failure(score, c->number[i], LAB_FALSE_POSITIVE);
    } else {
        const double t = c->hits.t[hit] - c->rays.t_base[i];
        const double off = fabs((double)((df_quad)t - truth.t)) * sqrt(length);
        score->true_positive++;
        lab_histogram_add(&score->depth, off);
        if (!run->surface && !run->mesh)
            lab_histogram_add(&score->residual,
                              df_truth_residual(run->scene->field, run->scene->iso, origin, direction, t));
        if (!(off <= LAB_LEAK_VOXELS)) {
            score->leaks++;
            keep_failure(score, c->number[i], LAB_LEAK);
        } else if (((c->hits.flags[hit] & DF_HIT_BACK) != 0) != truth.back) {
            score->wrong_face++;
            keep_failure(score, c->number[i], LAB_WRONG_FACE);
        }
    }
}

typedef void chunk_visit(const lab_run *run, const chunk *c, void *result);

/* Traces all rays of a run; `visit` takes each chunk into its thread's own result, results[thread]. */
static df_status for_each_chunk(const lab_run *run, chunk_visit *visit, void **results, df_error *err) {
    const df_trace_options options = {.solve = run->solve,
                                      .steps = run->steps,
                                      .precision = run->precision,
                                      .threads = (uint32_t)omp_get_max_threads(),
                                      .tile_width = CHUNK_RAYS,
                                      .tile_height = 1,
                                      .kernels = run->kernels ? run->kernels : &df_kernels_scalar};
    const uint64_t chunk_count = (run->count + CHUNK_RAYS - 1) / CHUNK_RAYS;
    void *state;
    df_status status = run->tracer->prepare(run->scene, &options, &state, err);
    if (status != DF_OK) return status;
#pragma omp parallel
    {
        chunk *mine;
        df_error error;
        df_status own = chunk_open(&mine, &error);
#pragma omp for schedule(dynamic)
        for (uint64_t n = 0; n < chunk_count; n++) {
            const uint64_t first = run->first + n * CHUNK_RAYS, last = run->first + run->count;
            if (own != DF_OK) continue;
            chunk_fill(mine, run, first, first + CHUNK_RAYS < last ? first + CHUNK_RAYS : last);
            if (mine->rays.count == 0) continue;
            own = chunk_trace(mine, run, state, &error);
            if (own == DF_OK) visit(run, mine, results[omp_get_thread_num()]);
        }
#pragma omp critical
        if (own != DF_OK) {
            status = own;
            if (err) *err = error;
        }
        chunk_close(mine);
    }
    run->tracer->release(state);
    return status;
}

static void judge_chunk(const lab_run *run, const chunk *c, void *result) {
    for (uint32_t i = 0; i < c->rays.count; i++) judge(run, c, i, result);
}

df_status lab_measure(const lab_run *run, lab_score *score, df_error *err) {
    const int threads = omp_get_max_threads();
    lab_score *scores = calloc((size_t)threads, sizeof *scores);
    void **results = calloc((size_t)threads, sizeof *results);
    df_status status = scores && results ? DF_OK : df_fail(err, DF_ERROR_MEMORY, "no memory for scores");
    for (int i = 0; i < threads && status == DF_OK; i++) results[i] = &scores[i];
    if (status == DF_OK) status = for_each_chunk(run, judge_chunk, results, err);
    for (int i = 0; i < threads && status == DF_OK; i++) lab_score_merge(score, &scores[i]);
    free(scores);
    free(results);
    return status;
}

static void keep_escape(lab_escapes *escapes, lab_escape escape) {
    uint32_t at = escapes->kept_count < LAB_FAILURES_KEPT ? escapes->kept_count++ : LAB_FAILURES_KEPT;
    if (at == LAB_FAILURES_KEPT) {
        for (uint32_t i = 0, largest = 0; i < LAB_FAILURES_KEPT; i++) {
            if (escapes->kept[i].ray >= escapes->kept[largest].ray) largest = at = i;
        }
        if (escapes->kept[at].ray <= escape.ray) return;
    }
    escapes->kept[at] = escape;
}

void lab_escapes_judge(lab_escapes *escapes, const df_scene *scene, lab_escape escape) {
    df_truth truth;
    df_truth_trace(scene->field, scene->iso, escape.origin, escape.direction, &truth);
    escape.tangent = truth.tangent;
    escape.true_hit = truth.hit ? (double)truth.t : -1;
    if (truth.tangent) escapes->tangent++;
    else escapes->count++;
    keep_escape(escapes, escape);
}

static void count_chunk(const lab_run *run, const chunk *c, void *result) {
    lab_escapes *sum = result;
    sum->rays += c->rays.count;
    for (uint32_t i = 0; i < c->rays.count; i++) {
        if (c->hit_of[i] != UINT32_MAX) continue;
        lab_escape escape = {.ray = c->number[i]};
        for (int a = 0; a < 3; a++) {
            escape.origin[a] = (double)c->rays.origin[a][i];
            escape.direction[a] = (double)c->rays.direction[a][i];
        }
        lab_escapes_judge(sum, run->scene, escape);
    }
}

static int compare_escapes(const void *a, const void *b) {
    const uint64_t x = ((const lab_escape *)a)->ray, y = ((const lab_escape *)b)->ray;
    return (x > y) - (x < y);
}

void lab_escapes_merge(lab_escapes *into, const lab_escapes *from) {
    into->rays += from->rays;
    into->count += from->count;
    into->tangent += from->tangent;
    for (uint32_t i = 0; i < from->kept_count; i++) keep_escape(into, from->kept[i]);
}

void lab_escapes_sort(lab_escapes *escapes) {
    qsort(escapes->kept, escapes->kept_count, sizeof *escapes->kept, compare_escapes);
}

df_status lab_count_escapes(const lab_run *run, lab_escapes *escapes, df_error *err) {
    const int threads = omp_get_max_threads();
    lab_escapes *sums = calloc((size_t)threads, sizeof *sums);
    void **results = calloc((size_t)threads, sizeof *results);
    df_status status = sums && results ? DF_OK : df_fail(err, DF_ERROR_MEMORY, "no memory for counts");
    for (int i = 0; i < threads && status == DF_OK; i++) results[i] = &sums[i];
    if (status == DF_OK) status = for_each_chunk(run, count_chunk, results, err);
    memset(escapes, 0, sizeof *escapes);
    for (int i = 0; i < threads && status == DF_OK; i++) lab_escapes_merge(escapes, &sums[i]);
    lab_escapes_sort(escapes);
    free(sums);
    free(results);
    return status;
}

void lab_print_failures(const lab_run *run, const lab_score *score) {
    static const char *const names[] = {"false positive", "false negative", "leak", "wrong face"};
    for (uint32_t i = 0; i < score->failure_count; i++) {
        double o[3], d[3];
        lab_family_ray(run->scene->field, run->family, run->seed, score->failures[i].ray, o, d);
        printf("%s: %s, solve %s %s, family %s, ray %" PRIu64 ": from %.17g %.17g %.17g along %.17g %.17g %.17g\n",
               run->tracer->name, names[score->failures[i].kind], df_solve_names[run->solve],
               df_precision_names[run->precision], lab_family_names[run->family], score->failures[i].ray, o[0], o[1],
               o[2], d[0], d[1], d[2]);
    }
}
