#include "convert/build_private.h"

#include "common/memory.h"

#include <stdlib.h>
#include <string.h>

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

/* Makes room for all bricks and fills those from number `first` on. */
static df_status fill_bricks(builder *b, uint32_t first, df_error *err) {
    const df_lattice *l = b->lattice;
    const uint32_t count = b->cells.brick_count;
    double bytes = (double)count * (double)b->brick_samples * sizeof(float) * 1.1;
    df_status status = df_build_check_memory(b->input->name, bytes, df_build_longest_side(l), 2, err);
    if (status == DF_OK && count > b->capacity) {
        b->capacity = first ? count + count / 4 : count;
        status = df_grow((void **)&b->samples, first, b->capacity, b->brick_samples * sizeof(float), "samples", err);
    }
    if (status != DF_OK) return status;
    df_progress_begin(&b->progress, "distances", count - first, b->input->quiet);
#pragma omp parallel for schedule(dynamic, 16)
    for (uint32_t i = first; i < count; i++) {
        fill_brick(b, i);
        df_progress_add(&b->progress, 1);
    }
    df_progress_end(&b->progress);
#pragma omp parallel for schedule(static, 256)
    for (uint32_t i = first; i < count; i++) complete_brick(b, i);
    return DF_OK;
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

/* Appends the cells around a brick that the sign does not leave whole: they have no brick, and the samples on the
 * common face say otherwise. That happens only where the sign changes without a surface, at holes. */
static df_status grow_around(builder *b, uint32_t brick, const uint32_t *tokens, df_error *err) {
    uint32_t cell[3];
    df_status status = DF_OK;
    df_cell_position(b->lattice, b->cells.indices[brick], cell);
    for (int to = 0; to < 6 && status == DF_OK; to++) {
        int64_t at[3] = {cell[0], cell[1], cell[2]};
        at[to / 2] += to & 1 ? 1 : -1;
        if (at[to / 2] < 0 || at[to / 2] >= b->lattice->cell_count[to / 2]) continue;
        size_t index =
            (size_t)at[0] + b->lattice->cell_count[0] * ((size_t)at[1] + b->lattice->cell_count[1] * (size_t)at[2]);
        if (b->cells.bricks[index] != DF_NO_BRICK || !face_differs(b, brick, to, tokens[index] == DF_CELL_INSIDE))
            continue;
        b->waiting[at[2]] = 1;
        status = df_cells_append(&b->cells, (uint32_t)index, err);
    }
    return status;
}

/* Appends what the bricks from number `first` on call for, and fills it. */
static df_status grow_cells(builder *b, uint32_t first, const uint32_t *tokens, df_error *err) {
    uint32_t count = b->cells.brick_count;
    df_status status = DF_OK;
    memset(b->waiting, 0, b->lattice->cell_count[2]);
    for (uint32_t brick = first; brick < count && status == DF_OK; brick++) status = grow_around(b, brick, tokens, err);
    b->signed_count = count;
    return status == DF_OK && b->cells.brick_count > count ? fill_bricks(b, count, err) : status;
}

/* Brings bricks that were appended into the order of their cells: along each cycle of the permutation, in place. */
static df_status sort_bricks(builder *b, df_error *err) {
    uint32_t *from;
    df_status status = df_cells_sort(b->lattice, &b->cells, &from, err);
    if (status != DF_OK) return status;
    float first[BRICK_SAMPLES_MAX];
    size_t bytes = b->brick_samples * sizeof(float);
    for (uint32_t start = 0; start < b->cells.brick_count; start++) {
        if (from[start] == start) continue;
        memcpy(first, b->samples + start * b->brick_samples, bytes);
        uint32_t at = start, next;
        for (; (next = from[at]) != start; at = next) {
            memcpy(b->samples + at * b->brick_samples, b->samples + next * b->brick_samples, bytes);
            from[at] = at;
        }
        memcpy(b->samples + at * b->brick_samples, first, bytes);
        from[at] = at;
    }
    free(from);
    return DF_OK;
}

/* At holes, where the sign changes away from the faces, adds bricks until the change is stored. */
#define GROWTH_MAX 64
static df_status grow_at_holes(builder *b, uint32_t *tokens, df_error *err) {
    uint32_t first = 0;
    df_status status = df_alloc((void **)&b->waiting, b->lattice->cell_count[2], 1, "bricks", err);
    for (int round = 0; status == DF_OK && round < GROWTH_MAX; round++) {
        status = grow_cells(b, first, tokens, err);
        first = b->signed_count;
        if (status != DF_OK || b->cells.brick_count == first) break;
        status = df_build_sign_bricks(b, tokens, err);
    }
    free(b->waiting);
    b->waiting = NULL;
    return status == DF_OK ? sort_bricks(b, err) : status;
}

static df_status sign_and_grow(builder *b, uint32_t *tokens, df_error *err) {
    df_status status = df_build_sign_bricks(b, tokens, err);
    return status == DF_OK && b->input->sign->made.cap_count ? grow_at_holes(b, tokens, err) : status;
}

/* Counts the pairs of neighbours along an axis whose signs differ although no surface can lie between them. */
static void count_walls(const builder *b, df_build_report *report) {
    uint64_t count = 0, first = UINT64_MAX;
    uint32_t k = b->lattice->brick_size, steps[3] = {1, b->side, b->side * b->side};
#pragma omp parallel for schedule(static, 256) reduction(+ : count) reduction(min : first)
    for (uint32_t brick = 0; brick < b->cells.brick_count; brick++) {
        const float *samples = b->samples + brick * b->brick_samples;
        for (uint32_t i = 0; i < k * k * k; i++) {
            const float *s = samples + i % k + steps[1] * (i / k % k) + steps[2] * (i / k / k);
            for (int a = 0; a < 3; a++) {
                if (!df_sign_is_wall(b->lattice->voxel_size, s[0], s[steps[a]])) continue;
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
        tokens[i] = df_build_token(value < 0);
    }
}

/* For each of the 27 cells around a brick (bit dx+1 + 3 * (dy+1 + 3 * (dz+1))): 1 where a surface voxel of the brick
 * lies within one voxel of it. */
static uint32_t needed_neighbours(const builder *b, uint32_t brick) {
    uint32_t rows[SIDE_MAX * SIDE_MAX] = {0}, k = b->lattice->brick_size, side = b->side, needed = 0;
    const float *samples = b->samples + brick * b->brick_samples;
    for (uint32_t r = 0; r < side * side; r++) {
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
    df_build_set_dimensions(b, field);
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
    df_status status = df_build_check_memory(in->name, bytes, df_build_longest_side(b->lattice), 3, err);
    if (status != DF_OK) return status;
    /* where the mesh has holes, the cells that their fans pass are needed as well */
    const df_mesh *mesh = in->sign && in->sign->made.mesh.face_count ? &in->sign->made.mesh : in->mesh;
    if (mesh) return df_cells_find(mesh, b->lattice, DF_CELL_REACH, &b->cells, err);
    return df_cells_select(b->lattice, in->keep, in->keep_context, &b->cells, err);
}

df_status df_build_bricks(builder *b, df_field *field, df_build_report *report, df_error *err) {
    uint32_t *tokens = NULL;
    double start = df_now_ms();
    df_status status = find_cells(b, err);
    if (status != DF_OK) goto done;
    report->cells_computed = b->cells.brick_count;
    double cells = df_now_ms();
    status = fill_bricks(b, 0, err);
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
