#include "render/devices.h"
#include "common/memory.h"
#include "common/options.h"
#include "common/progress.h"

#include <assert.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

/* Rows of a picture are divided in groups of so many, the height of a work group. */
#define ROW_GROUP 8u

/* One of those that make a picture. */
typedef struct device_part {
    uint32_t number; /* DF_DEVICE_CPU or an OpenCL device */
    df_renderer *cpu;
    df_opencl_renderer *opencl;
    char name[160];
    const char *tracer;
    uint32_t first_row, row_count;
    double start_ms, end_ms;
    df_opencl_times times;
    df_frame_stats stats;
    df_status status;
    df_error error;
    /* what its thread needs */
    const df_view *view;
    const df_picture *picture;
} device_part;

struct df_devices {
    df_devices_options options;
    const df_scene *scene;
    df_frame_options frame;
    uint32_t width, height;
    df_opencl_info *list;
    uint32_t list_count;
    device_part parts[DF_DEVICE_MAX];
    uint32_t part_count;
    bool taken_over;              /* by the CPU */
    double shares[DF_DEVICE_MAX]; /* of the picture's rows, by part */
};

/* ---- choosing ---- */

static df_status parse_one(const char *text, df_device_choice *choice, df_error *err) {
    uint32_t number = DF_OPENCL_ANY;
    if (strcmp(text, "cpu") == 0) {
        number = DF_DEVICE_CPU;
    } else if (strncmp(text, "opencl:", 7) == 0) {
        df_status status = df_parse_u32("--device opencl", text + 7, 0, 1000, &number, err);
        if (status != DF_OK) return status;
    } else if (strcmp(text, "opencl") != 0) {
        return df_fail(err, DF_ERROR_USAGE,
                       "--device %s: expected cpu, opencl, opencl:N, both or auto, or several with commas", text);
    }
    if (choice->count == DF_DEVICE_MAX)
        return df_fail(err, DF_ERROR_USAGE, "--device: at most %u devices", DF_DEVICE_MAX);
    for (uint32_t i = 0; i < choice->count; i++) {
        if (number == DF_DEVICE_CPU && choice->numbers[i] == number)
            return df_fail(err, DF_ERROR_USAGE, "--device: the CPU is named twice");
    }
    choice->numbers[choice->count++] = number;
    return DF_OK;
}

df_status df_devices_parse(const char *text, df_device_choice *choice, df_error *err) {
    memset(choice, 0, sizeof *choice);
    if (strcmp(text, "auto") == 0) {
        choice->automatic = true;
        choice->count = 1;
        choice->numbers[0] = DF_OPENCL_ANY;
        return DF_OK;
    }
    char *copy = strdup(strcmp(text, "both") == 0 ? "cpu,opencl" : text), *rest = copy;
    if (!copy) return df_fail(err, DF_ERROR_MEMORY, "out of memory");
    df_status status = DF_OK;
    for (char *name; status == DF_OK && (name = strsep(&rest, ","));) status = parse_one(name, choice, err);
    free(copy);
    return status;
}

/* ---- opening ---- */

static df_status open_cpu(df_devices *d, device_part *part, df_error *err) {
    if (d->frame.tracer->whole_frame && d->options.choice.count > 1 && !d->options.deal_frames) {
        return df_fail(err, DF_ERROR_USAGE, "--tracer %s makes whole pictures: it cannot share one with another device",
                       d->frame.tracer->name);
    }
    snprintf(part->name, sizeof part->name, "cpu");
    part->tracer = d->frame.tracer->name;
    part->number = DF_DEVICE_CPU;
    return df_renderer_open(d->scene, &d->frame, d->width, d->height, &part->cpu, err);
}

/* How an OpenCL device finds hits: by the tracer that was asked for by name, or by its own. */
static df_status choose_tracer(const df_devices *d, df_opencl_tracer *tracer, df_error *err) {
    int number = d->scene->levels ? DF_OPENCL_DDA : DF_OPENCL_ADF;
    if (d->options.tracer_given) {
        const char *name = d->frame.tracer->name;
        for (number = 0; number < DF_OPENCL_TRACER_COUNT; number++) {
            if (strcmp(name, df_opencl_tracer_names[number]) == 0) break;
        }
        if (number == DF_OPENCL_TRACER_COUNT)
            return df_fail(err, DF_ERROR_USAGE, "--tracer %s is the CPU's: OpenCL devices have dda, cgt and adf", name);
    }
    *tracer = (df_opencl_tracer)number;
    return DF_OK;
}

static df_status open_opencl(df_devices *d, uint32_t wanted, device_part *part, df_error *err) {
    if (!d->list) {
        df_status status = df_opencl_find(&d->list, &d->list_count, err);
        if (status != DF_OK) return status;
    }
    df_opencl_tracer tracer;
    df_status status = choose_tracer(d, &tracer, err);
    if (status != DF_OK) return status;
    if (d->frame.walk.lod > 0)
        return df_fail(err, DF_ERROR_USAGE, "--lod is the CPU's: OpenCL devices look into every cell");
    if (d->frame.filter)
        return df_fail(err, DF_ERROR_USAGE, "--filter %s is the CPU's: OpenCL devices interpolate trilinearly",
                       df_filter_names[d->frame.filter]);
    if (d->frame.precision == DF_PRECISION_F32)
        return df_fail(err, DF_ERROR_USAGE, "--precision f32 is the CPU's: OpenCL devices solve in double");
    if (d->frame.walk.no_clip && d->part_count == 1)
        return df_fail(err, DF_ERROR_USAGE, "--clip off is the CPU's: packets of OpenCL devices look at whole blocks");
    if (d->frame.walk.bounds == DF_BOUNDS_GL)
        return df_fail(err, DF_ERROR_USAGE, "--bounds gl is the CPU's: OpenCL devices have bricks and voxels");
    if (d->frame.walk.bounds && tracer == DF_OPENCL_ADF)
        return df_fail(err, DF_ERROR_USAGE, "--bounds %s: octrees have no use for it",
                       df_bounds_names[d->frame.walk.bounds]);
    status = df_opencl_choose(d->list, d->list_count, wanted, d->options.choice.automatic, &part->number, err);
    if (status != DF_OK) return status;
    const uint32_t *group = d->options.group, packet = tracer == DF_OPENCL_CGT ? d->frame.walk.packet : 0;
    const df_opencl_options options = {.tracer = tracer,
                                       .solve = d->frame.solve,
                                       .steps = d->frame.steps,
                                       .gradient = d->frame.gradient,
                                       .bounds = d->frame.walk.bounds,
                                       .threads = d->frame.threads,
                                       .group = {group[0] ? group[0] : packet, group[0] ? group[1] : packet},
                                       .images = d->options.images,
                                       .log = d->options.messages};
    part->tracer = df_opencl_tracer_names[tracer];
    snprintf(part->name, sizeof part->name, "opencl:%u %s", part->number, d->list[part->number].name);
    return df_opencl_renderer_open(&d->list[part->number], d->scene, &options, &part->opencl, err);
}

/* Lets the CPU make the pictures from here on, and says so. */
static df_status take_over(df_devices *d, const df_error *reason, df_error *err) {
    device_part *part = &d->parts[0];
    if (d->options.messages)
        fprintf(d->options.messages, "%s: %s: the CPU takes over\n", d->options.program, reason->text);
    df_opencl_renderer_close(part->opencl);
    memset(part, 0, sizeof *part);
    d->options.choice.automatic = false;
    d->taken_over = true;
    return open_cpu(d, part, err);
}

void df_devices_close(df_devices *d) {
    if (!d) return;
    for (uint32_t i = 0; i < d->part_count; i++) {
        df_renderer_close(d->parts[i].cpu);
        df_opencl_renderer_close(d->parts[i].opencl);
    }
    free(d->list);
    free(d);
}

df_status df_devices_open(const df_devices_options *options, const df_scene *scene, const df_frame_options *frame,
                          uint32_t width, uint32_t height, df_devices **out, df_error *err) {
    df_devices *d;
    *out = NULL;
    df_status status = df_alloc((void **)&d, 1, sizeof *d, "devices", err);
    if (status != DF_OK) return status;
    d->options = *options;
    d->scene = scene;
    d->frame = *frame;
    d->width = width;
    d->height = height;
    d->part_count = options->choice.count;
    for (uint32_t i = 0; i < d->part_count && status == DF_OK; i++) {
        const uint32_t wanted = options->choice.numbers[i];
        d->shares[i] = 1.0 / d->part_count;
        if (wanted == DF_DEVICE_CPU) {
            status = open_cpu(d, &d->parts[i], err);
            continue;
        }
        df_error reason = {0};
        status = open_opencl(d, wanted, &d->parts[i], &reason);
        if (status != DF_OK && d->options.choice.automatic) status = take_over(d, &reason, err);
        else if (status != DF_OK && err) *err = reason;
    }
    if (status != DF_OK) df_devices_close(d);
    else *out = d;
    return status;
}

/* ---- pictures ---- */

void df_devices_divide(const double shares[], uint32_t count, uint32_t height, uint32_t rows[]) {
    const uint32_t groups = (height + ROW_GROUP - 1) / ROW_GROUP;
    double passed = 0;
    uint32_t group = 0, row = 0;
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t after = count - 1 - i;
        passed += shares[i];
        uint32_t end = after == 0 ? groups : (uint32_t)(passed * groups + 0.5);
        if (groups >= count && end > groups - after) end = groups - after;
        if (groups >= count && end < group + 1) end = group + 1;
        if (end < group) end = group;
        if (end > groups) end = groups;
        const uint32_t last = end * ROW_GROUP < height ? end * ROW_GROUP : height;
        rows[i] = last - row;
        group = end;
        row = last;
    }
}

void df_devices_learn(const uint32_t rows[], const double ms[], uint32_t count, double shares[]) {
    double height = 0, speeds = 0;
    for (uint32_t i = 0; i < count; i++) {
        if (rows[i] == 0 || !(ms[i] > 0)) return;
        height += rows[i];
        speeds += rows[i] / ms[i];
    }
    for (uint32_t i = 0; i < count; i++) shares[i] = 0.5 * rows[i] / height + 0.5 * (rows[i] / ms[i]) / speeds;
}

static void *run_part(void *opaque) {
    device_part *part = opaque;
    part->status = DF_OK;
    part->start_ms = df_now_ms();
    memset(&part->stats, 0, sizeof part->stats);
    memset(&part->times, 0, sizeof part->times);
    if (part->cpu) {
        part->status = df_renderer_rows(part->cpu, part->view, part->first_row, part->row_count, part->picture,
                                        &part->stats, &part->error);
    } else {
        part->status = df_opencl_renderer_rows(part->opencl, part->view, part->first_row, part->row_count,
                                               part->picture, &part->times, &part->error);
        part->stats.begin_ms = part->times.bounds_ms;
        part->stats.trace_ms = part->times.trace_ms;
        part->stats.shade_ms = part->times.shade_ms;
    }
    part->end_ms = df_now_ms();
    return NULL;
}

/* Runs the first part here and the others in threads of their own. */
static df_status run_parts(df_devices *d, df_error *err) {
    pthread_t threads[DF_DEVICE_MAX];
    bool started[DF_DEVICE_MAX] = {false};
    for (uint32_t i = 1; i < d->part_count; i++) {
        started[i] = pthread_create(&threads[i], NULL, run_part, &d->parts[i]) == 0;
    }
    run_part(&d->parts[0]);
    for (uint32_t i = 1; i < d->part_count; i++) {
        if (started[i]) pthread_join(threads[i], NULL);
        else run_part(&d->parts[i]);
    }
    for (uint32_t i = 0; i < d->part_count; i++) {
        if (d->parts[i].status == DF_OK) continue;
        if (err) *err = d->parts[i].error;
        return d->parts[i].status;
    }
    return DF_OK;
}

df_status df_devices_frame(df_devices *d, const df_view *view, const df_picture *picture, df_frame_stats *stats,
                           df_error *err) {
    const double start = df_now_ms();
    uint32_t rows[DF_DEVICE_MAX] = {0}, first = 0;
    double ms[DF_DEVICE_MAX];
    df_devices_divide(d->shares, d->part_count, view->height, rows);
    for (uint32_t i = 0; i < d->part_count; i++) {
        d->parts[i].view = view;
        d->parts[i].picture = picture;
        d->parts[i].first_row = first;
        d->parts[i].row_count = rows[i];
        first += rows[i];
    }
    df_error reason = {0};
    df_status status = run_parts(d, &reason);
    if (status != DF_OK && d->options.choice.automatic) {
        status = take_over(d, &reason, err);
        return status == DF_OK ? df_devices_frame(d, view, picture, stats, err) : status;
    }
    if (status != DF_OK) {
        if (err) *err = reason;
        return status;
    }
    for (uint32_t i = 0; i < d->part_count; i++) ms[i] = d->parts[i].end_ms - d->parts[i].start_ms;
    df_devices_learn(rows, ms, d->part_count, d->shares);
    df_frame_stats sum = {0};
    for (uint32_t i = 0; i < d->part_count; i++) df_frame_stats_add(&sum, &d->parts[i].stats);
    sum.rays_cast = (uint64_t)view->width * view->height;
    sum.frame_ms = df_now_ms() - start;
    if (stats) *stats = sum;
    return DF_OK;
}

/* Views that parts take in turn. */
typedef struct frame_queue {
    const df_view *views;
    uint32_t count, next; /* the first that nobody has taken; atomic */
    uint32_t *makers;
} frame_queue;

typedef struct queue_worker {
    frame_queue *queue;
    device_part *part;
    uint32_t number;
    df_frame_stats sum;
} queue_worker;

static void *run_queue(void *opaque) {
    queue_worker *worker = opaque;
    frame_queue *queue = worker->queue;
    device_part *part = worker->part;
    for (;;) {
        const uint32_t i = __atomic_fetch_add(&queue->next, 1, __ATOMIC_RELAXED);
        if (i >= queue->count) return NULL;
        part->view = &queue->views[i];
        part->first_row = 0;
        part->row_count = queue->views[i].height;
        run_part(part);
        if (part->status != DF_OK) return NULL;
        if (queue->makers) queue->makers[i] = worker->number;
        df_frame_stats_add(&worker->sum, &part->stats);
    }
}

df_status df_devices_frames(df_devices *d, const df_view views[], uint32_t count, const df_picture pictures[],
                            uint32_t makers[], df_frame_stats *stats, df_error *err) {
    const double start = df_now_ms();
    frame_queue queue = {views, count, 0, makers};
    queue_worker workers[DF_DEVICE_MAX];
    pthread_t threads[DF_DEVICE_MAX];
    bool started[DF_DEVICE_MAX] = {false};
    df_frame_stats sum = {.rays_cast = (uint64_t)count * views[0].width * views[0].height};
    for (uint32_t i = d->part_count; i-- > 0;) {
        workers[i] = (queue_worker){.queue = &queue, .part = &d->parts[i], .number = i};
        d->parts[i].picture = &pictures[i];
        d->parts[i].status = DF_OK;
        if (i > 0) started[i] = pthread_create(&threads[i], NULL, run_queue, &workers[i]) == 0;
        else run_queue(&workers[i]); /* which is enough where no thread could be started */
    }
    for (uint32_t i = 1; i < d->part_count; i++) {
        if (started[i]) pthread_join(threads[i], NULL);
    }
    for (uint32_t i = 0; i < d->part_count; i++) {
        if (d->parts[i].status != DF_OK) {
            if (err) *err = d->parts[i].error;
            return d->parts[i].status;
        }
        df_frame_stats_add(&sum, &workers[i].sum);
    }
    sum.frame_ms = df_now_ms() - start;
    if (stats) *stats = sum;
    return DF_OK;
}

uint32_t df_devices_parts(const df_devices *d) { return d->part_count; }

bool df_devices_taken_over(const df_devices *d) { return d->taken_over; }

/* The counts of a view that a device could not count any more: the CPU makes a picture of it that nobody gets. */
static df_status count_anew(df_devices *d, const df_view *view, df_frame_stats *stats, df_error *err) {
    const df_picture none = {.width = view->width, .height = view->height};
    df_frame_stats counted = {0};
    df_status status = df_devices_frame(d, view, &none, &counted, err);
    stats->rays_hitting = counted.rays_hitting;
    stats->counters = counted.counters;
    return status;
}

df_status df_devices_count(df_devices *d, const df_view *view, df_frame_stats *stats, df_error *err) {
    for (uint32_t i = 0; i < d->part_count; i++) {
        if (!d->parts[i].opencl) continue;
        df_error reason = {0};
        df_status status =
            df_opencl_renderer_count(d->parts[i].opencl, view, &stats->rays_hitting, &stats->counters, &reason);
        if (status != DF_OK && d->options.choice.automatic) {
            status = take_over(d, &reason, err);
            return status == DF_OK ? count_anew(d, view, stats, err) : status;
        }
        if (status != DF_OK && err) *err = reason;
        return status;
    }
    return DF_OK; /* the CPU counts as it goes */
}

/* ---- reports ---- */

void df_devices_precomputation(const df_devices *d, double *ms, double *extract_ms, uint64_t *bytes) {
    *ms = d->scene->precompute_ms;
    *extract_ms = 0;
    *bytes = d->scene->precompute_bytes;
    for (uint32_t i = 0; i < d->part_count; i++) {
        if (d->parts[i].cpu) df_renderer_precomputation(d->parts[i].cpu, ms, extract_ms, bytes);
    }
}

uint32_t df_devices_report(const df_devices *d, df_device_report reports[DF_DEVICE_MAX]) {
    memset(reports, 0, DF_DEVICE_MAX * sizeof *reports);
    for (uint32_t i = 0; i < d->part_count; i++) {
        const device_part *part = &d->parts[i];
        df_device_report *report = &reports[i];
        memcpy(report->name, part->name, sizeof report->name);
        report->tracer = part->tracer;
        report->rows = part->row_count;
        report->ms = part->end_ms - part->start_ms;
        report->trace_ms = part->times.trace_ms;
        report->shade_ms = part->times.shade_ms;
        report->download_ms = part->times.download_ms;
        if (part->opencl) df_opencl_renderer_costs(part->opencl, &report->build_ms, &report->upload_ms);
    }
    return d->part_count;
}

double df_devices_overlap(const df_devices *d) {
    double start = d->parts[0].start_ms, end = d->parts[0].end_ms, shortest = end - start;
    for (uint32_t i = 1; i < d->part_count; i++) {
        const device_part *part = &d->parts[i];
        if (part->start_ms > start) start = part->start_ms;
        if (part->end_ms < end) end = part->end_ms;
        if (part->end_ms - part->start_ms < shortest) shortest = part->end_ms - part->start_ms;
    }
    return end > start && shortest > 0 ? (end - start) / shortest : 0;
}
