/*
 * Lanes: DF_LANES numbers that go through the same arithmetic, and nothing else about the machine.
 *
 * With DF_LANES = 1 a lane type is the plain scalar; this is the specification, and it compiles as C and (with
 * DF_OPENCL defined) as OpenCL C. Every operation here and the operators + - * / are IEEE operations that give the same
 * bits in every width. min and max are "a < b ? a : b" and "a > b ? a : b", as in the SSE instructions.
 *
 *   lf, lm    DF_LANES floats and the masks of their comparisons
 *   li        DF_LANES 32-bit integers
 *   ld, ldm   DF_DOUBLE_LANES doubles and the masks of their comparisons: half as many in SIMD, ld_part takes the
 *             lower (0) or the upper (1) half of an lf
 *
 * lf_load_8 takes 8 floats of every lane from an address of its own: out[c] holds number c of all. lf_load_pairs takes
 * them in pairs, two rows and two slices of a cell: from 0, row, slice and row + slice after the address.
 * li_load_4 takes 4 ints of every lane, as lf_load_8 its floats. lf_load_square takes DF_SQUARE_WIDTH floats from each
 * of as many rows as make DF_LANES, `stride` apart. lf_compress and li_compress store the lanes of a mask side by side
 * and may write up to DF_LANES entries. li_tally adds 1 to the lanes of a mask. li_lookup takes entries of a table of
 * 16 that all lanes share. lm_bits has lane 0 in bit 0.
 *
 * The wide types exist for SSE4.1 (4), AVX2 (8) and AVX-512 (16); the compiler's flags must allow them. In C only.
 */
#ifndef DF_LANE_H
#define DF_LANE_H

#include "common/dialect.h"

#ifndef DF_OPENCL
#include <string.h>
#endif

#ifndef DF_LANES
#define DF_LANES 1
#endif

/* The lanes as a block of pixels: how many are side by side. */
#define DF_SQUARE_WIDTH (DF_LANES >= 8 ? 4 : DF_LANES == 4 ? 2 : 1)

#if DF_LANES > 1
#include <immintrin.h>

/* Two floats each from two places. */
static inline __m128 lf_two_pairs(const float *a, const float *b) {
    const __m128i low = _mm_loadl_epi64((const __m128i *)(const void *)a); /* wherever floats lie, unlike _mm_load_sd */
    return _mm_loadh_pi(_mm_castsi128_ps(low), (const __m64 *)(const void *)b);
}

/* The words of four lanes, transposed. */
static inline void li_load_four(const void *const from[4], __m128i out[4]) {
    __m128 row[4];
    for (int i = 0; i < 4; i++) row[i] = _mm_castsi128_ps(_mm_loadu_si128((const __m128i *)from[i]));
    _MM_TRANSPOSE4_PS(row[0], row[1], row[2], row[3]);
    for (int i = 0; i < 4; i++) out[i] = _mm_castps_si128(row[i]);
}
#endif

#if DF_LANES == 4 || DF_LANES == 8
/* The numbers of which `bits` tells, side by side, first; the others are whatever. */
static inline __m128i li_pack_four(__m128i a, uint32_t bits) {
#define DF_FOUR(n) 0x03020100 + 0x04040404 * n /* the bytes of number n */
    static const uint32_t bytes[16][4] = {{DF_FOUR(0)},
                                          {DF_FOUR(0)},
                                          {DF_FOUR(1)},
                                          {DF_FOUR(0), DF_FOUR(1)},
                                          {DF_FOUR(2)},
                                          {DF_FOUR(0), DF_FOUR(2)},
                                          {DF_FOUR(1), DF_FOUR(2)},
                                          {DF_FOUR(0), DF_FOUR(1), DF_FOUR(2)},
                                          {DF_FOUR(3)},
                                          {DF_FOUR(0), DF_FOUR(3)},
                                          {DF_FOUR(1), DF_FOUR(3)},
                                          {DF_FOUR(0), DF_FOUR(1), DF_FOUR(3)},
                                          {DF_FOUR(2), DF_FOUR(3)},
                                          {DF_FOUR(0), DF_FOUR(2), DF_FOUR(3)},
                                          {DF_FOUR(1), DF_FOUR(2), DF_FOUR(3)},
                                          {DF_FOUR(0), DF_FOUR(1), DF_FOUR(2), DF_FOUR(3)}};
#undef DF_FOUR
    return _mm_shuffle_epi8(a, _mm_loadu_si128((const __m128i *)(const void *)bytes[bits]));
}
#endif

#if DF_LANES == 1

typedef float lf;
typedef int lm; /* 0 or 1 */

static inline lf lf_set(float a) { return a; }
static inline lf lf_min(lf a, lf b) { return a < b ? a : b; }
static inline lf lf_max(lf a, lf b) { return a > b ? a : b; }
static inline lm lf_lt(lf a, lf b) { return a < b; }
static inline lm lf_le(lf a, lf b) { return a <= b; }
static inline lf lf_select(lm m, lf a, lf b) { return m ? a : b; }
static inline lm lf_eq(lf a, lf b) { return a == b; }
static inline lf lf_masked(lm m, lf a) { return m ? a : 0; }
static inline lm lm_and(lm a, lm b) { return a & b; }
static inline lm lm_or(lm a, lm b) { return a | b; }
static inline lm lm_xor(lm a, lm b) { return a ^ b; }
static inline lm lm_not(lm a) { return !a; }
static inline lm lm_andnot(lm a, lm b) { return a & !b; }
static inline int lm_any(lm a) { return a; }
#ifdef DF_OPENCL
static inline lf lf_sqrt(lf a) { return sqrt(a); }
static inline lf lf_abs(lf a) { return fabs(a); }
#else
static inline lf lf_sqrt(lf a) { return sqrtf(a); }
static inline lf lf_abs(lf a) { return fabsf(a); }
#endif

#ifndef DF_NO_DOUBLE
typedef double ld;
typedef int ldm;

static inline ld ld_set(double a) { return a; }
static inline ld ld_min(ld a, ld b) { return a < b ? a : b; }
static inline ld ld_max(ld a, ld b) { return a > b ? a : b; }
static inline ldm ld_lt(ld a, ld b) { return a < b; }
static inline ldm ld_le(ld a, ld b) { return a <= b; }
static inline ld ld_select(ldm m, ld a, ld b) { return m ? a : b; }
static inline ldm ldm_and(ldm a, ldm b) { return a & b; }
static inline ldm ldm_or(ldm a, ldm b) { return a | b; }
static inline ldm ldm_xor(ldm a, ldm b) { return a ^ b; }
static inline ldm ldm_not(ldm a) { return !a; }
static inline int ldm_any(ldm a) { return a; }
static inline ld ld_sqrt(ld a) { return sqrt(a); }
static inline ld ld_abs(ld a) { return fabs(a); }
#endif

#ifndef DF_OPENCL
typedef int32_t li;

static inline lf lf_load(const float *p) { return *p; }
static inline void lf_store(float *p, lf a) { *p = a; }
static inline lf lf_floor(lf a) { return floorf(a); }
static inline uint32_t lm_bits(lm a) { return (uint32_t)a; }
static inline li li_set(int32_t a) { return a; }
static inline li li_load(const int32_t *p) { return *p; }
static inline void li_store(int32_t *p, li a) { *p = a; }
static inline li li_add(li a, li b) { return a + b; }
static inline li li_mul(li a, li b) { return a * b; }
static inline li li_and(li a, li b) { return a & b; }
static inline li li_shift_right(li a, int bits) { return (li)((uint32_t)a >> bits); }
static inline li li_from_lf(lf a) { return (li)a; }
static inline lf lf_from_li(li a) { return (lf)a; }
static inline li li_load_u16(const uint16_t *p) { return *p; }
static inline void li_store_u16(uint16_t *p, li a) { *p = (uint16_t)a; }
static inline lf lf_gather(const float *base, li index) { return base[index]; }
static inline void lf_compress(float *p, lm m, lf a) {
    if (m) *p = a;
}
static inline void li_compress(int32_t *p, lm m, li a) {
    if (m) *p = a;
}
static inline li li_gather(const int32_t *base, li index) { return base[index]; }
static inline lf lf_load_square(const float *p, size_t stride) {
    (void)stride;
    return *p;
}
static inline void li_load_4(const void *const from[DF_LANES], li out[4]) { memcpy(out, from[0], 4 * sizeof *out); }
static inline void lf_load_8(const float *const from[DF_LANES], lf out[8]) {
    for (int c = 0; c < 8; c++) out[c] = from[0][c];
}
static inline void lf_load_pairs(const float *const from[DF_LANES], size_t row, size_t slice, lf out[8]) {
    for (int c = 0; c < 8; c++) out[c] = from[0][(c & 1) + (c & 2 ? row : 0) + (c & 4 ? slice : 0)];
}
static inline li li_tally(li sum, lm m) { return sum + m; }
static inline li li_lookup(const int32_t table[16], li index) { return table[index]; }
static inline li li_select(lm m, li a, li b) { return m ? a : b; }
static inline li li_masked(lm m, li a) { return m ? a : 0; }
static inline lm li_lt(li a, li b) { return a < b; }
static inline lm li_bit(li word, li bit) { return (int)((uint32_t)word >> bit & 1); }
static inline lm lm_first(uint32_t n) { return n > 0; }
static inline ld ld_load(const double *p) { return *p; }
static inline ld ld_load_f32(const float *p) { return (double)*p; }
static inline ld ld_part(lf a, int part) {
    (void)part;
    return (double)a;
}
static inline void ld_store(double *p, ld a) { *p = a; }
static inline void ld_store_f32(float *p, ld a) { *p = (float)a; }
static inline lf lf_from_ld(const ld part[1]) { return (float)part[0]; }
#endif

#elif DF_LANES == 4

typedef __m128 lf, lm;
typedef __m128i li;
typedef __m128d ld, ldm;

static inline lf lf_set(float a) { return _mm_set1_ps(a); }
static inline lf lf_load(const float *p) { return _mm_loadu_ps(p); }
static inline void lf_store(float *p, lf a) { _mm_storeu_ps(p, a); }
static inline lf lf_min(lf a, lf b) { return _mm_min_ps(a, b); }
static inline lf lf_max(lf a, lf b) { return _mm_max_ps(a, b); }
static inline lm lf_lt(lf a, lf b) { return _mm_cmplt_ps(a, b); }
static inline lm lf_le(lf a, lf b) { return _mm_cmple_ps(a, b); }
static inline lf lf_select(lm m, lf a, lf b) { return _mm_blendv_ps(b, a, m); }
static inline lm lf_eq(lf a, lf b) { return _mm_cmpeq_ps(a, b); }
static inline lf lf_masked(lm m, lf a) { return _mm_and_ps(m, a); }
static inline lf lf_sqrt(lf a) { return _mm_sqrt_ps(a); }
static inline lf lf_abs(lf a) { return _mm_andnot_ps(_mm_set1_ps(-0.0f), a); }
static inline lf lf_floor(lf a) { return _mm_floor_ps(a); }
static inline lm lm_and(lm a, lm b) { return _mm_and_ps(a, b); }
static inline lm lm_or(lm a, lm b) { return _mm_or_ps(a, b); }
static inline lm lm_xor(lm a, lm b) { return _mm_xor_ps(a, b); }
static inline lm lm_not(lm a) { return _mm_xor_ps(a, _mm_castsi128_ps(_mm_set1_epi32(-1))); }
static inline lm lm_andnot(lm a, lm b) { return _mm_andnot_ps(b, a); }
static inline uint32_t lm_bits(lm a) { return (uint32_t)_mm_movemask_ps(a); }
static inline int lm_any(lm a) { return _mm_movemask_ps(a) != 0; }
static inline li li_set(int32_t a) { return _mm_set1_epi32(a); }
static inline li li_load(const int32_t *p) { return _mm_loadu_si128((const __m128i *)p); }
static inline void li_store(int32_t *p, li a) { _mm_storeu_si128((__m128i *)p, a); }
static inline li li_add(li a, li b) { return _mm_add_epi32(a, b); }
static inline li li_mul(li a, li b) { return _mm_mullo_epi32(a, b); }
static inline li li_and(li a, li b) { return _mm_and_si128(a, b); }
static inline li li_shift_right(li a, int bits) { return _mm_srli_epi32(a, bits); }
static inline li li_from_lf(lf a) { return _mm_cvttps_epi32(a); }
static inline lf lf_from_li(li a) { return _mm_cvtepi32_ps(a); }
static inline li li_load_u16(const uint16_t *p) { return _mm_cvtepu16_epi32(_mm_loadl_epi64((const __m128i *)p)); }
static inline void li_store_u16(uint16_t *p, li a) { _mm_storel_epi64((__m128i *)p, _mm_packus_epi32(a, a)); }
static inline lf lf_gather(const float *base, li index) {
    int32_t i[4];
    li_store(i, index);
    return _mm_setr_ps(base[(uint32_t)i[0]], base[(uint32_t)i[1]], base[(uint32_t)i[2]], base[(uint32_t)i[3]]);
}
static inline void li_compress(int32_t *p, lm m, li a) { li_store(p, li_pack_four(a, lm_bits(m))); }
static inline void lf_compress(float *p, lm m, lf a) {
    lf_store(p, _mm_castsi128_ps(li_pack_four(_mm_castps_si128(a), lm_bits(m))));
}
static inline li li_gather(const int32_t *base, li index) {
    int32_t i[4];
    li_store(i, index);
    return _mm_setr_epi32(base[(uint32_t)i[0]], base[(uint32_t)i[1]], base[(uint32_t)i[2]], base[(uint32_t)i[3]]);
}
static inline lf lf_load_square(const float *p, size_t stride) { return lf_two_pairs(p, p + stride); }
static inline void li_load_4(const void *const from[DF_LANES], li out[4]) { li_load_four(from, out); }
static inline void lf_load_8(const float *const from[DF_LANES], lf out[8]) {
    for (int half = 0; half < 2; half++) {
        lf *four = out + 4 * half;
        for (int i = 0; i < 4; i++) four[i] = _mm_loadu_ps(from[i] + 4 * half);
        _MM_TRANSPOSE4_PS(four[0], four[1], four[2], four[3]);
    }
}
static inline void lf_load_pairs(const float *const from[DF_LANES], size_t row, size_t slice, lf out[8]) {
    for (int half = 0; half < 2; half++) {
        lf *four = out + 4 * half;
        for (int i = 0; i < 4; i++) {
            const float *corner = from[i] + (half ? slice : 0);
            four[i] = lf_two_pairs(corner, corner + row);
        }
        _MM_TRANSPOSE4_PS(four[0], four[1], four[2], four[3]);
    }
}
static inline li li_tally(li sum, lm m) { return _mm_sub_epi32(sum, _mm_castps_si128(m)); }
static inline li li_lookup(const int32_t table[16], li index) { return li_gather(table, index); }
static inline li li_select(lm m, li a, li b) {
    return _mm_castps_si128(_mm_blendv_ps(_mm_castsi128_ps(b), _mm_castsi128_ps(a), m));
}
static inline li li_masked(lm m, li a) { return _mm_and_si128(_mm_castps_si128(m), a); }
static inline lm li_lt(li a, li b) { return _mm_castsi128_ps(_mm_cmplt_epi32(a, b)); }
/* There is no shift by lane: the word times 2^(31 - bit), which a float's exponent makes, has the bit as its sign. 2^31
 * converts to what it should be, by overflow. */
static inline lm li_bit(li word, li bit) {
    const li exponent = _mm_slli_epi32(_mm_sub_epi32(_mm_set1_epi32(127 + 31), bit), 23);
    const li power = _mm_cvttps_epi32(_mm_castsi128_ps(exponent));
    return _mm_castsi128_ps(_mm_srai_epi32(_mm_mullo_epi32(word, power), 31));
}
static inline lm lm_first(uint32_t n) {
    return _mm_castsi128_ps(_mm_cmplt_epi32(_mm_setr_epi32(0, 1, 2, 3), _mm_set1_epi32((int)n)));
}

static inline ld ld_set(double a) { return _mm_set1_pd(a); }
static inline ld ld_load(const double *p) { return _mm_loadu_pd(p); }
static inline ld ld_load_f32(const float *p) {
    return _mm_cvtps_pd(_mm_castsi128_ps(_mm_loadl_epi64((const __m128i *)p)));
}
static inline void ld_store(double *p, ld a) { _mm_storeu_pd(p, a); }
static inline void ld_store_f32(float *p, ld a) { _mm_storel_epi64((__m128i *)p, _mm_castps_si128(_mm_cvtpd_ps(a))); }
static inline lf lf_from_ld(const ld part[2]) { return _mm_movelh_ps(_mm_cvtpd_ps(part[0]), _mm_cvtpd_ps(part[1])); }
static inline ld ld_part(lf a, int part) { return _mm_cvtps_pd(part ? _mm_movehl_ps(a, a) : a); }
static inline ld ld_min(ld a, ld b) { return _mm_min_pd(a, b); }
static inline ld ld_max(ld a, ld b) { return _mm_max_pd(a, b); }
static inline ldm ld_lt(ld a, ld b) { return _mm_cmplt_pd(a, b); }
static inline ldm ld_le(ld a, ld b) { return _mm_cmple_pd(a, b); }
static inline ld ld_select(ldm m, ld a, ld b) { return _mm_blendv_pd(b, a, m); }
static inline ld ld_sqrt(ld a) { return _mm_sqrt_pd(a); }
static inline ld ld_abs(ld a) { return _mm_andnot_pd(_mm_set1_pd(-0.0), a); }
static inline ldm ldm_and(ldm a, ldm b) { return _mm_and_pd(a, b); }
static inline ldm ldm_or(ldm a, ldm b) { return _mm_or_pd(a, b); }
static inline ldm ldm_xor(ldm a, ldm b) { return _mm_xor_pd(a, b); }
static inline ldm ldm_not(ldm a) { return _mm_xor_pd(a, _mm_castsi128_pd(_mm_set1_epi32(-1))); }
static inline int ldm_any(ldm a) { return _mm_movemask_pd(a) != 0; }

#elif DF_LANES == 8

typedef __m256 lf, lm;
typedef __m256i li;
typedef __m256d ld, ldm;

static inline lf lf_set(float a) { return _mm256_set1_ps(a); }
static inline lf lf_load(const float *p) { return _mm256_loadu_ps(p); }
static inline void lf_store(float *p, lf a) { _mm256_storeu_ps(p, a); }
static inline lf lf_min(lf a, lf b) { return _mm256_min_ps(a, b); }
static inline lf lf_max(lf a, lf b) { return _mm256_max_ps(a, b); }
static inline lm lf_lt(lf a, lf b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
static inline lm lf_le(lf a, lf b) { return _mm256_cmp_ps(a, b, _CMP_LE_OQ); }
static inline lf lf_select(lm m, lf a, lf b) { return _mm256_blendv_ps(b, a, m); }
static inline lm lf_eq(lf a, lf b) { return _mm256_cmp_ps(a, b, _CMP_EQ_OQ); }
static inline lf lf_masked(lm m, lf a) { return _mm256_and_ps(m, a); }
static inline lf lf_sqrt(lf a) { return _mm256_sqrt_ps(a); }
static inline lf lf_abs(lf a) { return _mm256_andnot_ps(_mm256_set1_ps(-0.0f), a); }
static inline lf lf_floor(lf a) { return _mm256_floor_ps(a); }
static inline lm lm_and(lm a, lm b) { return _mm256_and_ps(a, b); }
static inline lm lm_or(lm a, lm b) { return _mm256_or_ps(a, b); }
static inline lm lm_xor(lm a, lm b) { return _mm256_xor_ps(a, b); }
static inline lm lm_not(lm a) { return _mm256_xor_ps(a, _mm256_castsi256_ps(_mm256_set1_epi32(-1))); }
static inline lm lm_andnot(lm a, lm b) { return _mm256_andnot_ps(b, a); }
static inline uint32_t lm_bits(lm a) { return (uint32_t)_mm256_movemask_ps(a); }
static inline int lm_any(lm a) { return _mm256_movemask_ps(a) != 0; }
static inline li li_set(int32_t a) { return _mm256_set1_epi32(a); }
static inline li li_load(const int32_t *p) { return _mm256_loadu_si256((const __m256i *)p); }
static inline void li_store(int32_t *p, li a) { _mm256_storeu_si256((__m256i *)p, a); }
static inline li li_add(li a, li b) { return _mm256_add_epi32(a, b); }
static inline li li_mul(li a, li b) { return _mm256_mullo_epi32(a, b); }
static inline li li_and(li a, li b) { return _mm256_and_si256(a, b); }
static inline li li_shift_right(li a, int bits) { return _mm256_srli_epi32(a, bits); }
static inline li li_from_lf(lf a) { return _mm256_cvttps_epi32(a); }
static inline lf lf_from_li(li a) { return _mm256_cvtepi32_ps(a); }
static inline li li_load_u16(const uint16_t *p) { return _mm256_cvtepu16_epi32(_mm_loadu_si128((const __m128i *)p)); }
static inline void li_store_u16(uint16_t *p, li a) {
    const __m128i both = _mm_packus_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    _mm_storeu_si128((__m128i *)p, both);
}
static inline lf lf_gather(const float *base, li index) { /* loads are faster than a gather on Zen */
    int32_t i[8];
    li_store(i, index);
    return _mm256_setr_ps(base[(uint32_t)i[0]], base[(uint32_t)i[1]], base[(uint32_t)i[2]], base[(uint32_t)i[3]],
                          base[(uint32_t)i[4]], base[(uint32_t)i[5]], base[(uint32_t)i[6]], base[(uint32_t)i[7]]);
}
static inline void li_pack_eight(void *p, __m256i a, uint32_t bits) {
    const uint32_t low = bits & 15;
    _mm_storeu_si128((__m128i *)p, li_pack_four(_mm256_castsi256_si128(a), low));
    _mm_storeu_si128((__m128i *)((int32_t *)p + __builtin_popcount(low)),
                     li_pack_four(_mm256_extracti128_si256(a, 1), bits >> 4));
}
static inline void lf_compress(float *p, lm m, lf a) { li_pack_eight(p, _mm256_castps_si256(a), lm_bits(m)); }
static inline void li_compress(int32_t *p, lm m, li a) { li_pack_eight(p, a, lm_bits(m)); }
static inline li li_gather(const int32_t *base, li index) {
    int32_t i[8];
    li_store(i, index);
    return _mm256_setr_epi32(base[(uint32_t)i[0]], base[(uint32_t)i[1]], base[(uint32_t)i[2]], base[(uint32_t)i[3]],
                             base[(uint32_t)i[4]], base[(uint32_t)i[5]], base[(uint32_t)i[6]], base[(uint32_t)i[7]]);
}
static inline lf lf_load_square(const float *p, size_t stride) {
    return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p)), _mm_loadu_ps(p + stride), 1);
}
static inline void lf_transpose_8(const lf row[8], lf out[8]) {
    lf pair[8], four[8];
    for (int i = 0; i < 4; i++) {
        pair[2 * i] = _mm256_unpacklo_ps(row[2 * i], row[2 * i + 1]);
        pair[2 * i + 1] = _mm256_unpackhi_ps(row[2 * i], row[2 * i + 1]);
    }
    for (int i = 0; i < 2; i++) {
        four[4 * i] = _mm256_shuffle_ps(pair[4 * i], pair[4 * i + 2], 0x44);
        four[4 * i + 1] = _mm256_shuffle_ps(pair[4 * i], pair[4 * i + 2], 0xEE);
        four[4 * i + 2] = _mm256_shuffle_ps(pair[4 * i + 1], pair[4 * i + 3], 0x44);
        four[4 * i + 3] = _mm256_shuffle_ps(pair[4 * i + 1], pair[4 * i + 3], 0xEE);
    }
    for (int c = 0; c < 4; c++) {
        out[c] = _mm256_permute2f128_ps(four[c], four[4 + c], 0x20);
        out[4 + c] = _mm256_permute2f128_ps(four[c], four[4 + c], 0x31);
    }
}
static inline void li_load_4(const void *const from[DF_LANES], li out[4]) {
    __m128i low[4], high[4];
    li_load_four(from, low);
    li_load_four(from + 4, high);
    for (int c = 0; c < 4; c++) out[c] = _mm256_set_m128i(high[c], low[c]);
}
static inline void lf_load_8(const float *const from[DF_LANES], lf out[8]) {
    lf rows[8];
    for (int i = 0; i < 8; i++) rows[i] = _mm256_loadu_ps(from[i]);
    lf_transpose_8(rows, out);
}
static inline void lf_load_pairs(const float *const from[DF_LANES], size_t row, size_t slice, lf out[8]) {
    lf rows[8];
    for (int i = 0; i < 8; i++) {
        const __m128 low = lf_two_pairs(from[i], from[i] + row);
        rows[i] =
            _mm256_insertf128_ps(_mm256_castps128_ps256(low), lf_two_pairs(from[i] + slice, from[i] + slice + row), 1);
    }
    lf_transpose_8(rows, out);
}
static inline li li_tally(li sum, lm m) { return _mm256_sub_epi32(sum, _mm256_castps_si256(m)); }
static inline li li_lookup(const int32_t table[16], li index) {
    const li low = _mm256_permutevar8x32_epi32(li_load(table), index),
             high = _mm256_permutevar8x32_epi32(li_load(table + 8), index);
    const lm upper = _mm256_castsi256_ps(_mm256_slli_epi32(index, 28)); /* index & 8 as the sign */
    return _mm256_castps_si256(_mm256_blendv_ps(_mm256_castsi256_ps(low), _mm256_castsi256_ps(high), upper));
}
static inline li li_select(lm m, li a, li b) {
    return _mm256_castps_si256(_mm256_blendv_ps(_mm256_castsi256_ps(b), _mm256_castsi256_ps(a), m));
}
static inline li li_masked(lm m, li a) { return _mm256_and_si256(_mm256_castps_si256(m), a); }
static inline lm li_lt(li a, li b) { return _mm256_castsi256_ps(_mm256_cmpgt_epi32(b, a)); }
static inline lm li_bit(li word, li bit) {
    const li set = _mm256_and_si256(_mm256_srlv_epi32(word, bit), _mm256_set1_epi32(1));
    return _mm256_castsi256_ps(_mm256_cmpgt_epi32(set, _mm256_setzero_si256()));
}
static inline lm lm_first(uint32_t n) {
    return _mm256_castsi256_ps(
        _mm256_cmpgt_epi32(_mm256_set1_epi32((int)n), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7)));
}

static inline ld ld_set(double a) { return _mm256_set1_pd(a); }
static inline ld ld_load(const double *p) { return _mm256_loadu_pd(p); }
static inline ld ld_load_f32(const float *p) { return _mm256_cvtps_pd(_mm_loadu_ps(p)); }
static inline void ld_store(double *p, ld a) { _mm256_storeu_pd(p, a); }
static inline void ld_store_f32(float *p, ld a) { _mm_storeu_ps(p, _mm256_cvtpd_ps(a)); }
static inline lf lf_from_ld(const ld part[2]) {
    return _mm256_set_m128(_mm256_cvtpd_ps(part[1]), _mm256_cvtpd_ps(part[0]));
}
static inline ld ld_part(lf a, int part) {
    return _mm256_cvtps_pd(part ? _mm256_extractf128_ps(a, 1) : _mm256_castps256_ps128(a));
}
static inline ld ld_min(ld a, ld b) { return _mm256_min_pd(a, b); }
static inline ld ld_max(ld a, ld b) { return _mm256_max_pd(a, b); }
static inline ldm ld_lt(ld a, ld b) { return _mm256_cmp_pd(a, b, _CMP_LT_OQ); }
static inline ldm ld_le(ld a, ld b) { return _mm256_cmp_pd(a, b, _CMP_LE_OQ); }
static inline ld ld_select(ldm m, ld a, ld b) { return _mm256_blendv_pd(b, a, m); }
static inline ld ld_sqrt(ld a) { return _mm256_sqrt_pd(a); }
static inline ld ld_abs(ld a) { return _mm256_andnot_pd(_mm256_set1_pd(-0.0), a); }
static inline ldm ldm_and(ldm a, ldm b) { return _mm256_and_pd(a, b); }
static inline ldm ldm_or(ldm a, ldm b) { return _mm256_or_pd(a, b); }
static inline ldm ldm_xor(ldm a, ldm b) { return _mm256_xor_pd(a, b); }
static inline ldm ldm_not(ldm a) { return _mm256_xor_pd(a, _mm256_castsi256_pd(_mm256_set1_epi32(-1))); }
static inline int ldm_any(ldm a) { return _mm256_movemask_pd(a) != 0; }

#elif DF_LANES == 16

typedef __m512 lf;
typedef __mmask16 lm;
typedef __m512i li;
typedef __m512d ld;
typedef __mmask8 ldm;

static inline lf lf_set(float a) { return _mm512_set1_ps(a); }
static inline lf lf_load(const float *p) { return _mm512_loadu_ps(p); }
static inline void lf_store(float *p, lf a) { _mm512_storeu_ps(p, a); }
static inline lf lf_min(lf a, lf b) { return _mm512_min_ps(a, b); }
static inline lf lf_max(lf a, lf b) { return _mm512_max_ps(a, b); }
static inline lm lf_lt(lf a, lf b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
static inline lm lf_le(lf a, lf b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
static inline lf lf_select(lm m, lf a, lf b) { return _mm512_mask_blend_ps(m, b, a); }
static inline lm lf_eq(lf a, lf b) { return _mm512_cmp_ps_mask(a, b, _CMP_EQ_OQ); }
static inline lf lf_masked(lm m, lf a) { return _mm512_maskz_mov_ps(m, a); }
static inline lf lf_sqrt(lf a) { return _mm512_sqrt_ps(a); }
static inline lf lf_abs(lf a) { return _mm512_abs_ps(a); }
static inline lf lf_floor(lf a) { return _mm512_roundscale_ps(a, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC); }
static inline lm lm_and(lm a, lm b) { return (lm)(a & b); }
static inline lm lm_or(lm a, lm b) { return (lm)(a | b); }
static inline lm lm_xor(lm a, lm b) { return (lm)(a ^ b); }
static inline lm lm_not(lm a) { return (lm)~a; }
static inline lm lm_andnot(lm a, lm b) { return (lm)(a & ~b); }
static inline uint32_t lm_bits(lm a) { return a; }
static inline int lm_any(lm a) { return a != 0; }
static inline li li_set(int32_t a) { return _mm512_set1_epi32(a); }
static inline li li_load(const int32_t *p) { return _mm512_loadu_si512(p); }
static inline void li_store(int32_t *p, li a) { _mm512_storeu_si512(p, a); }
static inline li li_add(li a, li b) { return _mm512_add_epi32(a, b); }
static inline li li_mul(li a, li b) { return _mm512_mullo_epi32(a, b); }
static inline li li_and(li a, li b) { return _mm512_and_si512(a, b); }
static inline li li_shift_right(li a, unsigned bits) { return _mm512_srli_epi32(a, bits); }
static inline li li_from_lf(lf a) { return _mm512_cvttps_epi32(a); }
static inline lf lf_from_li(li a) { return _mm512_cvtepi32_ps(a); }
static inline li li_load_u16(const uint16_t *p) {
    return _mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i *)p));
}
static inline void li_store_u16(uint16_t *p, li a) { _mm256_storeu_si256((__m256i *)p, _mm512_cvtepi32_epi16(a)); }
static inline lf lf_gather(const float *base, li index) { return _mm512_i32gather_ps(index, base, 4); }
static inline void lf_compress(float *p, lm m, lf a) { _mm512_storeu_ps(p, _mm512_maskz_compress_ps(m, a)); }
static inline void li_compress(int32_t *p, lm m, li a) { _mm512_storeu_si512(p, _mm512_maskz_compress_epi32(m, a)); }
static inline li li_gather(const int32_t *base, li index) { return _mm512_i32gather_epi32(index, base, 4); }
static inline lf lf_load_square(const float *p, size_t stride) {
    const lf low = _mm512_insertf32x4(_mm512_castps128_ps512(_mm_loadu_ps(p)), _mm_loadu_ps(p + stride), 1);
    return _mm512_insertf32x4(_mm512_insertf32x4(low, _mm_loadu_ps(p + 2 * stride), 2), _mm_loadu_ps(p + 3 * stride),
                              3);
}
static inline void lf_transpose_8(const lf row[8], lf out[8]) { /* lane i below, lane i + 8 above */
    lf pair[8], four[8];
    for (int i = 0; i < 4; i++) {
        pair[2 * i] = _mm512_unpacklo_ps(row[2 * i], row[2 * i + 1]);
        pair[2 * i + 1] = _mm512_unpackhi_ps(row[2 * i], row[2 * i + 1]);
    }
    for (int i = 0; i < 2; i++) {
        four[4 * i] = _mm512_shuffle_ps(pair[4 * i], pair[4 * i + 2], 0x44);
        four[4 * i + 1] = _mm512_shuffle_ps(pair[4 * i], pair[4 * i + 2], 0xEE);
        four[4 * i + 2] = _mm512_shuffle_ps(pair[4 * i + 1], pair[4 * i + 3], 0x44);
        four[4 * i + 3] = _mm512_shuffle_ps(pair[4 * i + 1], pair[4 * i + 3], 0xEE);
    }
    const li even = _mm512_setr_epi32(0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25, 26, 27);
    const li odd = _mm512_setr_epi32(4, 5, 6, 7, 20, 21, 22, 23, 12, 13, 14, 15, 28, 29, 30, 31);
    for (int c = 0; c < 4; c++) {
        out[c] = _mm512_permutex2var_ps(four[c], even, four[4 + c]);
        out[4 + c] = _mm512_permutex2var_ps(four[c], odd, four[4 + c]);
    }
}
static inline void li_load_4(const void *const from[DF_LANES], li out[4]) {
    __m128i part[4][4];
    for (int i = 0; i < 4; i++) li_load_four(from + 4 * i, part[i]);
    for (int c = 0; c < 4; c++) {
        const __m256i low = _mm256_set_m128i(part[1][c], part[0][c]), high = _mm256_set_m128i(part[3][c], part[2][c]);
        out[c] = _mm512_inserti64x4(_mm512_castsi256_si512(low), high, 1);
    }
}
static inline void lf_load_8(const float *const from[DF_LANES], lf out[8]) {
    lf rows[8];
    for (int i = 0; i < 8; i++) {
        const __m256 low = _mm256_loadu_ps(from[i]), high = _mm256_loadu_ps(from[i + 8]);
        rows[i] = _mm512_insertf32x8(_mm512_castps256_ps512(low), high, 1);
    }
    lf_transpose_8(rows, out);
}
static inline void lf_load_pairs(const float *const from[DF_LANES], size_t row, size_t slice, lf out[8]) {
    lf rows[8];
    for (int i = 0; i < 8; i++) {
        const float *low = from[i], *high = from[i + 8];
        const lf first = _mm512_insertf32x4(_mm512_castps128_ps512(lf_two_pairs(low, low + row)),
                                            lf_two_pairs(low + slice, low + slice + row), 1);
        rows[i] = _mm512_insertf32x4(_mm512_insertf32x4(first, lf_two_pairs(high, high + row), 2),
                                     lf_two_pairs(high + slice, high + slice + row), 3);
    }
    lf_transpose_8(rows, out);
}
static inline li li_tally(li sum, lm m) { return _mm512_mask_add_epi32(sum, m, sum, _mm512_set1_epi32(1)); }
static inline li li_lookup(const int32_t table[16], li index) {
    return _mm512_permutexvar_epi32(index, li_load(table));
}
static inline li li_select(lm m, li a, li b) { return _mm512_mask_blend_epi32(m, b, a); }
static inline li li_masked(lm m, li a) { return _mm512_maskz_mov_epi32(m, a); }
static inline lm li_lt(li a, li b) { return _mm512_cmplt_epi32_mask(a, b); }
static inline lm li_bit(li word, li bit) {
    return _mm512_test_epi32_mask(word, _mm512_sllv_epi32(_mm512_set1_epi32(1), bit));
}
static inline lm lm_first(uint32_t n) { return (lm)(n >= 16 ? 0xFFFFu : (1u << n) - 1u); }

static inline ld ld_set(double a) { return _mm512_set1_pd(a); }
static inline ld ld_load(const double *p) { return _mm512_loadu_pd(p); }
static inline ld ld_load_f32(const float *p) { return _mm512_cvtps_pd(_mm256_loadu_ps(p)); }
static inline void ld_store(double *p, ld a) { _mm512_storeu_pd(p, a); }
static inline void ld_store_f32(float *p, ld a) { _mm256_storeu_ps(p, _mm512_cvtpd_ps(a)); }
static inline lf lf_from_ld(const ld part[2]) {
    return _mm512_insertf32x8(_mm512_castps256_ps512(_mm512_cvtpd_ps(part[0])), _mm512_cvtpd_ps(part[1]), 1);
}
static inline ld ld_part(lf a, int part) {
    return _mm512_cvtps_pd(part ? _mm512_extractf32x8_ps(a, 1) : _mm512_castps512_ps256(a));
}
static inline ld ld_min(ld a, ld b) { return _mm512_min_pd(a, b); }
static inline ld ld_max(ld a, ld b) { return _mm512_max_pd(a, b); }
static inline ldm ld_lt(ld a, ld b) { return _mm512_cmp_pd_mask(a, b, _CMP_LT_OQ); }
static inline ldm ld_le(ld a, ld b) { return _mm512_cmp_pd_mask(a, b, _CMP_LE_OQ); }
static inline ld ld_select(ldm m, ld a, ld b) { return _mm512_mask_blend_pd(m, b, a); }
static inline ld ld_sqrt(ld a) { return _mm512_sqrt_pd(a); }
static inline ld ld_abs(ld a) { return _mm512_abs_pd(a); }
static inline ldm ldm_and(ldm a, ldm b) { return (ldm)(a & b); }
static inline ldm ldm_or(ldm a, ldm b) { return (ldm)(a | b); }
static inline ldm ldm_xor(ldm a, ldm b) { return (ldm)(a ^ b); }
static inline ldm ldm_not(ldm a) { return (ldm)~a; }
static inline int ldm_any(ldm a) { return a != 0; }

#endif

#ifndef DF_OPENCL
/* How many of the lanes in `bits` (lm_bits). Up to 4 lanes without an instruction that SSE4.1 does not promise. */
static inline uint32_t lm_count(uint32_t bits) {
#if DF_LANES <= 4
    return (uint32_t)(0x4332322132212110u >> 4 * bits & 15);
#else
    return (uint32_t)__builtin_popcount(bits);
#endif
}
#endif

#if DF_LANES == 1
#define DF_DOUBLE_LANES 1
#else
#define DF_DOUBLE_LANES (DF_LANES / 2)
#endif

#endif
