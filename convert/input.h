/* What df-convert turns into a field: a mesh, read, cleaned and oriented, or an analytic shape. */
#ifndef DF_INPUT_H
#define DF_INPUT_H

#include "convert/distance.h"
#include "convert/report.h"
#include "convert/request.h"
#include "convert/shape.h"

typedef struct df_input {
    df_shape shape;
    df_mesh mesh;
    df_sign sign;
    double low[3], high[3];
    df_distance_source source; /* made for the first field, kept for later ones: only that of --distance openvdb depends
                                  on a lattice, and it is made for one field */
} df_input;

/* Reads the input, repairs it where that is asked, and makes its signs ready; what was found and done goes to the
 * report. df_input_free() it in any case. */
df_status df_input_read(const df_request *request, df_input *input, df_convert_report *report, df_error *err);

/* The source of distances for fields on this lattice. One that was made before stays. */
df_status df_input_make_source(const df_request *request, df_input *input, const df_lattice *lattice,
                               df_convert_report *report, df_error *err);

/* Asks CGAL's exact inside test about points of a finished field, for the report. */
df_status df_input_check_signs(const df_input *input, const df_field *field, df_convert_report *report, df_error *err);

/* What the signs are worth; report->sign_reason says why. */
df_verdict df_input_judge_signs(const df_request *request, const df_input *input, df_convert_report *report);

void df_input_free(df_input *input);

#endif
