/*
 * The cell solves: where on an accepted segment the surface lies. Compiled like cell.h, which must have been included
 * for the same real number before.
 *
 * Every solve gets the side at the entry as the walk saw it. Where the solve's own arithmetic disagrees with the walk
 * (the surface passes within rounding of a face or a tangent), it answers with the nearest point of the segment: entry,
 * exit or the extremum.
 */
#ifndef LR
#include "render/methods/cell.h"
#endif
#include "render/methods/solve_methods.h"

/* A part of the segment on which the first crossing lies, with the field's values at its ends. */
typedef struct LR(df_bracket) {
    lr low, high, f_low, f_high;
    lrm found;
} LR(df_bracket);

/* True where the coefficients change sign once, from the side at the entry to the other: the segment then has one
 * crossing (variation diminution), and is itself a bracket. */
static inline lrm LR(df_crosses_once)(const lr bern[4], lrm inside) {
    const lr zero = lr_set(0);
    lrm other[4];
    for (int i = 0; i < 4; i++) other[i] = lrm_xor(inside, lr_lt(bern[i], zero));
    return lrm_and(lrm_and(other[3], lrm_not(other[0])), lrm_or(other[2], lrm_not(other[1])));
}

/* The first of the monotone parts between the extrema whose end lies on the other side. */
static inline LR(df_bracket) LR(df_isolate)(const lr bern[4], lrm inside, lr *extremum) {
    const lr zero = lr_set(0), one = lr_set(1);
    lr minimum, maximum;
    LR(df_cubic_extrema)(bern, &minimum, &maximum);
    *extremum = lr_select(inside, maximum, minimum);
    const lr end[3] = {lr_min(minimum, maximum), lr_max(minimum, maximum), one};
    LR(df_bracket) part = {zero, one, bern[0], bern[3], lrm_xor(inside, lr_lt(bern[0], zero))};
    part.high = lr_select(part.found, zero, one); /* found at the entry */
    part.f_high = lr_select(part.found, bern[0], bern[3]);
    for (int i = 0; i < 3; i++) {
        lr f = i == 2 ? bern[3] : LR(df_cubic)(bern, lr_min(end[i], one));
        lrm open = lrm_and(lrm_not(part.found), lr_le(end[i], one));
        lrm crossed = lrm_and(open, lrm_xor(inside, lr_lt(f, zero)));
        lrm passed = lrm_and(open, lrm_not(crossed));
        part.high = lr_select(crossed, end[i], part.high);
        part.f_high = lr_select(crossed, f, part.f_high);
        part.low = lr_select(passed, end[i], part.low);
        part.f_low = lr_select(passed, f, part.f_low);
        part.found = lrm_or(part.found, crossed);
    }
    return part;
}

/* Where the chord of a bracket is zero. */
static inline lr LR(df_chord)(lr low, lr high, lr f_low, lr f_high) {
    return LR(df_lerp)(low, high, f_low / (f_low - f_high));
}

static inline lr LR(df_repeat_linear)(const lr bern[4], lrm inside, LR(df_bracket) part, int steps) {
    for (int i = 0; i < steps; i++) {
        lr s = LR(df_chord)(part.low, part.high, part.f_low, part.f_high);
        lr f = LR(df_cubic)(bern, s);
        lrm crossed = lrm_xor(inside, lr_lt(f, lr_set(0)));
        part.high = lr_select(crossed, s, part.high);
        part.f_high = lr_select(crossed, f, part.f_high);
        part.low = lr_select(crossed, part.low, s);
        part.f_low = lr_select(crossed, part.f_low, f);
    }
    return LR(df_chord)(part.low, part.high, part.f_low, part.f_high);
}

/* A solve on its way. */
typedef struct LR(df_root) {
    lr bern[4], extremum, s;
    LR(df_bracket) part;
    lrm inside, kept_low, kept_high, done; /* Illinois: which end stayed, and whether s no longer moves */
} LR(df_root);

/* Brackets the first crossing. */
static inline void LR(df_root_begin)(int method, const lr bernstein[4], lrm inside, LR(df_root) * root) {
    const lr zero = lr_set(0), one = lr_set(1);
    lr *bern = root->bern;
    for (int i = 0; i < 4; i++) bern[i] = bernstein[i];
    if (LR_NARROW) LR(df_cubic_scale)(bern);
    LR(df_bracket) part = {zero, one, bern[0], bern[3], lrm_xor(inside, lr_lt(bern[3], zero))};
    root->extremum = one;
    if (DF_SOLVE_ISOLATES(method)) {
        /* Where there is one crossing, the robust solve needs no extrema; they cost more than its steps. */
        const lrm whole = method == DF_SOLVE_ROBUST ? LR(df_crosses_once)(bern, inside) : lr_lt(one, zero);
        if (lrm_any(lrm_not(whole))) {
            const LR(df_bracket) isolated = LR(df_isolate)(bern, inside, &root->extremum);
            part.low = lr_select(whole, part.low, isolated.low);
            part.high = lr_select(whole, part.high, isolated.high);
            part.f_low = lr_select(whole, part.f_low, isolated.f_low);
            part.f_high = lr_select(whole, part.f_high, isolated.f_high);
            part.found = lrm_or(whole, isolated.found);
        }
    }
    root->part = part;
    root->inside = inside;
    root->kept_low = root->kept_high = root->done = lr_lt(one, zero); /* all false */
    root->s = LR(df_chord)(part.low, part.high, part.f_low, part.f_high);
}

/* A step of regula falsi that halves the value of an end which stays (Illinois); a lane that no longer moves is left
 * alone. */
static inline void LR(df_illinois_step)(LR(df_root) * root, lr tolerance) {
    const lr one_half = lr_set(0.5);
    LR(df_bracket) *part = &root->part;
    lr f = LR(df_cubic)(root->bern, root->s);
    lrm crossed = lrm_xor(root->inside, lr_lt(f, lr_set(0)));
    part->f_low = lr_select(crossed, lr_select(root->kept_low, part->f_low * one_half, part->f_low), f);
    part->f_high = lr_select(crossed, f, lr_select(root->kept_high, part->f_high * one_half, part->f_high));
    part->high = lr_select(crossed, root->s, part->high);
    part->low = lr_select(crossed, part->low, root->s);
    root->kept_low = crossed;
    root->kept_high = lrm_not(crossed);
    lr next = LR(df_chord)(part->low, part->high, part->f_low, part->f_high);
    lrm still = lr_le(lr_abs(next - root->s), tolerance);
    root->s = lr_select(root->done, root->s, next);
    root->done = lrm_or(root->done, still);
}

/* Takes the steps of a method from its bracket. `steps` means what df_solve_steps in tracer.h says for the method. */
static inline void LR(df_root_steps)(int method, int steps, LR(df_root) * root, lr tolerance) {
    if (method != DF_SOLVE_ROBUST) {
        root->s = LR(df_repeat_linear)(root->bern, root->inside, root->part, method == DF_SOLVE_LINEAR ? 0 : steps);
        return;
    }
    for (int i = 0; i < steps && lrm_any(lrm_not(root->done)); i++) LR(df_illinois_step)(root, tolerance);
}

/* The s of the first crossing. */
static inline lr LR(df_root_end)(const LR(df_root) * root) {
    const lr zero = lr_set(0), one = lr_set(1);
    const lr *bern = root->bern;
    lr nearest = lr_select(lr_lt(lr_abs(bern[0]), lr_abs(bern[3])), zero, one);
    nearest = lr_select(lr_lt(root->extremum, one), root->extremum, nearest);
    lr s = lr_select(root->part.found, root->s, nearest);
    return lr_select(lrm_xor(root->inside, lr_lt(bern[0], zero)), zero, s); /* the other side begins at the entry */
}

/* All of it, for every method but the closed form. */
static inline lr LR(df_solve)(int method, int steps, const lr bernstein[4], lrm inside, lr tolerance) {
    if (method == DF_SOLVE_MIDPOINT) return lr_set(0.5);
    LR(df_root) root;
    LR(df_root_begin)(method, bernstein, inside, &root);
    LR(df_root_steps)(method, steps, &root, tolerance);
    return LR(df_root_end)(&root);
}
