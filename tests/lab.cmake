# The laboratory: truths, and what is measured against them.
add_subdirectory(lab)
pkg_check_modules(LAB_MPFR REQUIRED IMPORTED_TARGET mpfr)

df_test(test_truth LABELS unit LIBS distfield-lab PkgConfig::LAB_MPFR SOURCES fields.c)
df_test(test_lab LABELS stability LIBS distfield-lab SOURCES fields.c)
df_test(test_stability_cells LABELS stability LIBS distfield-lab SOURCES fields.c tracing.c)
df_test(test_stability_fields LABELS stability LIBS distfield-lab SOURCES fields.c tracing.c)
df_script_test(test_df_lab LABELS unit)
df_test(test_pictures LABELS stability LIBS distfield-lab SOURCES fields.c)
df_test(test_quality LABELS stability LIBS distfield-lab SOURCES fields.c)
df_test(test_mesh_truth LABELS stability LIBS distfield-lab SOURCES fields.c)
df_test(test_octree LABELS stability LIBS distfield-lab SOURCES fields.c)
df_test(test_escapes LABELS stability LIBS distfield-lab SOURCES fields.c)
