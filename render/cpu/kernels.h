/*
 * The inner loops, compiled once for every instruction set from one source each (kernel_*.c over lane.h). All
 * instruction sets give the same bits; scalar is the specification.
 */
#ifndef DF_KERNELS_H
#define DF_KERNELS_H

#include "render/cpu/bounds.h"
#include "render/tracer.h"

/* What is drawn of hits: everything that shading needs besides them. */
typedef struct df_shade_job {
    const df_scene *scene;
    const df_tile *tile;
    int gradient;
    const uint8_t *table; /* df_shade_table */
    uint32_t picture_width;
    uint8_t *rgb; /* of the whole picture; NULL: not wanted, as the others */
    float *depth, *normals;
} df_shade_job;

/* What gradients need around the leaves of an octree that the surface crosses (DF_REACH_FACES): all samples decoded,
 * and those beyond the three outer faces of each such leaf. (Beyond the others are its siblings.) A leaf's number is
 * that of its first sibling, by family, and 1 for each before it. */
struct df_leaf_stencils {
    float (*samples)[DF_FAMILY_SAMPLE_COUNT]; /* by family */
    uint32_t *first;                          /* by family */
    /* By leaf and axis, in the order of df_leaf_beyond. outer[..][0][0] is NaN where some are beyond the field's box.
     */
    float (*outer)[3][4];
};

/* One bit a child, every other one. */
static inline uint32_t df_leaf_surface_bits(uint32_t states) { return states >> 1 & ~states & 0x5555; }

/* How many of the even bits below 16 are set, where no others are. */
static inline uint32_t df_even_bit_count(uint32_t bits) {
    return ((bits & 0x3333) + (bits >> 2 & 0x3333)) * 0x1111 >> 12 & 15;
}

/* The number of a leaf, 8 * family + child, that the surface crosses. */
static inline uint32_t df_leaf_stencil_number(const df_leaf_stencils *stencils, const df_field *field, uint32_t leaf) {
    const uint32_t bits = df_leaf_surface_bits(field->families[leaf >> 3].states);
    return stencils->first[leaf >> 3] + df_even_bit_count(bits & ((1u << 2 * (leaf & 7)) - 1));
}

/* The corners of a leaf. */
static inline void df_leaf_corners_kept(const df_leaf_stencils *stencils, uint32_t leaf, float corner[8]) {
    const float *first = stencils->samples[leaf >> 3] + df_family_corner(leaf & 7, 0);
    for (uint32_t c = 0; c < 8; c++) corner[c] = first[df_family_corner(0, c)];
}

/* The cells of a scene that rays can hit as records, block by block: object-order tracers read these instead of the
 * field. Cells are voxels, of blocks of k*k*k; or leaves of an octree, of aligned cubes of 8*8*8 voxels, where a larger
 * leaf is a block of its own. A record tells the voxel's bit in its block's mask (its place in the block, axis by axis
 * k_shift bits), a box around the surface in it, in eighths of the cell (by axis 3 bits for where it begins and 3 for
 * the last eighth that it reaches), and of a leaf the logarithm of its size and whether rays that it is the first leaf
 * of may start inside. */
#define DF_SURFACE_LOW 9
#define DF_SURFACE_HIGH 18
#define DF_SURFACE_SIZE 27
#define DF_SURFACE_BORDER 0x80000000u
typedef struct df_surface {
    uint32_t *first;     /* by block: index of its first record; first[block_count] is the number of records */
    uint32_t *voxels;    /* by record, padded by DF_RAY_PADDING */
    void *corners;       /* by record: the 8 samples at the corners, as the field stores them; of octrees decoded */
    uint32_t *corner[3]; /* by block: its lower corner in voxels; one allocation, corner[0], padded by DF_RAY_PADDING */
    uint32_t *leaves;    /* by record: 8 * family + child; NULL: no octree */
    uint8_t *block_log2; /* by block: the logarithm of its size in voxels; NULL: all k_shift */
    df_leaf_stencils stencils; /* of octrees */
    uint64_t stencil_bytes;
    uint32_t k_shift, block_count, record_count;
    df_sample_type sample_type; /* of corners */
    bool has_border;            /* some record has DF_SURFACE_BORDER */
} df_surface;

/* A block as a view sees it: the pixels that it may cover, inclusive, none where x1 < x0, and the least t at which rays
 * can meet it. */
typedef struct df_block_rect {
    uint16_t x0, y0, x1, y1;
    float t_near;
} df_block_rect;

/* From grid space to a picture: a point at eye + w * (direction through pixel (x,y)) has rows * (point - eye) = (w, w
 * x, w y). */
typedef struct df_projection {
    float rows[3][3];
    float eye[3];
} df_projection;

/* One tile of an object-order tracer: blocks in, from front to back, the first accepted voxel of each ray out. */
typedef struct df_splat_job {
    const df_scene *scene;
    const df_surface *surface;
    const df_projection *projection;
    const df_tile *tile;
    const df_block_rect *rects; /* by block */
    const uint32_t *order;      /* blocks */
    uint32_t count;
    int isolate;      /* DF_SOLVE_ISOLATES */
    float *depth;     /* by ray, INFINITY at first: t of entry into the accepted voxel */
    uint32_t *record; /* by ray, with DF_SPLAT_BACK where the ray comes from inside */
    uint32_t *block;  /* by ray */
} df_splat_job;
#define DF_SPLAT_BACK 0x80000000u

/* A tile of rays for the packet tracers. */
#define DF_CGT_PACKET_MAX 32u
typedef struct df_packet_job {
    const df_scene *scene;
    const df_tile *tile;
    const df_bounds *bounds; /* of the tile's rays; NULL: none */
    int isolate;             /* DF_SOLVE_ISOLATES */
    uint32_t packet;  /* cgt: edge of the square of rays that go together, a power of two up to DF_CGT_PACKET_MAX */
    double footprint; /* adf: cells no larger than this * t, voxels, are not divided; 0: all are */
    uint32_t split;   /* packet: as in df_walk_options */
    /* packet: walks a ray of the tile alone, from `first` on; true for a hit */
    bool (*alone)(const struct df_packet_job *job, uint32_t ray, float first, df_candidate *candidate,
                  df_counters *counters);
    bool clip; /* cgt: look only at voxels that the packet's bounds meet */
} df_packet_job;

/* What t_base adds to footprint * t for a ray, as a float: the same for all tracers. */
static inline float df_footprint_base(double footprint, const df_rays *rays, uint32_t ray) {
    return rays->t_base ? (float)(rays->t_base[ray] * footprint) : 0;
}

struct df_kernels {
    const char *isa; /* "scalar", "sse4.1", "avx2", "avx512" */
    uint32_t lanes;

    /* Rays of a near view (rebase = 0): origins, directions and inverses of a rectangle, without padding. */
    void (*view_rays)(const df_view *view, uint32_t x, uint32_t y, uint32_t width, uint32_t height, df_rays *rays);

    /* Solves accepted cells in double and appends them to hits: the last step of every tracer that walks cells. Appends
     * nothing else. */
    void (*solve)(const df_scene *scene, const df_trace_options *options, const df_rays *rays,
                  const df_candidate *candidates, uint32_t count, df_hits *hits);

    /* Walks the rays of a tile in packets; returns the number of candidates, of which there is room for one a ray. */
    uint32_t (*packet)(const df_packet_job *job, df_candidate *candidates, df_counters *counters);

    /* The same by coherent grid traversal; rays share their origin and the scene has two levels. */
    uint32_t (*cgt)(const df_packet_job *job, df_candidate *candidates, df_counters *counters);

    /* The same through an octree. */
    uint32_t (*adf)(const df_packet_job *job, df_candidate *candidates, df_counters *counters);

    /* Adds the boxes of a block's records, whose corners are there, to surface->voxels, widened by `margin` voxels. Not
     * of octrees. */
    void (*surface_boxes)(const df_scene *scene, const df_surface *surface, uint32_t block, float margin);

    /* What `count` blocks from `first` on cover of a picture, or of some rows of it: a tile of which the rays are not
     * looked at, with x = 0. */
    void (*block_rects)(const df_surface *surface, const df_projection *projection, const df_tile *picture,
                        uint32_t first, uint32_t count, df_block_rect *rects);

    /* Finds the accepted voxels of a tile. The depth array must be padded by DF_RAY_PADDING. */
    void (*splat)(const df_splat_job *job, df_counters *counters);

    /* Solves them and appends them to hits. */
    void (*splat_solve)(const df_splat_job *job, const df_trace_options *options, df_hits *hits);

    /* Gradient, normal, light and depth of hits, written to their pixels. */
    void (*shade)(const df_shade_job *job, const df_hits *hits);
};

extern const df_kernels df_kernels_scalar, df_kernels_sse41, df_kernels_avx2, df_kernels_avx512;

/* The kernels of an instruction set by name, or with "auto" the widest that this processor has. DF_ERROR_UNSUPPORTED
 * for one that it lacks, DF_ERROR_USAGE for an unknown name. */
df_status df_kernels_select(const char *isa, const df_kernels **out, df_error *err);

#endif
