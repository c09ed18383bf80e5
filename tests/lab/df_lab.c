/*
 * df-lab: measures every method of the renderer against the truth. Built with the tests; not installed.
 *
 *   df-lab measure FILE.csv [--quick] [--uncounted] [FIELD...] [--choices FIELD...]
 *       measures what is not yet in FILE.csv; FIELD: a shape's name, "shapes" for all (the default), a .dfield file, or
 *       FIELD.dfield:MESH.obj with the mesh that it was made from; --uncounted: counts no instructions; of fields after
 *       --choices only what --quality auto chooses and might have chosen, and shapes are made at 45 voxels
 *
 *   df-lab count --quick|--full (FIELD SIZE all|choices)...
 *       draws once what measure times: it starts this under callgrind to count instructions
 *   df-lab escape [--table FILE.csv] [RAYS [TRACER [STRUCTURE]]]
 *       rays from inside closed fields of each structure, with every tracer (or TRACER on STRUCTURE): none may escape;
 *       those without a hit are printed, tangents apart; runs without an escape go to FILE.csv and are not made again
 *   df-lab judge FIELD [RAYS [TRACER [ISA]]]
 *       the default method against the trilinear field's truth: rays of several families (1e6 in all) and pictures from
 *       outside and inside, by every tracer that takes them (or TRACER) on every instruction set (or ISA), as CSV;
 *       fails where a ray outside the tangent band is wrong
 *   df-lab filters [FIELD.dfield:MESH.obj...]
 *       depth and normal errors by reconstruction filter
 *   df-lab field SHAPE SIZE FILE.dfield [PARAMETER]
 *       writes a field of the laboratory
 *   df-lab maps SHAPE SIZE NAME [PARAMETER]
 *       pictures of the depth error of each solve, NAME-SOLVE-error.png
 *   df-lab depth FIELD.dfield MESH.obj WIDTH HEIGHT FILE.pfm
 *       the depths of the mesh itself, as df-render --depth has them of its field, seen by its default camera
 */
#include "commands.h"
#include "common/output_file.h"
#include "filters.h"

#include <stdio.h>
#include <string.h>

int main(int argc, char **argv) {
    static const struct {
        const char *name, *usage;
        int least;
        df_status (*run)(int argc, char **argv, df_error *err);
    } commands[] = {
        {"measure", "FILE.csv [--quick] [--uncounted] [FIELD...] [--choices FIELD...]", 1, lab_command_measure},
        {"count", "--quick|--full (FIELD SIZE all|choices)...", 4, lab_command_count},
        {"escape", "[--table FILE.csv] [RAYS [TRACER [STRUCTURE]]]", 0, lab_command_escape},
        {"judge", "FIELD [RAYS [TRACER [ISA]]]", 1, lab_command_judge},
        {"filters", "[FIELD.dfield:MESH.obj...]", 0, lab_command_filters},
        {"field", "SHAPE SIZE FILE.dfield [PARAMETER]", 3, lab_command_field},
        {"maps", "SHAPE SIZE NAME [PARAMETER]", 3, lab_command_maps},
        {"depth", "FIELD.dfield MESH.obj WIDTH HEIGHT FILE.pfm", 5, lab_command_depth}};
    const int command_count = sizeof commands / sizeof commands[0];
    df_output_watch_standard("df-lab");
    df_error err = {0};
    for (int i = 0; i < command_count; i++) {
        if (argc < 2 || strcmp(argv[1], commands[i].name) != 0) continue;
        if (argc - 2 < commands[i].least) break;
        df_status status = commands[i].run(argc - 2, argv + 2, &err);
        if (status != DF_OK) fprintf(stderr, "df-lab: %s\n", err.text);
        return df_exit_code(status);
    }
    fprintf(stderr, "usage:\n");
    for (int i = 0; i < command_count; i++) fprintf(stderr, "  df-lab %s %s\n", commands[i].name, commands[i].usage);
    return 2;
}
