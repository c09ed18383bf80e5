/* Distances and winding numbers by brute force, for comparison: no code of the converter, no acceleration. */
#ifndef DF_TEST_ORACLE_H
#define DF_TEST_ORACLE_H

#include <stddef.h>
#include <stdint.h>

/* The distance of p to the nearest of face_count triangles (indices into positions), by the regions of each triangle,
 * in long double. */
double oracle_distance(const double *positions, const uint32_t *faces, size_t face_count, const double p[3]);

/* The generalised winding number of p: the solid angles of all triangles (van Oosterom, Strackee 1983) over 4 pi. */
double oracle_winding(const double *positions, const uint32_t *faces, size_t face_count, const double p[3]);

/* A number in [0, 1) from a state that it advances (splitmix64). */
double oracle_random(uint64_t *state);

#endif
