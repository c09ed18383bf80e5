/*
 * The readers behind df_mesh_read, one per format. Each takes the whole file in memory, followed by a zero byte that
 * is not counted, and hands vertices and polygons to a builder. `name` stands for the file in messages. What they add
 * to the builder before they fail does not matter.
 */
#ifndef DF_MESH_FORMATS_H
#define DF_MESH_FORMATS_H

#include "convert/mesh_builder.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Wavefront OBJ through tinyobjloader. Changes `text`: joins continued lines and blanks
 * comments. */
df_status df_mesh_parse_obj(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err);

/* Stanford PLY: ASCII, binary of either byte order, faces or triangle strips, any property types. */
df_status df_mesh_parse_ply(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err);

/* OFF, ASCII or binary, through CGAL. */
df_status df_mesh_parse_off(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err);

/* STL, ASCII or binary, through CGAL. */
df_status df_mesh_parse_stl(char *text, size_t size, const char *name, df_mesh_builder *builder, df_error *err);

#ifdef __cplusplus
}
#endif
#endif
