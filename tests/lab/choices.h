/* What --quality auto takes, beside what it might have taken. */
#ifndef DF_TESTS_CHOICES_H
#define DF_TESTS_CHOICES_H

#include "rows.h"

/* At four distances: the choice's errors and cost and, but for that of the chart, those of every method with the same
 * gradient. */
df_status lab_measure_auto(lab_session *session, const lab_subject *s);

#endif
