/* The commands of df-lab; argv holds what follows the command's name. */
#ifndef DF_TESTS_COMMANDS_H
#define DF_TESTS_COMMANDS_H

#include "common/status.h"

df_status lab_command_measure(int argc, char **argv, df_error *err);
df_status lab_command_count(int argc, char **argv, df_error *err);
df_status lab_command_escape(int argc, char **argv, df_error *err);
df_status lab_command_judge(int argc, char **argv, df_error *err);
df_status lab_command_field(int argc, char **argv, df_error *err);
df_status lab_command_maps(int argc, char **argv, df_error *err);
df_status lab_command_depth(int argc, char **argv, df_error *err);

#endif
