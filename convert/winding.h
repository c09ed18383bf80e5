/*
 * Winding numbers of lattice samples with respect to a closed mesh, exact.
 *
 * For every row of samples along x, the faces that the row crosses are found and the signs of the crossings added up.
 * Whether a row crosses a face is decided by exact signs of determinants with a symbolic shift of the row, on
 * coordinates rounded relative to the row the same way for all faces: so the crossings of a closed chain of faces
 * always cancel, whatever the geometry. Only on which side of a sample a crossing lies is decided in double, which
 * matters where the sample is within rounding of the surface. (A scan conversion like that of SDFGen's makelevelset3,
 * with signed crossings in place of parity.)
 */
#ifndef DF_WINDING_H
#define DF_WINDING_H

#include "convert/lattice.h"
#include "convert/mesh.h"

#include <stdbool.h>

typedef struct df_crossing {
    uint32_t sample; /* the first sample of the row beyond the crossing; may be voxel_count + 1 */
    int32_t change;  /* of the winding number: +1 where the row enters */
} df_crossing;

/* The rows of samples with z in [z_first, z_first + z_count), all y. The slab owns its arrays; zeroed is empty. */
typedef struct df_winding_slab {
    uint32_t z_first, z_count;
    uint32_t y_count, x_last;
    uint32_t *starts;       /* of the crossings by row y + y_count * (z - z_first), and one more */
    df_crossing *crossings; /* by row, in order of their samples */
    uint32_t *rows;         /* scratch: of the crossings, before they are sorted */
    df_crossing *unsorted;
    uint64_t capacity;
} df_winding_slab;

/* Finds the crossings of the faces listed (face_count indices into the mesh; NULL: all) with the rows of a slab. A slab
 * may be used again; its arrays grow. */
df_status df_winding_slab_find(df_winding_slab *slab, const df_mesh *mesh, const uint32_t *faces, uint32_t face_count,
                               const df_lattice *lattice, uint32_t z_first, uint32_t z_count, df_error *err);

void df_winding_slab_free(df_winding_slab *slab);

/* Writes the winding numbers of samples x_first to x_first + x_count of one row; those beyond the lattice repeat the
 * last one. */
void df_winding_row(const df_winding_slab *slab, uint32_t y, uint32_t z, uint32_t x_first, uint32_t x_count,
                    int32_t *winding);

/* The winding number of one sample; 0 beyond the slab. */
int32_t df_winding_at(const df_winding_slab *slab, uint32_t x, uint32_t y, uint32_t z);

/* True where a row of the slab has a winding number below 0. */
bool df_winding_has_negative(const df_winding_slab *slab);

/* The change of the winding number where the row that ends at p crosses the triangle abc, 0 where it does not. */
int32_t df_winding_cross(const double a[3], const double b[3], const double c[3], const double p[3]);

/* Faces sorted by slabs of z_step layers: those that may cross rows with z in [s * z_step, s * z_step + z_step] (both
 * ends included) are faces[starts[s]] to faces[starts[s + 1]]. */
typedef struct df_face_slabs {
    uint32_t *starts; /* slab_count + 1 */
    uint32_t *faces;
    uint32_t slab_count;
} df_face_slabs;

df_status df_face_slabs_make(const df_mesh *mesh, const df_lattice *lattice, uint32_t z_step, df_face_slabs *slabs,
                             df_error *err);
void df_face_slabs_free(df_face_slabs *slabs);

#endif
