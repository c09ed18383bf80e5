/* What others do, for the chart: the marching-cubes mesh traced by Embree and drawn by OpenGL, and an OpenCL device. */
#ifndef DF_TESTS_PEERS_H
#define DF_TESTS_PEERS_H

#include "rows.h"

/* Errors and times of each that is there, beside the default method in the same turns, at 1.6 longest sides. Rays are
 * those of the camera's family; mc-raster draws pictures only and is held to the pixels of the chart's view. Says on
 * stderr what is not there. */
df_status lab_measure_peers(lab_session *session, const lab_subject *s);

#endif
