#include "render/settings.h"
#include "common/options.h"
#include "render/methods/gradient.h"
#include "render/methods/solve_methods.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define DEGREE (M_PI / 180)

void df_settings_defaults(df_settings *settings) {
    memset(settings, 0, sizeof *settings);
    settings->width = 1280;
    settings->height = 1024;
    settings->solve = DF_SOLVE_ROBUST;
    settings->gradient = DF_GRADIENT_CORNER_CENTRAL;
    settings->orbit[0] = 30;
    settings->orbit[1] = 20;
    settings->orbit[2] = 1.6;
    settings->fov = 1 / DEGREE;
    settings->camera.up[1] = 1;
}

static df_status set_tracer(df_settings *settings, const char *value, df_error *err) {
    char names[512] = "";
    settings->tracer = df_tracer_find(value);
    if (settings->tracer || strcmp(value, "auto") == 0) return DF_OK;
    if (strcmp(value, "mc-embree") == 0 || strcmp(value, "mc-raster") == 0)
        return df_fail(err, DF_ERROR_USAGE, "--tracer %s: built without %s", value,
                       value[3] == 'e' ? "Embree" : "OpenGL and EGL");
    for (int list = 0; list < 2; list++) {
        for (const df_tracer *const *tracer = list ? df_mc_tracers : df_tracers; *tracer; tracer++) {
            snprintf(names + strlen(names), sizeof names - strlen(names), ", %s", (*tracer)->name);
        }
    }
    return df_fail(err, DF_ERROR_USAGE, "--tracer %s: expected one of auto%s", value, names);
}

static df_status set_camera(df_settings *s, const char *name, const char *value, bool *known, df_error *err) {
    if (strcmp(name, "orbit") == 0) {
        s->has_orbit = true;
        df_status status = df_parse_doubles("--orbit", value, 3, s->orbit, err);
        if (status == DF_OK && fabs(s->orbit[1]) > 90) {
            return df_fail(err, DF_ERROR_USAGE, "--orbit %s: the elevation must lie between -90 and 90 degrees", value);
        }
        return status;
    }
    if (strcmp(name, "eye") == 0) {
        s->has_eye = true;
        return df_parse_doubles("--eye", value, 3, s->camera.eye, err);
    }
    if (strcmp(name, "look-at") == 0) {
        s->has_look_at = true;
        return df_parse_doubles("--look-at", value, 3, s->camera.look_at, err);
    }
    if (strcmp(name, "up") == 0) {
        s->has_up = true;
        return df_parse_doubles("--up", value, 3, s->camera.up, err);
    }
    if (strcmp(name, "fov") == 0) return df_parse_double("--fov", value, 0.001, 179, &s->fov, err);
    *known = false;
    return DF_OK;
}

df_status df_settings_set(df_settings *s, const char *name, const char *value, bool *known, df_error *err) {
    uint32_t number;
    df_status status;
    *known = true;
    if (strcmp(name, "size") == 0) return df_parse_size("--size", value, &s->width, &s->height, err);
    if (strcmp(name, "iso") == 0) return df_parse_double("--iso", value, -3e38, 3e38, &s->iso, err);
    if (strcmp(name, "levels") == 0) return df_parse_u32("--levels", value, 1, 2, &s->scene.levels, err);
    if (strcmp(name, "coarse") == 0) {
        status = df_parse_u32("--coarse", value, 4, 8, &s->scene.coarse, err);
        if (status == DF_OK && s->scene.coarse != 4 && s->scene.coarse != 8) {
            return df_fail(err, DF_ERROR_USAGE, "--coarse %s: expected 4 or 8", value);
        }
        return status;
    }
    if (strcmp(name, "packet") == 0) {
        status = df_parse_u32("--packet", value, 1, DF_CGT_PACKET_MAX, &s->walk.packet, err);
        if (status == DF_OK && (s->walk.packet & (s->walk.packet - 1)))
            return df_fail(err, DF_ERROR_USAGE, "--packet %s: expected a power of two", value);
        return status;
    }
    if (strcmp(name, "clip") == 0) {
        static const char *const choices[] = {"on", "off", NULL};
        status = df_parse_name("--clip", value, choices, &number, err);
        if (status == DF_OK) s->walk.no_clip = number == 1;
        return status;
    }
    if (strcmp(name, "filter") == 0) {
        status = df_parse_name("--filter", value, df_filter_names, &number, err);
        if (status == DF_OK) s->filter = (int)number;
        return status;
    }
    if (strcmp(name, "lod") == 0) return df_parse_double("--lod", value, 0, 1000, &s->walk.lod, err);
    if (strcmp(name, "split") == 0) return df_parse_u32("--split", value, 0, 15, &s->walk.split, err);
    if (strcmp(name, "bounds") == 0) {
        status = df_parse_name("--bounds", value, df_bounds_names, &number, err);
        if (status == DF_OK) s->walk.bounds = (int)number;
        return status;
    }
    if (strcmp(name, "tracer") == 0) return set_tracer(s, value, err);
    if (strcmp(name, "quality") == 0) {
        static const char *const names[] = {"full", "auto", NULL};
        status = df_parse_name("--quality", value, names, &number, err);
        if (status == DF_OK) s->quality_auto = number == 1;
        return status;
    }
    if (strcmp(name, "intersect") == 0 || strcmp(name, "steps") == 0 || strcmp(name, "precision") == 0)
        s->has_solve = true;
    if (strcmp(name, "gradient") == 0) s->has_gradient = true;
    if (strcmp(name, "intersect") == 0) {
        status = df_parse_name("--intersect", value, df_solve_names, &number, err);
        if (status == DF_OK) s->solve = (int)number;
        return status;
    }
    if (strcmp(name, "steps") == 0) {
        status = df_parse_u32("--steps", value, 1, 100, &number, err);
        if (status == DF_OK) s->steps = (int)number;
        return status;
    }
    if (strcmp(name, "precision") == 0) {
        status = df_parse_name("--precision", value, df_precision_names, &number, err);
        if (status == DF_OK) s->precision = (int)number;
        return status;
    }
    if (strcmp(name, "gradient") == 0) {
        status = df_parse_name("--gradient", value, df_gradient_names, &number, err);
        if (status == DF_OK) s->gradient = (int)number;
        return status;
    }
    return set_camera(s, name, value, known, err);
}

df_status df_settings_camera(const df_settings *s, const df_field *field, df_camera *camera, df_error *err) {
    const bool has_methods = s->has_solve || s->has_gradient;
    if (s->quality_auto && has_methods) {
        return df_fail(err, DF_ERROR_USAGE,
                       "--quality auto chooses the methods: it cannot go with --intersect, --steps, --precision or "
                       "--gradient");
    }
    if (s->filter && (s->tracer || has_methods || s->quality_auto || s->walk.bounds)) {
        return df_fail(err, DF_ERROR_USAGE,
                       "--filter %s has a tracer, a solve and a gradient of its own: it cannot go with --tracer, "
                       "--intersect, --steps, --precision, --gradient, --quality or --bounds",
                       df_filter_names[s->filter]);
    }
    if ((s->walk.packet || s->walk.no_clip) && s->tracer != &df_tracer_cgt)
        return df_fail(err, DF_ERROR_USAGE, "--packet and --clip are about packets of cgt: they need --tracer cgt");
    if (s->walk.lod > 0 && field->kind != DF_FIELD_ADF)
        return df_fail(err, DF_ERROR_USAGE, "--lod %g: only octrees (--structure adf) have levels of detail",
                       s->walk.lod);
    if (s->walk.split && s->tracer != &df_tracer_packet)
        return df_fail(err, DF_ERROR_USAGE, "--split is about packets of dda-packet: it needs --tracer dda-packet");
    if (s->tracer && s->tracer->own_methods && has_methods) {
        return df_fail(err, DF_ERROR_USAGE,
                       "--tracer %s draws a mesh, which has its own hits and normals: it cannot go with --intersect, "
                       "--steps, --precision or --gradient",
                       s->tracer->name);
    }
    if (s->steps && df_solve_steps(s->solve) == 0) {
        return df_fail(err, DF_ERROR_USAGE, "--steps: --intersect %s has no steps", df_solve_names[s->solve]);
    }
    if (s->precision == DF_PRECISION_F32 && s->solve == DF_SOLVE_ANALYTIC) {
        return df_fail(
            err, DF_ERROR_USAGE,
            "--precision f32: --intersect analytic is in double only: in float the closed form is up to half a "
            "voxel off where the cubic term nearly vanishes");
    }
    if (s->has_orbit && (s->has_eye || s->has_look_at || s->has_up)) {
        return df_fail(err, DF_ERROR_USAGE, "--orbit places the camera: it cannot go with --eye, --look-at or --up");
    }
    df_camera_orbit(field, s->orbit[0], s->orbit[1], s->orbit[2], camera);
    camera->fov_y = s->fov * DEGREE;
    if (s->has_orbit) return DF_OK;
    if (s->has_eye) {
        memcpy(camera->eye, s->camera.eye, sizeof camera->eye);
        memcpy(camera->up, s->camera.up, sizeof camera->up);
    }
    if (s->has_up) memcpy(camera->up, s->camera.up, sizeof camera->up);
    if (s->has_look_at) memcpy(camera->look_at, s->camera.look_at, sizeof camera->look_at);
    return DF_OK;
}

char *df_settings_text(const df_settings *s, const df_camera *c) {
    char *text = NULL;
    size_t size;
    FILE *stream = open_memstream(&text, &size);
    if (!stream) return NULL;
    fprintf(stream, "size=%ux%u\niso=%.17g\ntracer=%s\n", s->width, s->height, s->iso,
            s->tracer ? s->tracer->name : "auto");
    if (s->filter) fprintf(stream, "filter=%s\n", df_filter_names[s->filter]);
    if (!s->filter && !(s->tracer && s->tracer->own_methods))
        fprintf(stream, "intersect=%s\ngradient=%s\n", df_solve_names[s->solve], df_gradient_names[s->gradient]);
    if (s->precision) fprintf(stream, "precision=%s\n", df_precision_names[s->precision]);
    if (s->steps) fprintf(stream, "steps=%d\n", s->steps);
    if (s->scene.levels) fprintf(stream, "levels=%u\n", s->scene.levels);
    if (s->walk.packet) fprintf(stream, "packet=%u\n", s->walk.packet);
    if (s->walk.lod > 0) fprintf(stream, "lod=%.17g\n", s->walk.lod);
    if (s->walk.split) fprintf(stream, "split=%u\n", s->walk.split);
    if (s->walk.bounds) fprintf(stream, "bounds=%s\n", df_bounds_names[s->walk.bounds]);
    if (s->walk.no_clip) fprintf(stream, "clip=off\n");
    if (s->scene.coarse) fprintf(stream, "coarse=%u\n", s->scene.coarse);
    fprintf(stream, "eye=%.17g,%.17g,%.17g\nlook-at=%.17g,%.17g,%.17g\nup=%.17g,%.17g,%.17g\nfov=%.17g", c->eye[0],
            c->eye[1], c->eye[2], c->look_at[0], c->look_at[1], c->look_at[2], c->up[0], c->up[1], c->up[2], s->fov);
    if (fclose(stream) != 0) {
        free(text);
        return NULL;
    }
    return text;
}

df_status df_settings_parse(df_settings *settings, const char *text, const char *name, df_error *err) {
    char *copy = strdup(text), *rest = copy;
    if (!copy) return df_fail(err, DF_ERROR_MEMORY, "%s: out of memory", name);
    df_status status = DF_OK;
    for (char *line; status == DF_OK && (line = strsep(&rest, "\n"));) {
        char *value = strchr(line, '=');
        bool known = false;
        if (value) {
            *value++ = 0;
            status = df_settings_set(settings, line, value, &known, err);
        }
        if (status == DF_OK && !known) status = df_fail(err, DF_ERROR_FORMAT, "%s: unknown setting '%s'", name, line);
    }
    free(copy);
    return status;
}
