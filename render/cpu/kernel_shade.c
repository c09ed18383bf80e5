/* Hits to pixels: DF_LANES at a time. */
#include "render/cpu/fetch.h"
#include "render/cpu/kernel.h"
#include "render/methods/gradient.h"
#include "render/methods/shade.h"

#include <string.h>

/* Samples around DF_LANES hits, as they are fetched, and around voxels that hits before them lay in. */
enum { KEPT = 64 };
typedef struct stencils {
    const float *from[DF_LANES];
    float of[DF_LANES][DF_FETCH_STENCIL];
    uint64_t voxel[KEPT];  /* x + 2^16 y + 2^32 z + 2^48 log2 of a leaf's size; all bits set: none */
    uint32_t needed[KEPT]; /* the vector of hits that wants it last: it stays as long */
    float kept[KEPT][DF_FETCH_STENCIL];
    float *to[DF_LANES]; /* of the vector found last: where what is fetched goes, NULL where it is there already */
    df_fetch_way ways[DF_LANES];
    df_fetch_leaf_way leaf_ways[DF_LANES];
} stencils;

/* Where the stencil of hit `first` + i of a vector goes, that of the voxel or leaf `key`; NULL where it is there
 * already. */
static inline float *place_stencil(stencils *in, uint32_t i, uint32_t first, uint64_t key, uint32_t slot) {
    const bool known = in->voxel[slot] == key, keep = known || in->needed[slot] != first;
    in->from[i] = keep ? in->kept[slot] : in->of[i];
    if (keep) in->needed[slot] = first;
    if (known) return NULL;
    if (keep) in->voxel[slot] = key;
    return keep ? in->kept[slot] : in->of[i];
}

/* Where the stencils of the vector of hits from `first` on lie. */
static inline void find_stencils(const df_scene *scene, const df_hits *hits, uint32_t first, bool beyond, stencils *in,
                                 df_sample_type type) {
    for (uint32_t i = 0; i < DF_LANES && first + i < hits->count; i++) {
        const uint32_t voxel[3] = {hits->cell[0][first + i], hits->cell[1][first + i], hits->cell[2][first + i]};
        const uint64_t key = voxel[0] | (uint64_t)voxel[1] << 16 | (uint64_t)voxel[2] << 32;
        in->to[i] = place_stencil(in, i, first, key, (voxel[0] + 5 * voxel[1] + 25 * voxel[2]) % KEPT);
        if (in->to[i]) df_fetch_find(scene, voxel, hits->block[first + i], beyond, &in->ways[i], type);
    }
}

static inline void fetch_stencils(const df_scene *scene, uint32_t lanes, bool beyond, const stencils *in,
                                  df_sample_type type) {
    for (uint32_t i = 0; i < lanes; i++) {
        if (in->to[i]) df_fetch_stencil(scene, &in->ways[i], beyond, in->to[i], type);
    }
}

/* The stencil of a leaf from the octree itself. */
static void find_leaf_stencil(const df_scene *scene, const uint32_t corner[3], uint32_t leaf, uint32_t size_log2,
                              bool beyond, float samples[DF_FETCH_STENCIL]) {
    float stencil[64] = {0};
    df_scene_leaf_stencil(scene, corner, leaf, size_log2, beyond ? DF_REACH_FACES : DF_REACH_CELL, stencil, 1);
    for (int n = 0; n < DF_FETCH_STENCIL; n++) samples[n] = stencil[df_fetch_place(n)];
}

static void find_leaf_stencils(const df_scene *scene, const df_hits *hits, uint32_t first, stencils *in) {
    for (uint32_t i = 0; i < DF_LANES && first + i < hits->count; i++) {
        const uint32_t corner[3] = {hits->cell[0][first + i], hits->cell[1][first + i], hits->cell[2][first + i]};
        const uint32_t size_log2 = hits->flags[first + i] >> DF_HIT_SIZE_SHIFT;
        const uint64_t key =
            corner[0] | (uint64_t)corner[1] << 16 | (uint64_t)corner[2] << 32 | (uint64_t)size_log2 << 48;
        const uint32_t slot = ((corner[0] >> size_log2) + 5 * (corner[1] >> size_log2) + 25 * (corner[2] >> size_log2));
        in->to[i] = place_stencil(in, i, first, key, slot % KEPT);
        if (in->to[i]) df_fetch_find_leaf(hits->stencils, scene->field, hits->block[first + i], &in->leaf_ways[i]);
    }
}

static void fetch_leaf_stencils(const df_scene *scene, const df_hits *hits, uint32_t first, uint32_t lanes, bool beyond,
                                const stencils *in) {
    for (uint32_t i = 0; i < lanes; i++) {
        if (!in->to[i] || df_fetch_leaf(&in->leaf_ways[i], beyond, in->to[i])) continue;
        const uint32_t corner[3] = {hits->cell[0][first + i], hits->cell[1][first + i], hits->cell[2][first + i]};
        /* the size scales the gradient, which the normal does not feel */
        const uint32_t size_log2 = hits->flags[first + i] >> DF_HIT_SIZE_SHIFT;
        find_leaf_stencil(scene, corner, hits->block[first + i], size_log2, beyond, in->to[i]);
    }
}

/* What is fetched, as lanes. */
static void transpose_stencils(const stencils *in, lf stencil[64]) {
    for (int part = 0; part < DF_FETCH_STENCIL; part += 8) {
        const float *from[DF_LANES];
        lf eight[8];
        for (int i = 0; i < DF_LANES; i++) from[i] = in->from[i] + part;
        lf_load_8(from, eight);
        for (int n = 0; n < 8; n++) stencil[df_fetch_place(part + n)] = eight[n];
    }
}

/* DF_REACH_ALL, as lanes. */
static void fetch_whole_stencils(const df_scene *scene, const df_hits *hits, uint32_t first, uint32_t lanes,
                                 lf stencil[64]) {
    float of[64][DF_LANES] = {{0}};
    for (uint32_t i = 0; i < lanes; i++) {
        const uint32_t cell[3] = {hits->cell[0][first + i], hits->cell[1][first + i], hits->cell[2][first + i]};
        const uint32_t block = hits->block[first + i], size_log2 = hits->flags[first + i] >> DF_HIT_SIZE_SHIFT;
        if (scene->levels == 0) df_scene_leaf_stencil(scene, cell, block, size_log2, DF_REACH_ALL, &of[0][i], DF_LANES);
        else df_scene_stencil(scene, cell, block, DF_REACH_ALL, &of[0][i], DF_LANES);
    }
    for (int n = 0; n < 64; n++) stencil[n] = lf_load(of[n]);
}

/* 1 / the distance between the samples of each hit's stencil along the axes, world units. */
static void inverse_steps(const df_shade_job *job, const df_hits *hits, uint32_t first, uint32_t lanes,
                          lf inverse_step[3]) {
    float size[DF_LANES];
    for (uint32_t i = 0; i < DF_LANES; i++)
        size[i] = i < lanes ? (float)(1u << (hits->flags[first + i] >> DF_HIT_SIZE_SHIFT)) : 1;
    for (int a = 0; a < 3; a++) inverse_step[a] = lf_set(df_view_inverse_size(job->tile->view, a)) / lf_load(size);
}

/* The gradients of the field at hits first .. first + lanes - 1. */
static void field_gradients(const df_shade_job *job, const df_hits *hits, uint32_t first, uint32_t lanes, stencils *in,
                            lf gradient[3]) {
    const df_scene *scene = job->scene;
    const df_sample_type type = scene->field->sample_type;
    const int reach = df_gradient_reach(job->gradient);
    const bool beyond = reach == DF_REACH_FACES;
    lf stencil[64], local[3], inverse_step[3] = {lf_set(1), lf_set(1), lf_set(1)};
    if (reach == DF_REACH_ALL) {
        fetch_whole_stencils(scene, hits, first, lanes, stencil);
    } else if (scene->levels == 0) { /* those of the next hits are on their way while these are shaded */
        if (first == 0) find_leaf_stencils(scene, hits, 0, in);
        fetch_leaf_stencils(scene, hits, first, lanes, beyond, in);
        transpose_stencils(in, stencil);
        find_leaf_stencils(scene, hits, first + DF_LANES, in);
    } else {
        if (first == 0) DF_FETCH_BY_TYPE(type, find_stencils, scene, hits, 0, beyond, in);
        DF_FETCH_BY_TYPE(type, fetch_stencils, scene, lanes, beyond, in);
        transpose_stencils(in, stencil);
        DF_FETCH_BY_TYPE(type, find_stencils, scene, hits, first + DF_LANES, beyond, in);
    }
    if (job->gradient == DF_GRADIENT_CREASE) inverse_steps(job, hits, first, lanes, inverse_step);
    for (int a = 0; a < 3; a++) local[a] = lf_load(hits->local[a] + first);
    df_gradient(job->gradient, stencil, local, inverse_step, gradient);
}

/* What a vector of hits looks like. */
typedef struct looks {
    int32_t level[3][DF_LANES]; /* of df_shade_table, by colour */
    float normal[3][DF_LANES], direction[3][DF_LANES];
} looks;

static void write_pixels(const df_shade_job *job, const df_hits *hits, uint32_t first, uint32_t lanes,
                         const looks *out) {
    const df_tile *tile = job->tile;
    const uint8_t *table = job->table;
    const double rows_a_ray = 1.0 / tile->width;
    size_t pixels[DF_LANES];
    for (uint32_t i = 0; i < lanes; i++) {
        const uint32_t ray = hits->ray[first + i];
        const uint32_t row = (uint32_t)((ray + 0.5) * rows_a_ray); /* ray / width: half a ray is more than rounds */
        pixels[i] = (size_t)(tile->y + row) * job->picture_width + tile->x + (ray - row * tile->width);
    }
    for (uint32_t i = 0; job->rgb && i < lanes; i++) {
        uint8_t *restrict rgb = job->rgb + 3 * pixels[i];
        rgb[0] = table[out->level[0][i]];
        rgb[1] = table[out->level[1][i]];
        rgb[2] = table[out->level[2][i]];
    }
    for (uint32_t i = 0; job->normals && i < lanes; i++) {
        for (int a = 0; a < 3; a++) job->normals[3 * pixels[i] + (size_t)a] = out->normal[a][i];
    }
    for (uint32_t i = 0; job->depth && i < lanes; i++) {
        const float direction[3] = {out->direction[0][i], out->direction[1][i], out->direction[2][i]};
        job->depth[pixels[i]] = df_view_distance(tile->view, direction, hits->t[first + i]);
    }
}

void DF_KERNEL(df_kernel_shade)(const df_shade_job *job, const df_hits *hits) {
    const df_view *view = job->tile->view;
    const float albedo[3] = DF_SHADE_ALBEDO;
    lf size[3], inverse_size[3];
    stencils in;
    memset(in.of, 0, sizeof in.of);
    memset(in.voxel, 0xFF, sizeof in.voxel);
    memset(in.needed, 0xFF, sizeof in.needed);
    for (int i = 0; i < DF_LANES; i++) in.from[i] = in.of[i];
    for (int a = 0; a < 3; a++) {
        size[a] = lf_set(view->relative_size[a]);
        inverse_size[a] = lf_set(1.0f / view->relative_size[a]);
    }
    for (uint32_t first = 0; first < hits->count; first += DF_LANES) {
        const uint32_t lanes = hits->count - first < DF_LANES ? hits->count - first : DF_LANES;
        lf gradient[3], direction[3], toward_eye[3], normal[3];
        looks out;
        if (hits->has_normals) { /* the tracer's own */
            const li ray = li_select(lm_first(lanes), li_load((const int32_t *)hits->ray + first), li_set(0));
            for (int a = 0; a < 3; a++) gradient[a] = lf_load(hits->normal[a] + first) * size[a];
            for (int a = 0; a < 3; a++) direction[a] = lf_gather(job->tile->rays.direction[a], ray);
        } else {
            field_gradients(job, hits, first, lanes, &in, gradient);
            for (int a = 0; a < 3; a++) direction[a] = lf_load(hits->direction[a] + first);
        }
        df_shade_toward_eye(direction, size, toward_eye);
        df_shade_normal(gradient, inverse_size, toward_eye, normal);
        const lf light = df_shade_light(normal, toward_eye);
        for (int c = 0; c < 3; c++) li_store(out.level[c], df_shade_level(lf_set(albedo[c]) * light));
        for (int a = 0; a < 3; a++) {
            lf_store(out.normal[a], normal[a]);
            lf_store(out.direction[a], direction[a]);
        }
        write_pixels(job, hits, first, lanes, &out);
    }
}
