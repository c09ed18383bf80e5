#include "convert/neighbours.h"

#include "common/memory.h"

#include <stdlib.h>
#include <string.h>

/* What the cell of the children's size of a family at `place` has become, -1 to 2 along each axis in units of the
 * children. */
static uint32_t family_at(const df_neighbours *n, const df_family *families, uint32_t family, const int place[3]) {
    uint32_t towards = 0, child = 0, weight = 1;
    for (int a = 0; a < 3; a++, weight *= 3) {
        towards += weight * (uint32_t)(place[a] < 0 ? 0 : place[a] > 1 ? 2 : 1);
        child |= (uint32_t)(place[a] & 1) << a;
    }
    uint32_t other = n->around[family][towards];
    if (other >= DF_NEIGHBOUR_LEAF) return other;
    bool divided = df_family_state(&families[other], child) == DF_CHILD_FAMILY;
    return divided ? df_family_child(&families[other], child) : DF_NEIGHBOUR_LEAF;
}

static void find_around(const df_neighbours *n, const df_family *families, uint32_t family) {
    uint32_t parent = families[family].parent >> 3, child = families[family].parent & 7;
    for (int d = 0; d < 27; d++) {
        const int place[3] = {(int)(child & 1) + d % 3 - 1, (int)(child >> 1 & 1) + d / 3 % 3 - 1,
                              (int)(child >> 2) + d / 9 - 1};
        n->around[family][d] = family_at(n, families, parent, place);
    }
}

static void list_cells(uint32_t sample, df_sample_cells *cells) {
    const uint32_t at[3] = {sample % 3, sample / 3 % 3, sample / 9};
    for (uint32_t octant = 0; octant < 8; octant++) {
        uint32_t direction = 0, there = 0, weight = 1;
        bool exists = true;
        for (int a = 0; a < 3; a++, weight *= 3) {
            uint32_t upper = octant >> a & 1, step = at[a] == 1 ? 1 : at[a] / 2 + upper;
            exists = exists && (at[a] != 1 || !upper); /* on the middle plane there is one cell along the axis */
            direction += weight * step;
            there += weight * (step == 1 ? at[a] : 2 - at[a]);
        }
        if (!exists) continue;
        cells->mask |= 1u << direction;
        cells->directions[cells->count] = (uint8_t)direction;
        cells->samples[cells->count++] = (uint8_t)there;
    }
}

void df_neighbours_list_cells(df_neighbours *n) {
    memset(n->cells, 0, sizeof n->cells);
    for (uint32_t i = 0; i < DF_FAMILY_SAMPLE_COUNT; i++) list_cells(i, &n->cells[i]);
}

df_status df_neighbours_find(const df_family *families, uint32_t count, df_neighbours *n, df_error *err) {
    *n = (df_neighbours){.level_count = 1};
    df_status status = df_alloc_raw((void **)&n->around, count, sizeof *n->around, "octree", err);
    if (status != DF_OK) return status;
    for (uint32_t f = 1; f < count; f++) {
        if (families[f].parent >> 3 >= n->starts[n->level_count - 1]) n->starts[n->level_count++] = f;
    }
    n->starts[n->level_count] = count;
    df_neighbours_list_cells(n);
    for (int d = 0; d < 27; d++) n->around[0][d] = d == 13 ? 0 : DF_NEIGHBOUR_BEYOND;
    for (uint32_t level = 1; level < n->level_count; level++) {
#pragma omp parallel for schedule(static)
        for (uint32_t f = n->starts[level]; f < n->starts[level + 1]; f++) find_around(n, families, f);
    }
    return DF_OK;
}

void df_neighbours_free(df_neighbours *neighbours) {
    free(neighbours->around);
    *neighbours = (df_neighbours){0};
}

uint32_t df_hanging_samples(const df_neighbours *neighbours, uint32_t family) {
    const uint32_t *around = neighbours->around[family];
    uint32_t leaves = 0, hanging = 0;
    for (uint32_t d = 0; d < 27; d++) leaves |= (uint32_t)(around[d] == DF_NEIGHBOUR_LEAF) << d;
    for (uint32_t s = 0; leaves && s < DF_FAMILY_SAMPLE_COUNT; s++) {
        hanging |= (uint32_t)((leaves & neighbours->cells[s].mask) != 0) << s;
    }
    return hanging;
}
