// Random numbers as a function of (seed, frame, pixel, sample, dimension): Philox4x32-10.
// SPDX-License-Identifier: BSD-3-Clause
// Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3"; constants of table 2 and
// section 4.4.
#pragma once
#include "lanes.h"

#define PHILOX_M0 0xD2511F53u
#define PHILOX_M1 0xCD9E8D57u
#define PHILOX_W0 0x9E3779B9u
#define PHILOX_W1 0xBB67AE85u
#define PHILOX_ROUNDS 10

/// Counter on the way in, 128 random bits on the way out.
typedef struct {
    vuint x, y, z, w;
} Philox;

#if PAVE_LANES == 1
static inline void mul_wide(uint a, uint m, uint* hi, uint* lo) {
    *hi = mul_hi(a, m);
    *lo = a * m;
}
#else
#if PAVE_LANES == 4
#define AS_PAIRS as_ulong2
#define PAIRS ulong2
#elif PAVE_LANES == 8
#define AS_PAIRS as_ulong4
#define PAIRS ulong4
#else
#define AS_PAIRS as_ulong8
#define PAIRS ulong8
#endif
/// 64-bit products of even and odd lanes: two multiplies and two blends, where mul_hi is dozens.
static inline void mul_wide(vuint a, uint m, vuint* hi, vuint* lo) {
    const PAIRS low_half = (PAIRS)(0xffffffffUL);
    const PAIRS pairs = AS_PAIRS(a);
    const PAIRS even = (pairs & low_half) * (PAIRS)((ulong)m);
    const PAIRS odd = (pairs >> 32) * (PAIRS)((ulong)m);
    *hi = as_vuint((even >> 32) | (odd & ~low_half));
    *lo = as_vuint((even & low_half) | (odd << 32));
}
#endif

#if PAVE_LANES == 1
/// The key of each round, computed on the way.
typedef struct {
    uint low, high;
} PhiloxKeys;
static inline void set_keys(PhiloxKeys* keys, uint low, uint high) {
    keys->low = low;
    keys->high = high;
}
#define ROUND_LOW(keys, round) ((keys)->low + (uint)(round)*PHILOX_W0)
#define ROUND_HIGH(keys, round) ((keys)->high + (uint)(round)*PHILOX_W1)
#else
/// The key of each round in every lane: operands from memory cost nothing, broadcasts would be a
/// sixth of the generator.
typedef struct {
    vuint low[PHILOX_ROUNDS], high[PHILOX_ROUNDS];
} PhiloxKeys;
static inline void set_keys(PhiloxKeys* keys, uint low, uint high) {
    for (uint round = 0; round < PHILOX_ROUNDS; ++round) {
        keys->low[round] = splat_uint(low + round * PHILOX_W0);
        keys->high[round] = splat_uint(high + round * PHILOX_W1);
    }
}
#define ROUND_LOW(keys, round) ((keys)->low[round])
#define ROUND_HIGH(keys, round) ((keys)->high[round])
#endif

static inline Philox philox(Philox c, const PhiloxKeys* keys) {
#pragma unroll
    for (int round = 0; round < PHILOX_ROUNDS; ++round) {
        vuint hi0, lo0, hi1, lo1;
        mul_wide(c.x, PHILOX_M0, &hi0, &lo0);
        mul_wide(c.z, PHILOX_M1, &hi1, &lo1);
        c.x = hi1 ^ c.y ^ ROUND_LOW(keys, round);
        c.z = hi0 ^ c.w ^ ROUND_HIGH(keys, round);
        c.y = lo1;
        c.w = lo0;
    }
    return c;
}

/// Uniform in [0, 1): the top 24 bits.
static inline vfloat unit_float(vuint bits) { return to_vfloat(as_vint(bits >> 8)) * 0x1p-24f; }

/// Uniform in [0, 1) from the low bytes that unit_float() of x, y and z leaves over: independent of
/// them.
static inline vfloat unit_float_of_rest(Philox r) {
    const vuint low = splat_uint(0xffu);
    return to_vfloat(as_vint((r.x & low) << 16 | (r.y & low) << 8 | (r.z & low))) * 0x1p-24f;
}

// Dimension blocks of a path; each is one call of philox().
#define BLOCK_CAMERA 0u /* x, y: place in the pixel */
#define block_of_vertex(depth) \
    (splat_uint(1u) + ((depth) << 1)) /* x, y: light; z, w: BSDF; rest: roulette */
#define block_of_light(depth) \
    (splat_uint(2u) +         \
     ((depth) << 1)) /* x: which light, if there are several; y: lobe of a rough dielectric */
