/* What a structure and a sample type cost in bytes and in error against the exact surface. */
#ifndef DF_TESTS_STORAGE_H
#define DF_TESTS_STORAGE_H

#include "rows.h"

/* A shape of the laboratory, dense, in bricks and as an octree, in floats and quantised: truth against truth, no
 * tracer. */
df_status lab_measure_structures(lab_session *session, const char *name, uint32_t size, uint64_t rays);

#endif
