# The laboratory: truths, and what is measured against them.
add_subdirectory(lab)
pkg_check_modules(LAB_MPFR REQUIRED IMPORTED_TARGET mpfr)

df_test(test_truth LABELS unit LIBS distfield-lab PkgConfig::LAB_MPFR SOURCES fields.c)
