#include "common/memory.h"
#include "render/mesh/mc_cell.h"
#include "render/mesh/mc_private.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <omp.h>
#include <stdlib.h>
#include <string.h>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

enum { SIDE_MAX = 9, FACE_MAX = SIDE_MAX * SIDE_MAX, CUBE_MAX = FACE_MAX * SIDE_MAX, BATCH_MAX = 256 };

/* Samples of a block are numbered x + SIDE_MAX * y + FACE_MAX * z, whatever its size. */
static const uint16_t AXIS_STEP[3] = {1, SIDE_MAX, FACE_MAX};

/*
 * The field in blocks of k^3 voxels: its bricks, or cubes of a dense field. A block owns the grid edges that start in
 * it (half open: the sample at its lower end, but not those on its upper faces), and the last block of an axis also
 * those on its upper face. A vertex is numbered by its block, then by the edge's row (z, then y, then axis) and x;
 * after them come vertices within voxels.
 */
typedef struct block {
    uint32_t cell; /* linear index in the grid of blocks */
    uint32_t vertex_first;
    uint32_t triangle_first;
    uint32_t edge_count; /* owned edges with a vertex */
} block;

/* What the first pass learns of a block and the second needs, also from the block's neighbours; rows y + (k+1) z. */
typedef struct signs {
    uint16_t *inside;      /* by row: bit x is set where the sample is inside */
    uint16_t *layer_first; /* by z: the first of its vertices, counted from the block's first */
    uint8_t *row_first;    /* by row: the first of its vertices, counted from the layer's: 3 * 9 * 8 at most */
} signs;

typedef struct grid {
    const df_field *field;
    df_mc_params params;
    df_mc_tables tables;
    uint32_t k;
    uint32_t cell_count[3];
    uint32_t *block_of; /* by brick, or by cell of a dense field: its block, or DF_MC_NONE */
    block *blocks;      /* those at the surface, in the order of their cells */
    uint32_t block_count;
    uint8_t *signs; /* by block: sign_bytes, as get_signs divides them */
    uint32_t sign_bytes;
    uint8_t bit_count[1 << SIDE_MAX];   /* of a row */
    uint16_t edge_at[DF_MC_EDGE_COUNT]; /* by edge of a voxel: its place in scratch.index, from that of the voxel */
} grid;

/* How large a block is along each axis. */
typedef struct extent {
    uint32_t voxels[3]; /* k, less at the upper end of the field */
    uint32_t owned[3];  /* samples: voxels, plus 1 in the last block */
} extent;

/* A block being worked on. */
typedef struct view {
    uint32_t cell[3];
    extent size;
    const float *values; /* of its first sample */
    uint64_t stride[3];
} view;

/* The samples just beyond a face of a view: values[i * stride[0] + j * stride[1]] on the two next axes; NAN where
 * nothing is stored. */
typedef struct beyond {
    const float *values;
    uint64_t stride[2];
} beyond;

/* Vertices on edges, to be computed many at a time. */
typedef struct batch {
    uint32_t count;
    uint8_t axis[BATCH_MAX], at[BATCH_MAX][3]; /* the edge runs along `axis` from this sample */
    double t[BATCH_MAX], rise[BATCH_MAX];      /* where on the edge, and how much the values rise along it */
    double gradient[3][BATCH_MAX], inverse_length[BATCH_MAX];
} batch;

/* What a thread works with. */
typedef struct scratch {
    view view;
    signs signs;
    float samples[CUBE_MAX]; /* decoded, where the field's are not float */
    beyond apron[6];         /* by face 2*axis + upper */
    float apron_samples[6][CUBE_MAX];
    uint32_t index[3 * CUBE_MAX]; /* by axis and lower end of an edge: its vertex */
    batch batch;
    df_mc_patch patch;
} scratch;

static void cell_coordinates(const grid *g, uint32_t cell, uint32_t at[3]) {
    at[0] = cell % g->cell_count[0];
    at[1] = cell / g->cell_count[0] % g->cell_count[1];
    at[2] = cell / g->cell_count[0] / g->cell_count[1];
}

/* The entry of block_of for a cell: its brick, or itself; DF_MC_NONE where nothing is stored. */
static uint32_t cell_slot(const grid *g, const uint32_t cell[3]) {
    for (int a = 0; a < 3; a++) {
        if (cell[a] >= g->cell_count[a]) return DF_MC_NONE; /* also below 0 */
    }
    uint64_t index = cell[0] + (uint64_t)g->cell_count[0] * (cell[1] + (uint64_t)g->cell_count[1] * cell[2]);
    if (g->field->kind == DF_FIELD_DENSE) return (uint32_t)index;
    uint32_t brick = g->field->cells[index];
    return brick < DF_CELL_INSIDE ? brick : DF_MC_NONE;
}

static void decode(const df_field *field, uint64_t first, uint32_t count, int exponent, float *out) {
    for (uint32_t i = 0; i < count; i++) out[i] = df_field_decode(field, first + i, exponent);
}

static extent extent_of(const grid *g, const uint32_t cell[3]) {
    extent e;
    for (int a = 0; a < 3; a++) {
        const uint32_t left = g->field->voxel_count[a] - cell[a] * g->k;
        e.voxels[a] = left < g->k ? left : g->k;
        e.owned[a] = e.voxels[a] + (cell[a] + 1 == g->cell_count[a]);
    }
    return e;
}

/* Points a view at a block's samples, decoded into `samples` where need be. `slot` as of cell_slot. */
static void open_view(const grid *g, const uint32_t cell[3], uint32_t slot, float samples[CUBE_MAX], view *v) {
    const df_field *field = g->field;
    uint32_t side = g->k + 1;
    uint64_t first, stride[3] = {1, side, (uint64_t)side * side};
    memcpy(v->cell, cell, sizeof v->cell);
    v->size = extent_of(g, cell);
    if (field->kind == DF_FIELD_DENSE) {
        stride[1] = (uint64_t)field->voxel_count[0] + 1;
        stride[2] = stride[1] * ((uint64_t)field->voxel_count[1] + 1);
        first = g->k * (cell[0] * stride[0] + cell[1] * stride[1] + cell[2] * stride[2]);
    } else {
        first = (uint64_t)slot * side * side * side;
    }
    if (field->sample_type == DF_SAMPLE_F32) {
        v->values = (const float *)field->samples + first;
        memcpy(v->stride, stride, sizeof stride);
        return;
    }
    int exponent = field->kind == DF_FIELD_DENSE ? field->step_exponent : field->brick_exponents[slot];
    for (uint32_t z = 0; z <= v->size.voxels[2]; z++) {
        for (uint32_t y = 0; y <= v->size.voxels[1]; y++) {
            decode(field, first + y * stride[1] + z * stride[2], v->size.voxels[0] + 1, exponent,
                   samples + side * (y + side * z));
        }
    }
    v->values = samples;
    v->stride[0] = 1;
    v->stride[1] = side;
    v->stride[2] = (uint64_t)side * side;
}

static inline float value_at(const view *v, uint32_t x, uint32_t y, uint32_t z) {
    return v->values[x + y * v->stride[1] + z * v->stride[2]];
}

/* Bit x is set where row[x] < iso, for x < count. */
static uint32_t row_inside(const float *row, uint32_t count, float iso) {
    uint32_t bits = 0, x = 0;
#ifdef __SSE2__
    for (; x + 4 <= count; x += 4)
        bits |= (uint32_t)_mm_movemask_ps(_mm_cmplt_ps(_mm_loadu_ps(row + x), _mm_set1_ps(iso))) << x;
#endif
    for (; x < count; x++) bits |= (uint32_t)(row[x] < iso) << x;
    return bits;
}

/* The signs of a view's samples as rows of bits. */
static void find_inside(const grid *g, const view *v, uint16_t *inside) {
    const float iso = g->params.iso;
    const uint32_t side = g->k + 1;
    for (uint32_t z = 0; z <= v->size.voxels[2]; z++) {
        for (uint32_t y = 0; y <= v->size.voxels[1]; y++) {
            const float *row = v->values + y * v->stride[1] + z * v->stride[2];
            inside[y + side * z] = (uint16_t)row_inside(row, v->size.voxels[0] + 1, iso);
        }
    }
}

/* Whether the samples of a view lie on both sides. */
static bool view_is_mixed(const grid *g, const view *v) {
    float iso = g->params.iso;
    uint32_t inside = 0, all = (v->size.voxels[0] + 1) * (v->size.voxels[1] + 1) * (v->size.voxels[2] + 1);
    for (uint32_t z = 0; z <= v->size.voxels[2]; z++) {
        for (uint32_t y = 0; y <= v->size.voxels[1]; y++) {
            const float *row = v->values + y * v->stride[1] + z * v->stride[2];
            for (uint32_t x = 0; x <= v->size.voxels[0]; x++) inside += row[x] < iso;
        }
    }
    return inside > 0 && inside < all;
}

/* Marks in block_of the slots at the surface with 0, the others with DF_MC_NONE. */
static void mark_slots(grid *g, uint32_t slot_count, scratch *all) {
    const df_field *field = g->field;
    float iso = g->params.iso;
#pragma omp parallel for schedule(dynamic, 64) num_threads(df_mc_threads(&g->params))
    for (uint32_t slot = 0; slot < slot_count; slot++) {
        bool mixed;
        if (field->kind == DF_FIELD_BRICKS) {
            const float *range = field->brick_ranges + 2 * (uint64_t)slot;
            mixed = range[0] < iso && range[1] >= iso;
        } else {
            scratch *s = &all[omp_get_thread_num()];
            uint32_t cell[3];
            cell_coordinates(g, slot, cell);
            open_view(g, cell, slot, s->samples, &s->view);
            mixed = view_is_mixed(g, &s->view);
        }
        g->block_of[slot] = mixed ? 0 : DF_MC_NONE;
        df_progress_add(g->params.progress, mixed ? 1 : 2);
    }
}

static signs get_signs(const grid *g, uint32_t block_number) {
    const uint32_t side = g->k + 1;
    uint16_t *inside = (uint16_t *)(void *)(g->signs + (uint64_t)block_number * g->sign_bytes);
    uint16_t *layers = inside + side * side;
    return (signs){.inside = inside, .layer_first = layers, .row_first = (uint8_t *)(layers + side)};
}

/* The edges with a vertex that start in row (y, z) of a block of size `e`, as bits by x, for the three axes. */
static inline void row_edges(const uint16_t *inside, uint32_t side, const extent *e, uint32_t y, uint32_t z,
                             uint32_t edges[3]) {
    const uint32_t own_x = (1u << e->owned[0]) - 1, here = inside[y + side * z];
    edges[0] = (here ^ here >> 1) & ((1u << e->voxels[0]) - 1);
    edges[1] = y < e->voxels[1] ? (here ^ inside[y + 1 + side * z]) & own_x : 0;
    edges[2] = z < e->voxels[2] ? (here ^ inside[y + side * (z + 1)]) & own_x : 0;
}

/* Sets up the blocks at the surface and the room for their signs. */
static df_status list_blocks(grid *g, scratch *all, df_error *err) {
    const df_field *field = g->field;
    bool bricks = field->kind == DF_FIELD_BRICKS;
    uint64_t cell_total = (uint64_t)g->cell_count[0] * g->cell_count[1] * g->cell_count[2];
    uint32_t slot_count = bricks ? field->brick_count : (uint32_t)cell_total;
    df_status status = df_alloc_raw((void **)&g->block_of, slot_count, sizeof *g->block_of, "blocks", err);
    if (status != DF_OK) return status;
    mark_slots(g, slot_count, all);
    for (uint32_t slot = 0; slot < slot_count; slot++) {
        if (g->block_of[slot] != DF_MC_NONE) g->block_of[slot] = g->block_count++;
    }
    status = df_alloc((void **)&g->blocks, g->block_count, sizeof *g->blocks, "blocks at the surface", err);
    if (status != DF_OK) return status;
    for (uint32_t slot = 0; slot < slot_count; slot++) {
        if (g->block_of[slot] != DF_MC_NONE)
            g->blocks[g->block_of[slot]].cell = bricks ? field->brick_cells[slot] : slot;
    }
    return df_alloc_raw((void **)&g->signs, g->block_count, g->sign_bytes, "signs at the surface", err);
}

/* The voxels of row (y, z) that the surface crosses, as bits; *rows: the signs along the row's four edges, 16 bits
 * each. */
static uint32_t crossed_voxels(const scratch *s, uint32_t side, uint32_t y, uint32_t z, uint64_t *rows) {
    const uint16_t *at = s->signs.inside + y + side * z;
    const uint32_t a = at[0], b = at[1], c = at[side], d = at[side + 1], any = a | b | c | d, all = a & b & c & d;
    *rows = a | (uint64_t)b << 16 | (uint64_t)c << 32 | (uint64_t)d << 48;
    return (any | any >> 1) & ~(all & all >> 1) & ((1u << s->view.size.voxels[0]) - 1);
}

/* The signs of a voxel's corners: two bits of each of the row's edges, which a product brings side by side (its other
 * terms end below bit 48 or beyond bit 63, and none meet). */
static uint32_t corner_signs(uint64_t rows, uint32_t x) {
    const uint64_t pairs = rows >> x & 0x0003000300030003;
    return (uint32_t)(pairs * (1ull << 48 | 1ull << 34 | 1ull << 20 | 1ull << 6) >> 48) & 0xFF;
}

/* Makes the surface of a voxel whose signs alone do not tell it. */
static void fill_voxel(const grid *g, scratch *s, uint32_t x, uint32_t y, uint32_t z) {
    double values[8];
    for (uint32_t c = 0; c < 8; c++) {
        values[c] = (double)value_at(&s->view, x + (c & 1), y + (c >> 1 & 1), z + (c >> 2)) - (double)g->params.iso;
    }
    df_status status = df_mc_cell_fill(&s->patch, values, NULL);
    assert(status == DF_OK); /* the patch got its room in make_scratch */
    (void)status;
}

/* First pass: the signs of a block, and how many vertices and triangles it makes. */
static void count_block(const grid *g, uint32_t number, scratch *s) {
    block *b = &g->blocks[number];
    const view *v = &s->view;
    uint32_t cell[3], side = g->k + 1;
    cell_coordinates(g, b->cell, cell);
    open_view(g, cell, cell_slot(g, cell), s->samples, &s->view);
    s->signs = get_signs(g, number);
    find_inside(g, v, s->signs.inside);
    b->edge_count = b->triangle_first = 0;
    for (uint32_t z = 0; z < v->size.owned[2]; z++) {
        uint32_t count = 0;
        for (uint32_t y = 0; y < v->size.owned[1]; y++) {
            uint32_t edges[3];
            row_edges(s->signs.inside, side, &v->size, y, z, edges);
            s->signs.row_first[y + side * z] = (uint8_t)count;
            count += (uint32_t)g->bit_count[edges[0]] + g->bit_count[edges[1]] + g->bit_count[edges[2]];
        }
        s->signs.layer_first[z] = (uint16_t)b->edge_count;
        b->edge_count += count;
    }
    b->vertex_first = b->edge_count;
    for (uint32_t z = 0; z < v->size.voxels[2]; z++) {
        for (uint32_t y = 0; y < v->size.voxels[1]; y++) {
            uint64_t rows;
            for (uint32_t left = crossed_voxels(s, side, y, z, &rows); left; left &= left - 1) {
                uint32_t x = (uint32_t)__builtin_ctz(left), count = g->tables.triangle_count[corner_signs(rows, x)];
                if (count == DF_MC_BY_VALUES) {
                    fill_voxel(g, s, x, y, z);
                    count = s->patch.triangle_count;
                    b->vertex_first += s->patch.position_count - DF_MC_EDGE_COUNT;
                }
                b->triangle_first += count;
            }
        }
    }
}

/* Turns the blocks' counts into where they start; the sums are the totals. */
static void sum_counts(grid *g, uint64_t *vertex_count, uint64_t *triangle_count) {
    *vertex_count = *triangle_count = 0;
    for (uint32_t i = 0; i < g->block_count; i++) {
        uint32_t vertices = g->blocks[i].vertex_first, triangles = g->blocks[i].triangle_first;
        g->blocks[i].vertex_first = (uint32_t)*vertex_count;
        g->blocks[i].triangle_first = (uint32_t)*triangle_count;
        *vertex_count += vertices;
        *triangle_count += triangles;
    }
}

/* Enters the vertices of the edges that the block at offset d (0 or 1 an axis, not 0 on all) owns and the view's voxels
 * use: those at its lower end on the axes where d is 1. */
static void enter_neighbour(const grid *g, scratch *s, const uint32_t d[3]) {
    uint32_t cell[3];
    const uint32_t side = g->k + 1;
    for (int a = 0; a < 3; a++) cell[a] = s->view.cell[a] + d[a];
    const uint32_t slot = cell_slot(g, cell);
    if (slot == DF_MC_NONE || g->block_of[slot] == DF_MC_NONE) return;
    const uint32_t block_number = g->block_of[slot], first = g->blocks[block_number].vertex_first;
    const signs n = get_signs(g, block_number);
    const extent e = extent_of(g, cell);
    const uint32_t y_end = d[1] ? 1 : e.owned[1], z_end = d[2] ? 1 : e.owned[2], x_mask = d[0] ? 1 : ~0u;
    uint32_t *const corner = s->index + g->k * (d[0] * AXIS_STEP[0] + d[1] * AXIS_STEP[1] + d[2] * AXIS_STEP[2]);
    for (uint32_t z = 0; z < z_end; z++) {
        for (uint32_t y = 0; y < y_end; y++) {
            uint32_t edges[3];
            row_edges(n.inside, side, &e, y, z, edges);
            if (!((edges[0] | edges[1] | edges[2]) & x_mask)) continue;
            uint32_t number = first + n.layer_first[z] + n.row_first[y + side * z];
            for (uint32_t axis = 0; axis < 3; axis++) {
                uint32_t *out = corner + y * AXIS_STEP[1] + z * AXIS_STEP[2] + axis * CUBE_MAX, vertex = number;
                for (uint32_t bits = edges[axis] & x_mask; bits; bits &= bits - 1) out[__builtin_ctz(bits)] = vertex++;
                number += g->bit_count[edges[axis]];
            }
        }
    }
}

/* Finds the samples just beyond the faces of the view, for gradients. They are read where a vertex needs them: few are,
 * and they lie in lines of memory of their own. */
static void open_apron(const grid *g, scratch *s) {
    static const float nothing = NAN;
    for (uint32_t face = 0; face < 6; face++) {
        const uint32_t axis = face / 2, upper = face & 1, u = axis == 2 ? 0 : axis + 1, w = axis == 0 ? 2 : axis - 1;
        uint32_t cell[3];
        memcpy(cell, s->view.cell, sizeof cell);
        cell[axis] += upper ? 1 : (uint32_t)-1;
        const uint32_t slot = cell_slot(g, cell);
        s->apron[face] = (beyond){.values = &nothing};
        if (slot == DF_MC_NONE) continue;
        view other;
        open_view(g, cell, slot, s->apron_samples[face], &other);
        s->apron[face] = (beyond){.values = other.values + (upper ? 1 : g->k - 1) * other.stride[axis],
                                  .stride = {other.stride[u], other.stride[w]}};
    }
}

static const float *beyond_at(const beyond *b, uint32_t i, uint32_t j) {
    return b->values + i * b->stride[0] + j * b->stride[1];
}

/* Central differences at a sample of the view, per voxel; one-sided where the other side is not stored. */
static inline void sample_gradient(const scratch *s, const float *here, const uint32_t at[3], double gradient[3]) {
    const view *v = &s->view;
    double low[3], high[3];
    for (uint32_t axis = 0; axis < 3; axis++) {
        const uint32_t i = at[axis == 2 ? 0 : axis + 1], j = at[axis == 0 ? 2 : axis - 1];
        const float *below = beyond_at(&s->apron[2 * axis], i, j), *above = beyond_at(&s->apron[2 * axis + 1], i, j);
        low[axis] = (double)*(at[axis] > 0 ? here - v->stride[axis] : below);
        high[axis] = (double)*(at[axis] < v->size.voxels[axis] ? here + v->stride[axis] : above);
        gradient[axis] = 0.5 * (high[axis] - low[axis]);
    }
    if (!isnan(gradient[0] + gradient[1] + gradient[2])) return;
    for (int axis = 0; axis < 3; axis++) {
        if (isnan(low[axis])) gradient[axis] = isnan(high[axis]) ? 0 : high[axis] - (double)*here;
        else if (isnan(high[axis])) gradient[axis] = (double)*here - low[axis];
    }
}

/* The gradients at the vertices of the batch: those at the ends of their edges, interpolated. */
static void batch_gradients(const grid *g, scratch *s) {
    batch *b = &s->batch;
    const view *v = &s->view;
    const double *size = g->field->voxel_size;
    const bool cubes = size[0] == size[1] && size[0] == size[2];
    for (uint32_t i = 0; i < b->count; i++) {
        const uint32_t axis = b->axis[i];
        uint32_t at[3] = {b->at[i][0], b->at[i][1], b->at[i][2]};
        const float *here = v->values + at[0] + at[1] * v->stride[1] + at[2] * v->stride[2];
        double low[3], high[3];
        sample_gradient(s, here, at, low);
        at[axis]++;
        sample_gradient(s, here + v->stride[axis], at, high);
        for (int a = 0; a < 3; a++) {
            const double mixed = (1 - b->t[i]) * low[a] + b->t[i] * high[a];
            b->gradient[a][i] = cubes ? mixed : mixed / size[a];
        }
        if (b->gradient[0][i] != 0 || b->gradient[1][i] != 0 || b->gradient[2][i] != 0) continue;
        b->gradient[axis][i] = b->rise[i];
    }
}

/* As df_mc_normal, for the batch: loops that run in lanes. */
static void batch_normals(batch *b, float *normals) {
    double *x = b->gradient[0], *y = b->gradient[1], *z = b->gradient[2];
    for (uint32_t i = 0; i < b->count; i++) {
        const double ax = fabs(x[i]), ay = fabs(y[i]), az = fabs(z[i]), xy = ax > ay ? ax : ay;
        const double scale = 1 / (xy > az ? xy : az);
        x[i] *= scale;
        y[i] *= scale;
        z[i] *= scale;
        b->inverse_length[i] = 1 / sqrt(x[i] * x[i] + y[i] * y[i] + z[i] * z[i]);
    }
    for (uint32_t i = 0; i < b->count; i++, normals += 3) {
        for (int a = 0; a < 3; a++) normals[a] = (float)(b->gradient[a][i] * b->inverse_length[i]);
    }
}

/* Writes the vertices of the batch as those from `vertex` on, and empties it. */
static void write_batch(const grid *g, scratch *s, uint64_t vertex, df_mc_mesh *mesh) {
    batch *b = &s->batch;
    const view *v = &s->view;
    const double iso = (double)g->params.iso;
    double corner[3];
    for (int a = 0; a < 3; a++) corner[a] = (double)v->cell[a] * g->k;
    for (uint32_t i = 0; i < b->count; i++) {
        const float *here = v->values + b->at[i][0] + b->at[i][1] * v->stride[1] + b->at[i][2] * v->stride[2];
        b->t[i] = (double)here[0] - iso;
        b->rise[i] = ((double)here[v->stride[b->axis[i]]] - iso) - b->t[i];
    }
    for (uint32_t i = 0; i < b->count; i++) b->t[i] /= -b->rise[i];
    double *position = mesh->positions + 3 * vertex;
    for (uint32_t i = 0; i < b->count; i++, position += 3) {
        for (int a = 0; a < 3; a++) position[a] = corner[a] + b->at[i][a];
        position[b->axis[i]] += b->t[i];
    }
    if (mesh->normals) {
        batch_gradients(g, s);
        batch_normals(b, mesh->normals + 3 * vertex);
    }
    b->count = 0;
}

/* The vertices that a block owns: written, and entered in the index. */
static void write_edge_vertices(const grid *g, const block *block_of_view, scratch *s, df_mc_mesh *mesh) {
    const uint32_t side = g->k + 1;
    const extent *e = &s->view.size;
    batch *b = &s->batch;
    uint32_t written = block_of_view->vertex_first;
    if (mesh->normals) open_apron(g, s);
    for (uint32_t z = 0; z < e->owned[2]; z++) {
        for (uint32_t y = 0; y < e->owned[1]; y++) {
            uint32_t edges[3];
            row_edges(s->signs.inside, side, e, y, z, edges);
            if (!(edges[0] | edges[1] | edges[2])) continue;
            for (uint32_t axis = 0; axis < 3; axis++) {
                uint32_t *out = s->index + y * AXIS_STEP[1] + z * AXIS_STEP[2] + axis * CUBE_MAX;
                for (uint32_t bits = edges[axis]; bits; bits &= bits - 1) {
                    const uint32_t x = (uint32_t)__builtin_ctz(bits), i = b->count++;
                    out[x] = written + i;
                    b->axis[i] = (uint8_t)axis;
                    b->at[i][0] = (uint8_t)x;
                    b->at[i][1] = (uint8_t)y;
                    b->at[i][2] = (uint8_t)z;
                }
            }
            if (b->count <= BATCH_MAX - 3 * SIDE_MAX) continue;
            const uint32_t count = b->count;
            write_batch(g, s, written, mesh);
            written += count;
        }
    }
    write_batch(g, s, written, mesh);
}

/* The normal within a voxel: the trilinear gradient there. */
static void interior_normal(const grid *g, const scratch *s, const uint32_t at[3], const double local[3],
                            float *normal) {
    float corners[8];
    double gradient[3], up[3] = {0, 0, 1};
    for (uint32_t c = 0; c < 8; c++)
        corners[c] = value_at(&s->view, at[0] + (c & 1), at[1] + (c >> 1 & 1), at[2] + (c >> 2));
    df_trilinear_gradient(corners, local, gradient);
    df_mc_normal(g->field, gradient, up, normal);
}

/* Writes the triangles of a voxel that fill_voxel made, and its interior vertices from *vertex on. index: at the voxel.
 */
static void write_patch(const grid *g, const scratch *s, const uint32_t at[3], const uint32_t *index, uint64_t *vertex,
                        uint32_t *triangles, df_mc_mesh *mesh) {
    const df_mc_patch *patch = &s->patch;
    for (uint32_t t = 0; t < patch->triangle_count; t++) {
        for (int i = 0; i < 3; i++) {
            uint32_t local = patch->triangles[t][i];
            *triangles++ =
                local < DF_MC_EDGE_COUNT ? index[g->edge_at[local]] : (uint32_t)*vertex + local - DF_MC_EDGE_COUNT;
        }
    }
    for (uint32_t p = DF_MC_EDGE_COUNT; p < patch->position_count; p++, ++*vertex) {
        double *out = mesh->positions + 3 * *vertex;
        for (int a = 0; a < 3; a++) out[a] = (double)s->view.cell[a] * g->k + at[a] + patch->positions[p][a];
        if (mesh->normals) interior_normal(g, s, at, patch->positions[p], mesh->normals + 3 * *vertex);
    }
}

/* Second pass: the vertices and triangles of a block. Returns false where a neighbouring brick lacks a vertex. */
static bool write_block(const grid *g, uint32_t number, scratch *s, df_mc_mesh *mesh) {
    const block *b = &g->blocks[number];
    uint32_t cell[3], side = g->k + 1;
    cell_coordinates(g, b->cell, cell);
    open_view(g, cell, cell_slot(g, cell), s->samples, &s->view);
    s->signs = get_signs(g, number);
    memset(s->index, 0xFF, sizeof s->index);
    write_edge_vertices(g, b, s, mesh);
    for (uint32_t d = 1; d < 8; d++) enter_neighbour(g, s, (uint32_t[3]){d & 1, d >> 1 & 1, d >> 2});
    uint64_t vertex = (uint64_t)b->vertex_first + b->edge_count;
    uint32_t *out = mesh->triangles + 3 * (uint64_t)b->triangle_first, *first = out;
    for (uint32_t z = 0; z < s->view.size.voxels[2]; z++) {
        for (uint32_t y = 0; y < s->view.size.voxels[1]; y++) {
            uint64_t rows;
            for (uint32_t left = crossed_voxels(s, side, y, z, &rows); left; left &= left - 1) {
                const uint32_t x = (uint32_t)__builtin_ctz(left), corners = corner_signs(rows, x);
                const uint32_t *index = s->index + x + y * AXIS_STEP[1] + z * AXIS_STEP[2];
                uint32_t count = g->tables.triangle_count[corners];
                if (count == DF_MC_BY_VALUES) {
                    fill_voxel(g, s, x, y, z);
                    write_patch(g, s, (uint32_t[3]){x, y, z}, index, &vertex, out, mesh);
                    out += 3 * (uint64_t)s->patch.triangle_count;
                    continue;
                }
                const uint8_t *edge = g->tables.triangles[corners][0];
                for (uint32_t i = 0; i < 3 * count; i++) *out++ = index[g->edge_at[edge[i]]];
            }
        }
    }
    uint32_t missing = 0;
    for (const uint32_t *i = first; i < out; i++) missing |= *i == DF_MC_NONE;
    return !missing;
}

static void free_scratch(scratch *all, int count) {
    for (int i = 0; all && i < count; i++) df_mc_patch_free(&all[i].patch);
    free(all);
}

static df_status make_scratch(scratch **all, int count, df_error *err) {
    df_status status = df_alloc((void **)all, (uint64_t)count, sizeof **all, "marching cubes", err);
    for (int i = 0; status == DF_OK && i < count; i++)
        status = df_mc_patch_begin(&(*all)[i].patch, DF_MC_EDGE_COUNT, err);
    return status;
}

static df_status extract_listed(grid *g, const char *name, scratch *all, df_mc_mesh *mesh, df_error *err) {
    df_status status = list_blocks(g, all, err);
    if (status != DF_OK) return status;
    int threads = df_mc_threads(&g->params); // NOLINT(clang-analyzer-deadcode.DeadStores): the pragma reads it
#pragma omp parallel for schedule(dynamic, 16) num_threads(threads)
    for (uint32_t i = 0; i < g->block_count; i++) count_block(g, i, &all[omp_get_thread_num()]);
    uint64_t vertex_count, triangle_count, incomplete = 0;
    sum_counts(g, &vertex_count, &triangle_count);
    if (!triangle_count) return DF_OK;
    status = df_mc_mesh_allocate(mesh, name, vertex_count, triangle_count, !g->params.skip_normals, err);
    if (status != DF_OK) return status;
#pragma omp parallel for schedule(dynamic, 16) num_threads(threads) reduction(+ : incomplete)
    for (uint32_t i = 0; i < g->block_count; i++) {
        incomplete += !write_block(g, i, &all[omp_get_thread_num()], mesh);
        df_progress_add(g->params.progress, 1);
    }
    if (!incomplete) return DF_OK;
    df_mc_mesh_free(mesh);
    return df_fail(err, DF_ERROR_FORMAT,
                   "%s: the samples of %" PRIu64 " bricks differ from those that their neighbours share", name,
                   incomplete);
}

df_status df_mc_extract_blocks(const df_field *field, const char *name, const df_mc_params *params, df_mc_mesh *mesh,
                               df_error *err) {
    grid g = {
        .field = field, .params = *params, .k = field->kind == DF_FIELD_BRICKS ? field->brick_size : DF_MC_DENSE_BLOCK};
    for (int a = 0; a < 3; a++) g.cell_count[a] = (field->voxel_count[a] + g.k - 1) / g.k;
    for (uint32_t bits = 1; bits < sizeof g.bit_count; bits++)
        g.bit_count[bits] = (uint8_t)(g.bit_count[bits >> 1] + (bits & 1));
    g.sign_bytes = ((g.k + 1) * (3 * (g.k + 1) + 2) + 1) / 2 * 2;
    for (uint32_t edge = 0; edge < DF_MC_EDGE_COUNT; edge++) {
        uint32_t corners[2];
        df_mc_edge_corners(edge, corners);
        g.edge_at[edge] = (uint16_t)(edge / 4 * CUBE_MAX);
        for (uint32_t a = 0; a < 3; a++) g.edge_at[edge] += (uint16_t)((corners[0] >> a & 1) * AXIS_STEP[a]);
    }
    df_mc_tables_make(&g.tables, params->method == DF_MC_CORRECT);
    scratch *all = NULL;
    int threads = df_mc_threads(params);
    df_status status = make_scratch(&all, threads, err);
    if (status == DF_OK) status = extract_listed(&g, name, all, mesh, err);
    free_scratch(all, threads);
    free(g.block_of);
    free(g.blocks);
    free(g.signs);
    return status;
}
