/* The numbers of the cell solves: --intersect. C and OpenCL C. */
#ifndef DF_SOLVE_METHODS_H
#define DF_SOLVE_METHODS_H

#define DF_SOLVE_MIDPOINT 0
#define DF_SOLVE_LINEAR 1 /* one linear interpolation between the ends */
#define DF_SOLVE_REPEATED \
    2 /* Neubauer et al. 2002: linear, evaluated and repeated in the half that keeps the crossing */
#define DF_SOLVE_MARMITT 3  /* Marmitt et al. 2004: isolated between the extrema, then repeated linear */
#define DF_SOLVE_ANALYTIC 4 /* closed form, in double; outside the promise of equal bits on other devices */
#define DF_SOLVE_ROBUST 5   /* isolated between the extrema, then Illinois steps until nothing moves */
#define DF_SOLVE_COUNT 6

/* The solves that see pairs of crossings between two ends on the same side. */
#define DF_SOLVE_ISOLATES(method) ((method) >= DF_SOLVE_MARMITT)
#endif
