/*
 * The walk of dda.h for devices: the same arithmetic with the three axes side by side. A walk lies in a few vector
 * registers and takes its steps without a branch; compilers for CPUs otherwise keep it on the stack.
 */

typedef struct dda_walk {
    float3 leave;      /* where the ray leaves the cell, by axis */
    float3 next_leave; /* and the cell after that, if it is along this axis */
    float3 next;       /* the plane it crosses there, grid space */
    float3 plane_step, end; /* to the next plane; what `next` is outside the box */
    float3 origin, inverse; /* of the ray */
    float t_end;            /* before this the ray does not leave the box */
    int64_t index, stride[3];
} dda_walk;

/* Places the walk in the cell after an event at which the ray enters the box, or starts in it. */
static DF_INLINE void dda_begin(dda_walk *w, const dda_box *box, const dda_ray *ray, dda_event at) {
    float plane[3], plane_step[3], last[3];
    w->index = box->base;
    for (int a = 0; a < 3; a++) {
        const int32_t upward = ray->direction[a] > 0, first = upward ? box->low[a] : box->high[a] - 1;
        const int32_t cell = a == at.axis ? first : dda_cell_after(box, ray, a, upward, at);
        plane_step[a] = upward ? box->size : -box->size;
        plane[a] = (float)(cell + upward) * box->size;
        last[a] = (float)(upward ? box->high[a] : box->low[a]) * box->size;
        w->index += (cell - box->low[a]) * box->stride[a];
        w->stride[a] = upward ? box->stride[a] : -box->stride[a];
    }
    const float3 planes = (float3)(plane[0], plane[1], plane[2]), ends = (float3)(last[0], last[1], last[2]);
    w->origin = (float3)(ray->origin[0], ray->origin[1], ray->origin[2]);
    w->inverse = (float3)(ray->inverse[0], ray->inverse[1], ray->inverse[2]);
    w->plane_step = (float3)(plane_step[0], plane_step[1], plane_step[2]);
    w->next = planes + w->plane_step;
    w->end = (ends + w->plane_step) + w->plane_step;
    w->leave = (planes - w->origin) * w->inverse;
    w->next_leave = (w->next - w->origin) * w->inverse;
    const float3 out = (ends - w->origin) * w->inverse;
    const float out_xy = out.y < out.x ? out.y : out.x;
    w->t_end = out.z < out_xy ? out.z : out_xy;
}

/* The lower corner of the cell, grid space. */
static inline void dda_cell(const dda_walk *w, float lower[3]) {
    const float3 plane = w->next - w->plane_step;
    const float3 corner = w->plane_step > 0 ? plane - w->plane_step : plane;
    lower[0] = corner.x;
    lower[1] = corner.y;
    lower[2] = corner.z;
}

/* Where the ray leaves the cell: along the lowest axis where it leaves through an edge. */
static inline void dda_exit(const dda_walk *w, dda_event *out) {
    const bool y = w->leave.y < w->leave.x;
    const float t = y ? w->leave.y : w->leave.x;
    const bool z = w->leave.z < t;
    out->t = z ? w->leave.z : t;
    out->axis = z ? 2 : y;
}

/* Goes on to the next cell, through the event of dda_exit; false where that is outside the box. */
static inline bool dda_step(dda_walk *w, const dda_ray *ray, const dda_event *out) {
    /* y before x, z before y, z before x: the ray crosses a plane of x where neither the first nor the last holds */
    const int3 before = w->leave.yzz < w->leave.xyx;
    const int3 crossed = (before.xxy ^ (int3)(-1, 0, 0)) & (before.zyz ^ (int3)(-1, -1, 0));
    const int64_t stride = out->axis == 1 ? w->stride[1] : w->stride[0];
    w->index += out->axis == 2 ? w->stride[2] : stride;
    w->leave = crossed ? w->next_leave : w->leave;
    w->next += as_float3(as_int3(w->plane_step) & crossed); /* whole numbers below 2^24: exact */
    w->next_leave = (w->next - w->origin) * w->inverse;
    return out->t < w->t_end || !any(w->next == w->end);
}
