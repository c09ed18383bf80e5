#include "rows.h"
#include "common/version.h"
#include "render/methods/solve_methods.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

/* The format of the table counts as a part of the version. */
#define LAB_VERSION DF_VERSION "-4"
#define KEY_COLUMNS 13
static const char columns[] =
    "kind,field,size,structure,samples,tracer,intersect,steps,precision,gradient,truth,family,rays,bytes,"
    "tangent,true_positive,false_positive,false_negative,true_negative,leaks,wrong_face,"
    "depth_p50,depth_p99,depth_p999,depth_max,residual_p99,residual_max,normal_p50,normal_p99,normal_max,"
    "ns_per_ray,ns_per_hit,repeats,isa,instructions_per_ray,counted,bound,contender,contender_ratio,field_floor,seed,"
    "machine,compiler";
const lab_method lab_methods[LAB_METHOD_COUNT] = {
    {DF_SOLVE_MIDPOINT, 0, DF_PRECISION_F64}, {DF_SOLVE_LINEAR, 0, DF_PRECISION_F64},
    {DF_SOLVE_REPEATED, 1, DF_PRECISION_F64}, {DF_SOLVE_REPEATED, 2, DF_PRECISION_F64},
    {DF_SOLVE_REPEATED, 3, DF_PRECISION_F64}, {DF_SOLVE_REPEATED, 5, DF_PRECISION_F64},
    {DF_SOLVE_MARMITT, 1, DF_PRECISION_F64},  {DF_SOLVE_MARMITT, 2, DF_PRECISION_F64},
    {DF_SOLVE_MARMITT, 3, DF_PRECISION_F64},  {DF_SOLVE_MARMITT, 5, DF_PRECISION_F64},
    {DF_SOLVE_ANALYTIC, 0, DF_PRECISION_F64}, {DF_SOLVE_ROBUST, 1, DF_PRECISION_F64},
    {DF_SOLVE_ROBUST, 2, DF_PRECISION_F64},   {DF_SOLVE_ROBUST, 3, DF_PRECISION_F64},
    {DF_SOLVE_ROBUST, 4, DF_PRECISION_F64},   {DF_SOLVE_ROBUST, 6, DF_PRECISION_F64},
    {DF_SOLVE_ROBUST, 16, DF_PRECISION_F64},  {DF_SOLVE_LINEAR, 0, DF_PRECISION_F32},
    {DF_SOLVE_REPEATED, 3, DF_PRECISION_F32}, {DF_SOLVE_MARMITT, 1, DF_PRECISION_F32},
    {DF_SOLVE_MARMITT, 3, DF_PRECISION_F32},  {DF_SOLVE_MARMITT, 5, DF_PRECISION_F32},
    {DF_SOLVE_ROBUST, 1, DF_PRECISION_F32},   {DF_SOLVE_ROBUST, 2, DF_PRECISION_F32},
    {DF_SOLVE_ROBUST, 3, DF_PRECISION_F32},   {DF_SOLVE_ROBUST, 4, DF_PRECISION_F32},
    {DF_SOLVE_ROBUST, 6, DF_PRECISION_F32},   {DF_SOLVE_ROBUST, 16, DF_PRECISION_F32}};

static void read_machine(char *name, size_t size) {
    char line[256];
    FILE *file = fopen("/proc/cpuinfo", "r");
    snprintf(name, size, "unknown");
    while (file && fgets(line, sizeof line, file)) {
        char *value = strstr(line, ": ");
        if (strncmp(line, "model name", 10) != 0 || !value) continue;
        value[strcspn(value, "\n")] = 0;
        snprintf(name, size, "%s", value + 2);
        break;
    }
    for (char *c = name; *c; c++) *c = *c == ',' ? ' ' : *c;
    if (file) fclose(file);
}

df_status lab_session_open(lab_session *session, const char *path, int argc, char **argv, df_error *err) {
    *session = (lab_session){.err = err, .path = path, .counter = lab_counter_open()};
    read_machine(session->machine, sizeof session->machine);
    for (int i = 0; i < argc; i++) {
        session->quick |= strcmp(argv[i], "--quick") == 0;
        session->uncounted |= strcmp(argv[i], "--uncounted") == 0;
    }
    if (session->uncounted && session->counter >= 0) close(session->counter);
    if (session->uncounted) session->counter = -1;
    df_status status = df_kernels_select("auto", &session->kernels, err);
    return status == DF_OK ? lab_table_open(path, LAB_VERSION, columns, KEY_COLUMNS, &session->table, err) : status;
}

void lab_session_close(lab_session *session) {
    for (int i = 0; i < LAB_COUNTING_CHILDREN; i++) lab_count_abandon(&session->counting[i]);
    if (session->asked && !session->counted)
        fprintf(stderr, "df-lab: no instructions were counted: no counter of the processor and no valgrind\n");
    lab_table_close(&session->table);
    lab_counts_free(&session->counts);
    if (session->counter >= 0) close(session->counter);
}

df_status lab_session_finish_counting(lab_session *session) {
    df_status status = DF_OK;
    for (int i = 0; i < LAB_COUNTING_CHILDREN && status == DF_OK; i++)
        status = lab_count_finish(&session->counting[i], &session->counts, session->err);
    return status;
}

void lab_row_key(const lab_subject *s, const lab_row *r, char *key, size_t size) {
    snprintf(key, size, "%s,%s,%u,%s,%s,%s,%s,%d,%s,%s,%s,%s,%" PRIu64, r->kind, s->name, lab_subject_size(s),
             df_field_kind_name(s->field.kind), df_sample_type_name(s->field.sample_type), r->tracer, r->intersect,
             r->steps, r->precision, r->gradient, r->truth, r->family, r->rays);
}

/* How the instructions of a frame are counted: callgrind knows nothing above AVX2. */
static const char *counting_way(const lab_session *session) {
    if (session->counter >= 0) return "counter";
    return session->counts.count ? "callgrind" : "";
}

static int print_counts(const lab_session *session, char *out, size_t size, const lab_row *r) {
    int n = snprintf(out, size, ",%s,", r->isa ? r->isa : "");
    if (r->instructions_per_ray > 0)
        n += snprintf(out + n, size - (size_t)n, "%.3f,%s,", r->instructions_per_ray, counting_way(session));
    else n += snprintf(out + n, size - (size_t)n, ",,");
    if (r->bound > 0) n += snprintf(out + n, size - (size_t)n, "%.3g", r->bound);
    n += snprintf(out + n, size - (size_t)n, ",%s,", r->contender);
    if (r->contender_ratio > 0) n += snprintf(out + n, size - (size_t)n, "%.4f", r->contender_ratio);
    return n;
}

static int print_times(char *out, size_t size, const lab_row *r) {
    int n = r->ns_per_ray >= 0 ? snprintf(out, size, "%.3f", r->ns_per_ray) : 0;
    n += snprintf(out + n, size - (size_t)n, ",");
    if (r->ns_per_hit >= 0) n += snprintf(out + n, size - (size_t)n, "%.3f", r->ns_per_hit);
    return n + snprintf(out + n, size - (size_t)n, ",%d", r->repeats);
}

df_status lab_row_write(lab_session *session, const lab_subject *s, const lab_row *r) {
    char key[LAB_KEY_SIZE], results[1024];
    const lab_histogram *n = r->normal;
    const size_t size = sizeof results;
    int at = snprintf(results, size, "%" PRIu64, r->bytes ? r->bytes : lab_model_bytes(&s->field));
    lab_row_key(s, r, key, sizeof key);
    if (r->score) {
        const lab_score *c = r->score;
        at += snprintf(results + at, size - (size_t)at,
                       ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64
                       ",%.3g,%.3g,%.3g,%.3g,%.3g,%.3g",
                       c->tangent, c->true_positive, c->false_positive, c->false_negative, c->true_negative, c->leaks,
                       c->wrong_face, lab_histogram_quantile(&c->depth, 0.5), lab_histogram_quantile(&c->depth, 0.99),
                       lab_histogram_quantile(&c->depth, 0.999), c->depth.max,
                       lab_histogram_quantile(&c->residual, 0.99), c->residual.max);
    } else {
        at += snprintf(results + at, size - (size_t)at, ",,,,,,,,,,,,,");
    }
    if (n) {
        at += snprintf(results + at, size - (size_t)at, ",%.3g,%.3g,%.3g,", lab_histogram_quantile(n, 0.5),
                       lab_histogram_quantile(n, 0.99), n->max);
    } else {
        at += snprintf(results + at, size - (size_t)at, ",,,,");
    }
    at += print_times(results + at, size - (size_t)at, r);
    at += print_counts(session, results + at, size - (size_t)at, r);
    snprintf(results + at, size - (size_t)at, ",%.3g,%u,%s,%s", s->field_floor, LAB_SEED, session->machine,
             DF_COMPILER);
    return lab_table_add(&session->table, LAB_VERSION, key, results, session->err);
}

bool lab_row_have(const lab_session *session, const lab_subject *s, const lab_row *r) {
    char key[LAB_KEY_SIZE];
    lab_row_key(s, r, key, sizeof key);
    return lab_table_has(&session->table, key);
}
