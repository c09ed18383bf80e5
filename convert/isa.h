/* DF_FOR_EACH_ISA before a function builds it for each width of vectors and picks the widest that the machine has when
 * the program starts. The arithmetic, and so every bit of the result, is the same in all. Sanitizers and clang cannot
 * build functions for several targets. */
#ifndef DF_ISA_H
#define DF_ISA_H

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(DF_SANITIZED)
#define DF_FOR_EACH_ISA __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define DF_FOR_EACH_ISA
#endif

#endif
