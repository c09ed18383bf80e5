#include "errors.h"
#include "render/methods/gradient.h"
#include "render/methods/shade.h"
#include "render/methods/solve_methods.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

df_status lab_measure_errors(lab_session *session, const lab_subject *s, lab_family family, const lab_surface *surface,
                             const lab_mesh *mesh, uint64_t rays) {
    const bool outer = surface || mesh;
    lab_run run = {.tracer = &df_tracer_dda,
                   .scene = &s->scene,
                   .surface = surface,
                   .mesh = mesh,
                   .family = family,
                   .seed = LAB_SEED,
                   .count = rays};
    df_status status = DF_OK;
    run.known = calloc(rays, sizeof *run.known);
    if (!run.known) return df_fail(session->err, DF_ERROR_MEMORY, "no memory for the truths of %" PRIu64 " rays", rays);
    for (int m = 0; m < LAB_METHOD_COUNT && status == DF_OK; m++) {
        lab_score score = {0};
        run.solve = lab_methods[m].solve;
        run.steps = lab_methods[m].steps;
        run.precision = lab_methods[m].precision;
        if (outer && run.solve != DF_SOLVE_ROBUST && run.steps > 1) continue; /* the field's error hides them */
        const lab_row r = {.kind = "solve",
                           .tracer = "dda",
                           .intersect = df_solve_names[run.solve],
                           .precision = df_precision_names[run.precision],
                           .gradient = "",
                           .steps = run.steps,
                           .truth = mesh      ? "mesh"
                                    : surface ? "surface"
                                              : "field",
                           .family = lab_family_names[family],
                           .rays = rays,
                           .score = &score,
                           .ns_per_ray = -1,
                           .ns_per_hit = -1};
        if (lab_row_have(session, s, &r)) continue;
        status = lab_measure(&run, &score, session->err);
        run.is_known = true;
        if (status == DF_OK) status = lab_row_write(session, s, &r);
    }
    free(run.known);
    return status;
}

/* The errors of each timing's method over the rays from an eye, into scores. */
df_status lab_score_view(lab_session *session, const lab_subject *s, const df_camera *camera, lab_timing *timings,
                         lab_score *scores, int count) {
    const uint64_t rays = session->quick ? 2000 : 100000;
    double eye[3];
    df_field_world_to_grid(&s->field, camera->eye, eye);
    lab_run run = {.tracer = &df_tracer_dda, .scene = &s->scene, .seed = LAB_SEED, .count = rays, .eye = eye};
    run.known = calloc(rays, sizeof *run.known);
    df_status status = run.known ? DF_OK : df_fail(session->err, DF_ERROR_MEMORY, "no memory for truths");
    for (int i = 0; i < count && status == DF_OK; i++) {
        run.solve = timings[i].options.solve;
        run.steps = timings[i].options.steps;
        run.precision = timings[i].options.precision;
        status = lab_measure(&run, &scores[i], session->err);
        run.is_known = true;
        timings[i].row.score = &scores[i];
    }
    free(run.known);
    return status;
}

/* The angle in degrees between the normal of each gradient at the default method's hit and that of the exact surface
 * there. */
df_status lab_measure_normals(lab_session *session, const lab_subject *s, uint64_t rays) {
    lab_histogram *angles = calloc(DF_GRADIENT_COUNT, sizeof *angles);
    if (!angles) return df_fail(session->err, DF_ERROR_MEMORY, "no memory for angles");
    for (uint64_t i = 0; i < rays; i++) {
        double o[3], d[3], p[3], exact[3], length = 0;
        df_truth truth;
        uint32_t voxel[3];
        float local[3], stencil[64], gradient[3], normal[3];
        if (!lab_family_ray(&s->field, LAB_CAMERA, LAB_SEED, i, o, d)) continue;
        df_truth_trace(&s->field, 0, o, d, &truth);
        if (!truth.hit || truth.tangent) continue;
        for (int a = 0; a < 3; a++) {
            p[a] = o[a] + (double)truth.t * d[a];
            const double below = floor(p[a]);
            voxel[a] = (uint32_t)fmin(fmax(below, 0), s->field.voxel_count[a] - 1.0);
            local[a] = (float)(p[a] - voxel[a]);
        }
        const uint32_t block = df_scene_block(&s->scene, voxel[0], voxel[1], voxel[2]);
        if (block >= DF_CELL_INSIDE) continue;
        lab_surface_gradient(&s->surface, p, exact);
        for (int a = 0; a < 3; a++) length += exact[a] * exact[a];
        if (!(length > 0.5)) continue; /* a crease: no normal */
        df_scene_stencil(&s->scene, voxel, block, DF_REACH_ALL, stencil, 1);
        for (int g = 0; g < DF_GRADIENT_COUNT; g++) {
            double cross[3], cosine = 0, sine = 0;
            df_gradient(g, stencil, local, (const float[]){1, 1, 1}, gradient);
            df_shade_normal(gradient, (const float[]){1, 1, 1}, (const float[]){0, 0, 1}, normal);
            for (int a = 0; a < 3; a++) {
                const int u = (a + 1) % 3, v = (a + 2) % 3;
                cross[a] = (double)normal[u] * exact[v] - (double)normal[v] * exact[u];
                cosine += (double)normal[a] * exact[a];
                sine += cross[a] * cross[a];
            }
            lab_histogram_add(&angles[g], atan2(sqrt(sine), cosine) * 180 / M_PI);
        }
    }
    df_status status = DF_OK;
    for (int g = 0; g < DF_GRADIENT_COUNT && status == DF_OK; g++) {
        const lab_row r = {.kind = "gradient",
                           .tracer = "",
                           .intersect = "",
                           .precision = "",
                           .gradient = df_gradient_names[g],
                           .truth = "surface",
                           .family = lab_family_names[LAB_CAMERA],
                           .rays = rays,
                           .normal = &angles[g],
                           .ns_per_ray = -1,
                           .ns_per_hit = -1};
        if (!lab_row_have(session, s, &r)) status = lab_row_write(session, s, &r);
    }
    free(angles);
    return status;
}
