/* An OpenCL device as a tracer of arbitrary rays, so that the laboratory can measure it like the others. */
#ifndef DF_TESTS_OPENCL_TRACER_H
#define DF_TESTS_OPENCL_TRACER_H

#include "render/tracer.h"

/* The first device that df-render would take: dda, or adf on octrees. Solves in double. DF_ERROR_UNSUPPORTED where
 * there is no device. May be called by several threads, which wait for each other. */
extern const df_tracer lab_tracer_opencl;

#endif
