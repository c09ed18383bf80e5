/*
 * What C and OpenCL C (with DF_OPENCL defined) call differently, for texts that compile as both.
 */
#ifndef DF_DIALECT_H
#define DF_DIALECT_H

#ifdef DF_OPENCL
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#pragma OPENCL FP_CONTRACT OFF
typedef char int8_t;
typedef uchar uint8_t;
typedef ushort uint16_t;
typedef int int32_t;
typedef uint uint32_t;
typedef long int64_t;
typedef ulong uint64_t;
#define floorf floor
#define DF_GLOBAL __global                              /* the memory of fields and rays */
#define DF_TABLE const                                  /* constants within a function */
#define DF_INLINE inline __attribute__((always_inline)) /* a call would keep the walk's state in memory */
#define df_bit_count(word) popcount((uint)(word))
#define df_leading_zeros(word) clz((uint)(word)) /* of a word that is not 0 */
#else
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#define DF_GLOBAL
#define DF_TABLE static const
#define DF_INLINE inline
#define df_leading_zeros(word) ((uint32_t)__builtin_clz(word))

/* __builtin_popcount is a call where the compiler may not use the processor's instruction. */
static inline uint32_t df_bit_count(uint32_t word) {
#ifdef __POPCNT__
    return (uint32_t)__builtin_popcount(word);
#else
    word -= word >> 1 & 0x55555555u;
    word = (word & 0x33333333u) + (word >> 2 & 0x33333333u);
    return ((word + (word >> 4)) & 0x0F0F0F0Fu) * 0x01010101u >> 24;
#endif
}
#endif

#endif
