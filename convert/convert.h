/* From a mesh or shape to the file of its field, as a request asks: resolution, structure, samples, measured error. */
#ifndef DF_CONVERT_H
#define DF_CONVERT_H

#include "convert/request.h"

/* Reads request->input, builds its field, writes it to `output` and reports. --max-error auto is settled in the
 * request. */
df_status df_convert(df_request *request, const char *output, df_error *err);

#endif
