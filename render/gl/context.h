/*
 * OpenGL without a window, through EGL: hardware where there is one, Mesa's llvmpipe otherwise. A context belongs to
 * one thread at a time; every call that draws takes it and leaves it.
 */
#ifndef DF_GL_CONTEXT_H
#define DF_GL_CONTEXT_H

#include "common/status.h"
#include "render/view.h"

#define GL_GLEXT_PROTOTYPES
#include <EGL/egl.h>
#include <GL/gl.h>
#include <GL/glext.h>
#include <stdbool.h>

/* Zeroed is closed. */
typedef struct df_gl {
    EGLDisplay display;
    EGLContext context;
    const char *what;                   /* the option that asks for it, for messages; not copied */
    GLuint frame_buffer, target, depth; /* what is drawn to; see df_gl_resize */
    uint32_t width, height;
} df_gl;

/* Opens a context of version 3.3. */
df_status df_gl_open(const char *what, df_gl *gl, df_error *err);
void df_gl_close(df_gl *gl);

df_status df_gl_take(const df_gl *gl, df_error *err);
void df_gl_leave(const df_gl *gl);

/* The rest is for a context that is taken. */

/* Compiles and links a vertex and a fragment shader. */
df_status df_gl_program(const df_gl *gl, const char *vertex, const char *fragment, GLuint *program, df_error *err);

/* Binds a target of `format` (GL_RGBA32F, ...) and width * height pixels, with a depth buffer if asked for. */
df_status df_gl_resize(df_gl *gl, GLenum format, bool with_depth, uint32_t width, uint32_t height, df_error *err);

/* Reads the target back, as floats, and reports the first error since the last call. */
df_status df_gl_read(const df_gl *gl, GLenum format, float *pixels, df_error *err);

/* From position - eye to clip space, so that pixel centres of the rows of a view are window coordinates plus a half,
 * and w is the t of the rays there; rows of the picture run upwards in the target. */
void df_gl_clip_matrix(const df_view *view, uint32_t first_row, uint32_t row_count, float column_major[16]);

#endif
