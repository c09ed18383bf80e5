#include "convert/mesh_check.h"

#include "common/memory.h"
#include "convert/mesh_repair.h"
#include "convert/sign_mesh.h"

#include <inttypes.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>

/* The side of a face opposite to a vertex. */
typedef struct link_edge {
    uint32_t from, to;
} link_edge;

static uint32_t link_root(const uint32_t *parents, uint32_t i) {
    while (parents[i] != i) i = parents[i];
    return i;
}

/* The number of fans that the faces around a vertex form: connected pieces of the sides opposite to it. */
static uint32_t count_fans(const link_edge *sides, uint32_t count, uint32_t *parents) {
    uint32_t fans = count;
    for (uint32_t i = 0; i < count; i++) parents[i] = i;
    for (uint32_t i = 0; i < count; i++) {
        for (uint32_t j = 0; j < i; j++) {
            bool meet = sides[i].from == sides[j].from || sides[i].from == sides[j].to ||
                        sides[i].to == sides[j].from || sides[i].to == sides[j].to;
            uint32_t a = link_root(parents, i), b = link_root(parents, j);
            if (!meet || a == b) continue;
            parents[a] = b;
            fans--;
        }
    }
    return fans;
}

static df_status count_non_manifold_vertices(const df_mesh *mesh, uint32_t *found, df_error *err) {
    uint32_t *starts = NULL, *parents = NULL;
    link_edge *sides = NULL;
    size_t corner_count = (size_t)mesh->face_count * 3;
    df_status status = df_alloc((void **)&starts, (uint64_t)mesh->vertex_count + 2, sizeof *starts, "mesh check", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&sides, corner_count, sizeof *sides, "mesh check", err);
    if (status == DF_OK) status = df_alloc_raw((void **)&parents, corner_count, sizeof *parents, "mesh check", err);
    if (status != DF_OK) goto done;
    uint32_t *at = starts + 1;
    for (size_t i = 0; i < corner_count; i++) at[mesh->faces[i] + 1]++;
    for (uint32_t v = 0; v < mesh->vertex_count; v++) at[v + 1] += at[v];
    for (size_t i = 0; i < corner_count; i++) {
        size_t face = i / 3 * 3;
        sides[at[mesh->faces[i]]++] = (link_edge){mesh->faces[face + (i + 1) % 3], mesh->faces[face + (i + 2) % 3]};
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++)
        *found += count_fans(sides + starts[v], starts[v + 1] - starts[v], parents) > 1;
done:
    free(starts);
    free(sides);
    free(parents);
    return status;
}

df_status df_mesh_check(const df_mesh *mesh, const df_mesh_cleaning *cleaning, df_mesh_diagnosis *d, df_error *err) {
    *d = (df_mesh_diagnosis){.cleaning = *cleaning, .vertices = mesh->vertex_count, .faces = mesh->face_count};
    df_sign_mesh sign = {0};
    df_status status = df_mesh_find_edges(mesh, &d->edges, err);
    free(d->edges.borders);
    d->edges.borders = NULL;
    if (status == DF_OK) status = df_sign_mesh_make(mesh, &sign, err);
    if (status != DF_OK) return status;
    d->holes = sign.cap_count;
    d->components = sign.component_count;
    d->cavities = sign.cavities;
    d->inverted = sign.inverted_components;
    d->flips = sign.flipped_faces;
    d->unorientable_edges = sign.unorientable_edges;
    df_sign_mesh_free(&sign);
    status = count_non_manifold_vertices(mesh, &d->non_manifold_vertices, err);
    if (status == DF_OK) status = df_mesh_count_intersections(mesh, &d->intersections, err);
    return status;
}

void df_mesh_print_diagnosis(const char *name, const df_mesh_diagnosis *d, bool json) {
    const struct {
        const char *key, *text;
        uint64_t value;
        bool always;
    } lines[] = {{"vertices", "vertices", d->vertices, true},
                 {"faces", "triangles", d->faces, true},
                 {"components", "pieces connected by edges", d->components, true},
                 {"boundary_edges", "boundary edges", d->edges.boundary, true},
                 {"holes", "holes", d->holes, true},
                 {"non_manifold_edges", "edges of more than two triangles", d->edges.non_manifold, true},
                 {"non_manifold_vertices", "vertices where the surface is pinched", d->non_manifold_vertices, true},
                 {"self_intersections", "pairs of triangles that cross", d->intersections, true},
                 {"misoriented_edges", "edges between triangles of opposite orientation", d->edges.misoriented, true},
                 {"faces_to_flip", "triangles to flip so that neighbours agree", d->flips, false},
                 {"unorientable_edges", "edges where triangles cannot agree", d->unorientable_edges, false},
                 {"inverted_bodies", "bodies that are inside out", d->inverted, false},
                 {"cavities", "cavities", d->cavities, false},
                 {"welded", "vertices welded", d->cleaning.welded, false},
                 {"unreferenced_vertices", "unused vertices", d->cleaning.unreferenced, false},
                 {"degenerate_faces", "degenerate triangles", d->cleaning.degenerate, false},
                 {"duplicate_faces", "duplicate triangles", d->cleaning.duplicate, false},
                 {"reversed_faces", "reversed copies of triangles", d->cleaning.reversed, false},
                 {"zero_area_faces", "triangles without area", d->cleaning.zero_area, false}};
    json_t *object = json ? json_pack("{s:s}", "input", name) : NULL;
    if (!json) printf("%s\n", name);
    for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
        if (json) json_object_set_new(object, lines[i].key, json_integer((json_int_t)lines[i].value));
        else if (lines[i].always || lines[i].value) printf("  %10" PRIu64 "  %s\n", lines[i].value, lines[i].text);
    }
    bool fit = d->edges.boundary == 0 && d->holes == 0 && d->flips == 0 && d->inverted == 0;
    const char *verdict = fit ? "closed and oriented" : "needs repair, see --repair";
    if (json) {
        json_object_set_new(object, "verdict", json_string(verdict));
        json_dumpf(object, stdout, JSON_INDENT(1));
        printf("\n");
        json_decref(object);
    } else {
        printf("  %s\n", verdict);
    }
}
