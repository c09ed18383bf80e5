/* A ray of a view in double, for the truths. */
#ifndef DF_TESTS_VIEW_RAY_H
#define DF_TESTS_VIEW_RAY_H

#include "render/view.h"

static inline void lab_view_ray(const df_rays *rays, uint32_t i, double origin[3], double direction[3]) {
    for (int a = 0; a < 3; a++) {
        origin[a] = (double)rays->origin[a][rays->shared_origin ? 0 : i];
        direction[a] = (double)rays->direction[a][i];
    }
}

#endif
