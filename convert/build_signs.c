#include "convert/build_private.h"

#include "common/memory.h"

#include <stdlib.h>

/* Signs of the samples in the layers of a slab, number `index` from below, and tokens of the cells without a brick.
 * `active` is scratch for rules. Returns the number of samples with a winding number below 0. */
typedef uint64_t slab_signer(const builder *b, const df_winding_slab *slab, uint32_t index, uint32_t *tokens,
                             uint32_t *active);

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
            for (uint32_t x = 0; rule.needs_points && x <= k; x++) {
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
                if (brick >= b->signed_count) negative += sign_brick(b, slab, cell, brick, active);
            } else if (b->signed_count > 0) {
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
                tokens[index] = df_build_token(side < 0);
                negative += winding < 0;
            }
            last = brick;
        }
    }
    return negative;
}

/* Signs of the samples of a dense field in the layers of the slab; rules are made for blocks of k^3. */
static uint64_t sign_dense_slab(const builder *b, const df_winding_slab *slab, uint32_t index, uint32_t *tokens,
                                uint32_t *active) {
    (void)tokens;
    const df_lattice *l = b->lattice;
    size_t row = (size_t)l->voxel_count[0] + 1, layer = row * ((size_t)l->voxel_count[1] + 1);
    uint32_t k = l->brick_size;
    uint64_t negative = 0;
    df_sign_rule rule;
    int32_t winding[SIDE_MAX];
    for (uint32_t j = 0; j <= l->voxel_count[1]; j += k) {
        for (uint32_t i = 0; i <= l->voxel_count[0]; i += k) {
            uint32_t cell[3] = {i / k, j / k, index}, width = i + k <= row ? k : (uint32_t)row - i;
            rule_of_cell(b, cell, active, &rule);
            for (uint32_t y = j; y < j + k && y <= l->voxel_count[1]; y++) {
                for (uint32_t z = slab->z_first; z < slab->z_first + slab->z_count; z++) {
                    double points[SIDE_MAX][3];
                    for (uint32_t x = 0; x < width; x++) {
                        points[x][0] = df_lattice_at(l, 0, i + x);
                        points[x][1] = df_lattice_at(l, 1, y);
                        points[x][2] = df_lattice_at(l, 2, z);
                    }
                    df_winding_row(slab, y, z, i, width, winding);
                    df_sign_apply(&rule, winding, (const double(*)[3])points, width,
                                  b->samples + i + row * y + layer * z);
                    negative += count_negative(winding, width);
                }
            }
        }
    }
    return negative;
}

/* Runs over slab_count slabs of k layers, and `shared` more that the slab above has as well, with the winding numbers
 * of their rows. */
static df_status sign_slabs(const builder *b, slab_signer *sign_slab, uint32_t slab_count, uint32_t shared,
                            uint32_t *tokens, uint64_t *negative_count, df_error *err) {
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
        uint32_t *active;
        df_status ready = df_alloc_raw((void **)&active, sign->made.cap_count + 1, sizeof *active, "signs", &slab_err);
#pragma omp for schedule(dynamic, 1)
        for (uint32_t s = 0; s < slab_count; s++) {
            if (b->waiting && !b->waiting[s]) continue;
            uint32_t z = s * l->brick_size, rest = l->voxel_count[2] + 1 - z, count = l->brick_size + shared;
            df_status found = ready;
            if (found == DF_OK) {
                found = df_winding_slab_find(&slab, sign->mesh, faces.faces + faces.starts[s],
                                             faces.starts[s + 1] - faces.starts[s], l, z, count < rest ? count : rest,
                                             &slab_err);
            }
            if (found == DF_OK) {
                negative += sign_slab(b, &slab, s, tokens, active);
            } else {
#pragma omp critical
                status = df_fail(err, found, "%s", slab_err.text);
            }
        }
        free(active);
        df_winding_slab_free(&slab);
    }
    *negative_count = negative;
done:
    df_face_slabs_free(&faces);
    return status;
}

/* The same, and again on an oriented mesh where winding numbers below 0 show that a body may be inside out. */
static df_status sign_oriented(const builder *b, slab_signer *sign_slab, uint32_t slab_count, uint32_t shared,
                               uint32_t *tokens, df_error *err) {
    df_sign *sign = b->input->sign;
    uint64_t negative = 0;
    df_status status = sign_slabs(b, sign_slab, slab_count, shared, tokens, &negative, err);
    if (status != DF_OK || negative == 0 || !df_sign_may_orient(sign, b->input->mesh)) return status;
    status = df_sign_orient(sign, b->input->mesh, err);
    if (status != DF_OK || !sign->made.inverted_components) return status;
    return sign_slabs(b, sign_slab, slab_count, shared, tokens, &negative, err);
}

df_status df_build_sign_bricks(builder *b, uint32_t *tokens, df_error *err) {
    return sign_oriented(b, sign_layer, b->lattice->cell_count[2], 1, tokens, err);
}

df_status df_build_sign_dense(builder *b, df_error *err) {
    return sign_oriented(b, sign_dense_slab, b->lattice->voxel_count[2] / b->lattice->brick_size + 1, 0, NULL, err);
}
