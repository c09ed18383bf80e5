/*
 * A tracer measured against a truth over a family of rays.
 *
 * A truth takes the ray as the tracer has it: its rounded origin and direction. Tangent rays (truth.h) are counted and
 * not judged. All counts and statistics are the same on any number of threads.
 */
#ifndef DF_TESTS_MEASURE_H
#define DF_TESTS_MEASURE_H

#include "families.h"
#include "mesh_truth.h"
#include "render/cpu/kernels.h"
#include "surface.h"

/* Values by size in bins of 1/50 decade, from 1e-18 to 1e3; smaller ones count as 0. */
#define LAB_BIN_COUNT 1050
typedef struct lab_histogram {
    uint64_t count, zeros, bins[LAB_BIN_COUNT];
    double max;
} lab_histogram;
void lab_histogram_add(lab_histogram *histogram, double value);
void lab_histogram_merge(lab_histogram *into, const lab_histogram *from);
/* The value that a part of all (0 to 1) does not exceed: the upper edge of its bin, at most max; 0 when empty. */
double lab_histogram_quantile(const lab_histogram *histogram, double part);

#define LAB_LEAK_VOXELS 0.5
#define LAB_FAILURES_KEPT 8
typedef enum lab_failure_kind { LAB_FALSE_POSITIVE, LAB_FALSE_NEGATIVE, LAB_LEAK, LAB_WRONG_FACE } lab_failure_kind;

typedef struct lab_score {
    uint64_t rays;    /* that were traced; those that a family could not make are left out */
    uint64_t tangent; /* of them, not judged */
    uint64_t true_positive, false_positive, false_negative, true_negative;
    uint64_t leaks;         /* hits more than half a voxel off; they count as true positives as well */
    uint64_t wrong_face;    /* back instead of front or the reverse */
    lab_histogram depth;    /* |t - truth| of true positives, voxels */
    lab_histogram residual; /* distance of the hit from the surface, voxels: truth 1 only */
    uint32_t failure_count; /* kept below: those of the smallest ray numbers */
    struct lab_failure {
        uint64_t ray;
        lab_failure_kind kind;
    } failures[LAB_FAILURES_KEPT];
} lab_score;

/* A ray of a run and its truth. */
typedef struct lab_known {
    bool made; /* false: the family cannot make this ray */
    double origin[3], direction[3];
    df_truth truth;
} lab_known;

typedef struct lab_run {
    const df_tracer *tracer;
    const df_scene *scene;
    int solve, steps;
    const lab_surface *surface; /* NULL: against the trilinear field */
    lab_family family;
    uint64_t seed, first, count; /* rays first .. first + count - 1 of the family */
    lab_known *known; /* NULL, or count zeroed ones: filled by the first run, used by those after it, which must
                         differ in tracer, kernels, solve, steps and precision only */
    bool is_known;
    const lab_mesh *mesh;      /* against this instead; NULL: not */
    int precision;             /* DF_PRECISION_... of the solve */
    const double *eye;         /* grid space: rays from there to the field's box instead of the family's; NULL: not */
    const df_kernels *kernels; /* NULL: scalar */
} lab_run;

/* Adds to *score, which starts zeroed. */
df_status lab_measure(const lab_run *run, lab_score *score, df_error *err);

/* A ray that did not hit, as the tracer had it. */
typedef struct lab_escape {
    uint64_t ray;
    bool tangent;    /* the truth does not judge it: it starts or turns around on the surface, or runs along it */
    double true_hit; /* t of the truth's first crossing; negative: none */
    double origin[3], direction[3];
} lab_escape;

typedef struct lab_escapes {
    uint64_t rays;       /* that were traced */
    uint64_t count;      /* of them, escaped: leaks */
    uint64_t tangent;    /* of them, without a hit but tangent: no leaks, and not in count */
    uint32_t kept_count; /* of both, those of the smallest ray numbers, in order */
    lab_escape kept[LAB_FAILURES_KEPT];
} lab_escapes;

/* Rays of a family that do not hit, for families where each must: INSIDE of a closed field. The truth is asked about
 * these only, so this is fast. */
df_status lab_count_escapes(const lab_run *run, lab_escapes *escapes, df_error *err);

/* Asks the truth about a ray without a hit and counts it. `escape` has its number, origin and direction. */
void lab_escapes_judge(lab_escapes *escapes, const df_scene *scene, lab_escape escape);
void lab_escapes_merge(lab_escapes *into, const lab_escapes *from);
/* Puts those that are kept in order. */
void lab_escapes_sort(lab_escapes *escapes);

/* A ray counted whose truth is known: what it hit was `off` voxels off. */
void lab_score_pair(lab_score *score, uint64_t ray, const df_truth *truth, bool hit, double off);

void lab_score_merge(lab_score *into, const lab_score *from);
/* False positives, false negatives, leaks and wrong faces. */
uint64_t lab_score_errors(const lab_score *score);
/* The failures that were kept, one a line, with what is needed to see them again. */
void lab_print_failures(const lab_run *run, const lab_score *score);

#endif
