#include "convert/restructure.h"

#include "common/memory.h"
#include "convert/adf.h"
#include "convert/build.h"
#include "convert/measure.h"
#include "convert/quantise.h"

#include <assert.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* What a source or a choice of cells looks at. */
typedef struct context {
    const df_field *from;
    uint32_t brick_size; /* wanted */
    float limit;         /* world units; values end there */
    float unknown;       /* the distance of samples that are not stored */
} context;

static float adf_sample(const df_field *field, const uint32_t at[3]) {
    double grid[3] = {at[0], at[1], at[2]}, local[3];
    df_adf_cell cell;
    float corners[8];
    df_adf_find(field, grid, DF_LEVEL_COUNT_MAX, &cell);
    df_adf_corners(field, cell.family, cell.child, corners);
    for (int a = 0; a < 3; a++) local[a] = (grid[a] - cell.corner[a]) / cell.side;
    double value = df_trilinear(corners, local);
    return value < 0 ? -df_distance_round(-value) : df_distance_round(value);
}

/* A sample, with c->unknown and its sign where none is stored. */
static float field_sample(const context *c, const uint32_t at[3]) {
    float value;
    if (c->from->kind == DF_FIELD_ADF) return adf_sample(c->from, at);
    bool stored = df_field_sample(c->from, at, &value);
    return stored ? value + 0.0f /* a zero is +0 */ : copysignf(c->unknown, value);
}

static void fill(const void *user, const df_lattice *lattice, const df_sample_box *box, float *out) {
    const context *c = user;
    (void)lattice;
    uint32_t at[3];
    for (at[2] = box->first[2]; at[2] < box->first[2] + box->count[2]; at[2]++) {
        for (at[1] = box->first[1]; at[1] < box->first[1] + box->count[1]; at[1]++) {
            for (at[0] = box->first[0]; at[0] < box->first[0] + box->count[0]; at[0]++) {
                *out++ = fmaxf(-c->limit, fminf(c->limit, field_sample(c, at)));
            }
        }
    }
}

/* The samples within one voxel of a coarse cell of the wanted bricks: low <= i <= high. */
static void reach_of_cell(const context *c, const uint32_t cell[3], uint32_t low[3], uint32_t high[3]) {
    for (int a = 0; a < 3; a++) {
        uint32_t first = cell[a] * c->brick_size, last = first + c->brick_size + 1;
        low[a] = first ? first - 1 : 0;
        high[a] = last < c->from->voxel_count[a] ? last : c->from->voxel_count[a];
    }
}

static bool dense_keeps(const context *c, const uint32_t low[3], const uint32_t high[3]) {
    float first;
    uint32_t at[3];
    df_field_sample(c->from, low, &first);
    for (at[2] = low[2]; at[2] <= high[2]; at[2]++) {
        for (at[1] = low[1]; at[1] <= high[1]; at[1]++) {
            for (at[0] = low[0]; at[0] <= high[0]; at[0]++) {
                float value;
                df_field_sample(c->from, at, &value);
                if ((value < 0) != (first < 0)) return true;
            }
        }
    }
    return false;
}

/* True where one of the cells that hold samples of the box has a brick: more than needed; the builder drops the rest.
 */
static bool bricks_keep(const df_field *f, const uint32_t low[3], const uint32_t high[3]) {
    uint32_t k = f->brick_size, first[3], last[3];
    for (int a = 0; a < 3; a++) {
        first[a] = low[a] / k;
        last[a] = high[a] / k < f->cell_count[a] ? high[a] / k : f->cell_count[a] - 1;
    }
    for (uint32_t z = first[2]; z <= last[2]; z++) {
        for (uint32_t y = first[1]; y <= last[1]; y++) {
            for (uint32_t x = first[0]; x <= last[0]; x++) {
                if (f->cells[x + f->cell_count[0] * (y + (uint64_t)f->cell_count[1] * z)] < DF_CELL_INSIDE) return true;
            }
        }
    }
    return false;
}

/* True where a leaf at the surface touches the box; `corner` and `side` are those of a cell whose children lie on
 * `level`. */
static bool adf_keeps(const df_field *f, const uint32_t corner[3], uint32_t side, uint32_t level, const uint32_t low[3],
                      const uint32_t high[3]) {
    for (uint32_t child = 0; child < 8; child++) {
        double centre[3];
        bool touches = true;
        for (int a = 0; a < 3; a++) {
            uint32_t begin = corner[a] + (child >> a & 1) * side / 2;
            centre[a] = begin + side * 0.25;
            touches = touches && begin <= high[a] && begin + side / 2 >= low[a];
        }
        if (!touches) continue;
        df_adf_cell cell;
        df_adf_find(f, centre, level, &cell);
        if (cell.state == DF_CHILD_SURFACE) return true;
        if (cell.state == DF_CHILD_FAMILY && adf_keeps(f, cell.corner, side / 2, level + 1, low, high)) return true;
    }
    return false;
}

static bool keeps_cell(const void *user, const uint32_t cell[3]) {
    const context *c = user;
    uint32_t low[3], high[3], root[3] = {0, 0, 0};
    reach_of_cell(c, cell, low, high);
    if (c->from->kind == DF_FIELD_DENSE) return dense_keeps(c, low, high);
    if (c->from->kind == DF_FIELD_BRICKS) return bricks_keep(c->from, low, high);
    return adf_keeps(c->from, root, 1u << c->from->level_count, 1, low, high);
}

void df_restructure_lattice(const df_field *field, uint32_t brick_size, df_lattice *lattice) {
    *lattice = (df_lattice){.voxel_size = field->voxel_size[0], .brick_size = brick_size};
    for (int a = 0; a < 3; a++) {
        lattice->voxel_count[a] = field->voxel_count[a];
        lattice->origin[a] = field->origin[a];
        lattice->cell_count[a] = (field->voxel_count[a] + brick_size - 1) / brick_size;
    }
}

static double smallest_voxel(const df_field *field) {
    return fmin(field->voxel_size[0], fmin(field->voxel_size[1], field->voxel_size[2]));
}

double df_restructure_band(const df_field *field) {
    float low, high;
    if (field->kind != DF_FIELD_BRICKS) return INFINITY;
    df_field_iso_range(field, &low, &high);
    return fmin(-(double)low, (double)high) / smallest_voxel(field);
}

static uint64_t cells_without_brick(const df_field *f, uint64_t *total) {
    uint64_t count = 0;
    *total = (uint64_t)f->cell_count[0] * f->cell_count[1] * f->cell_count[2];
    for (uint64_t i = 0; i < *total; i++) count += f->cells[i] >= DF_CELL_INSIDE;
    return count;
}

/* Refuses what the stored samples do not give. */
static df_status check_request(const df_field *from, const df_restructure_request *r, df_error *err) {
    double band = df_restructure_band(from);
    if (r->band > band) {
        return df_fail(err, DF_ERROR_INPUT,
                       "%s: --band %g: its bricks hold all samples up to %.3g voxels from the surface only", r->name,
                       r->band, band);
    }
    if (r->kind != DF_FIELD_DENSE || from->kind != DF_FIELD_BRICKS) return DF_OK;
    uint64_t total, empty = cells_without_brick(from, &total);
    if (empty == 0 || (r->fill && band > 0)) return DF_OK;
    return df_fail(err, DF_ERROR_INPUT,
                   "%s: cannot become dense: %" PRIu64 " of %" PRIu64
                   " cells hold no samples, only their side; --fill would give "
                   "them the least distance they can have, %.3g voxels",
                   r->name, empty, total, band);
}

/* ---- octrees ---- */

/* Where a field's surface is. */
typedef struct surface_voxels {
    context samples;
    uint64_t *codes; /* of the voxels that it crosses, by their bits in turn (Morton), ascending */
    uint64_t count;
} surface_voxels;

static uint64_t morton(const uint32_t voxel[3]) {
    uint64_t code = 0;
    for (int bit = 0; bit < 17; bit++) {
        for (int a = 0; a < 3; a++) code |= (uint64_t)(voxel[a] >> bit & 1) << (3 * bit + a);
    }
    return code;
}

static int compare_codes(const void *x, const void *y) {
    const uint64_t l = *(const uint64_t *)x, r = *(const uint64_t *)y;
    return l < r ? -1 : l > r;
}

/* The voxels of one octree cell follow each other. */
static bool crosses(const void *user, const uint32_t corner[3], uint32_t side) {
    const surface_voxels *v = user;
    const uint64_t first = morton(corner), end = first + (uint64_t)side * side * side;
    uint64_t low = 0, high = v->count;
    while (low < high) {
        const uint64_t middle = (low + high) / 2;
        if (v->codes[middle] < first) low = middle + 1;
        else high = middle;
    }
    return low < v->count && v->codes[low] < end;
}

/* Notes the voxels of a box of up to 8 voxels a side that the surface crosses. */
static void note_voxels(surface_voxels *v, const uint32_t low[3]) {
    const df_field *f = v->samples.from;
    uint32_t voxel[3], high[3];
    for (int a = 0; a < 3; a++) high[a] = low[a] + 8 < f->voxel_count[a] ? low[a] + 8 : f->voxel_count[a];
    for (voxel[2] = low[2]; voxel[2] < high[2]; voxel[2]++) {
        for (voxel[1] = low[1]; voxel[1] < high[1]; voxel[1]++) {
            for (voxel[0] = low[0]; voxel[0] < high[0]; voxel[0]++) {
                float corners[8];
                if (!df_field_corners(f, voxel, corners) || !df_corners_straddle(corners, 0)) continue;
                v->codes[v->count++] = morton(voxel);
            }
        }
    }
}

static df_status find_surface(surface_voxels *v, df_error *err) {
    const df_field *f = v->samples.from;
    uint32_t low[3];
    df_status status =
        df_alloc_raw((void **)&v->codes, df_field_surface_voxel_count(f), sizeof *v->codes, "surface voxels", err);
    if (status != DF_OK) return status;
    for (low[2] = 0; low[2] < f->voxel_count[2]; low[2] += 8) {
        for (low[1] = 0; low[1] < f->voxel_count[1]; low[1] += 8) {
            for (low[0] = 0; low[0] < f->voxel_count[0]; low[0] += 8) note_voxels(v, low);
        }
    }
    qsort(v->codes, v->count, sizeof *v->codes, compare_codes);
    return DF_OK;
}

/* The field at a point: what df_field_query says, or c->unknown with the side. */
static double value_at(const void *user, const double p[3]) {
    const context *c = user;
    df_point_info info;
    df_field_query(c->from, p, &info);
    if (info.stored) return info.value;
    return info.side == DF_SIDE_INSIDE ? -(double)c->unknown : (double)c->unknown;
}

/* The samples of an octree's corners: beyond the field's box those at its border. */
static void fill_coarse(const void *user, const df_lattice *lattice, const df_sample_box *box, float *out) {
    const context *c = user;
    const uint32_t step = (uint32_t)(lattice->voxel_size / c->from->voxel_size[0] + 0.5);
    for (uint32_t z = 0; z < box->count[2]; z++) {
        for (uint32_t y = 0; y < box->count[1]; y++) {
            for (uint32_t x = 0; x < box->count[0]; x++) {
                uint32_t at[3] = {(box->first[0] + x) * step, (box->first[1] + y) * step, (box->first[2] + z) * step};
                for (int a = 0; a < 3; a++) at[a] = at[a] < c->from->voxel_count[a] ? at[a] : c->from->voxel_count[a];
                *out++ = field_sample(c, at);
            }
        }
    }
}

/* Points at which the error of a field against another is measured. */
#define MEASURE_POINTS 20000

/* Adds the measured error against `from` to that which `from` has. */
static df_status measure_against(const context *c, df_field *to, double *largest, double *rms, df_error *err) {
    const df_distance_source source = {.context = (void *)(uintptr_t)c, .is_signed = true, .at = value_at};
    const df_truth truth = {.source = &source};
    df_status status = df_measure_error(&truth, MEASURE_POINTS, to, err);
    if (status != DF_OK) return status;
    const bool known = c->from->error_max >= 0;
    *largest = to->error_max;
    *rms = to->error_rms;
    to->error_max = known ? c->from->error_max + *largest : -1;
    to->error_rms = known ? c->from->error_rms + *rms : -1;
    return DF_OK;
}

/* Gives the octree what it takes over from the field, and measures it against that. */
static df_status finish_octree(const context *c, df_field *to, double *largest, double *rms, df_error *err) {
    for (int a = 0; a < 3; a++) to->voxel_size[a] = c->from->voxel_size[a];
    to->verdict = c->from->verdict;
    return measure_against(c, to, largest, rms, err);
}

#define ADF_ATTEMPTS 4
static df_status make_octree(const df_field *from, const df_restructure_request *r, df_field *to, df_error *err) {
    surface_voxels v = {.samples = {from, 0, INFINITY, INFINITY}};
    if (from->kind == DF_FIELD_BRICKS) v.samples.unknown = (float)(df_restructure_band(from) * smallest_voxel(from));
    df_distance_source source = {.context = &v.samples, .is_signed = true, .fill = fill_coarse};
    df_lattice lattice;
    df_adf_input input = {.name = r->name,
                          .lattice = &lattice,
                          .source = &source,
                          .crosses = crosses,
                          .crosses_context = &v,
                          .max_error = r->max_error,
                          .rms_error = r->rms_error,
                          .quiet = r->quiet};
    df_adf *adf = NULL;
    df_adf_report report;
    double largest = 0, rms = 0;
    const double rounding = 1e-9 * smallest_voxel(from);
    *to = (df_field){0};
    df_restructure_lattice(from, 8, &lattice);
    df_status status = find_surface(&v, err);
    if (status == DF_OK) status = df_adf_start(&input, &adf, to, &report, err);
    if (status == DF_OK) status = finish_octree(&v.samples, to, &largest, &rms, err);
    for (int attempt = 1; status == DF_OK && rms > r->rms_error + rounding && attempt < ADF_ATTEMPTS; attempt++) {
        df_field_free(to);
        status = df_adf_refine(adf, report.rms_slope * pow(0.97 * r->rms_error / rms, 2), to, &report, err);
        if (status == DF_OK) status = finish_octree(&v.samples, to, &largest, &rms, err);
    }
    if (status == DF_OK && !r->allow_partial && !(largest <= r->max_error + rounding && rms <= r->rms_error + rounding))
        status = df_fail(err, DF_ERROR_INPUT,
                         "%s: the error asked for cannot be reached: it is %g, RMS %g; pass --allow-partial", r->name,
                         largest, rms);
    if (status != DF_OK) df_field_free(to);
    df_adf_free(adf);
    free(v.codes);
    return status;
}

df_status df_restructure_samples(const df_field *from, const char *name, df_sample_type type, double *added,
                                 df_field *to, df_error *err) {
    const context c = {from, 0, INFINITY, INFINITY};
    df_field exact = {0};
    df_status status = DF_OK;
    double rms;
    if (from->sample_type != DF_SAMPLE_F32) {
        const df_restructure_request same = {
            .name = name, .kind = from->kind, .brick_size = from->brick_size, .quiet = true};
        if (from->kind == DF_FIELD_ADF) {
            return df_fail(err, DF_ERROR_INPUT, "%s: its samples are %s: octrees are quantised from f32 only", name,
                           df_sample_type_name(from->sample_type));
        }
        status = df_restructure(from, &same, &exact, err);
    }
    if (status == DF_OK && type == DF_SAMPLE_F32) {
        *added = 0;
        *to = exact;
        return DF_OK;
    }
    if (status == DF_OK) status = df_quantise(from->sample_type == DF_SAMPLE_F32 ? from : &exact, type, to, err);
    if (status == DF_OK) status = measure_against(&c, to, added, &rms, err);
    df_field_free(&exact);
    if (status != DF_OK) df_field_free(to);
    return status;
}

df_status df_restructure(const df_field *from, const df_restructure_request *r, df_field *to, df_error *err) {
    assert(r->kind != DF_FIELD_ADF || from->kind != DF_FIELD_ADF);
    if (r->kind == DF_FIELD_ADF) return make_octree(from, r, to, err);
    df_status status = check_request(from, r, err);
    if (status != DF_OK) return status;
    context c = {from, r->brick_size, r->band > 0 ? (float)(r->band * smallest_voxel(from)) : INFINITY, INFINITY};
    if (r->fill && from->kind == DF_FIELD_BRICKS) c.unknown = (float)(df_restructure_band(from) * smallest_voxel(from));
    df_distance_source source = {.context = &c, .is_signed = true, .fill = fill};
    df_lattice lattice;
    df_restructure_lattice(from, r->brick_size, &lattice);
    df_build_input input = {.name = r->name,
                            .kind = r->kind,
                            .lattice = &lattice,
                            .source = &source,
                            .keep = keeps_cell,
                            .keep_context = &c,
                            .quiet = r->quiet};
    df_build_report report;
    status = df_build(&input, to, &report, err);
    if (status == DF_ERROR_FORMAT && from->kind == DF_FIELD_BRICKS) {
        status = df_fail(err, DF_ERROR_INPUT,
                         "%s: bricks of %" PRIu32 " voxels need samples that its bricks of %" PRIu32 " do not hold",
                         r->name, r->brick_size, from->brick_size);
    }
    if (status != DF_OK) return status;
    for (int a = 0; a < 3; a++) to->voxel_size[a] = from->voxel_size[a];
    to->verdict = from->verdict;
    if (from->kind != DF_FIELD_ADF) { /* the same corners at the surface, so the same error */
        to->error_max = from->error_max;
        to->error_rms = from->error_rms;
    }
    return DF_OK;
}
