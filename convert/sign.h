/*
 * Which samples are inside. The winding number counted along the rows (winding.h) decides, on the mesh as it is or on a
 * sign mesh (oriented, with fans over its holes), or the pseudonormal of the nearest feature: as the caller asks.
 */
#ifndef DF_SIGN_H
#define DF_SIGN_H

#include "convert/sign_mesh.h"
#include "convert/sign_normal.h"
#include "convert/winding.h"

#include <math.h>

typedef enum df_sign_method {
    DF_SIGN_AUTO,    /* winding number >= 1, or generalised >= 0.5 where the mesh has a border */
    DF_SIGN_WINDING, /* the same: kept as a name of its own, so that a script can insist */
    DF_SIGN_PARITY,  /* an odd number of crossings */
    DF_SIGN_NORMAL,  /* on the inner side of the nearest face, by its pseudonormal */
    DF_SIGN_WRAP,    /* the same, within CGAL's alpha wrap of the mesh */
} df_sign_method;

typedef struct df_sign {
    df_sign_method method;
    const df_mesh *mesh;     /* whose crossings count: the input, or that of `made` */
    df_sign_mesh made;       /* owned; empty while the input's own faces do */
    df_sign_normals normals; /* of `made`; for DF_SIGN_NORMAL and DF_SIGN_WRAP */
    df_mesh wrap;            /* for DF_SIGN_WRAP */
} df_sign;

/* Makes the sign mesh and uses it from now on. Not for DF_SIGN_NORMAL and DF_SIGN_WRAP. */
df_status df_sign_orient(df_sign *sign, const df_mesh *input, df_error *err);

/* Makes what DF_SIGN_NORMAL and DF_SIGN_WRAP need. */
df_status df_sign_prepare_normals(df_sign *sign, const df_mesh *input, df_error *err);

/* True where winding numbers below 0, found on the input as it is, may still be mended by df_sign_orient. */
bool df_sign_may_orient(const df_sign *sign, const df_mesh *input);

void df_sign_free(df_sign *sign);

/* How a winding number becomes a side, for the points of a ball. */
typedef struct df_sign_rule {
    const df_sign *sign;
    int32_t threshold;     /* inside where the winding number is at least this; valid when active_count = 0 */
    bool needs_points;     /* df_sign_apply looks at the points */
    uint32_t active_count; /* fans that must be looked at for each point */
    uint32_t *active;      /* room for made.cap_count, given by the caller */
} df_sign_rule;

/* Sets the rule for points within `radius` of the centre; `active` has room for sign->made.cap_count. */
void df_sign_make_rule(const df_sign *sign, const double centre[3], double radius, uint32_t *active,
                       df_sign_rule *rule);

/* Makes values negative that are inside and positive that are not; zero stays +0. `windings` are counted along the
 * rows; points: where the values lie, looked at only where the rule needs them. */
void df_sign_apply(const df_sign_rule *rule, const int32_t *windings, const double (*points)[3], uint32_t count,
                   float *values);

/* True where the signed distances a and b of two points so far apart have different signs although no surface can lie
 * between them: |a| + |b| is more. */
static inline bool df_sign_is_wall(double apart, float a, float b) {
    return (a < 0) != (b < 0) && fabsf(a) + fabsf(b) > (float)(apart * (1 + 1e-6));
}

#endif
