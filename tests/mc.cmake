# The tests of marching cubes.
df_test(test_mc_mesh LABELS unit LIBS distfield-render SOURCES fields.c mesh_check.c)
