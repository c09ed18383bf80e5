/*
 * The picture of a hit: a headlight at the eye, diffuse, in linear light. Float lanes, also OpenCL C.
 */
#ifndef DF_SHADE_H
#define DF_SHADE_H

#include "render/methods/lane.h"

/* The object and the background in linear light: a warm grey clay before a light, slightly cool sky. */
#define DF_SHADE_ALBEDO \
    { 0.72f, 0.66f, 0.58f }
#define DF_SHADE_BACKGROUND \
    { 0.80f, 0.84f, 0.90f }
#define DF_SHADE_AMBIENT 0.06f

/* Levels of the table that turns linear light into sRGB bytes (df_shade_table in frame.h). */
#define DF_SHADE_LEVELS 4096

/* The unit normal in world space from a gradient per voxel; `toward_eye` where the field is flat. inverse_size: 1 /
 * voxel size. */
static inline void df_shade_normal(const lf gradient[3], const lf inverse_size[3], const lf toward_eye[3],
                                   lf normal[3]) {
    lf g[3];
    for (int a = 0; a < 3; a++) g[a] = gradient[a] * inverse_size[a];
    lf largest = lf_max(lf_abs(g[0]), lf_max(lf_abs(g[1]), lf_abs(g[2])));
    lm sound = lf_lt(lf_set(0), largest);
    /* so that squares neither vanish nor overflow; a subnormal number has no reciprocal */
    lf scale = lf_set(1) / lf_select(sound, lf_max(largest, lf_set(1e-37f)), lf_set(1));
    for (int a = 0; a < 3; a++) g[a] = g[a] * scale;
    lf length = lf_sqrt((g[0] * g[0] + g[1] * g[1]) + g[2] * g[2]);
    length = lf_select(sound, length, lf_set(1));
    for (int a = 0; a < 3; a++) normal[a] = lf_select(sound, g[a] / length, toward_eye[a]);
}

/* The unit vector from the hit to the eye, from a direction in grid space. */
static inline void df_shade_toward_eye(const lf direction[3], const lf voxel_size[3], lf toward_eye[3]) {
    lf w[3];
    for (int a = 0; a < 3; a++) w[a] = direction[a] * voxel_size[a];
    lf length = lf_sqrt((w[0] * w[0] + w[1] * w[1]) + w[2] * w[2]);
    for (int a = 0; a < 3; a++) toward_eye[a] = (lf_set(0) - w[a]) / length;
}

/* Light that returns to the eye, 0 to 1, before the albedo. Back faces are lit like front faces. */
static inline lf df_shade_light(const lf normal[3], const lf toward_eye[3]) {
    lf cosine = lf_abs((normal[0] * toward_eye[0] + normal[1] * toward_eye[1]) + normal[2] * toward_eye[2]);
    return lf_set(DF_SHADE_AMBIENT) + lf_set(1 - DF_SHADE_AMBIENT) * lf_min(cosine, lf_set(1));
}

#ifndef DF_OPENCL
/* The level of linear light in df_shade_table. */
static inline li df_shade_level(lf linear) { return li_from_lf(linear * lf_set(DF_SHADE_LEVELS - 1) + lf_set(0.5f)); }
#endif

#endif
