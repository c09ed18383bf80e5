#include "convert/build.h"

#include "common/memory.h"
#include "common/progress.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>

#define SIDE_MAX 9 /* samples along a brick, at most */
#define BRICK_SAMPLES_MAX (SIDE_MAX * SIDE_MAX * SIDE_MAX)

/* A build in progress. */
typedef struct builder {
    const df_build_input *input;
    const df_lattice *lattice;
    df_cells cells;
    uint32_t side;        /* samples along a brick: k + 1 */
    size_t brick_samples; /* side^3 */
    float *samples;       /* bricks: by brick; dense: all */
    uint8_t *is_signed;   /* while bricks are added at holes: by brick, 1 where its signs are known; NULL before */
    uint64_t negative;    /* samples with a winding number below 0: a body may be inside out */
    df_progress progress;
} builder;

double df_available_memory(void) {
    double available = 1e18;
    FILE *file = fopen("/proc/meminfo", "re");
    char line[256];
    unsigned long long kib;
    while (file && fgets(line, sizeof line, file)) {
        if (sscanf(line, "MemAvailable: %llu", &kib) == 1) available = (double)kib * 1024;
    }
    if (file) fclose(file);
    struct rlimit limit;
    unsigned long long pages = 0;
    if (getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY) {
        file = fopen("/proc/self/statm", "re");
        if (file && fscanf(file, "%llu", &pages) != 1) pages = 0;
        if (file) fclose(file);
        available = fmin(available, (double)limit.rlim_cur - (double)pages * 4096);
    }
    return available;
}

df_status df_build_check_memory(const char *name, double bytes, uint32_t longest, double exponent, df_error *err) {
    double available = df_available_memory();
    if (bytes <= available) return DF_OK;
    double fits = floor(longest * pow(fmax(available, 0) / bytes, 1 / exponent) * 0.95);
    return df_fail(err, DF_ERROR_MEMORY,
                   "%s: needs about %.3g GB at %u voxels along the longest side, %.3g GB are available: "
                   "--resolution %.0f would fit",
                   name, bytes / 1e9, longest, available / 1e9, fmax(fits, 1));
}

static uint32_t longest_side(const df_lattice *l) {
    uint32_t longest = 0;
    for (int a = 0; a < 3; a++) longest = l->voxel_count[a] > longest ? l->voxel_count[a] : longest;
    return longest;
}

/* The brick of the cell at `cell` + step along each axis, or DF_NO_BRICK. */
static uint32_t neighbour(const builder *b, const uint32_t cell[3], int dx, int dy, int dz) {
    const uint32_t *count = b->lattice->cell_count;
    int64_t x = (int64_t)cell[0] + dx, y = (int64_t)cell[1] + dy, z = (int64_t)cell[2] + dz;
    if (x < 0 || y < 0 || z < 0 || x >= count[0] || y >= count[1] || z >= count[2]) return DF_NO_BRICK;
    return b->cells.bricks[(size_t)x + count[0] * ((size_t)y + count[1] * (size_t)z)];
}

/* The samples that a brick computes itself: not those on an upper face that the brick beyond has, nor any beyond the
 * field. */
static df_sample_box own_box(const builder *b, const uint32_t cell[3]) {
    df_sample_box box;
    uint32_t k = b->lattice->brick_size;
    for (int a = 0; a < 3; a++) {
        box.first[a] = cell[a] * k;
        uint32_t rest = b->lattice->voxel_count[a] - box.first[a] + 1;
        box.count[a] = neighbour(b, cell, a == 0, a == 1, a == 2) != DF_NO_BRICK ? k : k + 1;
        if (box.count[a] > rest) box.count[a] = rest;
    }
    return box;
}

static void fill_brick(const builder *b, uint32_t brick) {
    uint32_t cell[3];
    float values[BRICK_SAMPLES_MAX];
    df_cell_position(b->lattice, b->cells.indices[brick], cell);
    df_sample_box box = own_box(b, cell);
    b->input->source->fill(b->input->source->context, b->lattice, &box, values);
    const float *from = values;
    float *to = b->samples + brick * b->brick_samples;
    for (uint32_t z = 0; z < box.count[2]; z++) {
        for (uint32_t y = 0; y < box.count[1]; y++, from += box.count[0]) {
            memcpy(to + (size_t)b->side * (y + (size_t)b->side * z), from, box.count[0] * sizeof *from);
        }
    }
}

/* Where the sample x, y, z of a brick was computed: in the brick itself, or in one beyond an upper face. */
static float shared_sample(const builder *b, uint32_t brick, const uint32_t at[3]) {
    uint32_t cell[3], p[3] = {at[0], at[1], at[2]}, k = b->lattice->brick_size;
    df_cell_position(b->lattice, b->cells.indices[brick], cell);
    for (int a = 0; a < 3; a++) {
        uint32_t next = p[a] == k ? neighbour(b, cell, a == 0, a == 1, a == 2) : DF_NO_BRICK;
        if (next == DF_NO_BRICK) continue;
        p[a] = 0;
        cell[a]++;
        brick = next;
        a = -1; /* the brick beyond may itself have got the sample from another */
    }
    return b->samples[brick * b->brick_samples + p[0] + (size_t)b->side * (p[1] + (size_t)b->side * p[2])];
}

/* Completes a brick: samples computed by a brick beyond are copied, those beyond the field repeat the last ones. Reads
 * only what bricks computed themselves, so that bricks may be completed in any order. */
static void complete_brick(const builder *b, uint32_t brick) {
    uint32_t cell[3], last[3], p[3], k = b->lattice->brick_size;
    df_cell_position(b->lattice, b->cells.indices[brick], cell);
    df_sample_box own = own_box(b, cell);
    float *samples = b->samples + brick * b->brick_samples;
    for (int a = 0; a < 3; a++) {
        uint32_t rest = b->lattice->voxel_count[a] - cell[a] * k;
        last[a] = rest < k ? rest : k;
    }
    for (p[2] = 0; p[2] <= last[2]; p[2]++) {
        for (p[1] = 0; p[1] <= last[1]; p[1]++) {
            bool own_row = p[1] < own.count[1] && p[2] < own.count[2];
            for (p[0] = own_row ? own.count[0] : 0; p[0] <= last[0]; p[0]++) {
                samples[p[0] + (size_t)b->side * (p[1] + (size_t)b->side * p[2])] = shared_sample(b, brick, p);
            }
        }
    }
    for (uint32_t z = 0; z < b->side; z++) {
        for (uint32_t y = 0; y < b->side; y++) {
            for (uint32_t x = 0; x < b->side; x++) {
                if (x <= last[0] && y <= last[1] && z <= last[2]) continue;
                uint32_t i = x < last[0] ? x : last[0], j = y < last[1] ? y : last[1], l = z < last[2] ? z : last[2];
                samples[x + (size_t)b->side * (y + (size_t)b->side * z)] =
                    samples[i + (size_t)b->side * (j + (size_t)b->side * l)];
            }
        }
    }
}

/* Fills all bricks; those that `old` has already, with samples in old_samples, are copied. */
static df_status fill_bricks(builder *b, const df_cells *old, const float *old_samples, df_error *err) {
    const df_lattice *l = b->lattice;
    double bytes = (double)b->cells.brick_count * (double)b->brick_samples * sizeof(float) * 1.1;
    df_status status = df_build_check_memory(b->input->name, bytes, longest_side(l), 2, err);
    if (status == DF_OK) {
        status =
            df_alloc_raw((void **)&b->samples, b->cells.brick_count, b->brick_samples * sizeof(float), "samples", err);
    }
    if (status != DF_OK) return status;
    df_progress_begin(&b->progress, "distances", b->cells.brick_count, b->input->quiet);
#pragma omp parallel for schedule(dynamic, 16)
    for (uint32_t i = 0; i < b->cells.brick_count; i++) {
        uint32_t from = old ? old->bricks[b->cells.indices[i]] : DF_NO_BRICK;
        if (from == DF_NO_BRICK) fill_brick(b, i);
        else
            memcpy(b->samples + i * b->brick_samples, old_samples + from * b->brick_samples,
                   b->brick_samples * sizeof(float));
        if (old) b->is_signed[i] = from != DF_NO_BRICK;
        df_progress_add(&b->progress, 1);
    }
    df_progress_end(&b->progress);
#pragma omp parallel for schedule(static, 256)
    for (uint32_t i = 0; i < b->cells.brick_count; i++) {
        if (!old || !b->is_signed[i]) complete_brick(b, i);
    }
    return DF_OK;
}

/* What a cell without a brick holds. */
static uint32_t token(bool inside) { return inside ? DF_CELL_INSIDE : DF_CELL_OUTSIDE; }

static uint32_t count_negative(const int32_t *windings, uint32_t count) {
    uint32_t negative = 0;
    for (uint32_t i = 0; i < count; i++) negative += windings[i] < 0;
    return negative;
}

/* The rule for the samples of a coarse cell. */
static void rule_of_cell(const builder *b, const uint32_t cell[3], uint32_t *active, df_sign_rule *rule) {
    double centre[3], k = b->lattice->brick_size, size = b->lattice->voxel_size;
    for (int a = 0; a < 3; a++) centre[a] = b->lattice->origin[a] + (cell[a] + 0.5) * k * size;
    df_sign_make_rule(b->input->sign, centre, k * size * 0.8660254037844387 * 1.000001, active, rule);
}

static uint32_t sign_brick(const builder *b, const df_winding_slab *slab, const uint32_t cell[3], uint32_t brick,
                           uint32_t *active) {
    const df_lattice *l = b->lattice;
    uint32_t k = l->brick_size, count = 0;
    int32_t windings[BRICK_SAMPLES_MAX];
    double points[BRICK_SAMPLES_MAX][3];
    df_sign_rule rule;
    rule_of_cell(b, cell, active, &rule);
    for (uint32_t z = 0; z <= k; z++) {
        for (uint32_t y = 0; y <= k; y++) {
            uint32_t j = cell[1] * k + y, i = cell[2] * k + z;
            j = j < l->voxel_count[1] ? j : l->voxel_count[1];
            i = i < l->voxel_count[2] ? i : l->voxel_count[2];
            df_winding_row(slab, j, i, cell[0] * k, k + 1, windings + count);
            for (uint32_t x = 0; rule.active_count && x <= k; x++) {
                uint32_t h = cell[0] * k + x;
                points[count + x][0] = df_lattice_at(l, 0, h < l->voxel_count[0] ? h : l->voxel_count[0]);
                points[count + x][1] = df_lattice_at(l, 1, j);
                points[count + x][2] = df_lattice_at(l, 2, i);
            }
            count += k + 1;
        }
    }
    df_sign_apply(&rule, windings, (const double(*)[3])points, count, b->samples + brick * b->brick_samples);
    return count_negative(windings, count);
}

/* Signs of the bricks in one layer of cells, and tokens of the cells without: `tokens` by coarse cell. Cells that
 * follow each other without a brick between lie on one side. Returns the number of samples with a winding number below
 * 0. */
static uint64_t sign_layer(const builder *b, const df_winding_slab *slab, uint32_t layer, uint32_t *tokens,
                           uint32_t *active) {
    const df_lattice *l = b->lattice;
    uint32_t k = l->brick_size;
    uint64_t negative = 0;
    for (uint32_t cy = 0; cy < l->cell_count[1]; cy++) {
        uint32_t last = DF_NO_BRICK;
        for (uint32_t cx = 0; cx < l->cell_count[0]; cx++) {
            uint32_t cell[3] = {cx, cy, layer};
            size_t index = cx + l->cell_count[0] * (cy + (size_t)l->cell_count[1] * layer);
            uint32_t brick = b->cells.bricks[index];
            if (brick != DF_NO_BRICK) {
                if (!b->is_signed || !b->is_signed[brick]) negative += sign_brick(b, slab, cell, brick, active);
            } else if (b->is_signed) {
                continue; /* known from the first round */
            } else if (cx > 0 && last == DF_NO_BRICK) {
                tokens[index] = tokens[index - 1];
            } else {
                df_sign_rule rule;
                int32_t winding;
                double p[1][3];
                for (int a = 0; a < 3; a++) p[0][a] = df_lattice_at(l, a, cell[a] * k);
                df_winding_row(slab, cy * k, layer * k, cx * k, 1, &winding);
                df_sign_make_rule(b->input->sign, p[0], 0, active, &rule);
                float side = 1;
                df_sign_apply(&rule, &winding, (const double(*)[3])p, 1, &side);
                tokens[index] = token(side < 0);
                negative += winding < 0;
            }
            last = brick;
        }
    }
    return negative;
}

/* Runs over the layers of cells with the winding numbers of their rows. */
static df_status sign_by_winding(builder *b, uint32_t *tokens, df_error *err) {
    const df_lattice *l = b->lattice;
    const df_sign *sign = b->input->sign;
    df_face_slabs faces;
    uint64_t negative = 0;
    df_status status = df_face_slabs_make(sign->mesh, l, l->brick_size, &faces, err);
    if (status != DF_OK) goto done;
#pragma omp parallel reduction(+ : negative)
    {
        df_winding_slab slab = {0};
        df_error slab_err;
        uint32_t *active = malloc((sign->made.cap_count + 1) * sizeof *active);
#pragma omp for schedule(dynamic, 1)
        for (uint32_t layer = 0; layer < l->cell_count[2]; layer++) {
            uint32_t z = layer * l->brick_size, end = z + l->brick_size;
            if (end > l->voxel_count[2]) end = l->voxel_count[2];
            df_status s = active ? df_winding_slab_find(&slab, sign->mesh, faces.faces + faces.starts[layer],
                                                        faces.starts[layer + 1] - faces.starts[layer], l, z,
                                                        end - z + 1, &slab_err)
                                 : df_fail(&slab_err, DF_ERROR_MEMORY, "signs: out of memory");
            if (s == DF_OK) {
                negative += sign_layer(b, &slab, layer, tokens, active);
            } else {
#pragma omp critical
                status = df_fail(err, s, "%s", slab_err.text);
            }
        }
        free(active);
        df_winding_slab_free(&slab);
    }
    b->negative = negative;
done:
    df_face_slabs_free(&faces);
    return status;
}

/* The same, and again on an oriented mesh where winding numbers below 0 show that a body may be inside out. */
static df_status sign_bricks(builder *b, uint32_t *tokens, df_error *err) {
    df_sign *sign = b->input->sign;
    df_status status = sign_by_winding(b, tokens, err);
    bool settled = b->negative == 0 || sign->mesh != b->input->mesh || sign->method == DF_SIGN_PARITY;
    if (status != DF_OK || settled) return status;
    status = df_sign_orient(sign, b->input->mesh, err);
    return status == DF_OK && sign->made.inverted_components ? sign_by_winding(b, tokens, err) : status;
}

/* True where a sample on the face of a brick towards direction `to` (0 to 5: -x, +x, -y, ...) lies on the other side
 * than `inside`. */
static bool face_differs(const builder *b, uint32_t brick, int to, bool inside) {
    const float *samples = b->samples + brick * b->brick_samples;
    size_t side = b->side, steps[3] = {1, side, side * side};
    size_t u = steps[(to / 2 + 1) % 3], v = steps[(to / 2 + 2) % 3], first = (to & 1) * (side - 1) * steps[to / 2];
    for (size_t j = 0; j < side; j++) {
        for (size_t i = 0; i < side; i++) {
            if ((samples[first + i * u + j * v] < 0) != inside) return true;
        }
    }
    return false;
}

/* Adds the cells without a brick that the sign does not leave whole: a neighbour's samples on the common face say
 * otherwise. That happens only where the sign changes without a surface, at holes. Returns DF_OK with *grown = false
 * when there are none. */
static df_status grow_cells(builder *b, const uint32_t *tokens, bool *grown, df_error *err) {
    df_cells more;
    *grown = false;
    df_status status = df_cells_copy(&b->cells, b->lattice, &more, err);
    if (status != DF_OK) return status;
    for (uint32_t brick = 0; brick < b->cells.brick_count; brick++) {
        uint32_t cell[3];
        df_cell_position(b->lattice, b->cells.indices[brick], cell);
        for (int to = 0; to < 6; to++) {
            int64_t at[3] = {cell[0], cell[1], cell[2]};
            at[to / 2] += to & 1 ? 1 : -1;
            if (at[to / 2] < 0 || at[to / 2] >= b->lattice->cell_count[to / 2]) continue;
            size_t index =
                (size_t)at[0] + b->lattice->cell_count[0] * ((size_t)at[1] + b->lattice->cell_count[1] * (size_t)at[2]);
            if (b->cells.bricks[index] != DF_NO_BRICK || !face_differs(b, brick, to, tokens[index] == DF_CELL_INSIDE))
                continue;
            more.bricks[index] = 0;
            *grown = true;
        }
    }
    if (!*grown) {
        df_cells_free(&more);
        return DF_OK;
    }
    status = df_cells_renumber(b->lattice, &more, err);
    free(b->is_signed);
    b->is_signed = NULL;
    if (status == DF_OK) status = df_alloc((void **)&b->is_signed, more.brick_count, 1, "bricks", err);
    float *old_samples = b->samples;
    df_cells old = b->cells;
    b->samples = NULL;
    b->cells = more;
    if (status == DF_OK) status = fill_bricks(b, &old, old_samples, err);
    free(old_samples);
    df_cells_free(&old);
    return status;
}

/* Signs the bricks; at holes, where the sign changes away from the faces, adds bricks until the change is stored. */
#define GROWTH_MAX 64
static df_status sign_and_grow(builder *b, uint32_t *tokens, df_error *err) {
    bool grown = true;
    df_status status = DF_OK;
    for (int round = 0; status == DF_OK && grown && round < GROWTH_MAX; round++) {
        status = sign_bricks(b, tokens, err);
        grown = false;
        if (status == DF_OK && b->input->sign->made.cap_count) status = grow_cells(b, tokens, &grown, err);
    }
    return status == DF_OK && grown ? sign_bricks(b, tokens, err) : status;
}

/* Counts the pairs of neighbours along an axis whose signs differ although no surface can lie between them. */
static void count_walls(const builder *b, df_build_report *report) {
    uint64_t count = 0, first = UINT64_MAX;
    float limit = (float)(b->lattice->voxel_size * (1 + 1e-6));
    uint32_t k = b->lattice->brick_size, steps[3] = {1, b->side, b->side * b->side};
#pragma omp parallel for schedule(static, 256) reduction(+ : count) reduction(min : first)
    for (uint32_t brick = 0; brick < b->cells.brick_count; brick++) {
        const float *samples = b->samples + brick * b->brick_samples;
        for (uint32_t i = 0; i < k * k * k; i++) {
            const float *s = samples + i % k + steps[1] * (i / k % k) + steps[2] * (i / k / k);
            for (int a = 0; a < 3; a++) {
                float next = s[steps[a]];
                if ((s[0] < 0) == (next < 0) || !(fabsf(s[0]) + fabsf(next) > limit)) continue;
                count++;
                uint64_t at = (uint64_t)brick * k * k * k + i;
                first = at < first ? at : first;
            }
        }
    }
    report->wall_count = count;
    if (count == 0) return;
    uint32_t cell[3], i = (uint32_t)(first % (k * k * k)), local[3] = {i % k, i / k % k, i / k / k};
    df_cell_position(b->lattice, b->cells.indices[first / (k * k * k)], cell);
    for (int a = 0; a < 3; a++) report->wall_place[a] = df_lattice_at(b->lattice, a, cell[a] * k + local[a]);
}

/* Tokens where the source itself knows the side: the sign at the first sample of the cell. */
static void tokens_from_source(const builder *b, uint32_t *tokens) {
    uint32_t total = (uint32_t)df_lattice_cell_total(b->lattice);
#pragma omp parallel for schedule(dynamic, 1024)
    for (uint32_t i = 0; i < total; i++) {
        if (b->cells.bricks[i] != DF_NO_BRICK) continue;
        df_sample_box box = {.count = {1, 1, 1}};
        df_cell_position(b->lattice, i, box.first);
        for (int a = 0; a < 3; a++) box.first[a] *= b->lattice->brick_size;
        float value;
        b->input->source->fill(b->input->source->context, b->lattice, &box, &value);
        tokens[i] = token(value < 0);
    }
}

/* For each of the 27 cells around a brick (bit dx+1 + 3 * (dy+1 + 3 * (dz+1))): 1 where a surface voxel of the brick
 * lies within one voxel of it. */
static uint32_t needed_neighbours(const builder *b, uint32_t brick) {
    uint32_t rows[SIDE_MAX * SIDE_MAX], k = b->lattice->brick_size, side = b->side, needed = 0;
    const float *samples = b->samples + brick * b->brick_samples;
    for (uint32_t r = 0; r < side * side; r++) {
        rows[r] = 0;
        for (uint32_t x = 0; x < side; x++) rows[r] |= (uint32_t)(samples[r * side + x] < 0) << x;
    }
    for (uint32_t z = 0; z < k; z++) {
        for (uint32_t y = 0; y < k; y++) {
            const uint32_t *r = rows + y + side * z;
            uint32_t any = r[0] | r[1] | r[side] | r[side + 1], all = r[0] & r[1] & r[side] & r[side + 1];
            uint32_t straddle = (any | any >> 1) & ~(all & all >> 1) & ((1u << k) - 1);
            if (!straddle) continue;
            uint32_t along_x = 2u | (straddle & 1u) | (straddle >> (k - 1) & 1u) << 2;
            for (uint32_t j = y == 0 ? 0 : 1; j <= (y == k - 1 ? 2 : 1); j++) {
                for (uint32_t i = z == 0 ? 0 : 1; i <= (z == k - 1 ? 2 : 1); i++) needed |= along_x << 3 * (j + 3 * i);
            }
        }
    }
    return needed;
}

#define OWN_BIT (1u << 13) /* of the brick itself among the 27 */

/* keep[brick]: 1 where the surface needs the brick. straddles[brick]: 1 where it holds a surface voxel. */
static void find_needed(const builder *b, uint8_t *keep, uint8_t *straddles) {
#pragma omp parallel for schedule(static, 256)
    for (uint32_t brick = 0; brick < b->cells.brick_count; brick++) {
        uint32_t cell[3], needed = needed_neighbours(b, brick);
        df_cell_position(b->lattice, b->cells.indices[brick], cell);
        straddles[brick] = (needed & OWN_BIT) != 0;
        for (int i = 0; i < 27; i++) {
            uint32_t other = needed >> i & 1 ? neighbour(b, cell, i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1) : DF_NO_BRICK;
            if (other == DF_NO_BRICK) continue;
#pragma omp atomic write
            keep[other] = 1;
        }
    }
}

/* Moves the bricks to keep to the front and turns cells.bricks into the field's cells. Returns the number of bricks. */
static uint32_t compact(builder *b, const uint8_t *keep, const uint32_t *tokens) {
    uint32_t count = 0;
    uint64_t total = df_lattice_cell_total(b->lattice);
    for (uint64_t i = 0; i < total; i++) {
        if (b->cells.bricks[i] == DF_NO_BRICK) b->cells.bricks[i] = tokens[i];
    }
    for (uint32_t brick = 0; brick < b->cells.brick_count; brick++) {
        float *from = b->samples + brick * b->brick_samples;
        uint32_t *cell = &b->cells.bricks[b->cells.indices[brick]];
        if (keep[brick]) {
            if (count != brick) memcpy(b->samples + count * b->brick_samples, from, b->brick_samples * sizeof *from);
            *cell = count++;
        } else {
            *cell = from[0] < 0 ? DF_CELL_INSIDE : DF_CELL_OUTSIDE;
        }
    }
    return count;
}

/* Counts the cells that a face crosses and whose samples do not show it. */
static df_status count_lost(const builder *b, const uint8_t *straddles, uint64_t *lost, df_error *err) {
    df_cells crossed;
    df_status status = df_cells_find(b->input->mesh, b->lattice, -1e-6, &crossed, err);
    for (uint32_t i = 0; status == DF_OK && i < crossed.brick_count; i++) {
        uint32_t brick = b->cells.bricks[crossed.indices[i]];
        *lost += brick == DF_NO_BRICK || !straddles[brick];
    }
    df_cells_free(&crossed);
    return status;
}

static void set_dimensions(const builder *b, df_field *field) {
    field->kind = b->input->kind;
    field->sample_type = DF_SAMPLE_F32;
    field->error_max = field->error_rms = -1;
    for (int a = 0; a < 3; a++) {
        field->voxel_count[a] = b->lattice->voxel_count[a];
        field->voxel_size[a] = b->lattice->voxel_size;
        field->origin[a] = b->lattice->origin[a];
    }
}

/* Drops what the surface does not need and moves the rest into the field. */
static df_status store_bricks(builder *b, const uint32_t *tokens, df_field *field, df_build_report *report,
                              df_error *err) {
    uint8_t *keep = NULL, *straddles = NULL;
    df_status status = df_alloc((void **)&keep, b->cells.brick_count, 1, "bricks", err);
    if (status == DF_OK) status = df_alloc((void **)&straddles, b->cells.brick_count, 1, "bricks", err);
    if (status != DF_OK) goto done;
    find_needed(b, keep, straddles);
    if (b->input->mesh) status = count_lost(b, straddles, &report->lost_features, err);
    if (status != DF_OK) goto done;
    set_dimensions(b, field);
    field->brick_size = b->lattice->brick_size;
    field->brick_count = compact(b, keep, tokens);
    field->samples = b->samples;
    field->cells = b->cells.bricks;
    df_field_own(field, b->samples);
    df_field_own(field, b->cells.bricks);
    b->samples = NULL;
    b->cells.bricks = NULL;
    status = df_field_finish(field, b->input->name, err);
done:
    free(keep);
    free(straddles);
    return status;
}

static df_status find_cells(builder *b, df_error *err) {
    const df_build_input *in = b->input;
    double bytes = (double)df_lattice_cell_total(b->lattice) * 2 * sizeof(uint32_t);
    df_status status = df_build_check_memory(in->name, bytes, longest_side(b->lattice), 3, err);
    if (status != DF_OK) return status;
    /* where the mesh has holes, the cells that their fans pass are needed as well */
    if (in->mesh) return df_cells_find(in->sign ? in->sign->mesh : in->mesh, b->lattice, DF_CELL_REACH, &b->cells, err);
    return df_cells_select(b->lattice, in->keep, in->keep_context, &b->cells, err);
}

static df_status build_bricks(builder *b, df_field *field, df_build_report *report, df_error *err) {
    uint32_t *tokens = NULL;
    double start = df_now_ms();
    df_status status = find_cells(b, err);
    if (status != DF_OK) goto done;
    report->cells_computed = b->cells.brick_count;
    double cells = df_now_ms();
    status = fill_bricks(b, NULL, NULL, err);
    if (status != DF_OK) goto done;
    double filled = df_now_ms();
    status = df_alloc_raw((void **)&tokens, df_lattice_cell_total(b->lattice), sizeof *tokens, "coarse cells", err);
    if (status != DF_OK) goto done;
    if (b->input->source->is_signed) tokens_from_source(b, tokens);
    else status = sign_and_grow(b, tokens, err);
    if (status != DF_OK) goto done;
    if (!b->input->source->is_signed) count_walls(b, report);
    double with_signs = df_now_ms();
    status = store_bricks(b, tokens, field, report, err);
    report->samples_computed = (uint64_t)b->cells.brick_count * b->brick_samples;
    report->cells_ms = cells - start;
    report->distance_ms = filled - cells;
    report->sign_ms = with_signs - filled;
    report->structure_ms = df_now_ms() - with_signs;
done:
    free(tokens);
    return status;
}

/* Computes the samples of one block of k^3 of a dense field. */
static void fill_block(const builder *b, uint32_t index) {
    const df_lattice *l = b->lattice;
    uint32_t cell[3];
    df_cell_position(l, index, cell);
    df_sample_box box;
    for (int a = 0; a < 3; a++) {
        box.first[a] = cell[a] * l->brick_size;
        box.count[a] = cell[a] + 1 == l->cell_count[a] ? l->voxel_count[a] - box.first[a] + 1 : l->brick_size;
    }
    float values[BRICK_SAMPLES_MAX];
    b->input->source->fill(b->input->source->context, l, &box, values);
    const float *from = values;
    size_t row = (size_t)l->voxel_count[0] + 1, layer = row * ((size_t)l->voxel_count[1] + 1);
    for (uint32_t z = 0; z < box.count[2]; z++) {
        for (uint32_t y = 0; y < box.count[1]; y++, from += box.count[0]) {
            float *to = b->samples + box.first[0] + row * (box.first[1] + y) + layer * (box.first[2] + z);
            memcpy(to, from, box.count[0] * sizeof *from);
        }
    }
}

/* Signs the samples of layers z to end of a dense field; rules are made for blocks of k samples along x. */
static uint64_t sign_dense_layers(const builder *b, const df_winding_slab *slab, uint32_t z, uint32_t end,
                                  int32_t *winding, uint32_t *active) {
    const df_lattice *l = b->lattice;
    size_t row = (size_t)l->voxel_count[0] + 1, layer = row * ((size_t)l->voxel_count[1] + 1);
    uint32_t k = l->brick_size;
    uint64_t negative = 0;
    df_sign_rule rule;
    for (uint32_t j = 0; j <= l->voxel_count[1]; j += k) {
        for (uint32_t i = 0; i <= l->voxel_count[0]; i += k) {
            uint32_t cell[3] = {i / k, j / k, z / k}, width = i + k <= row ? k : (uint32_t)row - i;
            rule_of_cell(b, cell, active, &rule);
            for (uint32_t y = j; y < j + k && y <= l->voxel_count[1]; y++) {
                for (uint32_t zz = z; zz <= end; zz++) {
                    double points[SIDE_MAX][3];
                    for (uint32_t x = 0; x < width; x++) {
                        points[x][0] = df_lattice_at(l, 0, i + x);
                        points[x][1] = df_lattice_at(l, 1, y);
                        points[x][2] = df_lattice_at(l, 2, zz);
                    }
                    df_winding_row(slab, y, zz, i, width, winding);
                    df_sign_apply(&rule, winding, (const double(*)[3])points, width,
                                  b->samples + i + row * y + layer * zz);
                    negative += count_negative(winding, width);
                }
            }
        }
    }
    return negative;
}

static df_status sign_dense_once(builder *b, df_error *err) {
    const df_lattice *l = b->lattice;
    const df_sign *sign = b->input->sign;
    df_face_slabs faces;
    uint64_t negative = 0;
    df_status status = df_face_slabs_make(sign->mesh, l, l->brick_size, &faces, err);
    if (status != DF_OK) goto done;
#pragma omp parallel reduction(+ : negative)
    {
        df_winding_slab slab = {0};
        df_error slab_err;
        int32_t winding[SIDE_MAX];
        uint32_t *active = malloc((sign->made.cap_count + 1) * sizeof *active);
#pragma omp for schedule(dynamic, 1)
        for (uint32_t s = 0; s < faces.slab_count; s++) {
            uint32_t z = s * l->brick_size, end = z + l->brick_size - 1;
            if (end > l->voxel_count[2]) end = l->voxel_count[2];
            df_status found =
                active ? df_winding_slab_find(&slab, sign->mesh, faces.faces + faces.starts[s],
                                              faces.starts[s + 1] - faces.starts[s], l, z, end - z + 1, &slab_err)
                       : df_fail(&slab_err, DF_ERROR_MEMORY, "signs: out of memory");
            if (found == DF_OK) {
                negative += sign_dense_layers(b, &slab, z, end, winding, active);
            } else {
#pragma omp critical
                status = df_fail(err, found, "%s", slab_err.text);
            }
        }
        free(active);
        df_winding_slab_free(&slab);
    }
    b->negative = negative;
done:
    df_face_slabs_free(&faces);
    return status;
}

static df_status sign_dense(builder *b, df_error *err) {
    df_sign *sign = b->input->sign;
    df_status status = sign_dense_once(b, err);
    if (status != DF_OK || b->negative == 0 || sign->mesh != b->input->mesh || sign->method == DF_SIGN_PARITY)
        return status;
    status = df_sign_orient(sign, b->input->mesh, err);
    return status == DF_OK && sign->made.inverted_components ? sign_dense_once(b, err) : status;
}

static df_status build_dense(builder *b, df_field *field, df_build_report *report, df_error *err) {
    double start = df_now_ms();
    uint64_t count = df_dense_sample_count(b->lattice->voxel_count);
    df_status status =
        df_build_check_memory(b->input->name, (double)count * sizeof(float), longest_side(b->lattice), 3, err);
    if (status == DF_OK) status = df_alloc_raw((void **)&b->samples, count, sizeof(float), "samples", err);
    if (status != DF_OK) return status;
    uint32_t total = (uint32_t)df_lattice_cell_total(b->lattice);
    df_progress_begin(&b->progress, "distances", total, b->input->quiet);
#pragma omp parallel for schedule(dynamic, 16)
    for (uint32_t i = 0; i < total; i++) {
        fill_block(b, i);
        df_progress_add(&b->progress, 1);
    }
    df_progress_end(&b->progress);
    double filled = df_now_ms();
    if (!b->input->source->is_signed) status = sign_dense(b, err);
    if (status != DF_OK) return status;
    double with_signs = df_now_ms();
    set_dimensions(b, field);
    field->samples = b->samples;
    df_field_own(field, b->samples);
    b->samples = NULL;
    status = df_field_finish(field, b->input->name, err);
    report->samples_computed = count;
    report->distance_ms = filled - start;
    report->sign_ms = with_signs - filled;
    report->structure_ms = df_now_ms() - with_signs;
    return status;
}

df_status df_build(const df_build_input *input, df_field *field, df_build_report *report, df_error *err) {
    assert(input->mesh || input->source->is_signed);
    uint32_t side = input->lattice->brick_size + 1;
    builder b = {.input = input, .lattice = input->lattice, .side = side, .brick_samples = (size_t)side * side * side};
    *report = (df_build_report){0};
    df_status status =
        input->kind == DF_FIELD_DENSE ? build_dense(&b, field, report, err) : build_bricks(&b, field, report, err);
    if (status != DF_OK) df_field_free(field);
    df_cells_free(&b.cells);
    free(b.samples);
    free(b.is_signed);
    return status;
}
