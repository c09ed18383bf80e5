/*
 * The octree while it grows: nodes, which are divided cells, and what adf.c, adf_divide.c and adf_fit.c do with them.
 */
#ifndef DF_ADF_TREE_H
#define DF_ADF_TREE_H

#include "convert/adf.h"
#include "convert/neighbours.h"

#define ADF_NONE UINT32_MAX

/* A divided cell. Bytes rather than bits by child, as its children may be worked at by several threads. */
typedef struct adf_node {
    uint32_t corner[3];
    uint32_t level;       /* of its children: 1 for those of the root */
    uint32_t parent;      /* 8 * node + child of the cell that was divided; 0 for the root */
    uint32_t children[8]; /* nodes, or ADF_NONE */
    uint8_t crossed[8];   /* the surface may cross the child */
    uint8_t fitted[8];    /* fit and misfit are known: of undivided crossed children larger than a voxel */
    float fit[8][8];      /* by child: its corners where they fit its samples best, less the exact ones */
    float misfit[8];    /* the largest error with those at the 27 samples and at points of faces; of divided children as
                           well, at the samples */
    int8_t left[8][27]; /* the error at the samples, in 127ths of it */
    int8_t at_face[8];  /* and at the point of a face that is worst off, */
    uint8_t face[8][3]; /* which lies there, in 255ths of a side */
    float rms[8];       /* its root mean square, of divided children as well */
    float exact[27];    /* signed distances */
    float final[27];    /* what is stored; see adf_fit.c */
} adf_node;

/* What has to be looked at again in a node since cells were divided; bytes, as threads set them. */
typedef struct adf_marks {
    uint8_t fresh;  /* it was made since */
    uint8_t wishes; /* what its leaves want may have changed, */
    uint8_t final;  /* what it is given, */
    uint8_t check;  /* whether its leaves are spoiled, */
    uint8_t probe;  /* and whether they miss a ridge */
} adf_marks;

/* What leaves want of a sample: the sum of weighted moves, and the weights. */
typedef struct adf_wish {
    float move, weight;
} adf_wish;

/* Nodes live in chunks, which threads fill on their own. */
#define ADF_CHUNK 1024u
#define ADF_CHUNK_COUNT (DF_FAMILY_COUNT_MAX / ADF_CHUNK)

typedef struct adf_tree {
    const df_adf_input *input;
    uint32_t level_count;
    double slope;           /* df_adf_input.rms_slope */
    bool pilot;             /* only a part of the cells of ADF_PILOT_LEVEL is divided */
    df_winding_slab *slabs; /* winding numbers of all samples, ADF_SLAB layers each; NULL for signed sources */
    uint32_t slab_count;
    adf_node **chunks;
    uint32_t chunk_count;
    uint64_t samples_computed;

    uint32_t family_count;

    /* By node, what adf_fit keeps from round to round: */
    uint32_t room; /* nodes that there is room for */
    adf_marks *marks;
    adf_wish (*wishes)[27];   /* NULL where samples stay exact */
    df_neighbours neighbours; /* around: nodes, by node; starts: where the levels begin in order */
    uint32_t *order;          /* the nodes in it, by level */

    /* Breadth first, once adf_number has run, and then order as well: */
    df_family *families;
} adf_tree;

#define ADF_SLAB 16u
#define ADF_PILOT_LEVEL 4
#define ADF_PILOT_PART 8 /* 1 of so many cells */

static inline adf_node *adf_node_at(const adf_tree *t, uint32_t number) {
    return &t->chunks[number / ADF_CHUNK][number % ADF_CHUNK];
}

/* The side of cells on a level, in voxels. */
static inline uint32_t adf_side(const adf_tree *t, uint32_t level) { return 1u << (t->level_count - level); }

/* A cell to be looked at, and divided where that is needed. */
typedef struct adf_task {
    uint32_t parent, child; /* whose child it is; parent ADF_NONE for the root */
    bool forced;            /* divided at any rate, not for its error; its crossed children by their error */
} adf_task;

/* Works at cells and all below. */
df_status adf_divide(adf_tree *t, const adf_task *tasks, uint32_t count, df_error *err);

/* Sets the final values of all nodes, of which adf_divide made those at the tasks and below since the last time: only
 * what these change is looked at. */
df_status adf_fit(adf_tree *t, const adf_task *tasks, uint32_t count, df_error *err);

/* Lists the leaves that must be divided then, without repetition: *tasks is owned by the caller. */
df_status adf_find_spoiled(adf_tree *t, int round, adf_task **tasks, uint32_t *count, df_error *err);

/* Lists the leaves that miss a ridge of the distance between their samples: *tasks is owned by the caller. */
df_status adf_find_ridges(adf_tree *t, adf_task **tasks, uint32_t *count, df_error *err);

/* Numbers the nodes breadth first, and makes families of them, which store() takes. */
df_status adf_number(adf_tree *t, df_error *err);

#endif
