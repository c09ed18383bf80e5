/* df-lab filters: does a better reconstruction filter buy fewer samples? */
#ifndef DF_TESTS_FILTERS_H
#define DF_TESTS_FILTERS_H

#include "common/status.h"

/* Prints errors of depth and normal against the exact surfaces of the laboratory at 64, 128 and 256 voxels, or of dense
 * fields FIELD.dfield:MESH.obj against the mesh that they were made from, for trilinear interpolation and both cubic
 * filters. */
df_status lab_command_filters(int argc, char **argv, df_error *err);

#endif
