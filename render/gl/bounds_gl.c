#include "render/gl/bounds_gl.h"
#include "common/memory.h"
#include "render/gl/context.h"

#include <math.h>
#include <stdlib.h>

struct df_bounds_gl {
    df_gl gl;
    GLuint program, vertex_array, buffer;
    GLsizei box_count;
    float *pixels; /* t and -t */
    uint64_t pixel_capacity;
};

/* A box is 12 triangles: corner i of the list, whose bits choose low or high along x, y, z. */
static const char vertex_text[] =
    "#version 330 core\n"
    "layout(location = 0) in vec3 low;\n"
    "layout(location = 1) in vec3 last;\n"
    "uniform vec3 eye;\n"
    "uniform float pad;\n"
    "uniform mat4 projection;\n" /* from position - eye to clip space */
    "const int corners[36] = int[36](0,1,3, 0,3,2, 4,5,7, 4,7,6, 0,1,5, 0,5,4, 2,3,7, 2,7,6, 0,2,6, 0,6,4, 1,3,7, "
    "1,7,5);\n"
    "void main() {\n"
    "    int corner = corners[gl_VertexID];\n"
    "    bvec3 high = bvec3((corner & 1) != 0, (corner & 2) != 0, (corner & 4) != 0);\n"
    "    gl_Position = projection * vec4(mix(low - eye - pad, last + 1.0 - eye + pad, vec3(high)), 1.0);\n"
    "}\n";
static const char fragment_text[] = "#version 330 core\n"
                                    "out vec2 pixel;\n"
                                    "void main() { pixel = vec2(1.0, -1.0) / gl_FragCoord.w; }\n";

static df_status upload(df_bounds_gl *b, const uint16_t (*boxes)[6], df_error *err) {
    df_status status = df_gl_program(&b->gl, vertex_text, fragment_text, &b->program, err);
    if (status != DF_OK) return status;
    glGenVertexArrays(1, &b->vertex_array);
    glBindVertexArray(b->vertex_array);
    glGenBuffers(1, &b->buffer);
    glBindBuffer(GL_ARRAY_BUFFER, b->buffer);
    glBufferData(GL_ARRAY_BUFFER, (GLsizeiptr)((size_t)b->box_count * sizeof *boxes), boxes, GL_STATIC_DRAW);
    for (GLuint i = 0; i < 2; i++) {
        glVertexAttribPointer(i, 3, GL_UNSIGNED_SHORT, GL_FALSE, sizeof *boxes, (const void *)(uintptr_t)(i * 6));
        glVertexAttribDivisor(i, 1);
        glEnableVertexAttribArray(i);
    }
    if (glGetError() == GL_NO_ERROR) return DF_OK;
    return df_fail(err, DF_ERROR_MEMORY, "%s: OpenGL has no room for %d boxes", b->gl.what, (int)b->box_count);
}

df_status df_bounds_gl_open(const uint16_t (*boxes)[6], uint64_t box_count, df_bounds_gl **out, df_error *err) {
    df_bounds_gl *b;
    *out = NULL;
    if (box_count > INT32_MAX)
        return df_fail(err, DF_ERROR_MEMORY, "--bounds gl: OpenGL draws at most 2147483647 boxes");
    df_status status = df_alloc((void **)&b, 1, sizeof *b, "bounds", err);
    if (status != DF_OK) return status;
    b->box_count = (GLsizei)box_count;
    status = df_gl_open("--bounds gl", &b->gl, err);
    if (status == DF_OK) status = df_gl_take(&b->gl, err);
    if (status == DF_OK) {
        status = upload(b, boxes, err);
        df_gl_leave(&b->gl);
    }
    if (status != DF_OK) df_bounds_gl_close(b);
    else *out = b;
    return status;
}

void df_bounds_gl_close(df_bounds_gl *b) {
    if (!b) return;
    df_gl_close(&b->gl);
    free(b->pixels);
    free(b);
}

/* Corners are moved to a grid within a pixel, of 16 steps at the least; a box must hold itself however its corners were
 * moved. */
static double snap_pad(const df_view *view) {
    double afar = 0, step = 0;
    for (int a = 0; a < 3; a++) {
        afar += (fabs(view->eye[a]) + view->box[a]) * (fabs(view->eye[a]) + view->box[a]);
        step = fmax(step, fmax(fabs(view->right[a]), fabs(view->down[a])));
    }
    double forward = 0; /* the least length of a direction is that across the picture's plane */
    const double *r = view->right, *d = view->down;
    double normal[3], length = 0;
    for (int a = 0; a < 3; a++) {
        normal[a] = r[(a + 1) % 3] * d[(a + 2) % 3] - r[(a + 2) % 3] * d[(a + 1) % 3];
        length += normal[a] * normal[a];
        forward += normal[a] * view->corner[a];
    }
    const double t_last = sqrt(afar) / (fabs(forward) / sqrt(length));
    return 0.125 * step * t_last;
}

static df_status draw(df_bounds_gl *b, const df_view *view, uint32_t first_row, uint32_t row_count, double pad,
                      df_error *err) {
    const GLfloat nowhere[4] = {INFINITY, INFINITY, 0, 0};
    float matrix[16];
    df_status status = df_gl_resize(&b->gl, GL_RG32F, false, view->width, row_count, err);
    if (status != DF_OK) return status;
    df_gl_clip_matrix(view, first_row, row_count, matrix);
    glViewport(0, 0, (GLsizei)view->width, (GLsizei)row_count);
    glClearBufferfv(GL_COLOR, 0, nowhere);
    glEnable(GL_DEPTH_CLAMP); /* nothing is cut off but what lies behind the eye */
    glEnable(GL_BLEND);
    glBlendEquation(GL_MIN);
    glUseProgram(b->program);
    glUniform3f(glGetUniformLocation(b->program, "eye"), (float)view->eye[0], (float)view->eye[1], (float)view->eye[2]);
    glUniform1f(glGetUniformLocation(b->program, "pad"), (float)(pad + snap_pad(view)));
    glUniformMatrix4fv(glGetUniformLocation(b->program, "projection"), 1, GL_FALSE, matrix);
    glBindVertexArray(b->vertex_array);
    glDrawArraysInstanced(GL_TRIANGLES, 0, 36, b->box_count);
    return df_gl_read(&b->gl, GL_RG, b->pixels, err);
}

/* t from a rasteriser is a quotient of interpolated floats: so much of it may be wrong. */
#define T_MARGIN 1e-4

static void reduce(const df_bounds_gl *b, uint32_t width, uint32_t rows, uint32_t edge, double *least,
                   double *greatest) {
    const uint32_t columns = (width + edge - 1) / edge;
    for (uint32_t y = 0; y < rows; y++) {
        const float *row = b->pixels + 2 * (uint64_t)width * y;
        for (uint32_t x = 0; x < width; x++) {
            if (!isfinite(row[2 * x])) continue;
            const uint64_t at = x / edge + (uint64_t)columns * (y / edge);
            least[at] = fmin(least[at], (double)row[2 * x] * (1 - T_MARGIN));
            greatest[at] = fmax(greatest[at], -(double)row[2 * x + 1] * (1 + T_MARGIN));
        }
    }
}

df_status df_bounds_gl_draw(df_bounds_gl *b, const df_view *view, uint32_t first_row, uint32_t row_count, double pad,
                            uint32_t edge, double *least, double *greatest, df_error *err) {
    const uint64_t pixels = (uint64_t)view->width * row_count;
    df_status status = DF_OK;
    if (pixels > b->pixel_capacity) {
        free(b->pixels);
        b->pixel_capacity = 0;
        status = df_alloc_raw((void **)&b->pixels, pixels, 2 * sizeof *b->pixels, "bounds", err);
        if (status != DF_OK) return status;
        b->pixel_capacity = pixels;
    }
    status = df_gl_take(&b->gl, err);
    if (status != DF_OK) return status;
    status = draw(b, view, first_row, row_count, pad, err);
    df_gl_leave(&b->gl);
    if (status == DF_OK) reduce(b, view->width, row_count, edge, least, greatest);
    return status;
}
