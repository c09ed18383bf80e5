# The tests of marching cubes.
find_package(CGAL REQUIRED)
df_test(test_mc_mesh LABELS unit LIBS distfield-render CGAL::CGAL SOURCES fields.c mesh_check.c mesh_judge.cpp)
set_source_files_properties(mesh_judge.cpp PROPERTIES COMPILE_OPTIONS "-Wno-shadow") # CGAL's headers
add_test(NAME test_mc_mesh_full COMMAND test_mc_mesh full)
set_tests_properties(test_mc_mesh_full PROPERTIES LABELS slow TIMEOUT 1200 ENVIRONMENT OMP_WAIT_POLICY=passive)
df_script_test(test_mc_2048 LABELS slow)
set_tests_properties(test_mc_2048 PROPERTIES TIMEOUT 1200)
df_script_test(test_export_mesh LABELS unit)
df_script_test(test_mc_tracers LABELS unit)
df_script_test(test_bounds_gl LABELS unit)
df_script_test(test_compare LABELS unit)
df_script_test(test_compare_page LABELS unit)
df_script_test(test_without_meshes LABELS unit)
