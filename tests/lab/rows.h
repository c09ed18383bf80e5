/*
 * The table of the laboratory, accuracy.csv: what a row says, and the session that writes it.
 */
#ifndef DF_TESTS_ROWS_H
#define DF_TESTS_ROWS_H

#include "instructions.h"
#include "measure.h"
#include "subject.h"
#include "table.h"

#define LAB_KEY_SIZE 512

typedef struct lab_method {
    int solve, steps; /* steps as for --steps; 0: there is nothing to choose */
    int precision;
} lab_method;
#define LAB_METHOD_COUNT 28
extern const lab_method lab_methods[LAB_METHOD_COUNT];

/* What a walk over a subject's frames is for: to see whether the table lacks any; to count their instructions, in the
 * child under callgrind; to write their rows. */
typedef enum lab_stage { LAB_MEASURING, LAB_PLANNING, LAB_COUNTING } lab_stage;

#define LAB_COUNTING_CHILDREN 2
typedef struct lab_session {
    const char *path; /* of the table */
    lab_table table;
    bool quick;
    const df_kernels *kernels;
    char machine[128];
    lab_stage stage;
    bool missing;                                  /* set by LAB_PLANNING: a frame is not in the table */
    int counter;                                   /* the processor's own of instructions; negative: none */
    bool uncounted;                                /* nothing is to be counted */
    bool asked, counted;                           /* a child was started; some frame's instructions are known */
    lab_count_run counting[LAB_COUNTING_CHILDREN]; /* the children, while they run */
    lab_counts counts;                             /* and what they counted; of a child itself: what it has drawn */
    df_error *err;
} lab_session;

/* Opens or continues the table at path; argv may hold --quick and --uncounted. Close in any case. */
df_status lab_session_open(lab_session *session, const char *path, int argc, char **argv, df_error *err);
void lab_session_close(lab_session *session);

typedef struct lab_row {
    const char *kind, *tracer, *intersect, *precision, *gradient, *truth, *family;
    int steps;
    uint64_t rays;
    const lab_score *score;        /* NULL: no errors measured */
    const lab_histogram *normal;   /* degrees; NULL: not measured */
    double ns_per_ray, ns_per_hit; /* negative: not measured */
    int repeats;
    const char *isa;             /* of the times */
    double instructions_per_ray; /* 0: not counted */
    double bound;                /* what --quality auto allows, voxels; 0: does not apply */
    uint64_t bytes;              /* that are held for tracing; 0: the field's */
    double contender_ratio;      /* contender.h; 0: there is none */
    char contender[64];
} lab_row;

/* Waits for the children. */
df_status lab_session_finish_counting(lab_session *session);

/* What a row is known by: kind to rays, at most LAB_KEY_SIZE bytes. */
void lab_row_key(const lab_subject *s, const lab_row *r, char *key, size_t size);
bool lab_row_have(const lab_session *session, const lab_subject *s, const lab_row *r);
df_status lab_row_write(lab_session *session, const lab_subject *s, const lab_row *r);

#endif
