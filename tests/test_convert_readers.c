/*
 * Claims about the mesh readers: the same body in every dialect of every format is the same mesh. The body is the box
 * 0..1 x 0..2 x 0..3, outward oriented; what is compared is its signed volume, its bounds, and that it is closed after
 * welding. The bridges are called from C here.
 */
#include "convert/mesh.h"
#include "convert/mesh_formats.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

typedef df_status (*parser)(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err);

static const double corners[8][3] = {{0, 0, 0}, {1, 0, 0}, {0, 2, 0}, {1, 2, 0},
                                     {0, 0, 3}, {1, 0, 3}, {0, 2, 3}, {1, 2, 3}};
static const int quads[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};

/* Bytes in the making. */
typedef struct buffer {
    char data[16384];
    size_t size;
} buffer;

static void put(buffer *b, const char *format, ...) __attribute__((format(printf, 2, 3)));
static void put(buffer *b, const char *format, ...) {
    va_list args;
    va_start(args, format);
    b->size += (size_t)vsnprintf(b->data + b->size, sizeof b->data - b->size, format, args);
    va_end(args);
    assert_true(b->size < sizeof b->data);
}

static void put_bytes(buffer *b, const void *data, size_t size, int swap) {
    const char *from = data;
    for (size_t i = 0; i < size; i++) b->data[b->size++] = from[swap ? size - 1 - i : i];
}

static double signed_volume(const df_mesh *mesh) {
    double sum = 0;
    for (uint32_t f = 0; f < mesh->face_count; f++) {
        const double *a = mesh->positions + 3 * (size_t)mesh->faces[3 * (size_t)f];
        const double *b = mesh->positions + 3 * (size_t)mesh->faces[3 * (size_t)f + 1];
        const double *c = mesh->positions + 3 * (size_t)mesh->faces[3 * (size_t)f + 2];
        sum += a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
               a[2] * (b[0] * c[1] - b[1] * c[0]);
    }
    return sum / 6;
}

static void is_the_box(parser parse, const buffer *b, const char *what) {
    df_mesh_builder builder = {0};
    df_mesh mesh = {0};
    df_error err = {0};
    df_mesh_cleaning cleaning = {0};
    df_mesh_edges edges = {0};
    char *text = malloc(b->size + 1);
    memcpy(text, b->data, b->size);
    text[b->size] = 0;
    df_status status = parse(text, b->size, what, &builder, &err);
    free(text);
    if (status != DF_OK) fail_msg("%s: %s", what, err.text);
    assert_int_equal(df_mesh_builder_finish(&builder, what, &mesh, &err), DF_OK);
    assert_int_equal(df_mesh_clean(&mesh, what, &cleaning, &err), DF_OK);
    assert_int_equal(df_mesh_find_edges(&mesh, &edges, &err), DF_OK);
    if (fabs(signed_volume(&mesh) - 6) > 1e-12) fail_msg("%s: volume %g", what, signed_volume(&mesh));
    if (mesh.vertex_count != 8 || mesh.face_count != 12 || edges.boundary) {
        fail_msg("%s: %u vertices, %u faces, %u boundary edges", what, mesh.vertex_count, mesh.face_count,
                 edges.boundary);
    }
    double low[3], high[3];
    df_mesh_bounds(&mesh, low, high);
    for (int a = 0; a < 3; a++) assert_true(low[a] == 0 && high[a] == a + 1);
    free(edges.borders);
    df_mesh_free(&mesh);
}

/* ---- OBJ ---- */

static void obj_vertices(buffer *b, const char *end) {
    b->size = 0;
    put(b, "# a box%smtllib none.mtl%so box%s", end, end, end);
    for (int v = 0; v < 8; v++) put(b, "v %.1f %.3e %g%s", corners[v][0], corners[v][1], corners[v][2], end);
    put(b, "vt 0 0%svn 0 0 1%s", end, end);
}

static void obj_dialects_agree(void **state) {
    (void)state;
    static const char *const formats[] = {"%d", "%d/1", "%d/1/1", "%d//1"};
    static const char *const ends[] = {"\n", "\r\n"};
    buffer b;
    for (int form = 0; form < 4; form++) {
        for (int negative = 0; negative < 2; negative++) {
            for (int triangles = 0; triangles < 2; triangles++) {
                for (int end = 0; end < 2; end++) {
                    obj_vertices(&b, ends[end]);
                    put(&b, "g faces%ss off%s", ends[end], ends[end]);
                    for (int q = 0; q < 6; q++) {
                        for (int part = 0; part <= triangles; part++) {
                            put(&b, "f");
                            for (int c = 0; c < (triangles ? 3 : 4); c++) {
                                int corner = quads[q][triangles && c > 0 ? c + part : c];
                                put(&b, " ");
                                put(&b, formats[form], negative ? corner - 8 : corner + 1);
                            }
                            put(&b, "%s", ends[end]);
                        }
                    }
                    is_the_box(df_mesh_parse_obj, &b, "obj");
                }
            }
        }
    }
}

static void obj_lines_that_go_on_and_elements_that_are_no_faces_are_read(void **state) {
    (void)state;
    buffer b;
    obj_vertices(&b, "\n");
    put(&b, "p 1\nl 1 2 3\nusemtl m\n");
    for (int q = 0; q < 6; q++)
        put(&b, "f %d %d \\\n %d %d # a face\n", quads[q][0] + 1, quads[q][1] + 1, quads[q][2] + 1, quads[q][3] + 1);
    is_the_box(df_mesh_parse_obj, &b, "obj with continued lines");
}

/* ---- PLY ---- */

static void ply_header(buffer *b, const char *format, const char *type, const char *faces, const char *list) {
    b->size = 0;
    put(b,
        "ply\nformat %s 1.0\ncomment a box\nelement vertex 8\nproperty %s x\nproperty uchar red\nproperty %s "
        "y\nproperty %s z\n",
        format, type, type, type);
    put(b, "%s\nproperty list %s\nend_header\n", faces, list);
}

static void ply_text_is_read(void **state) {
    (void)state;
    static const char *const lists[] = {"uchar int vertex_indices", "uint8 uint32 vertex_index",
                                        "int ushort vertex_indices"};
    buffer b;
    for (int l = 0; l < 3; l++) {
        ply_header(&b, "ascii", l ? "float32" : "double", "element face 6", lists[l]);
        for (int v = 0; v < 8; v++) put(&b, "%g 7 %g %g\n", corners[v][0], corners[v][1], corners[v][2]);
        for (int q = 0; q < 6; q++) put(&b, "4 %d %d %d %d\n", quads[q][0], quads[q][1], quads[q][2], quads[q][3]);
        is_the_box(df_mesh_parse_ply, &b, lists[l]);
    }
}

static void binary_ply_is_read_in_either_byte_order(void **state) {
    (void)state;
    buffer b;
    for (int swap = 0; swap < 2; swap++) {
        for (int wide = 0; wide < 2; wide++) {
            ply_header(&b, swap ? "binary_big_endian" : "binary_little_endian", wide ? "double" : "float",
                       "element face 6", wide ? "uint int vertex_indices" : "uchar short vertex_indices");
            for (int v = 0; v < 8; v++) {
                for (int a = 0; a < 3; a++) {
                    float narrow = (float)corners[v][a];
                    if (wide) put_bytes(&b, &corners[v][a], 8, swap);
                    else put_bytes(&b, &narrow, 4, swap);
                    if (a == 0) put_bytes(&b, "\7", 1, 0);
                }
            }
            for (int q = 0; q < 6; q++) {
                uint32_t count = 4;
                if (wide) put_bytes(&b, &count, 4, swap);
                else put_bytes(&b, "\4", 1, 0);
                for (int c = 0; c < 4; c++) {
                    int32_t index = quads[q][c];
                    int16_t narrow = (int16_t)index;
                    if (wide) put_bytes(&b, &index, 4, swap);
                    else put_bytes(&b, &narrow, 2, swap);
                }
            }
            is_the_box(df_mesh_parse_ply, &b, swap ? "big-endian ply" : "little-endian ply");
        }
    }
}

static void ply_triangle_strips_are_read(void **state) {
    (void)state;
    buffer b;
    ply_header(&b, "ascii", "float", "element tristrips 1", "int int vertex_indices");
    for (int v = 0; v < 8; v++) put(&b, "%g 7 %g %g\n", corners[v][0], corners[v][1], corners[v][2]);
    put(&b, "29");
    for (int q = 0; q < 6; q++) { /* a quad a b c d is the strip a b d c */
        put(&b, " %d %d %d %d%s", quads[q][0], quads[q][1], quads[q][3], quads[q][2], q < 5 ? " -1" : "\n");
    }
    is_the_box(df_mesh_parse_ply, &b, "ply of strips");
}

/* ---- OFF ---- */

/* The lines of the box's vertices, scaled, and of its faces, each followed by `rest`. */
static void put_off_vertices(buffer *b, double scale, const char *rest) {
    for (int v = 0; v < 8; v++)
        put(b, "%g %g %g%s\n", scale * corners[v][0], scale * corners[v][1], scale * corners[v][2], rest);
}
static void put_off_faces(buffer *b, const char *rest) {
    for (int q = 0; q < 6; q++) put(b, "4 %d %d %d %d%s\n", quads[q][0], quads[q][1], quads[q][2], quads[q][3], rest);
}

static void off_dialects_are_read(void **state) {
    (void)state;
    buffer b = {.size = 0};
    put(&b, "OFF\n# a box\n8 6 12\n");
    put_off_vertices(&b, 1, "");
    for (int q = 0; q < 6; q++) put(&b, "4  %d %d %d %d\n", quads[q][0], quads[q][1], quads[q][2], quads[q][3]);
    is_the_box(df_mesh_parse_off, &b, "off");
    b.size = 0;
    put(&b, "COFF\n8 6 0\n\n");
    put_off_vertices(&b, 1, " 255 0 0 255");
    put_off_faces(&b, "");
    is_the_box(df_mesh_parse_off, &b, "off with colours");
    b.size = 0;
    put(&b, "COFF\n8 6 0\n\n"); /* colours are promised, and some lines have none, or parts */
    for (int v = 0; v < 8; v++)
        put(&b, "%g %g %g%s\n", corners[v][0], corners[v][1], corners[v][2],
            v % 3 == 0   ? ""
            : v % 3 == 1 ? " 7"
                         : " 7 0.5");
    put_off_faces(&b, " 3");
    is_the_box(df_mesh_parse_off, &b, "off with colours missing");
    b.size = 0;
    put(&b, "# first\n\nOFF8 6 # of edges nobody needs the number\n2147483647\n");
    put_off_vertices(&b, 1, "");
    put_off_faces(&b, "");
    is_the_box(df_mesh_parse_off, &b, "off whose keyword touches its numbers");
    b.size = 0;
    put(&b, "ST4OFF\n8 6 12\n");
    put_off_vertices(&b, 2, " 2 0.5 0.5");
    put_off_faces(&b, "");
    is_the_box(df_mesh_parse_off, &b, "off with weights and textures");
}

static void off_headers_that_are_none_are_refused(void **state) {
    static const char counts[] = "test: the numbers of vertices, faces and edges after OFF are damaged or missing";
    static const char *const texts[] = {"",
                                        "OF",
                                        "XOFF\n3 1 3\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
                                        "4COFF\n3 1 3\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
                                        "OFF",
                                        "OFF\n3 -1 3\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
                                        "OFF\n-3 1 3\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
                                        "OFF\n3 1 3000000000\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
                                        "OFF\nBINARX\n\1\1\1\1"};
    (void)state;
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        df_mesh_builder builder = {0};
        df_error err = {0};
        char text[64];
        snprintf(text, sizeof text, "%s", texts[i]);
        if (df_mesh_parse_off(text, strlen(text), "test", &builder, &err) != DF_ERROR_FORMAT)
            fail_msg("\"%s\" is taken for an OFF file", texts[i]);
        assert_string_equal(err.text, i < 4 ? "test: not an OFF file" : counts);
        df_mesh_builder_free(&builder);
    }
}

static void put_big_endian(buffer *b, int32_t value) { put_bytes(b, &value, sizeof value, 1); }

static void binary_off_is_read(void **state) {
    (void)state;
    buffer b = {.size = 0};
    put(&b, "OFF BINARY\n");
    put_big_endian(&b, 8);
    put_big_endian(&b, 6);
    put_big_endian(&b, 0);
    for (int v = 0; v < 8; v++) {
        for (int a = 0; a < 3; a++) {
            float x = (float)corners[v][a];
            put_bytes(&b, &x, sizeof x, 1);
        }
    }
    for (int q = 0; q < 6; q++) {
        put_big_endian(&b, 4);
        for (int c = 0; c < 4; c++) put_big_endian(&b, quads[q][c]);
        put_big_endian(&b, q % 2 ? 3 : 0); /* colours */
        for (int c = 0; c < (q % 2 ? 3 : 0); c++) put_big_endian(&b, 0x3f000000);
    }
    is_the_box(df_mesh_parse_off, &b, "binary off");
}

/* ---- STL ---- */

static void stl_text_and_bytes_are_read_and_welded(void **state) {
    (void)state;
    buffer b = {.size = 0};
    put(&b, "solid box\n");
    for (int t = 0; t < 12; t++) {
        put(&b, "  facet normal 0 0 0\n    outer loop\n");
        for (int c = 0; c < 3; c++) {
            const double *p = corners[quads[t / 2][c > 0 ? c + t % 2 : 0]];
            put(&b, "      vertex %g %g %e\n", p[0], p[1], p[2]);
        }
        put(&b, "    endloop\n  endfacet\n");
    }
    put(&b, "endsolid box\n");
    is_the_box(df_mesh_parse_stl, &b, "stl text");
    for (int solid = 0; solid < 2; solid++) { /* many programs begin binary files with "solid" */
        memset(b.data, 0, 84);
        strcpy(b.data, solid ? "solid made by someone" : "binary");
        b.data[80] = 12;
        b.size = 84;
        for (int t = 0; t < 12; t++) {
            const float normal[3] = {0, 0, 0};
            put_bytes(&b, normal, sizeof normal, 0);
            for (int c = 0; c < 3; c++) {
                for (int a = 0; a < 3; a++) {
                    float x = (float)corners[quads[t / 2][c > 0 ? c + t % 2 : 0]][a];
                    put_bytes(&b, &x, sizeof x, 0);
                }
            }
            put_bytes(&b, "\0\0", 2, 0);
        }
        is_the_box(df_mesh_parse_stl, &b, solid ? "binary stl that begins with solid" : "binary stl");
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(obj_dialects_agree),
        cmocka_unit_test(obj_lines_that_go_on_and_elements_that_are_no_faces_are_read),
        cmocka_unit_test(ply_text_is_read),
        cmocka_unit_test(binary_ply_is_read_in_either_byte_order),
        cmocka_unit_test(ply_triangle_strips_are_read),
        cmocka_unit_test(off_dialects_are_read),
        cmocka_unit_test(off_headers_that_are_none_are_refused),
        cmocka_unit_test(binary_off_is_read),
        cmocka_unit_test(stl_text_and_bytes_are_read_and_welded),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
