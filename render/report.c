#include "render/report.h"

#include <stdio.h>
#include <string.h>

/* What OpenCL devices took, and where a picture has several parts, each of them. */
static void add_devices(const df_devices *devices, json_t *json) {
    df_device_report parts[DF_DEVICE_MAX];
    const uint32_t count = df_devices_report(devices, parts);
    double build_ms = 0, upload_ms = 0, download_ms = 0;
    char text[DF_DEVICE_MAX * (sizeof parts[0].name + 3)] = "";
    char tracers[64] = "";
    size_t used = 0;
    for (uint32_t i = 0; i < count; i++) {
        build_ms += parts[i].build_ms;
        upload_ms += parts[i].upload_ms;
        download_ms += parts[i].download_ms;
        if (i == 0 || strcmp(parts[i].tracer, parts[i - 1].tracer) != 0)
            snprintf(tracers + strlen(tracers), sizeof tracers - strlen(tracers), "%s%s", *tracers ? " + " : "",
                     parts[i].tracer);
        used += (size_t)snprintf(text + used, sizeof text - used, "%s%.*s", i ? " + " : "",
                                 (int)sizeof parts[i].name - 1, parts[i].name);
    }
    json_object_set_new(json, "tracer", json_string(tracers));
    json_object_set_new(json, "device", json_string(text));
    json_object_set_new(json, "phase_build_ms", json_real(build_ms));
    json_object_set_new(json, "phase_upload_ms", json_real(upload_ms));
    json_object_set_new(json, "phase_download_ms", json_real(download_ms));
    for (uint32_t i = 0; i < count && count > 1; i++) {
        char key[32];
        snprintf(key, sizeof key, "part_%u_rows", i);
        json_object_set_new(json, key, json_integer(parts[i].rows));
        snprintf(key, sizeof key, "part_%u_ms", i);
        json_object_set_new(json, key, json_real(parts[i].ms));
    }
    if (count > 1) json_object_set_new(json, "overlap", json_real(df_devices_overlap(devices)));
}

json_t *df_report_json(const df_report *report) {
    const df_field *field = report->scene->field;
    const df_settings *settings = report->settings;
    const df_frame_stats *stats = &report->stats;
    const df_counters *counters = &stats->counters;
    double rays = (double)stats->rays_cast, lanes = (double)counters->lanes_total;
    /* what is left of a frame whose hit cells are known */
    const double floor_ms = stats->rays_ms + counters->solve_ms + stats->shade_ms;
    const double pixels = (double)settings->width * settings->height;
    const bool own = report->tracer->own_methods;
    json_t *json = json_object();
    if (!json) return NULL;
    json_object_set_new(json, "field", json_string(report->field_path));
    json_object_set_new(json, "structure", json_string(df_scene_structure_name(report->scene)));
    json_object_set_new(json, "samples", json_string(df_sample_type_name(field->sample_type)));
    json_object_set_new(json, "tracer",
                        json_string(report->tracer->name)); /* keeps its place: add_devices completes it */
    json_object_set_new(json, "bounds", json_string(df_bounds_names[settings->walk.bounds]));
    json_object_set_new(json, "lod", json_real(settings->walk.lod));
    json_object_set_new(json, "filter", json_string(df_filter_names[settings->filter]));
    json_object_set_new(json, "intersect", json_string(own ? "own" : df_solve_names[settings->solve]));
    json_object_set_new(json, "steps",
                        json_integer(settings->steps ? settings->steps : df_solve_steps(settings->solve)));
    json_object_set_new(json, "precision", json_string(own ? "own" : df_precision_names[settings->precision]));
    json_object_set_new(json, "gradient", json_string(own ? "own" : df_gradient_names[settings->gradient]));
    json_object_set_new(json, "isa", json_string(report->kernels->isa));
    json_object_set_new(json, "threads", json_integer(report->threads));
    json_object_set_new(json, "width", json_integer(settings->width));
    json_object_set_new(json, "height", json_integer(settings->height));
    json_object_set_new(json, "tile", json_integer(report->tile));
    json_object_set_new(json, "rays_cast", json_integer((json_int_t)stats->rays_cast));
    json_object_set_new(json, "rays_entering", json_integer((json_int_t)stats->rays_entering));
    json_object_set_new(json, "rays_hitting", json_integer((json_int_t)stats->rays_hitting));
    json_object_set_new(json, "coarse_steps_per_ray", json_real((double)counters->coarse_steps / rays));
    json_object_set_new(json, "fine_steps_per_ray", json_real((double)counters->fine_steps / rays));
    json_object_set_new(json, "cells_tested_per_ray", json_real((double)counters->cells_tested / rays));
    json_object_set_new(json, "mean_active_lanes", json_real(lanes > 0 ? (double)counters->lanes_active / lanes : 1));
    json_object_set_new(json, "load_ms", json_real(report->load_ms));
    json_object_set_new(json, "precompute_ms", json_real(report->precompute_ms));
    json_object_set_new(json, "extract_ms", json_real(report->extract_ms));
    json_object_set_new(json, "precompute_bytes", json_integer((json_int_t)report->precompute_bytes));
    json_object_set_new(json, "frame_ms", json_real(stats->frame_ms));
    json_object_set_new(json, "ns_per_ray", json_real(stats->frame_ms * 1e6 / rays));
    json_object_set_new(json, "phase_begin_ms", json_real(stats->begin_ms));
    json_object_set_new(json, "phase_rays_ms", json_real(stats->rays_ms));
    json_object_set_new(json, "phase_trace_ms", json_real(stats->trace_ms)); /* solves included */
    json_object_set_new(json, "phase_solve_ms", json_real(counters->solve_ms));
    json_object_set_new(json, "phase_shade_ms", json_real(stats->shade_ms));
    json_object_set_new(json, "floor_ns_per_ray", json_real(counters->solve_ms > 0 ? floor_ms * 1e6 / pixels : 0.0));
    add_devices(report->devices, json);
    return json;
}

void df_report_print(const json_t *json) {
    const char *name;
    json_t *value;
    json_object_foreach((json_t *)json, name, value) {
        if (json_is_string(value)) printf("%-22s %s\n", name, json_string_value(value));
        else if (json_is_integer(value)) printf("%-22s %" JSON_INTEGER_FORMAT "\n", name, json_integer_value(value));
        else printf("%-22s %.4g\n", name, json_real_value(value));
    }
}
