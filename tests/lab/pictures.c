#include "commands.h"
#include "common/field_file.h"
#include "common/image.h"
#include "common/memory.h"
#include "common/options.h"
#include "mesh_truth.h"
#include "render/frame.h"
#include "render/methods/solve_methods.h"
#include "render/settings.h"
#include "subject.h"
#include "view_ray.h"
#include "view_truth.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

df_status lab_command_field(int argc, char **argv, df_error *err) {
    lab_surface surface;
    df_field field = {0};
    df_status status = lab_field_make(argv[0], (uint32_t)atoi(argv[1]), argc > 3 ? atof(argv[3]) : 0, DF_FIELD_BRICKS,
                                      &surface, &field, err);
    if (status == DF_OK) status = df_field_write(&field, argv[2], err);
    df_field_free(&field);
    return status;
}

/* The colour of an error: from blue for 1e-6 voxel and less by green to red for 1 and more; misses that are wrong are
 * magenta, hits that are wrong white, the background is grey. */
static void error_colour(double error, uint8_t rgb[3]) {
    const double s = fmin(1, fmax(0, (log10(fmax(error, 1e-9)) + 6) / 6));
    rgb[0] = (uint8_t)(255 * fmin(1, fmax(0, 2 * s - 0.5)));
    rgb[1] = (uint8_t)(255 * fmax(0, 1 - fabs(2 * s - 1)));
    rgb[2] = (uint8_t)(255 * fmax(0, 1 - 2 * s));
}

enum { MAP_SIZE = 320, MAP_PIXELS = MAP_SIZE * MAP_SIZE };

/* A view of a field, and what is really to be seen there. */
typedef struct map {
    lab_surface surface;
    df_field field;
    df_scene scene;
    df_view view;
    lab_known *pixels;
    float *drawn; /* depths, as a solve has them */
    uint8_t *rgb;
} map;

static df_status map_open(map *m, const char *shape, uint32_t size, double parameter, df_error *err) {
    const df_scene_options options = {0};
    df_camera camera;
    *m = (map){.pixels = calloc(MAP_PIXELS, sizeof(lab_known)),
               .drawn = malloc(sizeof(float) * MAP_PIXELS),
               .rgb = malloc(3 * MAP_PIXELS)};
    if (!m->pixels || !m->drawn || !m->rgb) return df_fail(err, DF_ERROR_MEMORY, "no memory for a picture");
    df_status status = lab_field_make(shape, size, parameter, DF_FIELD_BRICKS, &m->surface, &m->field, err);
    if (status == DF_OK) status = df_scene_prepare(&m->field, 0, &options, &m->scene, err);
    if (status != DF_OK) return status;
    df_camera_orbit(&m->field, 30, 20, 1.6, &camera);
    camera.fov_y = 0.75;
    status = df_view_make(&camera, &m->field, MAP_SIZE, MAP_SIZE, &m->view, err);
    return status == DF_OK ? lab_view_truths(&m->scene, &m->view, m->pixels, err) : status;
}

static void map_close(map *m) {
    df_scene_free(&m->scene);
    df_field_free(&m->field);
    free(m->pixels);
    free(m->drawn);
    free(m->rgb);
}

static df_status map_draw(map *m, int solve, const char *path, df_error *err) {
    const df_frame_options frame = {.tracer = &df_tracer_dda, .solve = solve, .tile = 64, .threads = 1};
    const df_picture picture = {.width = MAP_SIZE, .height = MAP_SIZE, .depth = m->drawn};
    df_renderer *renderer = NULL;
    df_status status = df_renderer_open(&m->scene, &frame, MAP_SIZE, MAP_SIZE, &renderer, err);
    if (status == DF_OK) status = df_renderer_frame(renderer, &m->view, &picture, NULL, err);
    df_renderer_close(renderer);
    if (status != DF_OK) return status;
    for (size_t i = 0; i < MAP_PIXELS; i++) {
        const double depth = lab_known_depth(&m->field, &m->pixels[i]);
        const bool hit = isfinite(m->drawn[i]), exists = m->pixels[i].truth.hit;
        uint8_t *c = m->rgb + 3 * i;
        if (!hit && !exists) memset(c, 120, 3);
        else if (!hit) c[0] = 255, c[1] = 0, c[2] = 255;
        else if (!exists) memset(c, 255, 3);
        else error_colour(fabs((double)m->drawn[i] - depth), c);
    }
    return df_image_write_png(path, m->rgb, MAP_SIZE, MAP_SIZE, NULL, 0, err);
}

df_status lab_command_maps(int argc, char **argv, df_error *err) {
    map m;
    df_status status = map_open(&m, argv[0], (uint32_t)atoi(argv[1]), argc > 3 ? atof(argv[3]) : 0, err);
    for (int solve = 0; solve < DF_SOLVE_COUNT && status == DF_OK; solve++) {
        char path[1024];
        snprintf(path, sizeof path, "%s-%s-error.png", argv[2], df_solve_names[solve]);
        status = map_draw(&m, solve, path, err);
    }
    map_close(&m);
    return status;
}

/* The depth image of a mesh, in double, one ray after the other. */
static df_status trace_mesh(const lab_mesh *mesh, const df_field *field, const df_camera *camera, const df_view *view,
                            float *depth, df_error *err) {
    df_rays rays;
    df_status status = df_rays_alloc(view->width, true, &rays, err);
    for (uint32_t y = 0; y < view->height && status == DF_OK; y++) {
        df_view_rays(view, &df_kernels_scalar, 0, y, view->width, 1, &rays);
#pragma omp parallel for schedule(dynamic, 64)
        for (uint32_t x = 0; x < view->width; x++) {
            double o[3], d[3], at[3], world[3], square = 0;
            df_truth truth;
            lab_view_ray(&rays, x, o, d);
            lab_mesh_trace(mesh, o, d, &truth);
            for (int a = 0; a < 3; a++) at[a] = o[a] + (double)truth.t * d[a];
            df_field_grid_to_world(field, at, world);
            for (int a = 0; a < 3; a++) square += (world[a] - camera->eye[a]) * (world[a] - camera->eye[a]);
            depth[(size_t)y * view->width + x] = truth.hit ? (float)sqrt(square) : INFINITY;
        }
    }
    if (status == DF_OK) df_rays_free(&rays);
    return status;
}

df_status lab_command_depth(int argc, char **argv, df_error *err) {
    (void)argc;
    df_settings settings;
    df_field field = {0};
    df_camera camera;
    df_view view;
    lab_mesh *mesh = NULL;
    float *depth = NULL;
    df_settings_defaults(&settings);
    df_status status = df_parse_u32("WIDTH", argv[2], 1, 16384, &settings.width, err);
    if (status == DF_OK) status = df_parse_u32("HEIGHT", argv[3], 1, 16384, &settings.height, err);
    if (status == DF_OK) status = df_field_read(argv[0], DF_READ_COPY, &field, err);
    if (status == DF_OK) status = df_settings_camera(&settings, &field, &camera, err);
    if (status == DF_OK) status = df_view_make(&camera, &field, settings.width, settings.height, &view, err);
    if (status == DF_OK) status = lab_mesh_read(argv[1], &field, &mesh, err);
    if (status == DF_OK)
        status = df_alloc_raw((void **)&depth, (uint64_t)view.width * view.height, sizeof *depth, "picture", err);
    if (status == DF_OK) status = trace_mesh(mesh, &field, &camera, &view, depth, err);
    if (status == DF_OK) status = df_image_write_float(argv[4], depth, view.width, view.height, 1, err);
    lab_mesh_free(mesh);
    df_field_free(&field);
    free(depth);
    return status;
}
