/*
 * Lanes: DF_LANES numbers that go through the same arithmetic, and nothing else about the machine.
 *
 * With DF_LANES = 1 a lane type is the plain scalar; this is the specification, and it compiles as C and (with DF_OPENCL
 * defined) as OpenCL C. Every operation here and the operators + - * / are IEEE operations that give the same bits in every
 * width. min and max are "a < b ? a : b" and "a > b ? a : b", as in the SSE instructions.
 *
 *   lf, lm    floats and the masks of their comparisons
 *   ld, ldm   doubles and the masks of their comparisons
 */
#ifndef DF_LANE_H
#define DF_LANE_H

#include "render/dialect.h"

#ifndef DF_LANES
#define DF_LANES 1
#endif

#if DF_LANES == 1

typedef float lf;
typedef int lm; /* 0 or 1 */

static inline lf lf_set(float a) { return a; }
static inline lf lf_min(lf a, lf b) { return a < b ? a : b; }
static inline lf lf_max(lf a, lf b) { return a > b ? a : b; }
static inline lm lf_lt(lf a, lf b) { return a < b; }
static inline lm lf_le(lf a, lf b) { return a <= b; }
static inline lf lf_select(lm m, lf a, lf b) { return m ? a : b; }
static inline lm lm_and(lm a, lm b) { return a & b; }
static inline lm lm_or(lm a, lm b) { return a | b; }
static inline lm lm_xor(lm a, lm b) { return a ^ b; }
static inline lm lm_not(lm a) { return !a; }
static inline int lm_any(lm a) { return a; }
#ifdef DF_OPENCL
static inline lf lf_sqrt(lf a) { return sqrt(a); }
static inline lf lf_abs(lf a) { return fabs(a); }
#else
static inline lf lf_sqrt(lf a) { return sqrtf(a); }
static inline lf lf_abs(lf a) { return fabsf(a); }
#endif

#ifndef DF_NO_DOUBLE
typedef double ld;
typedef int ldm;

static inline ld ld_set(double a) { return a; }
static inline ld ld_min(ld a, ld b) { return a < b ? a : b; }
static inline ld ld_max(ld a, ld b) { return a > b ? a : b; }
static inline ldm ld_lt(ld a, ld b) { return a < b; }
static inline ldm ld_le(ld a, ld b) { return a <= b; }
static inline ld ld_select(ldm m, ld a, ld b) { return m ? a : b; }
static inline ldm ldm_and(ldm a, ldm b) { return a & b; }
static inline ldm ldm_or(ldm a, ldm b) { return a | b; }
static inline ldm ldm_xor(ldm a, ldm b) { return a ^ b; }
static inline ldm ldm_not(ldm a) { return !a; }
static inline int ldm_any(ldm a) { return a; }
static inline ld ld_sqrt(ld a) { return sqrt(a); }
static inline ld ld_abs(ld a) { return fabs(a); }
#endif

#endif
#endif
