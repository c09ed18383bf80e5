#include "truth.h"

#include <assert.h>
#include <float.h>
#include <math.h>

typedef df_quad quad;

static quad quad_abs(quad a) { return a < 0 ? -a : a; }

static quad quad_max(quad a, quad b) { return a > b ? a : b; }

/* long double has the exponents of quad and 64 bits of it; each Newton step doubles that. */
static quad quad_sqrt(quad a) {
    if (a <= 0) return 0;
    quad root = (quad)sqrtl((long double)a);
    for (int i = 0; i < 2; i++) root = (root + a / root) / 2;
    return root;
}

static int64_t quad_floor(quad a) {
    int64_t whole = (int64_t)a;
    return (quad)whole > a ? whole - 1 : whole;
}

/* The cubic along one piece of the ray, over s in [0,1], and the gradient as a function of s. */
typedef struct piece {
    quad t0, t1;
    quad c[4];       /* c[0] + c[1] s + c[2] s^2 + c[3] s^3 */
    quad k[8];       /* the trilinear field in powers: corner order, k[7] is of xyz */
    quad a[3], e[3]; /* local entry, and exit - entry */
    quad side;       /* of the cell, voxels */
    quad zero;       /* values up to this are rounding: exactly iso */
} piece;

/* What is known of a ray so far: see visit. */
typedef struct search {
    quad length; /* of the direction */
    bool jumps;  /* the field is not continuous */
    quad band;
    /* the exact answer */
    bool started, inside, found;
    quad t;
    /* the answer that stands up to the band */
    int certain;             /* +1 or -1: the last side that is beyond doubt; 0: none yet */
    bool run, done, tangent; /* run: in the band since run_low */
    quad run_low, run_high;
} search;

static quad cubic(const piece *p, quad s) { return ((p->c[3] * s + p->c[2]) * s + p->c[1]) * s + p->c[0]; }

static quad gradient_length(const piece *p, quad s) {
    quad x = p->a[0] + s * p->e[0], y = p->a[1] + s * p->e[1], z = p->a[2] + s * p->e[2];
    const quad *k = p->k;
    quad gx = k[1] + k[3] * y + k[5] * z + k[7] * y * z;
    quad gy = k[2] + k[3] * x + k[6] * z + k[7] * x * z;
    quad gz = k[4] + k[5] * x + k[6] * y + k[7] * x * y;
    return quad_sqrt(gx * gx + gy * gy + gz * gz) / p->side;
}

/* The crossing in [low, high], where the cubic is monotone and the sides of the ends differ. */
static quad monotone_root(const piece *p, quad low, quad high) {
    bool rising = cubic(p, high) > cubic(p, low);
    quad s = (low + high) / 2;
    for (int i = 0; i < 400 && low < high; i++) {
        quad f = cubic(p, s), slope = (3 * p->c[3] * s + 2 * p->c[2]) * s + p->c[1];
        if (f == 0) return s;
        if ((f < 0) == rising) low = s;
        else high = s;
        quad next = s - f / slope; /* not finite where the slope is 0: the comparison refuses it */
        quad middle = (low + high) / 2;
        if (!(next > low && next < high) || i % 4 == 3)
            next = middle; /* a bisection now and then bounds the number of steps */
        if (next == s || middle == low || middle == high) return s;
        s = next;
    }
    return s;
}

/* Takes the next point of a ray at which the field may turn around: its value and the width of the band there. `from`:
 * the last such point in the same piece, negative when there is none (a piece begins). */
static void visit(search *r, const piece *p, quad from, quad s, quad f, quad width) {
    const quad t = p->t0 + s * (p->t1 - p->t0);
    const bool inside = f < -p->zero;
    if (!r->started) {
        r->started = true;
        r->inside = inside;
    } else if (!r->found && inside != r->inside) {
        r->found = true;
        r->t = from < 0 ? t : p->t0 + monotone_root(p, from, s) * (p->t1 - p->t0);
    }
    const int side = f > width ? 1 : f < -width ? -1 : 0;
    if (side == 0) {
        if (!r->run) r->run_low = t;
        r->run = true;
        r->run_high = t;
        r->tangent |= r->certain == 0;
        return;
    }
    if (r->run && (side == r->certain || (r->run_high - r->run_low) * r->length > (quad)DF_TRUTH_RUN_MAX))
        r->tangent = true;
    r->run = false;
    r->done = r->found;
    r->certain = side;
}

static void visit_cubic(search *r, const piece *p) {
    quad stops[4] = {0, 1, 1, 1};
    int count = 1;
    /* derivative: a s^2 + 2 b s + c */
    quad a = 3 * p->c[3], b = p->c[2], c = p->c[1], disc = b * b - a * c;
    if (disc > 0) {
        quad far = b > 0 ? -b - quad_sqrt(disc) : quad_sqrt(disc) - b;
        quad roots[2] = {far != 0 ? c / far : 2, a != 0 ? far / a : 2};
        if (roots[0] > roots[1]) {
            quad swap = roots[0];
            roots[0] = roots[1];
            roots[1] = swap;
        }
        for (int i = 0; i < 2; i++) {
            if (roots[i] > 0 && roots[i] < 1) stops[count++] = roots[i];
        }
    }
    stops[count++] = 1;
    /* Where neighbours differ (ADF), a piece shorter than the band is one that another ray, as good as this one, does
     * not meet. */
    const bool doubtful = r->jumps && (p->t1 - p->t0) * r->length < r->band;
    for (int i = 0; i < count && !r->done; i++) {
        quad width = doubtful ? (quad)INFINITY : r->band * gradient_length(p, stops[i]);
        visit(r, p, i ? stops[i - 1] : -1, stops[i], cubic(p, stops[i]), width);
    }
}

/* A piece in a cell with these corners (minus iso), with local coordinates in units of the cell. */
static void make_piece(piece *p, const quad f[8]) {
    const quad *a = p->a, *e = p->e;
    quad *k = p->k;
    k[0] = f[0];
    k[1] = f[1] - f[0];
    k[2] = f[2] - f[0];
    k[3] = f[3] - f[2] - k[1];
    k[4] = f[4] - f[0];
    k[5] = f[5] - f[4] - k[1];
    k[6] = f[6] - f[4] - k[2];
    k[7] = (f[7] - f[6]) - (f[5] - f[4]) - k[3];
    p->c[0] = k[0] + k[1] * a[0] + k[2] * a[1] + k[4] * a[2] + k[3] * a[0] * a[1] + k[5] * a[0] * a[2] +
              k[6] * a[1] * a[2] + k[7] * a[0] * a[1] * a[2];
    p->c[1] = e[0] * (k[1] + k[3] * a[1] + k[5] * a[2] + k[7] * a[1] * a[2]) +
              e[1] * (k[2] + k[3] * a[0] + k[6] * a[2] + k[7] * a[0] * a[2]) +
              e[2] * (k[4] + k[5] * a[0] + k[6] * a[1] + k[7] * a[0] * a[1]);
    p->c[2] = k[3] * e[0] * e[1] + k[5] * e[0] * e[2] + k[6] * e[1] * e[2] +
              k[7] * (a[0] * e[1] * e[2] + a[1] * e[0] * e[2] + a[2] * e[0] * e[1]);
    p->c[3] = k[7] * e[0] * e[1] * e[2];
}

/* The cell of a voxel: a voxel itself or the leaf around it. Returns +1 or -1 when no corner is near iso: nothing can
 * happen in the cell. */
static int find_cell(const df_field *field, float iso, const int64_t voxel[3], double band, quad corner[8],
                     double lower[3], double *side) {
    float values[8];
    *side = 1;
    for (int a = 0; a < 3; a++) lower[a] = (double)voxel[a];
    if (field->kind == DF_FIELD_ADF) {
        const double centre[3] = {lower[0] + 0.5, lower[1] + 0.5, lower[2] + 0.5};
        df_adf_cell cell;
        df_adf_find(field, centre, DF_LEVEL_COUNT_MAX, &cell);
        df_adf_corners(field, cell.family, cell.child, values);
        for (int a = 0; a < 3; a++) lower[a] = cell.corner[a];
        *side = cell.side;
    } else {
        const uint32_t at[3] = {(uint32_t)voxel[0], (uint32_t)voxel[1], (uint32_t)voxel[2]};
        if (!df_field_corners(field, at, values)) return values[0] < 0 ? -1 : 1;
    }
    double low = INFINITY, high = -INFINITY;
    for (int c = 0; c < 8; c++) {
        double value = (double)values[c] - (double)iso; /* for the test below; corner[] is exact */
        corner[c] = (quad)values[c] - (quad)iso;
        low = fmin(low, value);
        high = fmax(high, value);
    }
    const double margin = 4 * band * (high - low); /* no gradient is longer than sqrt(3) * (high - low) */
    return low > margin ? 1 : high < -margin ? -1 : 0;
}

/* A walk over voxels. */
typedef struct walk {
    quad origin[3], direction[3];
    int64_t voxel[3], step[3];
    quad next[3]; /* where the ray leaves the voxel, by axis */
    quad t_end;
} walk;

static void set_next(walk *w, int axis) {
    if (w->step[axis] == 0) w->next[axis] = w->t_end + 1;
    else w->next[axis] = ((quad)(w->voxel[axis] + (w->step[axis] > 0)) - w->origin[axis]) / w->direction[axis];
}

/* Clips the ray to the box and stands in the voxel after the entry; false where it misses. */
static bool walk_begin(walk *w, const uint32_t box[3], quad *t_start) {
    quad t_in = 0, t_out = (quad)DBL_MAX;
    int entry = -1;
    for (int a = 0; a < 3; a++) {
        quad o = w->origin[a], d = w->direction[a], side = box[a];
        if (d == 0 && (o < 0 || o > side)) return false;
        if (d == 0) continue;
        quad low = (0 - o) / d, high = (side - o) / d, enter = d > 0 ? low : high, leave = d > 0 ? high : low;
        if (enter > t_in) {
            t_in = enter;
            entry = a;
        }
        if (leave < t_out) t_out = leave;
    }
    *t_start = t_in;
    w->t_end = t_out;
    if (!(t_in < t_out)) return false;
    for (int a = 0; a < 3; a++) {
        quad d = w->direction[a], p = w->origin[a] + t_in * d;
        w->step[a] = d > 0 ? 1 : d < 0 ? -1 : 0;
        if (a == entry) p = d > 0 ? 0 : (quad)box[a];
        int64_t at = quad_floor(p);
        if (at > (int64_t)box[a] - 1) at = (int64_t)box[a] - 1;
        w->voxel[a] = at < 0 ? 0 : at;
        set_next(w, a);
    }
    return true;
}

static void trace(search *r, walk *w, const df_field *field, float iso, quad t) {
    const quad tiny = (quad)1e-30L;
    while (!r->done) {
        int axis = w->next[0] <= w->next[1] ? 0 : 1;
        if (w->next[2] < w->next[axis]) axis = 2;
        quad t_out = w->next[axis] < w->t_end ? w->next[axis] : w->t_end;
        if (t_out - t > tiny * quad_max(1, quad_abs(t))) { /* otherwise two planes meet there: nothing lies between */
            quad corner[8];
            double lower[3], side;
            piece p = {.t0 = t, .t1 = t_out};
            int sure = find_cell(field, iso, w->voxel, (double)r->band, corner, lower, &side);
            if (sure) {
                visit(r, &p, -1, 0, sure, 0);
            } else {
                quad largest = 0;
                p.side = side;
                for (int c = 0; c < 8; c++) largest = quad_max(largest, quad_abs(corner[c]));
                for (int a = 0; a < 3; a++) {
                    p.a[a] = ((w->origin[a] + t * w->direction[a]) - (quad)lower[a]) / p.side;
                    p.e[a] = (t_out - t) * w->direction[a] / p.side;
                    if (p.a[a] < 0) p.a[a] = 0; /* rounding */
                    if (p.a[a] > 1) p.a[a] = 1;
                }
                p.zero = largest * tiny;
                make_piece(&p, corner);
                visit_cubic(r, &p);
            }
            t = t_out;
        }
        if (w->next[axis] >= w->t_end) return;
        w->voxel[axis] += w->step[axis];
        if (w->voxel[axis] < 0 || w->voxel[axis] >= (int64_t)field->voxel_count[axis]) return;
        set_next(w, axis);
    }
}

/* Whether a place lies on a face, or within `band` of one, where two leaves differ in its side: on the surface, as far
 * as anyone can tell. */
static bool starts_on_jump(const df_field *field, float iso, const double origin[3], double band) {
    bool any[2] = {false, false};
    for (int n = 0; n < 8; n++) {
        double at[3], local[3];
        float corners[8];
        df_adf_cell cell;
        for (int a = 0; a < 3; a++) {
            if (origin[a] < 0 || origin[a] > field->voxel_count[a]) return false;
            at[a] = fmin(fmax(origin[a] + (n >> a & 1 ? band : -band), 0), field->voxel_count[a]);
        }
        df_adf_find(field, at, DF_LEVEL_COUNT_MAX, &cell);
        df_adf_corners(field, cell.family, cell.child, corners);
        for (int a = 0; a < 3; a++) local[a] = fmin(fmax((origin[a] - cell.corner[a]) / cell.side, 0), 1);
        any[df_trilinear(corners, local) < (double)iso] = true;
    }
    return any[0] && any[1];
}

void df_truth_trace(const df_field *field, float iso, const double origin[3], const double direction[3],
                    df_truth *out) {
    walk w;
    search r = {.jumps = field->kind == DF_FIELD_ADF};
    quad t_start;
    float largest = 0;
    *out = (df_truth){.hit = false};
    for (int a = 0; a < 3; a++) {
        assert(isfinite(origin[a]) && isfinite(direction[a]));
        w.origin[a] = origin[a];
        w.direction[a] = direction[a];
        r.length += w.direction[a] * w.direction[a];
        largest = fmaxf(largest, fmaxf((float)fabs(origin[a]), (float)field->voxel_count[a]));
    }
    r.length = quad_sqrt(r.length);
    assert(r.length > 0);
    out->band = 1e-6 + 2.0 * ((double)nextafterf(largest, INFINITY) - (double)largest);
    r.band = out->band;
    if (!walk_begin(&w, field->voxel_count, &t_start)) return;
    trace(&r, &w, field, iso, t_start);
    out->hit = r.found;
    out->back = r.found && r.inside;
    out->t = r.t;
    /* a ray that ends in the band, or only cuts a corner of the box */
    out->tangent = r.tangent || (r.run && !r.done) || (w.t_end - t_start) * r.length < 10 * r.band;
    if (r.jumps && starts_on_jump(field, iso, origin, out->band)) out->tangent = true;
}

static void voxel_field(const float corners[8], df_field *field) {
    *field = (df_field){.kind = DF_FIELD_DENSE,
                        .sample_type = DF_SAMPLE_F32,
                        .voxel_count = {1, 1, 1},
                        .voxel_size = {1, 1, 1},
                        .samples = corners,
                        .sample_count = 8};
}

void df_truth_trace_voxel(const float corners[8], const double origin[3], const double direction[3], df_truth *out) {
    df_field field;
    voxel_field(corners, &field);
    df_truth_trace(&field, 0, origin, direction, out);
}

double df_truth_residual(const df_field *field, float iso, const double origin[3], const double direction[3],
                         double t) {
    int64_t voxel[3];
    quad corner[8];
    double lower[3], side;
    piece p = {.t0 = 0};
    for (int a = 0; a < 3; a++) {
        quad at = (quad)origin[a] + (quad)t * (quad)direction[a];
        voxel[a] = quad_floor(at);
        if (voxel[a] < 0) voxel[a] = 0;
        if (voxel[a] >= (int64_t)field->voxel_count[a]) voxel[a] = (int64_t)field->voxel_count[a] - 1;
        p.a[a] = at;
    }
    if (find_cell(field, iso, voxel, INFINITY, corner, lower, &side)) return INFINITY;
    p.side = side;
    for (int a = 0; a < 3; a++) p.a[a] = (p.a[a] - (quad)lower[a]) / p.side;
    make_piece(&p, corner);
    quad slope = gradient_length(&p, 0);
    if (p.c[0] == 0) return 0;
    return slope > 0 ? (double)(quad_abs(p.c[0]) / slope) : (double)INFINITY;
}
