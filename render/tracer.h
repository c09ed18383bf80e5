/*
 * Tracers: ways to find the first hit of rays.
 *
 * A tracer gets a tile of rays and returns its hits; it knows nothing of gradients and colours. They are a second pass
 * over hits (frame.h), the same for all tracers. A tile is usually a small rectangle of pixels, traced by one thread of
 * many; for a tracer with whole_frame set it is the whole picture; and without a view it is a buffer of arbitrary rays.
 * All tracers of df_tracers give the same hits, bit for bit, for the same solve.
 */
#ifndef DF_TRACER_H
#define DF_TRACER_H

#include "render/scene.h"
#include "render/view.h"

/* Hits as arrays, only those that there are, in any order. The arrays hold DF_RAY_PADDING entries more than capacity,
 * so that whole vectors may be stored at the end. */
#define DF_HIT_BACK 1u      /* the ray came from inside: what it sees is a back face */
#define DF_HIT_SIZE_SHIFT 4 /* from here on: the binary logarithm of the cell's size in voxels; 0 but for octrees */
typedef struct df_leaf_stencils df_leaf_stencils; /* kernels.h */
typedef struct df_hits {
    uint32_t count, capacity;
    uint32_t *ray;     /* index of the ray in its tile */
    uint16_t *cell[3]; /* the voxel, or the lower corner of the leaf */
    uint32_t *block; /* its brick or mask block (df_scene_block); 0 for uniform fields; of a leaf 8 * family + child */
    uint8_t *flags;
    float *local[3];     /* position in the cell, [0,1]^3 */
    float *direction[3]; /* the ray's, where the hits are the solve's: without has_normals */
    double *t;           /* along the ray as the caller knows it: t_base included */
    float *normal[3]; /* world directions towards the outside, of any length: of tracers that draw something else than
                         the field */
    const df_leaf_stencils *stencils; /* of a tracer that keeps them; NULL: there are none. Borrowed */
    bool has_normals;                 /* set by such tracers; otherwise shading takes the field's gradient */
} df_hits;

df_status df_hits_alloc(uint32_t capacity, df_hits *hits, df_error *err);
void df_hits_free(df_hits *hits);

/* What was done, summed over rays; threads have one each. */
typedef struct df_counters {
    uint64_t coarse_steps, fine_steps;  /* cells visited */
    uint64_t cells_tested;              /* cell segments whose field values were computed */
    uint64_t lanes_active, lanes_total; /* of SIMD steps */
    double solve_ms;                    /* time that went into solving accepted cells; 0 for tracers that do not tell */
} df_counters;

/* Called before each tile is a place to put what the tile's rays are. */
typedef struct df_tile {
    const df_view *view; /* NULL: arbitrary rays, x and y are meaningless, width = rays.count, height = 1 */
    uint32_t x, y, width, height;
    df_rays rays; /* row by row */
} df_tile;

/* The interval pre-pass of views (cpu/bounds.h): what is projected. */
#define DF_BOUNDS_NONE 0
#define DF_BOUNDS_BRICKS 1 /* the part of each block that holds surface */
#define DF_BOUNDS_VOXELS 2 /* each surface voxel */
#define DF_BOUNDS_GL 3     /* as bricks, drawn by OpenGL */

/* The numbers that a cell solve computes with. Walks are in float always, t in double. */
#define DF_PRECISION_F64 0
#define DF_PRECISION_F32 1

/* How tracers go about finding hits, which they are for, and what changes no hit. Zero: the defaults. */
typedef struct df_walk_options {
    uint32_t packet; /* cgt: rays along an edge of a packet, a power of two up to 32; 0: 8 */
    bool no_clip;    /* cgt: look at all voxels of a block, not only at those in the packet's bounds */
    int bounds;      /* DF_BOUNDS_...: for tracers that have takes_bounds */
    double lod;      /* octrees: cells are not divided where they are smaller than so many pixels; 0: always */
    uint32_t split;  /* dda-packet: once so few rays of a packet are left, each walks on alone; 0: never */
} df_walk_options;

typedef struct df_trace_options {
    const df_kernels *kernels;        /* the instruction set to use */
    int solve;                        /* DF_SOLVE_... of solve.h */
    int steps;                        /* of the solve; 0: df_solve_steps */
    int precision;                    /* DF_PRECISION_...: of the solve; F64 only with DF_SOLVE_ANALYTIC */
    int filter;                       /* DF_FILTER_...: of df_tracer_tricubic */
    uint32_t threads;                 /* at most so many call trace at a time, with numbers 0 .. threads - 1 */
    uint32_t tile_width, tile_height; /* of the largest tile; tiles of a view start at multiples of them, rows counted
                                         from begin_frame's first */
    df_walk_options walk;
} df_trace_options;

typedef struct df_tracer df_tracer;
struct df_tracer {
    const char *name;
    const char *summary; /* for --help */
    bool whole_frame;    /* wants one tile, the picture, from one thread */
    bool own_methods;    /* hits and normals of its own: solve and gradient mean nothing to it */
    bool takes_bounds;   /* df_walk_options.bounds */

    /* Prepares a scene; the state belongs to the tracer and is released by it. The precomputation must not depend on a
     * view. */
    df_status (*prepare)(const df_scene *scene, const df_trace_options *options, void **state, df_error *err);
    void (*release)(void *state);
    /* NULL: it has to be prepared anew; or takes another solve, steps and precision for the tiles that follow, out of
     * options that are those of prepare in all else. */
    void (*set_method)(void *state, const df_trace_options *options);
    /* NULL or the bytes that prepare added for the scene, workspaces of threads not counted. */
    uint64_t (*bytes)(const void *state);
    /* NULL or the time within prepare that went into extracting a mesh. */
    double (*extract_ms)(const void *state);
    /* NULL, or false where the tracer cannot do this view (tiles without a view are arbitrary rays: view is NULL). */
    bool (*suits)(const df_scene *scene, const df_view *view);
    /* NULL or called once before the tiles of a picture, or of some rows of it. */
    df_status (*begin_frame)(void *state, const df_view *view, uint32_t first_row, uint32_t row_count, df_error *err);
    /* NULL, or false where no ray of the tile can hit: its rays are then not even made. tile->rays is not valid yet. */
    bool (*touches)(const void *state, const df_tile *tile);
    /* Appends the hits of a tile to hits, which is empty and has room for one a ray. */
    df_status (*trace)(void *state, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                       df_error *err);
};

extern const df_tracer df_tracer_adf_packet, df_tracer_adf, df_tracer_cgt, df_tracer_dda, df_tracer_packet,
    df_tracer_splat;
extern const df_tracer df_tracer_mc_embree, df_tracer_mc_raster; /* where they were built in */

/* Another field between the samples: cubic reconstruction, which --filter asks for. */
extern const df_tracer df_tracer_tricubic;

/* All tracers of the field, the fastest first, and those that draw its marching-cubes mesh instead, as far as built in;
 * ended by NULL. */
extern const df_tracer *const df_tracers[];
extern const df_tracer *const df_mc_tracers[];
const df_tracer *df_tracer_find(const char *name); /* NULL: no such tracer */

/* The fastest tracer that suits a scene and a view, and takes the bounds that the options ask for: what --tracer auto
 * takes. walk: NULL: no wishes. */
const df_tracer *df_tracer_choose(const df_scene *scene, const df_view *view, const df_walk_options *walk);

/* The same where only one picture of the scene will be made: one that has too few pixels to repay what splat prepares
 * goes to the next. *repays: the pixels that it takes; 0 where there was nothing to weigh. */
const df_tracer *df_tracer_choose_once(const df_scene *scene, const df_view *view, const df_walk_options *walk,
                                       uint64_t *repays);

/* Names of solves, precisions, gradients, bounds and filters, by number, ended by NULL. */
extern const char *const df_solve_names[];
extern const char *const df_precision_names[];
extern const char *const df_gradient_names[];
extern const char *const df_bounds_names[];
extern const char *const df_filter_names[];

/* The default of --steps. Linear, midpoint, analytic: 0. Repeated, marmitt: interpolations after the first (3). Robust:
 * Illinois steps at most (16). */
int df_solve_steps(int solve);

/* A cell that a walk has accepted for a ray of its tile: to be solved. */
typedef struct df_candidate {
    uint32_t ray, block;
    uint16_t cell[3];
    uint8_t flags;
} df_candidate;

#endif
