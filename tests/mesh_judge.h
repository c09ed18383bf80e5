/* CGAL's judgement of a mesh, behind a C interface. */
#ifndef DF_TESTS_MESH_JUDGE_H
#define DF_TESTS_MESH_JUDGE_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* 1: a closed, consistently oriented 2-manifold without unused vertices; 0: not; -1: CGAL threw. */
int judge_mesh(const double *positions, uint32_t vertex_count, const uint32_t *triangles, uint32_t triangle_count);

#ifdef __cplusplus
}
#endif
#endif
