# Triangle meshes of fields, and pictures of them.
target_sources(distfield-render PRIVATE export.c marching_cubes.c mc_cell.c mc_octree.c mesh_file.c)
