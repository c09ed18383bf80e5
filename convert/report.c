#include "convert/report.h"

#include "common/version.h"

#include <inttypes.h>
#include <stdio.h>

#define LIBRARIES "CGAL 5.5, OpenVDB 10.0, tinyobjloader 2.0"

static json_t *json_mesh(const df_convert_report *r) {
    return json_pack("{s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:I}", "vertices", (json_int_t)r->vertices,
                     "faces", (json_int_t)r->faces, "welded", (json_int_t)r->cleaning.welded, "unreferenced_vertices",
                     (json_int_t)r->cleaning.unreferenced, "degenerate_faces", (json_int_t)r->cleaning.degenerate,
                     "duplicate_faces", (json_int_t)r->cleaning.duplicate, "reversed_faces",
                     (json_int_t)r->cleaning.reversed, "zero_area_faces", (json_int_t)r->cleaning.zero_area,
                     "boundary_edges", (json_int_t)r->edges.boundary, "non_manifold_edges",
                     (json_int_t)r->edges.non_manifold, "misoriented_edges", (json_int_t)r->edges.misoriented);
}

static json_t *json_repairs(const df_convert_report *r) {
    return json_pack("{s:I, s:I, s:I, s:I, s:I, s:I, s:I}", "flipped_faces", (json_int_t)r->repair_flips,
                     "turned_bodies", (json_int_t)r->repair_turned, "split_vertices",
                     (json_int_t)r->repairs.split_vertices, "stitched_edges", (json_int_t)r->repairs.stitched,
                     "holes_filled", (json_int_t)r->repairs.holes_filled, "holes_left",
                     (json_int_t)r->repairs.holes_left, "faces_added", (json_int_t)r->repairs.faces_added);
}

static json_t *json_sign(const df_convert_report *r, const df_field *field) {
    json_t *sign =
        json_pack("{s:s, s:s, s:I, s:I}", "method", r->sign_method, "verdict", df_verdict_name(field->verdict),
                  "lost_features", (json_int_t)r->build.lost_features, "wall_samples", (json_int_t)r->build.wall_count);
    if (r->sign_reason) json_object_set_new(sign, "reason", json_string(r->sign_reason));
    if (r->build.wall_count) {
        const double *p = r->build.wall_place;
        json_object_set_new(sign, "wall_at", json_pack("[f,f,f]", p[0], p[1], p[2]));
    }
    const struct {
        const char *name;
        uint64_t count;
    } counts[] = {{"flipped_faces", r->flipped_faces},
                  {"inverted_bodies", r->inverted_components},
                  {"holes", r->holes},
                  {"hole_edges", r->hole_edges},
                  {"unorientable_edges", r->unorientable_edges},
                  {"checked_points", r->sign_checks},
                  {"contradictions", r->sign_contradictions}};
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
        if (counts[i].count) json_object_set_new(sign, counts[i].name, json_integer((json_int_t)counts[i].count));
    }
    return sign;
}

char *df_report_provenance(const df_convert_report *r, const df_field *field, json_t *options) {
    json_t *sign = json_sign(r, field);
    json_t *root = json_pack("{s:s, s:s, s:s, s:o, s:s, s:o}", "program", "df-convert " DF_VERSION, "libraries",
                             LIBRARIES, "input", r->input, "options", options, "distance", r->distance, "sign", sign);
    if (root && !r->is_shape) {
        json_object_set_new(root, "input_sha256", json_string(r->input_sha256));
        json_object_set_new(root, "mesh", json_mesh(r));
        if (r->repaired) json_object_set_new(root, "repairs", json_repairs(r));
    }
    char *text = root ? json_dumps(root, JSON_INDENT(1)) : NULL;
    json_decref(root);
    return text;
}

/* ", 12 of them welded" for counts that are not zero. */
static void print_count(uint64_t count, const char *one, const char *more) {
    if (count) printf(", %" PRIu64 " %s", count, count == 1 ? one : more);
}

static void print_repair(const df_convert_report *r) {
    const df_mesh_repairs *d = &r->repairs;
    printf("repaired  %" PRIu32 " vertices, %" PRIu32 " triangles read", r->repair_cleaning.vertices_read,
           r->repair_cleaning.faces_read);
    print_count(r->repair_cleaning.welded, "vertex welded", "vertices welded");
    print_count(r->repair_cleaning.degenerate, "degenerate triangle dropped", "degenerate triangles dropped");
    print_count(r->repair_cleaning.duplicate, "duplicate triangle dropped", "duplicate triangles dropped");
    print_count(r->repair_cleaning.reversed, "reversed copy dropped", "reversed copies dropped");
    print_count(r->repair_flips, "triangle flipped", "triangles flipped");
    print_count(r->repair_turned, "body turned", "bodies turned");
    print_count(d->split_vertices, "vertex split", "vertices split");
    print_count(d->stitched, "pair of edges stitched", "pairs of edges stitched");
    print_count(d->holes_filled, "hole filled", "holes filled");
    print_count(d->faces_added, "triangle added", "triangles added");
    print_count(d->holes_left, "hole left", "holes left");
    printf("\n");
}

static void print_mesh(const df_convert_report *r) {
    if (r->repaired) print_repair(r);
    printf("read      %" PRIu32 " vertices, %" PRIu32 " triangles in %.0f ms\n", r->cleaning.vertices_read,
           r->cleaning.faces_read, r->read_ms);
    printf("cleaned   %" PRIu32 " vertices, %" PRIu32 " triangles", r->vertices, r->faces);
    print_count(r->cleaning.welded, "vertex welded", "vertices welded");
    print_count(r->cleaning.unreferenced, "unused vertex dropped", "unused vertices dropped");
    print_count(r->cleaning.degenerate, "degenerate triangle dropped", "degenerate triangles dropped");
    print_count(r->cleaning.duplicate, "duplicate triangle dropped", "duplicate triangles dropped");
    print_count(r->cleaning.reversed, "reversed copy dropped", "reversed copies dropped");
    print_count(r->cleaning.zero_area, "triangle without area", "triangles without area");
    printf("; %.0f ms\n", r->clean_ms);
    printf("mesh      %s", r->edges.border_count ? "not closed" : "closed");
    print_count(r->edges.boundary, "boundary edge", "boundary edges");
    print_count(r->edges.non_manifold, "edge of more than two faces", "edges of more than two faces");
    print_count(r->edges.misoriented, "edge between faces of opposite orientation",
                "edges between faces of opposite orientation");
    printf("\n");
}

static void print_signs(const df_convert_report *r, const df_field *field) {
    printf("signs     by %s in %.0f ms: %s", r->sign_method, r->build.sign_ms, df_verdict_name(field->verdict));
    if (r->sign_reason) printf(": %s", r->sign_reason);
    print_count(r->flipped_faces, "face flipped", "faces flipped");
    print_count(r->unorientable_edges, "edge where faces cannot agree", "edges where faces cannot agree");
    print_count(r->inverted_components, "body turned", "bodies turned");
    print_count(r->holes, "hole", "holes");
    print_count(r->build.wall_count, "change of sign away from the surface", "changes of sign away from the surface");
    if (r->build.wall_count) {
        printf(" (first at %g %g %g)", r->build.wall_place[0], r->build.wall_place[1], r->build.wall_place[2]);
    }
    print_count(r->sign_checks, "point checked", "points checked");
    print_count(r->sign_contradictions, "contradiction", "contradictions");
    print_count(r->build.lost_features, "coarse cell crossed without a change of sign",
                "coarse cells crossed without a change of sign");
    printf("\n");
}

void df_report_print(const df_convert_report *r, const df_field *field) {
    if (!r->is_shape) print_mesh(r);
    printf("lattice   %" PRIu32 " x %" PRIu32 " x %" PRIu32 " voxels of %g\n", field->voxel_count[0],
           field->voxel_count[1], field->voxel_count[2], field->voxel_size[0]);
    printf("distances %" PRIu64 " samples by %s in %.0f ms\n", r->build.samples_computed, r->distance,
           r->prepare_ms + r->build.cells_ms + r->build.distance_ms);
    print_signs(r, field);
    if (field->kind == DF_FIELD_BRICKS) {
        printf("bricks    %" PRIu32 " of %" PRIu32 "^3 voxels\n", field->brick_count, field->brick_size);
    }
    if (field->kind == DF_FIELD_ADF) {
        printf("octree    %" PRIu32 " families on %" PRIu32 " levels, %" PRIu64 " leaves, %" PRIu64
               " of them divided for continuity\n",
               field->family_count, field->level_count, r->leaves, r->divided_for_continuity);
    }
    if (field->error_max >= 0) {
        printf("error     at most %.3g voxels, RMS %.3g, near the surface; measured in %.0f ms\n",
               field->error_max / field->voxel_size[0], field->error_rms / field->voxel_size[0], r->measure_ms);
    }
    printf("wrote     %s, %.2f MB, in %.0f ms\n", r->output, (double)r->bytes / 1e6, r->write_ms);
    printf("total     %.0f ms, peak memory %.0f MB\n", r->total_ms, (double)r->peak_bytes / 1e6);
}

df_status df_report_print_json(const df_convert_report *r, const df_field *field, df_error *err) {
    json_t *phases = json_pack("{s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f}", "read_ms", r->read_ms, "clean_ms",
                               r->clean_ms, "prepare_ms", r->prepare_ms, "cells_ms", r->build.cells_ms, "distance_ms",
                               r->build.distance_ms, "sign_ms", r->build.sign_ms, "structure_ms", r->build.structure_ms,
                               "measure_ms", r->measure_ms, "write_ms", r->write_ms);
    json_t *root = r->is_shape ? json_object() : json_mesh(r), *sign = json_sign(r, field);
    json_t *more = json_pack(
        "{s:s, s:s, s:s, s:s, s:s, s:I, s:[I,I,I], s:f, s:I, s:s, s:s, s:s, s:o, s:I, s:f, s:f, s:o, s:f, s:I}",
        "input", r->input, "input_sha256", r->input_sha256, "output", r->output, "structure",
        df_field_kind_name(field->kind), "samples", df_sample_type_name(field->sample_type), "resolution",
        (json_int_t)r->resolution, "voxels", (json_int_t)field->voxel_count[0], (json_int_t)field->voxel_count[1],
        (json_int_t)field->voxel_count[2], "voxel_size", field->voxel_size[0], "bytes", (json_int_t)r->bytes,
        "distance", r->distance, "sign_method", r->sign_method, "verdict", df_verdict_name(field->verdict), "sign",
        sign, "lost_features", (json_int_t)r->build.lost_features, "max_error", field->error_max, "rms_error",
        field->error_rms, "phases", phases, "total_ms", r->total_ms, "peak_bytes", (json_int_t)r->peak_bytes);
    df_status status = DF_OK;
    if (!root || !more || json_object_update(root, more) != 0) {
        status = df_fail(err, DF_ERROR_MEMORY, "report: out of memory");
        goto done;
    }
    json_object_set_new(
        root, "dropped_faces",
        json_integer((json_int_t)r->cleaning.degenerate + r->cleaning.duplicate + r->cleaning.reversed));
    if (field->kind == DF_FIELD_ADF) json_object_set_new(root, "leaves", json_integer((json_int_t)r->leaves));
    if (field->kind == DF_FIELD_BRICKS) json_object_set_new(root, "bricks", json_integer(field->brick_count));
    if (json_dumpf(root, stdout, JSON_INDENT(1)) != 0 || printf("\n") < 0)
        status = df_fail(err, DF_ERROR_IO, "standard output: cannot write");
done:
    json_decref(root);
    json_decref(more);
    return status;
}
