// Points, directions and colours of PAVE_LANES lanes: three vfloats.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "lanes.h"

typedef struct {
    vfloat x, y, z;
} vec3;

static inline vec3 vec3_of(vfloat x, vfloat y, vfloat z) {
    vec3 r;
    r.x = x;
    r.y = y;
    r.z = z;
    return r;
}
static inline vec3 splat3(float x, float y, float z) {
    return vec3_of(splat(x), splat(y), splat(z));
}
static inline vec3 add3(vec3 a, vec3 b) { return vec3_of(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline vec3 sub3(vec3 a, vec3 b) { return vec3_of(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline vec3 mul3(vec3 a, vec3 b) { return vec3_of(a.x * b.x, a.y * b.y, a.z * b.z); }
static inline vec3 scale3(vec3 a, vfloat s) { return vec3_of(a.x * s, a.y * s, a.z * s); }
static inline vec3 neg3(vec3 a) { return vec3_of(-a.x, -a.y, -a.z); }
/// a * s + b
static inline vec3 mad3(vec3 a, vfloat s, vec3 b) {
    return vec3_of(mad_f(a.x, s, b.x), mad_f(a.y, s, b.y), mad_f(a.z, s, b.z));
}
static inline vfloat dot3(vec3 a, vec3 b) { return mad_f(a.x, b.x, mad_f(a.y, b.y, a.z * b.z)); }
static inline vec3 cross3(vec3 a, vec3 b) {
    return vec3_of(mad_f(a.y, b.z, -(a.z * b.y)), mad_f(a.z, b.x, -(a.x * b.z)),
                   mad_f(a.x, b.y, -(a.y * b.x)));
}
static inline vec3 abs3(vec3 a) { return vec3_of(vabs(a.x), vabs(a.y), vabs(a.z)); }
static inline vec3 normalize3(vec3 a) { return scale3(a, inverse_sqrt(dot3(a, a))); }
static inline vec3 select3(vmask m, vec3 a, vec3 b) {
    return vec3_of(m ? a.x : b.x, m ? a.y : b.y, m ? a.z : b.z);
}
static inline vec3 keep3(vmask m, vec3 a) {
    return vec3_of(keep(m, a.x), keep(m, a.y), keep(m, a.z));
}
static inline vfloat max_component(vec3 a) { return vmax(vmax(a.x, a.y), a.z); }
static inline vfloat max_abs_component(vec3 a) { return max_component(abs3(a)); }

/// An orthonormal basis around n; local = (dot s, dot t, dot n).
typedef struct {
    vec3 s, t, n;
} Basis;

/// Any basis around the unit vector n. Duff et al. 2017, "Building an orthonormal basis,
/// revisited".
static inline Basis basis_around(vec3 n) {
    const vfloat sign = with_sign(splat(1.0f), n.z);
    const vfloat a = -reciprocal(sign + n.z);
    const vfloat b = n.x * n.y * a;
    Basis r;
    r.s = vec3_of(mad_f(sign * n.x * n.x, a, splat(1.0f)), sign * b, -sign * n.x);
    r.t = vec3_of(b, mad_f(n.y * n.y, a, sign), -n.y);
    r.n = n;
    return r;
}
static inline vec3 to_local(Basis b, vec3 w) {
    return vec3_of(dot3(b.s, w), dot3(b.t, w), dot3(b.n, w));
}
static inline vec3 to_world(Basis b, vec3 v) {
    return mad3(b.s, v.x, mad3(b.t, v.y, scale3(b.n, v.z)));
}

// ---- Rows of tables: 8 floats of one entry, fetched for every lane's own entry ----

/// Column c of the result is float c of row index[lane].
typedef struct {
    vfloat s0, s1, s2, s3, s4, s5, s6, s7;
} Row;

#if PAVE_LANES == 1

static inline Row gather_row(__global const float8* table, vint index) {
    const float8 r = table[index];
    Row row;
    row.s0 = r.s0;
    row.s1 = r.s1;
    row.s2 = r.s2;
    row.s3 = r.s3;
    row.s4 = r.s4;
    row.s5 = r.s5;
    row.s6 = r.s6;
    row.s7 = r.s7;
    return row;
}

#else

/// Transposes 4 rows; out.lo/.hi of element k hold columns k and k+4.
static inline void transpose_4(uint8 a, uint8 b, uint8 c, uint8 d, uint4* columns) {
    const uint8 t0 = (uint8)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, b.s5);
    const uint8 t1 = (uint8)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, b.s7);
    const uint8 t2 = (uint8)(c.s0, d.s0, c.s1, d.s1, c.s4, d.s4, c.s5, d.s5);
    const uint8 t3 = (uint8)(c.s2, d.s2, c.s3, d.s3, c.s6, d.s6, c.s7, d.s7);
    const uint8 u0 = (uint8)(t0.s0, t0.s1, t2.s0, t2.s1, t0.s4, t0.s5, t2.s4, t2.s5);
    const uint8 u1 = (uint8)(t0.s2, t0.s3, t2.s2, t2.s3, t0.s6, t0.s7, t2.s6, t2.s7);
    const uint8 u2 = (uint8)(t1.s0, t1.s1, t3.s0, t3.s1, t1.s4, t1.s5, t3.s4, t3.s5);
    const uint8 u3 = (uint8)(t1.s2, t1.s3, t3.s2, t3.s3, t1.s6, t1.s7, t3.s6, t3.s7);
    columns[0] = u0.lo;
    columns[1] = u1.lo;
    columns[2] = u2.lo;
    columns[3] = u3.lo;
    columns[4] = u0.hi;
    columns[5] = u1.hi;
    columns[6] = u2.hi;
    columns[7] = u3.hi;
}

#if PAVE_LANES == 4
#define ROW_COLUMN(k) as_vfloat(c0[k])
#elif PAVE_LANES == 8
#define ROW_COLUMN(k) as_vfloat((uint8)(c0[k], c1[k]))
#else
#define ROW_COLUMN(k) as_vfloat((uint16)(c0[k], c1[k], c2[k], c3[k]))
#endif

/// One 32-byte load a lane and a transpose: half the work of eight gathers. As integers, for rows
/// hold such too, and a float that is NaN need not survive.
static inline Row gather_row(__global const float8* rows, vint index) {
    __global const uint8* table = (__global const uint8*)rows;
    uint4 c0[8];
    transpose_4(table[index.s0], table[index.s1], table[index.s2], table[index.s3], c0);
#if PAVE_LANES >= 8
    uint4 c1[8];
    transpose_4(table[index.s4], table[index.s5], table[index.s6], table[index.s7], c1);
#endif
#if PAVE_LANES == 16
    uint4 c2[8], c3[8];
    transpose_4(table[index.s8], table[index.s9], table[index.sa], table[index.sb], c2);
    transpose_4(table[index.sc], table[index.sd], table[index.se], table[index.sf], c3);
#endif
    Row row;
    row.s0 = ROW_COLUMN(0);
    row.s1 = ROW_COLUMN(1);
    row.s2 = ROW_COLUMN(2);
    row.s3 = ROW_COLUMN(3);
    row.s4 = ROW_COLUMN(4);
    row.s5 = ROW_COLUMN(5);
    row.s6 = ROW_COLUMN(6);
    row.s7 = ROW_COLUMN(7);
    return row;
}

#endif

#if PAVE_BUILTINS
/// A table of at most 32 rows, column by column: picking one is an instruction a column.
typedef struct {
    vfloat low[8], high[8];
} FewRows;

/// Rows `low` of the table become 0 to 15, `high` 16 to 31.
static inline FewRows few_rows(__global const float8* table, vint low, vint high) {
    FewRows f;
    const Row a = gather_row(table, low), b = gather_row(table, high);
    f.low[0] = a.s0;
    f.low[1] = a.s1;
    f.low[2] = a.s2;
    f.low[3] = a.s3;
    f.low[4] = a.s4;
    f.low[5] = a.s5;
    f.low[6] = a.s6;
    f.low[7] = a.s7;
    f.high[0] = b.s0;
    f.high[1] = b.s1;
    f.high[2] = b.s2;
    f.high[3] = b.s3;
    f.high[4] = b.s4;
    f.high[5] = b.s5;
    f.high[6] = b.s6;
    f.high[7] = b.s7;
    return f;
}
static inline vfloat pick_column(const FewRows* f, int column, vint index) {
    return __builtin_astype(
        __builtin_ia32_vpermi2varps512(as_plain_float16(f->low[column]), as_plain_int16(index),
                                       as_plain_float16(f->high[column])),
        vfloat);
}
static inline Row pick_row(const FewRows* f, vint index) {
    Row r;
    r.s0 = pick_column(f, 0, index);
    r.s1 = pick_column(f, 1, index);
    r.s2 = pick_column(f, 2, index);
    r.s3 = pick_column(f, 3, index);
    r.s4 = pick_column(f, 4, index);
    r.s5 = pick_column(f, 5, index);
    r.s6 = pick_column(f, 6, index);
    r.s7 = pick_column(f, 7, index);
    return r;
}
static inline vfloat xor_floats(vfloat a, vfloat b) { return as_vfloat(as_vuint(a) ^ as_vuint(b)); }
static inline Row xor_rows(Row a, Row b) {
    Row r;
    r.s0 = xor_floats(a.s0, b.s0);
    r.s1 = xor_floats(a.s1, b.s1);
    r.s2 = xor_floats(a.s2, b.s2);
    r.s3 = xor_floats(a.s3, b.s3);
    r.s4 = xor_floats(a.s4, b.s4);
    r.s5 = xor_floats(a.s5, b.s5);
    r.s6 = xor_floats(a.s6, b.s6);
    r.s7 = xor_floats(a.s7, b.s7);
    return r;
}
#endif

/// table[index] of every lane.
static inline vuint gather_uint(__global const uint* table, vint index) {
#if PAVE_LANES == 1
    return table[index];
#elif PAVE_LANES == 4
    return (uint4)(table[index.s0], table[index.s1], table[index.s2], table[index.s3]);
#else
    uint values[PAVE_LANES];
    int at[PAVE_LANES];
    lane_store(index, at);
    for (int i = 0; i < PAVE_LANES; ++i) values[i] = table[at[i]];
    return lane_load(values);
#endif
}
