#include "render/gl/context.h"

#include <EGL/eglext.h>
#include <math.h>
#include <pthread.h>
#include <string.h>

/* eglTerminate ends a display for all who opened it: the last one does it. */
static pthread_mutex_t display_lock = PTHREAD_MUTEX_INITIALIZER;
static uint32_t display_users;

static df_status open_display(df_gl *gl, df_error *err) {
    gl->display = eglGetPlatformDisplay(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, NULL);
    if (gl->display == EGL_NO_DISPLAY) gl->display = eglGetDisplay(EGL_DEFAULT_DISPLAY);
    pthread_mutex_lock(&display_lock);
    const bool opened = gl->display != EGL_NO_DISPLAY && eglInitialize(gl->display, NULL, NULL);
    display_users += opened;
    pthread_mutex_unlock(&display_lock);
    if (opened) return DF_OK;
    gl->display = EGL_NO_DISPLAY;
    return df_fail(err, DF_ERROR_UNSUPPORTED, "%s: EGL offers no OpenGL without a window (no display)", gl->what);
}

df_status df_gl_open(const char *what, df_gl *gl, df_error *err) {
    const EGLint context_attributes[] = {
        EGL_CONTEXT_MAJOR_VERSION,           3,       EGL_CONTEXT_MINOR_VERSION, 3, EGL_CONTEXT_OPENGL_PROFILE_MASK,
        EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL_NONE};
    const EGLint config_attributes[] = {EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_SURFACE_TYPE, EGL_PBUFFER_BIT,
                                        EGL_NONE};
    EGLConfig config;
    EGLint count = 0;
    *gl = (df_gl){.display = EGL_NO_DISPLAY, .context = EGL_NO_CONTEXT, .what = what};
    df_status status = open_display(gl, err);
    if (status != DF_OK) return status;
    if (!eglBindAPI(EGL_OPENGL_API) || !eglChooseConfig(gl->display, config_attributes, &config, 1, &count) ||
        count < 1) {
        status = df_fail(err, DF_ERROR_UNSUPPORTED,
                         "%s: EGL offers no OpenGL without a window (no configuration, EGL error 0x%x)", what,
                         (unsigned)eglGetError());
    } else {
        gl->context = eglCreateContext(gl->display, config, EGL_NO_CONTEXT, context_attributes);
        if (gl->context == EGL_NO_CONTEXT)
            status = df_fail(err, DF_ERROR_UNSUPPORTED,
                             "%s: EGL offers no OpenGL without a window (no context of version 3.3, EGL error 0x%x)",
                             what, (unsigned)eglGetError());
    }
    if (status != DF_OK) df_gl_close(gl);
    return status;
}

void df_gl_close(df_gl *gl) {
    if (gl->context != EGL_NO_CONTEXT) eglDestroyContext(gl->display, gl->context);
    if (gl->display != EGL_NO_DISPLAY) {
        pthread_mutex_lock(&display_lock);
        if (--display_users == 0) eglTerminate(gl->display);
        pthread_mutex_unlock(&display_lock);
    }
    *gl = (df_gl){.display = EGL_NO_DISPLAY, .context = EGL_NO_CONTEXT};
}

df_status df_gl_take(const df_gl *gl, df_error *err) {
    if (eglMakeCurrent(gl->display, EGL_NO_SURFACE, EGL_NO_SURFACE, gl->context)) return DF_OK;
    return df_fail(err, DF_ERROR_UNSUPPORTED, "%s: EGL offers no context without a surface", gl->what);
}

void df_gl_leave(const df_gl *gl) { eglMakeCurrent(gl->display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT); }

static df_status add_shader(const df_gl *gl, GLuint program, GLenum type, const char *text, df_error *err) {
    GLuint shader = glCreateShader(type);
    GLint compiled = 0;
    char log[512] = "";
    glShaderSource(shader, 1, &text, NULL);
    glCompileShader(shader);
    glGetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
    if (!compiled) glGetShaderInfoLog(shader, sizeof log, NULL, log);
    glAttachShader(program, shader);
    glDeleteShader(shader);
    if (compiled) return DF_OK;
    return df_fail(err, DF_ERROR_UNSUPPORTED, "%s: OpenGL refuses a shader: %.300s", gl->what, log);
}

df_status df_gl_program(const df_gl *gl, const char *vertex, const char *fragment, GLuint *program, df_error *err) {
    GLint linked = 0;
    *program = glCreateProgram();
    df_status status = add_shader(gl, *program, GL_VERTEX_SHADER, vertex, err);
    if (status == DF_OK) status = add_shader(gl, *program, GL_FRAGMENT_SHADER, fragment, err);
    if (status != DF_OK) return status;
    glLinkProgram(*program);
    glGetProgramiv(*program, GL_LINK_STATUS, &linked);
    if (linked) return DF_OK;
    return df_fail(err, DF_ERROR_UNSUPPORTED, "%s: OpenGL does not link the shaders", gl->what);
}

df_status df_gl_resize(df_gl *gl, GLenum format, bool with_depth, uint32_t width, uint32_t height, df_error *err) {
    if (!gl->frame_buffer) {
        glGenFramebuffers(1, &gl->frame_buffer);
        glGenRenderbuffers(1, &gl->target);
        glGenRenderbuffers(1, &gl->depth);
    }
    glBindFramebuffer(GL_FRAMEBUFFER, gl->frame_buffer);
    if (gl->width == width && gl->height == height) return DF_OK;
    glBindRenderbuffer(GL_RENDERBUFFER, gl->target);
    glRenderbufferStorage(GL_RENDERBUFFER, format, (GLsizei)width, (GLsizei)height);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER, gl->target);
    if (with_depth) {
        glBindRenderbuffer(GL_RENDERBUFFER, gl->depth);
        glRenderbufferStorage(GL_RENDERBUFFER, GL_DEPTH_COMPONENT32F, (GLsizei)width, (GLsizei)height);
        glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_RENDERBUFFER, gl->depth);
    }
    if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
        return df_fail(err, DF_ERROR_UNSUPPORTED, "%s: OpenGL has no float target of %ux%u pixels", gl->what, width,
                       height);
    }
    gl->width = width;
    gl->height = height;
    return DF_OK;
}

df_status df_gl_read(const df_gl *gl, GLenum format, float *pixels, df_error *err) {
    glReadBuffer(GL_COLOR_ATTACHMENT0);
    glReadPixels(0, 0, (GLsizei)gl->width, (GLsizei)gl->height, format, GL_FLOAT, pixels);
    const GLenum error = glGetError();
    if (error == GL_NO_ERROR) return DF_OK;
    return df_fail(err, DF_ERROR_UNSUPPORTED, "%s: OpenGL fails with error 0x%x", gl->what, (unsigned)error);
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

void df_gl_clip_matrix(const df_view *view, uint32_t first_row, uint32_t row_count, float column_major[16]) {
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
