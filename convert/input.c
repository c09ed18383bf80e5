#include "convert/input.h"

#include "common/digest.h"
#include "common/progress.h"
#include "convert/mesh_read.h"

#include <math.h>
#include <string.h>

/* Cleans, orients, stitches and fills; what was done goes to the report. */
static df_status repair_mesh(const df_request *r, df_mesh *mesh, df_convert_report *report, df_error *err) {
    df_sign_mesh sign = {0};
    df_mesh_cleaning *cleaning = &report->repair_cleaning;
    df_status status = df_mesh_clean(mesh, r->input, cleaning, err);
    if (status == DF_OK) status = df_sign_mesh_make(mesh, &sign, err);
    if (status == DF_OK) {
        memcpy(mesh->faces, sign.mesh.faces, (size_t)mesh->face_count * 3 * sizeof *mesh->faces);
        report->repaired = true;
        report->repair_flips = sign.flipped_faces;
        report->repair_turned = sign.inverted_components;
        status = df_mesh_repair(mesh, r->input, &report->repairs, err);
    }
    df_sign_mesh_free(&sign);
    return status;
}
df_status df_input_read(const df_request *r, df_input *s, df_convert_report *report, df_error *err) {
    report->is_shape = df_shape_is_name(r->input);
    if (report->is_shape) {
        df_status status = df_shape_parse(r->input, &s->shape, err);
        if (status == DF_OK) df_shape_bounds(&s->shape, s->low, s->high);
        return status;
    }
    double start = df_now_ms();
    df_status status = df_mesh_read(r->input, &s->mesh, err);
    if (status == DF_OK) status = df_sha256_file(r->input, report->input_sha256, err);
    if (status != DF_OK) return status;
    double read = df_now_ms();
    if (r->repair) status = repair_mesh(r, &s->mesh, report, err);
    if (status != DF_OK) return status;
    status = df_mesh_clean(&s->mesh, r->input, &report->cleaning, err);
    if (status == DF_OK) status = df_mesh_find_edges(&s->mesh, &report->edges, err);
    if (status != DF_OK) return status;
    report->vertices = s->mesh.vertex_count;
    report->faces = s->mesh.face_count;
    report->read_ms = read - start;
    report->clean_ms = df_now_ms() - read;
    df_mesh_bounds(&s->mesh, s->low, s->high);
    s->sign = (df_sign){.method = (df_sign_method)r->sign, .mesh = &s->mesh};
    /* a mesh that is closed and oriented alike decides as it is; whether a body is inside out shows later */
    if (r->distance == DF_DISTANCE_OPENVDB) return DF_OK;
    if (r->sign == DF_SIGN_NORMAL || r->sign == DF_SIGN_WRAP) return df_sign_prepare_normals(&s->sign, &s->mesh, err);
    bool decides = report->edges.border_count == 0 || r->sign == DF_SIGN_PARITY;
    return decides ? DF_OK : df_sign_orient(&s->sign, &s->mesh, err);
}

df_status df_input_make_source(const df_request *r, df_input *s, const df_lattice *lattice, df_convert_report *report,
                               df_error *err) {
    if (s->source.fill) return DF_OK;
    report->distance = report->is_shape ? "shape" : df_request_distance_names[r->distance];
    report->sign_method = report->is_shape                     ? "shape"
                          : r->distance == DF_DISTANCE_OPENVDB ? "openvdb"
                          : r->sign == DF_SIGN_AUTO            ? "winding"
                                                               : df_request_sign_names[r->sign];
    if (report->is_shape) {
        df_distance_shape(&s->shape, &s->source);
        return DF_OK;
    }
    if (r->distance == DF_DISTANCE_EXACT) return df_distance_exact(&s->mesh, &s->source, err);
    if (r->distance == DF_DISTANCE_CGAL) return df_distance_cgal(&s->mesh, &s->source, err);
    /* in bricks no sample lies further from a face than a cell's diagonal and the reach */
    double band = (r->brick_size + 2) * 1.7320508;
    for (int a = 0; a < 3 && r->structure == DF_FIELD_DENSE; a++) band = fmax(band, 2.0 * lattice->voxel_count[a]);
    return df_distance_openvdb(&s->mesh, lattice, (float)band, &s->source, err);
}

/* Asks CGAL's exact inside test about samples spread over the field and compares it with the signs stored. CGAL counts
 * crossings by parity, so where bodies overlap it says outside; then the two may differ and the verdict is left as it
 * is. */
df_status df_input_check_signs(const df_input *s, const df_field *field, df_convert_report *report, df_error *err) {
    enum { POINTS = 2000 };
    static double points[POINTS][3];
    static int8_t sides[POINTS];
    uint64_t count = 0, total = df_dense_sample_count(field->voxel_count), step = total / POINTS + 1;
    float values[POINTS];
    for (uint64_t i = step / 2; i < total && count < POINTS; i += step) {
        uint64_t row = (uint64_t)field->voxel_count[0] + 1, rows = (uint64_t)field->voxel_count[1] + 1;
        uint32_t at[3] = {(uint32_t)(i % row), (uint32_t)(i / row % rows), (uint32_t)(i / row / rows)};
        double grid[3] = {at[0], at[1], at[2]};
        df_field_sample(field, at, &values[count]);
        df_field_grid_to_world(field, grid, points[count++]);
    }
    df_status status = df_cgal_side(&s->mesh, points[0], count, sides, err);
    if (status != DF_OK) return status;
    report->sign_checks = count;
    for (uint64_t i = 0; i < count; i++)
        report->sign_contradictions += sides[i] != 0 && (sides[i] > 0) != (values[i] < 0);
    return DF_OK;
}

df_verdict df_input_judge_signs(const df_request *r, const df_input *s, df_convert_report *report) {
    const df_sign_mesh *made = &s->sign.made;
    if (report->is_shape) return DF_VERDICT_CERTAIN;
    if (r->distance == DF_DISTANCE_OPENVDB) {
        report->sign_reason = "OpenVDB fills thin gaps and cavities";
        return DF_VERDICT_UNKNOWN;
    }
    bool parity = r->sign == DF_SIGN_PARITY;
    report->flipped_faces = made->flipped_faces;
    report->inverted_components = made->inverted_components;
    report->holes = made->cap_count;
    report->hole_edges = made->border_edges;
    report->unorientable_edges = made->unorientable_edges;
    if (report->build.wall_count) report->sign_reason = "the sign changes where no surface is";
    else if (report->sign_contradictions) report->sign_reason = "CGAL's inside test disagrees";
    else if (parity && report->edges.boundary) report->sign_reason = "rays through holes were counted";
    if (report->sign_reason) return DF_VERDICT_UNCERTAIN;
    if (report->repaired &&
        (report->repair_flips || report->repair_turned || report->repairs.faces_added || report->repairs.stitched)) {
        report->sign_reason = "the mesh was repaired";
    }
    if (made->cap_count)
        report->sign_reason = r->structure == DF_FIELD_ADF ? "holes closed, none wider than the leaf around it"
                                                           : "holes closed, none wider than a voxel";
    else if (made->flipped_faces) report->sign_reason = "faces oriented alike";
    else if (made->inverted_components) report->sign_reason = "bodies turned that were inside out";
    return report->sign_reason ? DF_VERDICT_REPAIRED : DF_VERDICT_CERTAIN;
}

void df_input_free(df_input *s) {
    df_distance_source_free(&s->source);
    df_sign_free(&s->sign);
    df_mesh_free(&s->mesh);
}
