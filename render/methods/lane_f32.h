/* Makes lr, the real number of cell.h and solve.h, mean float lanes. No include guard: texts are compiled once per
 * type. */
#include "render/methods/lane.h"
#undef LR
#undef lr
#undef lrm
#define LR(name) name##_f32
#define lr lf
#undef LR_NARROW
#define LR_NARROW 1 /* products of two field values may leave its range */
#define lrm lm
#undef lr_set
#undef lr_min
#undef lr_max
#undef lr_lt
#undef lr_le
#undef lr_select
#undef lr_abs
#undef lr_sqrt
#undef lrm_and
#undef lrm_or
#undef lrm_xor
#undef lrm_not
#undef lrm_any
#define lr_set(a) lf_set((float)(a))
#define lr_min lf_min
#define lr_max lf_max
#define lr_lt lf_lt
#define lr_le lf_le
#define lr_select lf_select
#define lr_abs lf_abs
#define lr_sqrt lf_sqrt
#define lrm_and lm_and
#define lrm_or lm_or
#define lrm_xor lm_xor
#define lrm_not lm_not
#define lrm_any lm_any
