/* Makes lr, the real number of cell.h and solve.h, mean double lanes. No include guard: texts are compiled once per
 * type. */
#include "render/methods/lane.h"
#undef LR
#undef lr
#undef lrm
#define LR(name) name##_f64
#define lr ld
#undef LR_NARROW
#define LR_NARROW 0 /* products of two float values stay within its range */
#define lrm ldm
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
#define lr_set(a) ld_set(a)
#define lr_min ld_min
#define lr_max ld_max
#define lr_lt ld_lt
#define lr_le ld_le
#define lr_select ld_select
#define lr_abs ld_abs
#define lr_sqrt ld_sqrt
#define lrm_and ldm_and
#define lrm_or ldm_or
#define lrm_xor ldm_xor
#define lrm_not ldm_not
#define lrm_any ldm_any
