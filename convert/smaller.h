/* The smaller and the larger of two numbers, neither of which is NaN. fmin and fmax mind NaN, and are calls. */
#ifndef DF_SMALLER_H
#define DF_SMALLER_H

static inline double df_smaller(double x, double y) { return x < y ? x : y; }
static inline double df_larger(double x, double y) { return x > y ? x : y; }

#endif
