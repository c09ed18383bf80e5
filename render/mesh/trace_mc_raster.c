/*
 * The marching-cubes mesh drawn as triangles by OpenGL, through EGL and without a window: hardware where there is one,
 * Mesa's llvmpipe otherwise. A vertex's clip coordinate w is the parameter t of the rays through it, so that 1 /
 * gl_FragCoord.w is a pixel's t; it goes to a float target with the normal. The depth buffer only hides surfaces and is
 * not read.
 */
#include "common/memory.h"
#include "render/mesh/mc_model.h"

#define GL_GLEXT_PROTOTYPES
#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <GL/gl.h>
#include <GL/glext.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct raster_state {
    const df_scene *scene;
    df_mc_model model;
    EGLDisplay display;
    EGLContext context;
    GLuint program, vertex_array, buffers[3];
    GLuint frame_buffer, target, depth;
    uint32_t width, height; /* of the targets */
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

static df_status open_context(raster_state *state, df_error *err) {
    static const char *const what = "--tracer mc-raster: EGL offers no OpenGL without a window";
    const EGLint context_attributes[] = {
        EGL_CONTEXT_MAJOR_VERSION,           3,       EGL_CONTEXT_MINOR_VERSION, 3, EGL_CONTEXT_OPENGL_PROFILE_MASK,
        EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL_NONE};
    const EGLint config_attributes[] = {EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_SURFACE_TYPE, EGL_PBUFFER_BIT,
                                        EGL_NONE};
    EGLConfig config;
    EGLint count = 0;
    state->display = eglGetPlatformDisplay(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL);
    if (state->display == EGL_NO_DISPLAY) state->display = eglGetDisplay(EGL_DEFAULT_DISPLAY);
    if (state->display == EGL_NO_DISPLAY || !eglInitialize(state->display, NULL, NULL)) {
        state->display = EGL_NO_DISPLAY;
        return df_fail(err, DF_ERROR_UNSUPPORTED, "%s (no display)", what);
    }
    if (!eglBindAPI(EGL_OPENGL_API) || !eglChooseConfig(state->display, config_attributes, &config, 1, &count) ||
        count < 1) {
        return df_fail(err, DF_ERROR_UNSUPPORTED, "%s (no configuration, EGL error 0x%x)", what,
                       (unsigned)eglGetError());
    }
    state->context = eglCreateContext(state->display, config, EGL_NO_CONTEXT, context_attributes);
    if (state->context == EGL_NO_CONTEXT)
        return df_fail(err, DF_ERROR_UNSUPPORTED, "%s (no context of version 3.3, EGL error 0x%x)", what,
                       (unsigned)eglGetError());
    return DF_OK;
}

/* A context belongs to one thread at a time: each call that draws takes it and leaves it. */
static bool take(const raster_state *state) {
    return eglMakeCurrent(state->display, EGL_NO_SURFACE, EGL_NO_SURFACE, state->context);
}
static void leave(const raster_state *state) {
    eglMakeCurrent(state->display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
}

static df_status add_shader(GLuint program, GLenum type, const char *text, df_error *err) {
    GLuint shader = glCreateShader(type);
    GLint compiled = 0;
    char log[512] = "";
    glShaderSource(shader, 1, &text, NULL);
    glCompileShader(shader);
    glGetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
    if (!compiled) glGetShaderInfoLog(shader, sizeof log, NULL, log);
    glAttachShader(program, shader);
    glDeleteShader(shader);
    return compiled ? DF_OK
                    : df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer mc-raster: OpenGL refuses a shader: %.300s", log);
}

static df_status upload(raster_state *state, df_error *err) {
    const df_mc_model *model = &state->model;
    GLint linked = 0;
    state->program = glCreateProgram();
    df_status status = add_shader(state->program, GL_VERTEX_SHADER, vertex_text, err);
    if (status == DF_OK) status = add_shader(state->program, GL_FRAGMENT_SHADER, fragment_text, err);
    if (status != DF_OK) return status;
    glLinkProgram(state->program);
    glGetProgramiv(state->program, GL_LINK_STATUS, &linked);
    if (!linked) return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer mc-raster: OpenGL does not link the shaders");
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
    glGenFramebuffers(1, &state->frame_buffer);
    glGenRenderbuffers(1, &state->target);
    glGenRenderbuffers(1, &state->depth);
    if (glGetError() != GL_NO_ERROR)
        return df_fail(err, DF_ERROR_MEMORY, "--tracer mc-raster: OpenGL has no room for %u triangles",
                       model->triangle_count);
    return DF_OK;
}

static void raster_release(void *opaque) {
    raster_state *state = opaque;
    if (!state) return;
    if (state->context != EGL_NO_CONTEXT) eglDestroyContext(state->display, state->context);
    if (state->display != EGL_NO_DISPLAY) eglTerminate(state->display);
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
    state->display = EGL_NO_DISPLAY;
    state->context = EGL_NO_CONTEXT;
    status = open_context(state, err);
    if (status == DF_OK) status = df_mc_model_make(scene, options->threads, &state->model, err);
    if (status == DF_OK && !take(state))
        status = df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer mc-raster: EGL offers no context without a surface");
    if (status == DF_OK) {
        status = upload(state, err);
        leave(state);
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

/* The inverse of the matrix with the given columns, as rows: a point eye + w * (direction through pixel (x,y)) has rows
 * * (point - eye) = (w, w x, w y). */
static void projection_rows(const df_view *view, double rows[3][3]) {
    const double *m[3] = {view->corner, view->right, view->down};
    double determinant = 0;
    for (int i = 0; i < 3; i++) {
        const double *u = m[(i + 1) % 3], *v = m[(i + 2) % 3];
        for (int a = 0; a < 3; a++) rows[i][a] = u[(a + 1) % 3] * v[(a + 2) % 3] - u[(a + 2) % 3] * v[(a + 1) % 3];
    }
    for (int a = 0; a < 3; a++) determinant += m[0][a] * rows[0][a];
    for (int i = 0; i < 9; i++) rows[i / 3][i % 3] /= determinant;
}

/* Clip space so that pixel centres are window coordinates plus a half and w is t; rows of the picture run upwards in
 * the target. */
static void clip_matrix(const df_view *view, uint32_t first_row, uint32_t row_count, float column_major[16]) {
    double rows[3][3], far = 0, near = INFINITY, clip[4][4] = {{0}};
    projection_rows(view, rows);
    for (int c = 0; c < 8; c++) {
        double w = 0;
        for (int a = 0; a < 3; a++) w += rows[0][a] * ((c >> a & 1 ? view->box[a] : 0) - view->eye[a]);
        far = fmax(far, w);
        near = fmin(near, w);
    }
    far *= 1.001;
    near = fmax(near * 0.999, 1e-4 * far);
    for (int a = 0; a < 3; a++) {
        clip[0][a] = 2.0 / view->width * rows[1][a] + (1.0 / view->width - 1) * rows[0][a];
        clip[1][a] = 2.0 / row_count * (rows[2][a] - first_row * rows[0][a]) + (1.0 / row_count - 1) * rows[0][a];
        clip[2][a] = (far + near) / (far - near) * rows[0][a];
        clip[3][a] = rows[0][a];
    }
    clip[2][3] = -2 * far * near / (far - near);
    for (int i = 0; i < 16; i++) column_major[i] = (float)clip[i % 4][i / 4];
}

static df_status resize(raster_state *state, uint32_t width, uint32_t height, df_error *err) {
    if (state->width == width && state->height == height) return DF_OK;
    const uint64_t pixels = (uint64_t)width * height;
    if (pixels > state->pixel_capacity) {
        free(state->pixels);
        state->pixel_capacity = 0;
        df_status status = df_alloc_raw((void **)&state->pixels, pixels, 4 * sizeof(float), "picture", err);
        if (status != DF_OK) return status;
        state->pixel_capacity = pixels;
    }
    glBindRenderbuffer(GL_RENDERBUFFER, state->target);
    glRenderbufferStorage(GL_RENDERBUFFER, GL_RGBA32F, (GLsizei)width, (GLsizei)height);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER, state->target);
    glBindRenderbuffer(GL_RENDERBUFFER, state->depth);
    glRenderbufferStorage(GL_RENDERBUFFER, GL_DEPTH_COMPONENT32F, (GLsizei)width, (GLsizei)height);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_RENDERBUFFER, state->depth);
    if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
        return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer mc-raster: OpenGL has no float target of %ux%u pixels",
                       width, height);
    }
    state->width = width;
    state->height = height;
    return DF_OK;
}

static df_status draw(raster_state *state, const df_view *view, uint32_t first_row, uint32_t row_count, df_error *err) {
    glBindFramebuffer(GL_FRAMEBUFFER, state->frame_buffer);
    df_status status = resize(state, view->width, row_count, err);
    if (status != DF_OK) return status;
    float matrix[16];
    clip_matrix(view, first_row, row_count, matrix);
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
    glReadBuffer(GL_COLOR_ATTACHMENT0);
    glReadPixels(0, 0, (GLsizei)view->width, (GLsizei)row_count, GL_RGBA, GL_FLOAT, state->pixels);
    const GLenum error = glGetError();
    if (error != GL_NO_ERROR)
        return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer mc-raster: OpenGL fails with error 0x%x", (unsigned)error);
    return DF_OK;
}

static df_status raster_begin(void *opaque, const df_view *view, uint32_t first_row, uint32_t row_count,
                              df_error *err) {
    raster_state *state = opaque;
    state->first_row = first_row;
    state->view_width = view->width;
    if (!take(state))
        return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer mc-raster: EGL offers no context without a surface");
    df_status status = draw(state, view, first_row, row_count, err);
    leave(state);
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
    .draws_mesh = true,
    .summary = "the marching-cubes mesh, rasterised by OpenGL: for comparison",
    .prepare = raster_prepare,
    .release = raster_release,
    .bytes = raster_bytes,
    .suits = raster_suits,
    .begin_frame = raster_begin,
    .trace = raster_trace,
};
