/* Random numbers with a seed that anybody can repeat: splitmix64. */
#ifndef DF_TESTS_RANDOM_H
#define DF_TESTS_RANDOM_H

#include <math.h>
#include <stdint.h>

static inline uint64_t lab_random_bits(uint64_t *seed) {
    uint64_t z = *seed += 0x9E3779B97F4A7C15u;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return z ^ z >> 31;
}

/* In [low, high). */
static inline double lab_random(uint64_t *seed, double low, double high) {
    return low + (high - low) * (double)(lab_random_bits(seed) >> 11) * 0x1p-53;
}

/* 0 .. count - 1 */
static inline uint32_t lab_random_index(uint64_t *seed, uint32_t count) {
    return (uint32_t)((lab_random_bits(seed) >> 32) * count >> 32);
}

/* A point of the unit sphere, evenly. */
static inline void lab_random_direction(uint64_t *seed, double direction[3]) {
    double z = lab_random(seed, -1, 1), angle = lab_random(seed, 0, 6.283185307179586), r = sqrt(1 - z * z);
    direction[0] = r * cos(angle);
    direction[1] = r * sin(angle);
    direction[2] = z;
}

#endif
