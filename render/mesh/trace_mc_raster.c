/*
 * The marching-cubes mesh drawn as triangles by OpenGL, through EGL and without a window: hardware where there is one,
 * Mesa's llvmpipe otherwise. A vertex's clip coordinate w is the parameter t of the rays through it, so that 1 /
 * gl_FragCoord.w is a pixel's t; it goes to a float target with the normal. The depth buffer only hides surfaces and is
 * not read.
 */
#include "common/memory.h"
#include "render/gl/context.h"
#include "render/mesh/mc_model.h"

#include <math.h>
#include <stdlib.h>

typedef struct raster_state {
    const df_scene *scene;
    df_mc_model model;
    df_gl gl;
    GLuint program, vertex_array, buffers[3];
    uint32_t first_row, view_width;
    float *pixels; /* normal and t, rows from first_row on; t = 0: nothing */
    uint64_t pixel_capacity;
} raster_state;

static const char vertex_text[] = "#version 330 core\n"
                                  "layout(location = 0) in vec3 position;\n"
                                  "layout(location = 1) in vec3 normal;\n"
                                  "uniform vec3 eye;\n"
                                  "uniform mat4 projection;\n" /* from position - eye to clip space */
                                  "out vec3 surface_normal;\n"
                                  "void main() {\n"
                                  "    surface_normal = normal;\n"
                                  "    gl_Position = projection * vec4(position - eye, 1.0);\n"
                                  "}\n";
static const char fragment_text[] =
    "#version 330 core\n"
    "in vec3 surface_normal;\n"
    "out vec4 pixel;\n"
    "void main() {\n"
    "    pixel = vec4(surface_normal, (gl_FrontFacing ? -1.0 : 1.0) / gl_FragCoord.w);\n" /* y runs down: fronts turn */
    "}\n";

static df_status upload(raster_state *state, df_error *err) {
    const df_mc_model *model = &state->model;
    df_status status = df_gl_program(&state->gl, vertex_text, fragment_text, &state->program, err);
    if (status != DF_OK) return status;
    glGenVertexArrays(1, &state->vertex_array);
    glBindVertexArray(state->vertex_array);
    glGenBuffers(3, state->buffers);
    const float *attributes[2] = {model->positions, model->normals};
    for (GLuint i = 0; i < 2; i++) {
        glBindBuffer(GL_ARRAY_BUFFER, state->buffers[i]);
        glBufferData(GL_ARRAY_BUFFER, (GLsizeiptr)(model->vertex_count * 3 * sizeof(float)), attributes[i],
                     GL_STATIC_DRAW);
        glVertexAttribPointer(i, 3, GL_FLOAT, GL_FALSE, 0, NULL);
        glEnableVertexAttribArray(i);
    }
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, state->buffers[2]);
    glBufferData(GL_ELEMENT_ARRAY_BUFFER, (GLsizeiptr)(model->triangle_count * 3 * sizeof(uint32_t)), model->triangles,
                 GL_STATIC_DRAW);
    if (glGetError() != GL_NO_ERROR)
        return df_fail(err, DF_ERROR_MEMORY, "--tracer mc-raster: OpenGL has no room for %u triangles",
                       model->triangle_count);
    return DF_OK;
}

static void raster_release(void *opaque) {
    raster_state *state = opaque;
    if (!state) return;
    df_gl_close(&state->gl);
    df_mc_model_free(&state->model);
    free(state->pixels);
    free(state);
}

static df_status raster_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    raster_state *state;
    *out = NULL;
    df_status status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status != DF_OK) return status;
    state->scene = scene;
    status = df_gl_open("--tracer mc-raster", &state->gl, err);
    if (status == DF_OK) status = df_mc_model_make(scene, options->threads, &state->model, err);
    if (status == DF_OK) status = df_gl_take(&state->gl, err);
    if (status == DF_OK) {
        status = upload(state, err);
        df_gl_leave(&state->gl);
    }
    if (status != DF_OK) {
        raster_release(state);
        return status;
    }
    *out = state;
    return DF_OK;
}

/* What OpenGL holds is not known; counted are the arrays here and their copies there. */
static uint64_t raster_bytes(const void *opaque) {
    return 2 * df_mc_model_bytes(&((const raster_state *)opaque)->model);
}

static double raster_extract_ms(const void *opaque) { return ((const raster_state *)opaque)->model.extract_ms; }

static df_status reserve(raster_state *state, uint64_t pixels, df_error *err) {
    if (pixels <= state->pixel_capacity) return DF_OK;
    free(state->pixels);
    state->pixel_capacity = 0;
    df_status status = df_alloc_raw((void **)&state->pixels, pixels, 4 * sizeof(float), "picture", err);
    if (status == DF_OK) state->pixel_capacity = pixels;
    return status;
}

static df_status draw(raster_state *state, const df_view *view, uint32_t first_row, uint32_t row_count, df_error *err) {
    df_status status = reserve(state, (uint64_t)view->width * row_count, err);
    if (status == DF_OK) status = df_gl_resize(&state->gl, GL_RGBA32F, true, view->width, row_count, err);
    if (status != DF_OK) return status;
    float matrix[16];
    df_gl_clip_matrix(view, first_row, row_count, matrix);
    glViewport(0, 0, (GLsizei)view->width, (GLsizei)row_count);
    glClearColor(0, 0, 0, 0);
    glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
    glEnable(GL_DEPTH_TEST);
    glUseProgram(state->program);
    glUniform3f(glGetUniformLocation(state->program, "eye"), (float)view->eye[0], (float)view->eye[1],
                (float)view->eye[2]);
    glUniformMatrix4fv(glGetUniformLocation(state->program, "projection"), 1, GL_FALSE, matrix);
    glBindVertexArray(state->vertex_array);
    glDrawElements(GL_TRIANGLES, (GLsizei)(3 * state->model.triangle_count), GL_UNSIGNED_INT, NULL);
    return df_gl_read(&state->gl, GL_RGBA, state->pixels, err);
}

static df_status raster_begin(void *opaque, const df_view *view, uint32_t first_row, uint32_t row_count,
                              df_error *err) {
    raster_state *state = opaque;
    state->first_row = first_row;
    state->view_width = view->width;
    df_status status = df_gl_take(&state->gl, err);
    if (status != DF_OK) return status;
    status = draw(state, view, first_row, row_count, err);
    df_gl_leave(&state->gl);
    return status;
}

/* From far away a pixel's t would be too coarse: rays get an origin of their own then. */
static bool raster_suits(const df_scene *scene, const df_view *view) {
    (void)scene;
    return view && !view->rebase;
}

static df_status raster_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                              df_error *err) {
    (void)thread;
    (void)counters;
    (void)err;
    const raster_state *state = opaque;
    hits->has_normals = true;
    for (uint32_t y = 0; y < tile->height; y++) {
        for (uint32_t x = 0; x < tile->width; x++) {
            const float *pixel =
                state->pixels + 4 * ((uint64_t)(tile->y + y - state->first_row) * state->view_width + tile->x + x);
            if (pixel[3] != 0)
                df_mc_model_hit(state->scene, &tile->rays, x + tile->width * y, fabsf(pixel[3]), pixel, pixel[3] < 0,
                                hits);
        }
    }
    return DF_OK;
}

const df_tracer df_tracer_mc_raster = {
    .name = "mc-raster",
    .own_methods = true,
    .summary = "the marching-cubes mesh, rasterised by OpenGL: for comparison",
    .prepare = raster_prepare,
    .release = raster_release,
    .bytes = raster_bytes,
    .extract_ms = raster_extract_ms,
    .suits = raster_suits,
    .begin_frame = raster_begin,
    .trace = raster_trace,
};
