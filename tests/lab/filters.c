#include "filters.h"
#include "common/field_file.h"
#include "fields.h"
#include "measure.h"
#include "render/methods/filter.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { RAYS = 20000, SEED = 1 };

/* A dense field, and what it was made from: a surface, or a mesh. */
typedef struct subject {
    char name[64];
    df_field field;
    df_scene scene;
    lab_surface surface;
    lab_mesh *mesh;
} subject;

typedef struct errors {
    uint64_t wrong; /* false hits and misses */
    lab_histogram depth, normal;
} errors;

/* A way to make hits and normals of a field. */
typedef struct way {
    const char *name;
    const df_tracer *tracer;
    int filter, gradient;
} way;
static const way ways[] = {
    {"trilinear, analytic", &df_tracer_dda, DF_FILTER_TRILINEAR, DF_GRADIENT_ANALYTIC},
    {"trilinear, corner-central", &df_tracer_dda, DF_FILTER_TRILINEAR, DF_GRADIENT_CORNER_CENTRAL},
    {"trilinear, c0", &df_tracer_dda, DF_FILTER_TRILINEAR, DF_GRADIENT_C0},
    {"trilinear, crease", &df_tracer_dda, DF_FILTER_TRILINEAR, DF_GRADIENT_CREASE},
    {"catmull-rom", &df_tracer_tricubic, DF_FILTER_CATMULL_ROM, 0},
    {"b-spline", &df_tracer_tricubic, DF_FILTER_B_SPLINE, 0}};
enum { WAY_COUNT = sizeof ways / sizeof ways[0] };

/* ---- one field ---- */

static void find_truth(const subject *s, const double origin[3], const double direction[3], df_truth *truth,
                       double normal[3]) {
    const double box[3] = {s->field.voxel_count[0], s->field.voxel_count[1], s->field.voxel_count[2]};
    double p[3];
    if (s->mesh) lab_mesh_trace(s->mesh, origin, direction, truth);
    else lab_surface_trace(&s->surface, box, origin, direction, truth);
    if (!truth->hit) return;
    for (int a = 0; a < 3; a++) p[a] = origin[a] + (double)truth->t * direction[a];
    if (s->mesh) lab_mesh_normal(s->mesh, truth->triangle, normal);
    else lab_surface_gradient(&s->surface, p, normal);
}

/* The direction of the normal at a hit, in grid space. */
static void hit_normal(const subject *s, const way *w, const df_hits *hits, uint32_t i, double normal[3]) {
    if (hits->has_normals) {
        for (int a = 0; a < 3; a++) normal[a] = (double)hits->normal[a][i] * s->field.voxel_size[a];
        return;
    }
    const uint32_t voxel[3] = {hits->cell[0][i], hits->cell[1][i], hits->cell[2][i]};
    const float local[3] = {hits->local[0][i], hits->local[1][i], hits->local[2][i]};
    float stencil[64], gradient[3], inverse_step[3];
    for (int a = 0; a < 3; a++) inverse_step[a] = (float)(1 / s->field.voxel_size[a]);
    df_scene_stencil(&s->scene, voxel, hits->block[i], DF_REACH_ALL, stencil, 1);
    df_gradient(w->gradient, stencil, local, inverse_step, gradient);
    for (int a = 0; a < 3; a++) normal[a] = (double)gradient[a];
}

static double angle_degrees(const double a[3], const double b[3]) {
    double cosine = 0, sine = 0;
    for (int i = 0; i < 3; i++) {
        const int u = (i + 1) % 3, v = (i + 2) % 3;
        const double cross = a[u] * b[v] - a[v] * b[u];
        cosine += a[i] * b[i];
        sine += cross * cross;
    }
    return atan2(sqrt(sine), cosine) * 180 / M_PI;
}

/* Compares the hits of rays 0 .. count - 1 with the truth. */
static void judge(const subject *s, const way *w, const df_rays *rays, const df_hits *hits, errors *sum) {
    uint32_t *hit_of = malloc(rays->count * sizeof *hit_of);
    if (!hit_of) abort();
    memset(hit_of, 0xFF, rays->count * sizeof *hit_of);
    for (uint32_t i = 0; i < hits->count; i++) hit_of[hits->ray[i]] = i;
    for (uint32_t i = 0; i < rays->count; i++) {
        double origin[3], direction[3], exact[3], normal[3], length = 0;
        df_truth truth;
        for (int a = 0; a < 3; a++) {
            origin[a] = (double)rays->origin[a][i];
            direction[a] = (double)rays->direction[a][i];
            length += direction[a] * direction[a];
        }
        find_truth(s, origin, direction, &truth, exact);
        if (truth.tangent) continue;
        if (truth.hit != (hit_of[i] != UINT32_MAX)) sum->wrong++;
        if (!truth.hit || hit_of[i] == UINT32_MAX) continue;
        const double off = fabs(hits->t[hit_of[i]] - rays->t_base[i] - (double)truth.t) * sqrt(length);
        lab_histogram_add(&sum->depth, off);
        if (off > 1) continue; /* another part of the surface, with another normal */
        hit_normal(s, w, hits, hit_of[i], normal);
        lab_histogram_add(&sum->normal, angle_degrees(normal, exact));
    }
    free(hit_of);
}

static df_status make_rays(const subject *s, df_rays *rays, df_error *err) {
    const double box[3] = {s->field.voxel_count[0], s->field.voxel_count[1], s->field.voxel_count[2]};
    df_status status = df_rays_alloc(RAYS, true, rays, err);
    if (status != DF_OK) return status;
    for (uint64_t i = 0; i < RAYS; i++) {
        double origin[3], direction[3], scale;
        if (lab_family_ray(&s->field, LAB_CAMERA, SEED, i, origin, direction) &&
            df_rays_set(rays, rays->count, box, origin, direction, &scale))
            rays->count++;
    }
    df_rays_pad(rays);
    return DF_OK;
}

static df_status measure(const subject *s, const way *w, df_rays *rays, errors *sum, df_error *err) {
    const df_trace_options options = {.solve = DF_SOLVE_ROBUST,
                                      .filter = w->filter,
                                      .threads = 1,
                                      .tile_width = RAYS,
                                      .tile_height = 1,
                                      .kernels = &df_kernels_scalar};
    df_tile tile = {.width = rays->count, .height = 1, .rays = *rays};
    df_hits hits = {0};
    df_counters counters = {0};
    void *state = NULL;
    df_status status = df_hits_alloc(RAYS, &hits, err);
    if (status == DF_OK) status = w->tracer->prepare(&s->scene, &options, &state, err);
    if (status == DF_OK) status = w->tracer->trace(state, 0, &tile, &hits, &counters, err);
    if (status == DF_OK) judge(s, w, rays, &hits, sum);
    if (state) w->tracer->release(state);
    df_hits_free(&hits);
    return status;
}

static df_status measure_subject(const subject *s, df_error *err) {
    df_rays rays = {0};
    df_status status = make_rays(s, &rays, err);
    for (int i = 0; i < WAY_COUNT && status == DF_OK; i++) {
        errors *sum = calloc(1, sizeof *sum);
        if (!sum) return df_fail(err, DF_ERROR_MEMORY, "no memory for errors");
        status = measure(s, &ways[i], &rays, sum, err);
        if (status == DF_OK)
            printf("%-16s %-26s %9.5f %9.4f %9.4f %9.3f %9.3f %8.3f\n", s->name, ways[i].name,
                   lab_histogram_quantile(&sum->depth, 0.5), lab_histogram_quantile(&sum->depth, 0.99), sum->depth.max,
                   lab_histogram_quantile(&sum->normal, 0.5), lab_histogram_quantile(&sum->normal, 0.99),
                   100.0 * (double)sum->wrong / rays.count);
        free(sum);
    }
    df_rays_free(&rays);
    return status;
}

/* ---- the command ---- */

static df_status open_shape(subject *s, lab_shape shape, uint32_t size, df_error *err) {
    const uint32_t count[3] = {size, size, size};
    snprintf(s->name, sizeof s->name, "%s %u", lab_shape_names[shape], size);
    s->surface = lab_surface_make(shape, size, 0);
    return test_field_from_function(&s->field, DF_FIELD_DENSE, 0, count, s->surface.value, &s->surface, err);
}

static df_status open_mesh(subject *s, const char *name, df_error *err) {
    char path[1024];
    const char *mesh = strchr(name, ':'), *base;
    if (!mesh) return df_fail(err, DF_ERROR_USAGE, "%s: expected FIELD.dfield:MESH.obj", name);
    snprintf(path, sizeof path, "%.*s", (int)(mesh - name), name);
    base = strrchr(path, '/') ? strrchr(path, '/') + 1 : path;
    snprintf(s->name, sizeof s->name, "%.60s", base);
    df_status status = df_field_read(path, DF_READ_COPY, &s->field, err);
    return status == DF_OK ? lab_mesh_read(mesh + 1, &s->field, &s->mesh, err) : status;
}

/* Measures a subject that an opener has filled, and frees it. */
static df_status finish(subject *s, df_status status, df_error *err) {
    const df_scene_options options = {0};
    if (status == DF_OK) status = df_scene_prepare(&s->field, 0, &options, &s->scene, err);
    if (status == DF_OK) status = measure_subject(s, err);
    lab_mesh_free(s->mesh);
    df_scene_free(&s->scene);
    df_field_free(&s->field);
    return status;
}

df_status lab_command_filters(int argc, char **argv, df_error *err) {
    const lab_shape shapes[] = {LAB_SPHERE, LAB_TORUS, LAB_GYROID, LAB_ROTATED_BOX};
    const uint32_t sizes[] = {64, 128, 256};
    df_status status = DF_OK;
    printf("%-16s %-26s %9s %9s %9s %9s %9s %8s\n", "field", "filter, gradient", "depth p50", "p99", "max", "angle p50",
           "p99", "wrong %");
    for (int i = 0; i < argc && status == DF_OK; i++) {
        subject s = {0};
        status = finish(&s, open_mesh(&s, argv[i], err), err);
    }
    for (int i = 0; argc == 0 && i < 12 && status == DF_OK; i++) {
        subject s = {0};
        status = finish(&s, open_shape(&s, shapes[i / 3], sizes[i % 3], err), err);
    }
    return status;
}
