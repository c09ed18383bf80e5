#include "render/bench.h"
#include "common/memory.h"
#include "common/progress.h"
#include "common/version.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

static int by_value(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void add(df_frame_stats *sum, const df_frame_stats *frame) {
    df_frame_stats_add(sum, frame);
    sum->rays_cast += frame->rays_cast;
    sum->rays_entering += frame->rays_entering;
}

static df_status frame_view(const df_settings *settings, const df_field *field, double azimuth, df_view *view,
                            df_error *err) {
    df_settings turned = *settings;
    df_camera camera;
    turned.orbit[0] += azimuth;
    df_status status = df_settings_camera(&turned, field, &camera, err);
    if (status != DF_OK) return status;
    return df_view_make(&camera, field, settings->width, settings->height, view, err);
}

/* Frames that devices take in turn. */
static df_status run_dealt(df_bench *bench, df_devices *devices, const df_settings *settings, const df_field *field,
                           df_error *err) {
    const uint32_t parts = df_devices_parts(devices);
    const uint64_t pixels = (uint64_t)settings->width * settings->height;
    df_picture pictures[DF_DEVICE_MAX] = {{0}};
    df_view *views;
    df_status status = df_alloc((void **)&views, bench->frames, sizeof *views, "views", err);
    for (uint32_t i = 0; i < bench->frames && status == DF_OK; i++)
        status = frame_view(settings, field, 360.0 * i / bench->frames, &views[i], err);
    for (uint32_t i = 0; i < parts && status == DF_OK; i++) {
        pictures[i] = (df_picture){.width = settings->width, .height = settings->height};
        status = df_alloc((void **)&pictures[i].rgb, pixels, 3, "pictures", err);
    }
    for (uint32_t repeat = 0; repeat < bench->repeats && status == DF_OK; repeat++) {
        status = df_devices_frames(devices, views, bench->frames, pictures, NULL, &bench->stats, err);
        bench->repeat_ms[repeat] = bench->stats.frame_ms / bench->frames;
    }
    bench->stats.rays_hitting = 0;
    memset(&bench->stats.counters, 0, sizeof bench->stats.counters);
    for (uint32_t i = 0; i < bench->frames && status == DF_OK; i++) {
        df_frame_stats counts = {0}; /* by a device: no device is named twice but OpenCL's */
        status = df_count_entering(&views[i], &counts.rays_entering, err);
        if (status == DF_OK) status = df_devices_count(devices, &views[i], &counts, err);
        add(&bench->stats, &counts);
    }
    for (uint32_t i = 0; i < parts; i++) free(pictures[i].rgb);
    free(views);
    return status;
}

df_status df_bench_run(df_bench *bench, df_devices *devices, const df_settings *settings, const df_field *field,
                       const df_picture *picture, df_error *err) {
    df_view view;
    if (settings->has_eye || settings->has_look_at || settings->has_up) {
        return df_fail(err, DF_ERROR_USAGE, "--bench turns the camera itself: only --orbit goes with it");
    }
    df_status status = df_alloc((void **)&bench->repeat_ms, bench->repeats, sizeof *bench->repeat_ms, "bench", err);
    if (status == DF_OK)
        status = df_alloc((void **)&bench->edit_ms, bench->repeats, sizeof *bench->edit_ms, "bench", err);
    if (status == DF_OK) status = frame_view(settings, field, 0, &view, err);
    const double start = df_now_ms();
    if (status == DF_OK) status = df_devices_frame(devices, &view, picture, NULL, err); /* warms up */
    bench->first_frame_ms = df_now_ms() - start;
    if (status == DF_OK && bench->deal_frames) return run_dealt(bench, devices, settings, field, err);
    for (uint32_t repeat = 0; repeat < bench->repeats && status == DF_OK; repeat++) {
        double total = 0;
        memset(&bench->stats, 0, sizeof bench->stats);
        for (uint32_t i = 0; i < bench->frames && status == DF_OK; i++) {
            df_frame_stats stats = {0};
            status = frame_view(settings, field, 360.0 * i / bench->frames, &view, err);
            if (status == DF_OK) status = df_devices_frame(devices, &view, picture, &stats, err);
            if (status == DF_OK && repeat + 1 == bench->repeats) {
                status = df_count_entering(&view, &stats.rays_entering, err);
                if (status == DF_OK) status = df_devices_count(devices, &view, &stats, err);
            }
            total += stats.frame_ms;
            add(&bench->stats, &stats);
        }
        bench->repeat_ms[repeat] = total / bench->frames;
    }
    return status;
}

void df_bench_free(df_bench *bench) {
    free(bench->repeat_ms);
    free(bench->edit_ms);
    bench->repeat_ms = bench->edit_ms = NULL;
}

/* The processor's name from /proc/cpuinfo, without commas. */
static void machine_name(char *name, size_t size) {
    FILE *file = fopen("/proc/cpuinfo", "r");
    char line[256];
    snprintf(name, size, "unknown");
    if (!file) return;
    while (fgets(line, sizeof line, file)) {
        char *value = strchr(line, ':');
        if (strncmp(line, "model name", 10) != 0 || !value) continue;
        value[strcspn(value, "\n")] = 0;
        snprintf(name, size, "%s", value + 2);
        break;
    }
    fclose(file);
}

/* Sorts `count` times and returns the middle one. */
static double median_of(double *times, uint32_t count) {
    qsort(times, count, sizeof *times, by_value);
    return 0.5 * (times[(count - 1) / 2] + times[count / 2]);
}

/* A CSV field in quotes. */
static void put_text(FILE *out, const char *text) {
    fputc('"', out);
    for (; *text; text++) {
        if (*text == '"') fputc('"', out);
        fputc(*text, out);
    }
    fputc('"', out);
}

/* Columns of the report that are figures of one frame: the bench prints means over frames instead. */
static const char *const columns[] = {
    "field",
    "structure",
    "samples",
    "tracer",
    "bounds",
    "intersect",
    "precision",
    "gradient",
    "isa",
    "threads",
    "device",
    "width",
    "height",
    "tile",
    "rays_cast",
    "rays_entering",
    "rays_hitting",
    "coarse_steps_per_ray",
    "fine_steps_per_ray",
    "cells_tested_per_ray",
    "mean_active_lanes",
    "precompute_ms",
    "extract_ms",
    "precompute_bytes",
    "phase_begin_ms",
    "phase_rays_ms",
    "phase_trace_ms",
    "phase_solve_ms",
    "phase_shade_ms",
    "floor_ns_per_ray",
};
enum { COLUMN_COUNT = sizeof columns / sizeof columns[0] };

void df_bench_print_header(FILE *out) {
    for (int i = 0; i < COLUMN_COUNT; i++) fprintf(out, "%s,", columns[i]);
    fprintf(out,
            "frames,repeats,frame_ms_min,frame_ms_median,frame_ms_max,ns_per_ray_min,ns_per_ray_median,mrays_per_s,"
            "ns_per_hitting_ray,model_bytes,edit_ms,first_frame_ms,machine,compiler,flags,commit,command\n");
}

df_status df_bench_print(FILE *out, const df_bench *bench, const df_report *report, df_error *err) {
    df_report mean = *report;
    char machine[256];
    mean.stats = bench->stats;
    mean.stats.begin_ms /= bench->frames;
    mean.stats.rays_ms /= bench->frames;
    mean.stats.trace_ms /= bench->frames;
    mean.stats.shade_ms /= bench->frames;
    mean.stats.counters.solve_ms /= bench->frames;
    json_t *json = df_report_json(&mean);
    if (!json) return df_fail(err, DF_ERROR_MEMORY, "out of memory");
    for (int i = 0; i < COLUMN_COUNT; i++) {
        const json_t *value = json_object_get(json, columns[i]);
        if (json_is_string(value)) put_text(out, json_string_value(value));
        else if (json_is_integer(value)) fprintf(out, "%" JSON_INTEGER_FORMAT, json_integer_value(value));
        else fprintf(out, "%.6g", json_real_value(value));
        fputc(',', out);
    }
    json_decref(json);
    const df_field *field = report->scene->field;
    const double rays = (double)bench->stats.rays_cast / bench->frames,
                 hits = (double)bench->stats.rays_hitting / bench->frames;
    const double median = median_of(bench->repeat_ms, bench->repeats);
    const double least = bench->repeat_ms[0], most = bench->repeat_ms[bench->repeats - 1];
    const uint64_t model = field->sample_count * df_sample_size(field->sample_type) + report->precompute_bytes;
    machine_name(machine, sizeof machine);
    fprintf(out, "%u,%u,%.4f,%.4f,%.4f,%.4f,%.4f,%.3f,%.3f,%" PRIu64 ",%.4f,%.4f,", bench->frames, bench->repeats,
            least, median, most, least * 1e6 / rays, median * 1e6 / rays, rays / median / 1e3,
            hits > 0 ? median * 1e6 / hits : 0.0, model, median_of(bench->edit_ms, bench->repeats),
            bench->first_frame_ms);
    put_text(out, machine);
    fputc(',', out);
    put_text(out, DF_COMPILER);
    fputc(',', out);
    put_text(out, DF_BUILD_FLAGS);
    fputc(',', out);
    put_text(out, DF_BUILD_COMMIT);
    fputc(',', out);
    put_text(out, bench->command);
    fputc('\n', out);
    return DF_OK;
}
