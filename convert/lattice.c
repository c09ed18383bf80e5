#include "convert/lattice.h"

#include "common/field.h"

#include <math.h>

static df_status check_box(const double low[3], const double high[3], const char *name, df_error *err) {
    double longest = 0, coordinate = 0;
    for (int a = 0; a < 3; a++) {
        longest = fmax(longest, high[a] - low[a]);
        coordinate = fmax(coordinate, fmax(fabs(low[a]), fabs(high[a])));
    }
    if (!(longest > 0)) return df_fail(err, DF_ERROR_INPUT, "%s: all of it lies in one point", name);
    if (longest < 1e-9 * coordinate) {
        return df_fail(err, DF_ERROR_INPUT, "%s: its size of %g is too small beside its coordinates of %g", name,
                       longest, coordinate);
    }
    return DF_OK;
}

df_status df_lattice_make(const df_lattice_request *request, const double low[3], const double high[3],
                          const char *name, df_lattice *lattice, df_error *err) {
    df_status status = check_box(low, high, name, err);
    if (status != DF_OK) return status;
    double longest = fmax(high[0] - low[0], fmax(high[1] - low[1], high[2] - low[2]));
    double room = (double)request->resolution - 2 * request->padding;
    if (request->resolution && room < 1) {
        return df_fail(err, DF_ERROR_USAGE,
                       "--resolution %u: a padding of %g voxels on each side leaves no room for %s",
                       request->resolution, request->padding, name);
    }
    double size = request->resolution ? longest / room : request->voxel_size;
    *lattice = (df_lattice){.voxel_size = size, .brick_size = request->brick_size};
    for (int a = 0; a < 3; a++) {
        double extent = high[a] - low[a];
        /* the slack keeps a side that fits exactly from growing by a voxel through rounding */
        double count = fmax(1, ceil(extent / size + 2 * request->padding - 1e-9));
        if (count > DF_VOXEL_COUNT_MAX) {
            return df_fail(err, DF_ERROR_USAGE, "--voxel-size %g: %s would need %.0f voxels along %c, the limit is %u",
                           size, name, count, "xyz"[a], DF_VOXEL_COUNT_MAX);
        }
        lattice->voxel_count[a] = (uint32_t)count;
        lattice->cell_count[a] = (lattice->voxel_count[a] + request->brick_size - 1) / request->brick_size;
        lattice->origin[a] = low[a] + extent / 2 - count / 2 * size;
    }
    if (!(size * size > 1e-200) || !(size < 1e37)) {
        return df_fail(err, DF_ERROR_INPUT, "%s: a voxel size of %g is out of range", name, size);
    }
    return DF_OK;
}
