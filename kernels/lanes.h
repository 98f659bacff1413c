// One source for every device: PAVE_LANES samples in flight per work-item, plain scalars when it
// is 1.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#ifndef PAVE_LANES /* 1, 4, 8 or 16; 1 is for devices that vectorise over work-items (GPUs) */
#define PAVE_LANES 1
#endif

// Fused multiply-add where the device has it; FP_CONTRACT is off, so a*b+c alone rounds twice.
#if defined(FP_FAST_FMAF) || defined(__FMA__)
#define mad_f(a, b, c) fma(a, b, c)
#else
#define mad_f(a, b, c) ((a) * (b) + (c))
#endif

#define PAVE_PASTE_2(a, b) a##b
#define PAVE_PASTE(a, b) PAVE_PASTE_2(a, b)

#if PAVE_LANES == 1

typedef float vfloat;
typedef int vint;
typedef uint vuint;
typedef int vmask;  // 0 or 1, as scalar comparisons give
#define as_vfloat(x) as_float(x)
#define as_vint(x) as_int(x)
#define as_vuint(x) as_uint(x)
#define to_vfloat(x) convert_float(x)
#define to_vint(x) convert_int(x)
#define lane_not(m) (!(m))
#define lane_any(m) ((m) != 0)
#define lane_bits(m) ((uint)((m) != 0))
#define lane_store(v, p) ((p)[0] = (v))
#define lane_load(p) ((p)[0])
#define mask_of(b) ((b) ? 1 : 0)
#define MASK_BITS 1  // a set lane of a stored mask
#define LANE_INDEX 0
#define first_lane(v) (v)

#else

typedef PAVE_PASTE(float, PAVE_LANES) vfloat;
typedef PAVE_PASTE(int, PAVE_LANES) vint;
typedef PAVE_PASTE(uint, PAVE_LANES) vuint;
typedef vint vmask;  // 0 or -1, as vector comparisons give
#define as_vfloat(x) PAVE_PASTE(as_float, PAVE_LANES)(x)
#define as_vint(x) PAVE_PASTE(as_int, PAVE_LANES)(x)
#define as_vuint(x) PAVE_PASTE(as_uint, PAVE_LANES)(x)
#define to_vfloat(x) PAVE_PASTE(convert_float, PAVE_LANES)(x)
#define to_vint(x) PAVE_PASTE(convert_int, PAVE_LANES)(x)
#define lane_not(m) (~(m))
#define lane_store(v, p) PAVE_PASTE(vstore, PAVE_LANES)(v, 0, p)
#define lane_load(p) PAVE_PASTE(vload, PAVE_LANES)(0, p)
#define mask_of(b) ((vmask)((b) ? -1 : 0))
#define MASK_BITS (-1)
#define first_lane(v) ((v).s0)

#endif

#define splat(x) ((vfloat)(x))
#define splat_int(x) ((vint)(x))
#define splat_uint(x) ((vuint)(x))

#if PAVE_LANES == 16 && defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__has_builtin)
#if __has_builtin(__builtin_ia32_cvtd2mask512) && __has_builtin(__builtin_ia32_rcp14ps512_mask) && \
    __has_builtin(__builtin_ia32_rsqrt14ps512_mask) &&                                             \
    __has_builtin(__builtin_ia32_vpermi2varps512)
#ifndef PAVE_BUILTINS /* 0 or 1: the processor's own instructions beside OpenCL's */
#define PAVE_BUILTINS 1
#endif
#endif
#endif
#ifndef PAVE_BUILTINS
#define PAVE_BUILTINS 0
#endif

#if defined(__AVX__) && defined(__has_builtin)
#if __has_builtin(__builtin_ia32_movmskps256)
#ifndef PAVE_BUILTINS_8 /* 0 or 1: the same for 8 floats, whatever PAVE_LANES is */
#define PAVE_BUILTINS_8 1
#endif
#endif
#endif
#ifndef PAVE_BUILTINS_8
#define PAVE_BUILTINS_8 0
#endif

#if PAVE_BUILTINS_8
typedef float plain_float8 __attribute__((vector_size(32)));
#endif
#if PAVE_BUILTINS
typedef float plain_float16 __attribute__((vector_size(64)));
typedef int plain_int16 __attribute__((vector_size(64)));
#define as_plain_float16(x) __builtin_astype(x, plain_float16)
#define as_plain_int16(x) __builtin_astype(x, plain_int16)
#endif

// any() and a lane-by-lane test of 8 lanes are dozens of instructions in PoCL 3.1; these are a
// handful.
#if PAVE_LANES == 4
#define LANE_INDEX ((vint)(0, 1, 2, 3))
static inline int lane_any(vmask m) {
    const ulong2 r = as_ulong2(m);
    return (r.x | r.y) != 0;
}
/// Bit i is set if lane i is.
static inline uint lane_bits(vmask m) {
    const uint bytes = as_uint(convert_char4(m));
    return ((bytes & 0x08040201u) * 0x01010101u) >> 24;
}
#elif PAVE_LANES == 8
#define LANE_INDEX ((vint)(0, 1, 2, 3, 4, 5, 6, 7))
static inline int lane_any(vmask m) {
    const ulong4 r = as_ulong4(m);
    return (r.x | r.y | r.z | r.w) != 0;
}
#elif PAVE_LANES == 16
#define LANE_INDEX ((vint)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#if PAVE_BUILTINS
/// The compiler holds masks in mask registers, where this is one instruction.
static inline uint lane_bits(vmask m) { return __builtin_ia32_cvtd2mask512(as_plain_int16(m)); }
static inline int lane_any(vmask m) { return lane_bits(m) != 0; }
#else
static inline int lane_any(vmask m) {
    const ulong4 r = as_ulong4(m.lo | m.hi);
    return (r.x | r.y | r.z | r.w) != 0;
}
#endif
#endif

/// Bit i is set if lane i of an 8-wide mask is; also used by the 8-wide tree whatever PAVE_LANES
/// is.
#if PAVE_BUILTINS_8
static inline uint bits_of_8(int8 m) {
    return (uint)__builtin_ia32_movmskps256(__builtin_astype(m, plain_float8));
}
#else
static inline uint bits_of_8(int8 m) {
    const ulong bytes = as_ulong(convert_char8(m));
    return (uint)(((bytes & 0x8040201008040201UL) * 0x0101010101010101UL) >> 56);
}
#endif
#if PAVE_LANES == 8
#define lane_bits(m) bits_of_8(m)
#elif PAVE_LANES == 16 && !PAVE_BUILTINS
#define lane_bits(m) (bits_of_8((m).lo) | bits_of_8((m).hi) << 8)
#endif

/// Lanes whose bit is set: undoes lane_bits.
static inline vmask mask_of_bits(uint bits) {
    return ((splat_uint(bits) >> as_vuint(splat_int(0) + LANE_INDEX)) & 1u) != 0u;
}
/// Index of the lowest set bit; `bits` is not 0.
static inline uint lowest_bit(uint bits) { return popcount(~bits & (bits - 1u)); }

// fmin and fmax have NaN rules that cost four instructions a piece; with a NaN these give b.
static inline vfloat vmin(vfloat a, vfloat b) { return a < b ? a : b; }
static inline vfloat vmax(vfloat a, vfloat b) { return a > b ? a : b; }
static inline vfloat vabs(vfloat a) { return as_vfloat(as_vuint(a) & splat_uint(0x7fffffffu)); }
/// |a| with the sign of b.
static inline vfloat with_sign(vfloat a, vfloat b) {
    return as_vfloat((as_vuint(a) & splat_uint(0x7fffffffu)) |
                     (as_vuint(b) & splat_uint(0x80000000u)));
}
/// a with its sign flipped where b is negative.
static inline vfloat mul_sign(vfloat a, vfloat b) {
    return as_vfloat(as_vuint(a) ^ (as_vuint(b) & splat_uint(0x80000000u)));
}
static inline vmask is_finite(vfloat a) {
    return (as_vuint(a) & splat_uint(0x7f800000u)) != splat_uint(0x7f800000u);
}
// ---- Reciprocals: a divider's 16 lanes take as long as a dozen other instructions ----
//
// Within 1.5 units in the last place of 1/x and 1/sqrt(x): one step of Newton on the processor's
// estimate of 14 bits where it has one. reciprocal() and inverse_sqrt() of zero are infinite;
// slope_of() stays finite, so that a ray along a slab gives no NaN.
#define STEEPEST 1e30f

#if PAVE_BUILTINS
static inline vfloat reciprocal(vfloat x) {
    const plain_float16 p = as_plain_float16(x);
    const vfloat r =
        __builtin_astype(__builtin_ia32_rcp14ps512_mask(p, p, (unsigned short)-1), vfloat);
    const vfloat error = fma(-x, r, splat(1.0f));
    return error == error ? fma(r, error, r) : r;
}
static inline vfloat slope_of(vfloat x) {
    const plain_float16 p = as_plain_float16(x);
    vfloat r = __builtin_astype(__builtin_ia32_rcp14ps512_mask(p, p, (unsigned short)-1), vfloat);
    r = vmin(vmax(r, splat(-STEEPEST)), splat(STEEPEST));
    return fma(r, fma(-x, r, splat(1.0f)), r);
}
static inline vfloat inverse_sqrt(vfloat x) {
    const plain_float16 p = as_plain_float16(x);
    const vfloat r =
        __builtin_astype(__builtin_ia32_rsqrt14ps512_mask(p, p, (unsigned short)-1), vfloat);
    const vfloat error = fma(-x * r, r, splat(1.0f));
    return error == error ? fma(0.5f * r, error, r) : r;
}
#else
static inline vfloat reciprocal(vfloat x) { return 1.0f / x; }
static inline vfloat slope_of(vfloat x) {
    return vmin(vmax(1.0f / x, splat(-STEEPEST)), splat(STEEPEST));
}
static inline vfloat inverse_sqrt(vfloat x) { return 1.0f / sqrt(x); }
#endif

static inline vfloat safe_sqrt(vfloat a) { return sqrt(vmax(a, splat(0.0f))); }
static inline vfloat square(vfloat a) { return a * a; }
/// a where `m`, else 0; never a multiplication, so that a NaN of an idle lane stays out.
static inline vfloat keep(vmask m, vfloat a) { return m ? a : splat(0.0f); }

#ifndef INFINITY
#define INFINITY as_float(0x7f800000)
#endif
#define PI_F 3.14159265358979f
#define INV_PI_F 0.318309886183791f
