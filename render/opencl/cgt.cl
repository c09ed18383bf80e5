/*
 * Coherent grid traversal (Wald et al. 2006): a work group is a packet of rays that visits the grid slice by slice along its main axis.
 * Each work item finds for all, in a slice of its own, the rectangle of cells that the packet can meet and whether it holds surface; then every
 * ray goes through the rectangles that do, looks which cells it passes through, and goes on in them alone. Rays that do not run together walk alone
 * from the start. The hits are those of the 3DDDA: a ray takes the first of its cells, in the order of events, that holds a hit.
 */

#if DF_LEVELS == 1
#define DF_CGT_SIZE 1
#else
#define DF_CGT_SIZE DF_K
#endif
#define DF_CGT_BOUNDS 9                   /* floats per work item in local memory while bounds are found; */
#define DF_CGT_VALUES (DF_CGT_BOUNDS + 4) /* the 4 after those of all work items: the rectangle of a slice */

/* The event at which a ray enters a cell, or starts in it; false where it does not visit it (as df_cell_segment has it). */
static inline bool dda_enter_cell(const dda_ray *ray, const float lower[3], float size, dda_event *at) {
    dda_event in = {-INFINITY, 0}, out = {INFINITY, 0};
    for (int a = 0; a < 3; a++) {
        float low = dda_plane_t(ray, a, lower[a]), high = dda_plane_t(ray, a, lower[a] + size);
        float enter = low < high ? low : high, leave = low < high ? high : low;
        if (enter >= in.t) in = (dda_event){enter, a};
        if (leave < out.t) out = (dda_event){leave, a};
    }
    *at = in.t > 0 ? in : (dda_event){0, 3};
    return at->t < out.t || (at->t == out.t && at->axis <= out.axis);
}

/* Sets bounds[i] for i < DF_CGT_BOUNDS to the largest of the work items' values. All work items of the group must call it. */
static inline void df_cgt_largest(__local float *bounds, uint item, uint count) {
    barrier(CLK_LOCAL_MEM_FENCE);
    while (count > 1) {
        const uint half_count = (count + 1) / 2;
        if (item + half_count < count) {
            for (int i = 0; i < DF_CGT_BOUNDS; i++) {
                bounds[i + DF_CGT_BOUNDS * item] = fmax(bounds[i + DF_CGT_BOUNDS * item], bounds[i + DF_CGT_BOUNDS * (item + half_count)]);
            }
        }
        count = half_count;
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

/* What the packet has in common. */
typedef struct df_cgt_packet {
    int main, u, v; /* axes */
    int upward;     /* along the main axis */
    bool coherent;
} df_cgt_packet;

/* Finds the main axis, that of the first ray's largest direction, whether all rays run along it, and where they meet the first and last
 * plane of the grid: bounds holds -low and high of u on the first plane, of u on the last, of v on the first, of v on the last. */
static inline df_cgt_packet df_cgt_begin(const dda_ray *ray, const uint32_t cells[3], __local float *bounds, uint item, uint items) {
    df_cgt_packet packet;
    if (item == 0) {
        for (int a = 0; a < 3; a++) bounds[a] = ray->direction[a];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    const float first[3] = {fabs(bounds[0]), fabs(bounds[1]), fabs(bounds[2])};
    packet.main = first[0] >= first[1] ? 0 : 1;
    if (first[2] > first[packet.main]) packet.main = 2;
    packet.upward = bounds[packet.main] > 0;
    packet.u = (packet.main + 1) % 3;
    packet.v = (packet.main + 2) % 3;
    barrier(CLK_LOCAL_MEM_FENCE);

    const int m = packet.main;
    const float length = (float)(cells[m] * DF_CGT_SIZE), along = ray->direction[m];
    const float widest = fmax(fabs(ray->direction[packet.u]), fabs(ray->direction[packet.v]));
    const bool alone = (along > 0) != (packet.upward != 0) || fabs(along) < 0.25f * widest;
    const float t[2] = {dda_plane_t(ray, m, packet.upward ? 0 : length), dda_plane_t(ray, m, packet.upward ? length : 0)};
    __local float *mine = bounds + DF_CGT_BOUNDS * item;
    for (int end = 0; end < 2; end++) {
        const float u = ray->origin[packet.u] + t[end] * ray->direction[packet.u];
        const float v = ray->origin[packet.v] + t[end] * ray->direction[packet.v];
        mine[2 * end] = -u;
        mine[2 * end + 1] = u;
        mine[4 + 2 * end] = -v;
        mine[4 + 2 * end + 1] = v;
    }
    mine[8] = alone ? 1 : 0;
    df_cgt_largest(bounds, item, items);
    packet.coherent = bounds[8] == 0;
    return packet;
}

/* The larger of two numbers: fmax is a call on some devices, and so is floor. */
static inline float df_cgt_larger(float a, float b) {
    return a < b ? b : a;
}

/* The whole part of a number, within 0 and count. */
static inline int df_cgt_whole(float number, int count) {
    return number >= (float)count ? count : number > 0 ? (int)number : 0;
}

/* The cells low <= c < high along u or v that the packet can meet between two fractions of its way through the grid. */
static inline void df_cgt_range(__local const float *bounds, float from, float to, float margin, int count, int *low, int *high) {
    const float to_low = bounds[2] - bounds[0], to_high = bounds[3] - bounds[1];
    const float least = -df_cgt_larger(bounds[0] + from * to_low, bounds[0] + to * to_low) - margin;
    const float most = df_cgt_larger(bounds[1] + from * to_high, bounds[1] + to * to_high) + margin;
    *low = df_cgt_whole(least / DF_CGT_SIZE, count);
    *high = most < 0 ? 0 : df_cgt_whole(most / DF_CGT_SIZE + 1, count);
}

/* Looks for a hit of a ray in one cell that holds surface, if that comes before the one it has. */
static inline void df_cgt_cell(const df_scene *scene, const dda_ray *ray, const float lower[3], uint32_t block,
                               dda_event *first, bool *hit, df_candidate *candidate, df_counters *counters) {
    dda_event at;
    df_candidate found;
    counters->coarse_steps++;
    if (!dda_enter_cell(ray, lower, DF_CGT_SIZE, &at) || (*hit && !dda_precedes(at.t, at.axis, *first))) return;
#if DF_LEVELS == 1
    if (!dda_accept(scene, DF_ISOLATE, ray, lower, block, &found, counters)) return;
#else
    if (!dda_block(scene, DF_ISOLATE, ray, lower, block, at, &found, counters)) return;
#endif
    *hit = true;
    *first = at;
    *candidate = found;
}

/* The surface in a cell: its block, or DF_CELL_INSIDE or more where there is none. */
static inline uint32_t df_cgt_block(const df_scene *scene, const int cell[3]) {
#if DF_LEVELS == 1
    const uint64_t row = ((uint64_t)cell[2] * scene->voxel_count[1] + cell[1]) * scene->row_words;
    return scene->rows[row + cell[0] / 64] >> (cell[0] & 63) & 1 ? 0 : DF_CELL_INSIDE;
#else
    return scene->coarse[((uint64_t)cell[2] * scene->coarse_count[1] + cell[1]) * scene->coarse_count[0] + cell[0]];
#endif
}

/* The cells of slice s that the packet can meet and that lie between the first and the last that hold surface, along v: rectangle holds low
 * and high along u, low and high along v; low = high where there are none. */
static inline void df_cgt_slice(const df_scene *scene, const df_cgt_packet *packet, const uint32_t cells[3], __local const float *bounds,
                                int s, __local int *rectangle) {
    const int u = packet->u, v = packet->v, slices = (int)cells[packet->main];
    const float margin = 0.01f + 4e-6f * DF_CGT_SIZE * (float)max(cells[0], max(cells[1], cells[2]));
    const float from = (float)s / slices, to = (float)(s + 1) / slices;
    int cell[3], low[2], high[2], first = INT_MAX, last = -1;
    cell[packet->main] = packet->upward ? s : slices - 1 - s;
    df_cgt_range(bounds, from, to, margin, (int)cells[u], &low[0], &high[0]);
    df_cgt_range(bounds + 4, from, to, margin, (int)cells[v], &low[1], &high[1]);
    for (cell[v] = low[1]; cell[v] < high[1]; cell[v]++) {
        for (cell[u] = low[0]; cell[u] < high[0]; cell[u]++) {
            if (df_cgt_block(scene, cell) >= DF_CELL_INSIDE) continue;
            first = min(first, cell[v]);
            last = cell[v];
        }
    }
    rectangle[0] = low[0];
    rectangle[1] = high[0];
    rectangle[2] = last < 0 ? 0 : first;
    rectangle[3] = last + 1;
}

/* Looks for a hit of a ray in a slice. */
static inline bool df_cgt_visit(const df_scene *scene, const dda_ray *ray, const df_cgt_packet *packet, int slice, __local const int *rectangle,
                                df_candidate *candidate, df_counters *counters) {
    const int m = packet->main, u = packet->u, v = packet->v;
    int cell[3];
    bool hit = false;
    dda_event first;
    cell[m] = slice;
    for (cell[v] = rectangle[2]; cell[v] < rectangle[3]; cell[v]++) {
        for (cell[u] = rectangle[0]; cell[u] < rectangle[1]; cell[u]++) {
            const uint32_t block = df_cgt_block(scene, cell);
            if (block >= DF_CELL_INSIDE) continue;
            const float lower[3] = {(float)(cell[0] * DF_CGT_SIZE), (float)(cell[1] * DF_CGT_SIZE), (float)(cell[2] * DF_CGT_SIZE)};
            df_cgt_cell(scene, ray, lower, block, &first, &hit, candidate, counters);
        }
    }
    return hit;
}

/* A ray through the grid, by the slices and rectangles of its packet. Of as many slices as there are work items, each finds the rectangle of
 * one, for all; then every ray goes through them on its own. All work items of the group must call it; `ended`: the ray needs no more. Returns
 * whether it has a hit. */
static inline bool df_cgt_walk(const df_scene *scene, const dda_ray *ray, const df_cgt_packet *packet, const uint32_t cells[3],
                               __local const float *bounds, __local int *rectangles, int item, int items, bool ended,
                               df_candidate *candidate, df_counters *counters) {
    const int m = packet->main, slices = packet->coherent ? (int)cells[m] : 0;
    bool hit = false;
    for (int begin = 0; begin < slices; begin += items) {
        if (begin + item < slices) df_cgt_slice(scene, packet, cells, bounds, begin + item, rectangles + 4 * item);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int s = begin; s < slices && s < begin + items && !ended; s++) {
            __local const int *rectangle = rectangles + 4 * (s - begin);
            if (rectangle[2] >= rectangle[3]) continue;
            const int near = packet->upward ? s : slices - s, far = packet->upward ? s + 1 : slices - 1 - s;
            if (dda_plane_t(ray, m, (float)(far * DF_CGT_SIZE)) < ray->first) continue;
            ended = dda_plane_t(ray, m, (float)(near * DF_CGT_SIZE)) > ray->last;
            if (ended) break;
            hit = df_cgt_visit(scene, ray, packet, packet->upward ? s : slices - 1 - s, rectangle, candidate, counters);
            ended = hit;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    return hit;
}

/* What df_trace_view does, by packets. shared: DF_CGT_VALUES floats a work item. A work group is a packet. */
__kernel void df_cgt_view(DF_SCENE_PARAMETERS, const df_view view, uint first_row, uint row_count, __global const double *bounds,
                          __global uchar *found, __global uint4 *candidates, __global uint *counts, __local float *shared) {
    const uint x = get_global_id(0), y = get_global_id(1);
    const uint items = (uint)(get_local_size(0) * get_local_size(1)), item = (uint)(get_local_id(0) + get_local_size(0) * get_local_id(1));
    const df_scene scene = df_scene_make(DF_SCENE_ARGUMENTS);
    df_candidate candidate;
    df_counters counters = {0, 0, 0};
    /* Work items past the edge of the picture follow its last rays. */
    const dda_ray ray = df_pixel_ray(&view, min(x, view.width - 1), first_row, min(y, row_count - 1), row_count, bounds);
    uint32_t cells[3];
    for (int a = 0; a < 3; a++) cells[a] = DF_LEVELS == 1 ? scene.voxel_count[a] : scene.coarse_count[a];
    const df_cgt_packet packet = df_cgt_begin(&ray, cells, shared, item, items);
    const bool misses = !(ray.first <= ray.last);
    bool hit = df_cgt_walk(&scene, &ray, &packet, cells, shared, (__local int *)(shared + DF_CGT_BOUNDS * items), (int)item, (int)items, misses,
                           &candidate, &counters);
    if (!packet.coherent && !misses) hit = dda_walk_scene(&scene, DF_ISOLATE, &ray, &candidate, &counters);
    if (x < view.width && y < row_count) {
        df_store_found(hit, &candidate, &counters, x + (size_t)view.width * y, (size_t)view.width * row_count, found, candidates, counts);
    }
}
