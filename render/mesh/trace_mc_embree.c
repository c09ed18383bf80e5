/*
 * The marching-cubes mesh ray traced by Embree: packets of the widest native size, coherent, its best BVH, not robust:
 * its fastest mode.
 */
#include "common/memory.h"
#include "common/progress.h"
#include "render/mesh/mc_model.h"

#include <embree3/rtcore.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct embree_state {
    const df_scene *scene;
    df_mc_model model;
    RTCDevice device;
    RTCScene rtc_scene;
    uint32_t lanes;
    atomic_llong bytes; /* what Embree holds */
} embree_state;

static bool count_memory(void *opaque, ssize_t bytes, bool post) {
    (void)post;
    atomic_fetch_add(&((embree_state *)opaque)->bytes, bytes);
    return true;
}

static void embree_release(void *opaque) {
    embree_state *state = opaque;
    if (!state) return;
    if (state->rtc_scene) rtcReleaseScene(state->rtc_scene);
    if (state->device) rtcReleaseDevice(state->device);
    df_mc_model_free(&state->model);
    free(state);
}

static df_status build(embree_state *state, uint32_t threads, df_error *err) {
    char config[64];
    snprintf(config, sizeof config, "threads=%u", threads);
    state->device = rtcNewDevice(config);
    if (!state->device)
        return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer mc-embree: Embree does not start (error %d)",
                       (int)rtcGetDeviceError(NULL));
    rtcSetDeviceMemoryMonitorFunction(state->device, count_memory, state);
    state->lanes = rtcGetDeviceProperty(state->device, RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED)  ? 16
                   : rtcGetDeviceProperty(state->device, RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED) ? 8
                                                                                                    : 4;
    RTCGeometry geometry = rtcNewGeometry(state->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    const df_mc_model *model = &state->model;
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, model->positions, 0,
                               3 * sizeof(float), model->vertex_count);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, model->triangles, 0,
                               3 * sizeof(uint32_t), model->triangle_count);
    rtcSetGeometryBuildQuality(geometry, RTC_BUILD_QUALITY_HIGH);
    rtcCommitGeometry(geometry);
    state->rtc_scene = rtcNewScene(state->device);
    rtcSetSceneBuildQuality(state->rtc_scene, RTC_BUILD_QUALITY_HIGH);
    rtcAttachGeometry(state->rtc_scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(state->rtc_scene);
    const enum RTCError error = rtcGetDeviceError(state->device);
    if (error == RTC_ERROR_OUT_OF_MEMORY)
        return df_fail(err, DF_ERROR_MEMORY, "--tracer mc-embree: no memory for the tree over %u triangles",
                       model->triangle_count);
    if (error != RTC_ERROR_NONE)
        return df_fail(err, DF_ERROR_UNSUPPORTED, "--tracer mc-embree: Embree fails with error %d", (int)error);
    return DF_OK;
}

static df_status embree_prepare(const df_scene *scene, const df_trace_options *options, void **out, df_error *err) {
    embree_state *state;
    *out = NULL;
    df_status status = df_alloc((void **)&state, 1, sizeof *state, "tracer", err);
    if (status != DF_OK) return status;
    state->scene = scene;
    status = df_mc_model_make(scene, options->threads, &state->model, err);
    if (status == DF_OK) status = build(state, options->threads, err);
    if (status != DF_OK) {
        embree_release(state);
        return status;
    }
    *out = state;
    return DF_OK;
}

static uint64_t embree_bytes(const void *opaque) {
    const embree_state *state = opaque;
    return df_mc_model_bytes(&state->model) + (uint64_t)atomic_load(&((embree_state *)state)->bytes);
}

static double embree_extract_ms(const void *opaque) { return ((const embree_state *)opaque)->model.extract_ms; }

/* A packet as arrays, whatever its width. */
typedef struct packet {
    _Alignas(64) int valid[16];
    uint32_t ray[16];
    struct RTCRayHit16 hit;
} packet;

static void intersect(const embree_state *state, packet *p) {
    struct RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    if (state->lanes == 16) {
        rtcIntersect16(p->valid, state->rtc_scene, &context, &p->hit);
        return;
    }
    /* Narrower packets: every array of RTCRayHit16 in pieces. */
    enum { ARRAYS = sizeof(struct RTCRayHit16) / (16 * sizeof(float)) };
    for (uint32_t first = 0; first < 16; first += state->lanes) {
        _Alignas(64) float narrow[ARRAYS * 8];
        for (uint32_t i = 0; i < ARRAYS; i++)
            memcpy(narrow + i * state->lanes, (float *)&p->hit + 16 * i + first, state->lanes * sizeof(float));
        if (state->lanes == 8)
            rtcIntersect8(p->valid + first, state->rtc_scene, &context, (struct RTCRayHit8 *)(void *)narrow);
        else rtcIntersect4(p->valid + first, state->rtc_scene, &context, (struct RTCRayHit4 *)(void *)narrow);
        for (uint32_t i = 0; i < ARRAYS; i++)
            memcpy((float *)&p->hit + 16 * i + first, narrow + i * state->lanes, state->lanes * sizeof(float));
    }
}

static void load_packet(const df_tile *tile, uint32_t x, uint32_t y, packet *p) {
    const df_rays *rays = &tile->rays;
    for (uint32_t i = 0; i < 16; i++) {
        const uint32_t column = x + i % 4, row = y + i / 4;
        const bool valid = column < tile->width && row < tile->height;
        const uint32_t ray = valid ? column + tile->width * row : y * tile->width + x,
                       from = rays->shared_origin ? 0 : ray;
        p->valid[i] = valid ? -1 : 0;
        p->ray[i] = ray;
        p->hit.ray.org_x[i] = rays->origin[0][from];
        p->hit.ray.org_y[i] = rays->origin[1][from];
        p->hit.ray.org_z[i] = rays->origin[2][from];
        p->hit.ray.dir_x[i] = rays->direction[0][ray];
        p->hit.ray.dir_y[i] = rays->direction[1][ray];
        p->hit.ray.dir_z[i] = rays->direction[2][ray];
        p->hit.ray.tnear[i] = 0;
        p->hit.ray.tfar[i] = INFINITY;
        p->hit.ray.time[i] = 0;
        p->hit.ray.mask[i] = 0xFFFFFFFFu;
        p->hit.ray.flags[i] = 0;
        p->hit.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
        p->hit.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
    }
}

static void store_hit(const embree_state *state, const df_tile *tile, const packet *p, uint32_t i, df_hits *hits) {
    const df_rays *rays = &tile->rays;
    const df_mc_model *model = &state->model;
    const uint32_t *v = model->triangles + 3 * (size_t)p->hit.hit.primID[i], ray = p->ray[i];
    const float u = p->hit.hit.u[i], w = p->hit.hit.v[i];
    float normal[3];
    for (int a = 0; a < 3; a++) {
        normal[a] = (1 - u - w) * model->normals[3 * (size_t)v[0] + (size_t)a] +
                    u * model->normals[3 * (size_t)v[1] + (size_t)a] + w * model->normals[3 * (size_t)v[2] + (size_t)a];
    }
    const float away = p->hit.hit.Ng_x[i] * rays->direction[0][ray] + p->hit.hit.Ng_y[i] * rays->direction[1][ray] +
                       p->hit.hit.Ng_z[i] * rays->direction[2][ray];
    df_mc_model_hit(state->scene, rays, ray, p->hit.ray.tfar[i], normal, away > 0, hits);
}

static df_status embree_trace(void *opaque, uint32_t thread, const df_tile *tile, df_hits *hits, df_counters *counters,
                              df_error *err) {
    (void)thread;
    (void)counters;
    (void)err;
    const embree_state *state = opaque;
    hits->has_normals = true;
    for (uint32_t y = 0; y < tile->height; y += 4) {
        for (uint32_t x = 0; x < tile->width; x += 4) {
            packet p;
            load_packet(tile, x, y, &p);
            intersect(state, &p);
            for (uint32_t i = 0; i < 16; i++) {
                if (p.valid[i] && p.hit.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID) store_hit(state, tile, &p, i, hits);
            }
        }
    }
    return DF_OK;
}

const df_tracer df_tracer_mc_embree = {
    .name = "mc-embree",
    .own_methods = true,
    .summary = "the marching-cubes mesh, ray traced by Embree: for comparison",
    .prepare = embree_prepare,
    .release = embree_release,
    .bytes = embree_bytes,
    .extract_ms = embree_extract_ms,
    .trace = embree_trace,
};
