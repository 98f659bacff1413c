// Where a path's numbers come from: a scrambled Sobol table for the first dimensions, Philox
// beyond.
// SPDX-License-Identifier: BSD-3-Clause
// A table of SOBOL_SAMPLES points serves all pixels: each pixel, frame, seed and block of
// SOBOL_SAMPLES samples moves it by its own digital shift, which is what Philox gives for that
// pixel and block. So every number alone is uniform, numbers of different pixels are independent,
// and those of one pixel are stratified. With PAVE_SOBOL 0 all numbers are independent.
#pragma once
#include "features.h"
#include "rng.h"
#include "scene.h"

// Dimension blocks of a path; each is one call of philox().
#define BLOCK_CAMERA 0u /* x, y: place in the pixel */
#define block_of_vertex(depth) \
    (splat_uint(1u) + ((depth) << 1)) /* x, y: light; z, w: BSDF; rest: roulette */
#define block_of_light(depth) \
    (splat_uint(2u) +         \
     ((depth) << 1)) /* x: which light, if there are several; y: lobe of a rough dielectric */

/// Numbers of one vertex, 32 random bits each.
typedef struct {
    Philox u;      // x, y: light; z, w: BSDF
    vuint choice;  // of the light, if there are several
    vuint lobe;    // of a rough dielectric
} VertexNumbers;

/// Place in the pixel.
typedef struct {
    vuint x, y;
} CameraNumbers;

/// 128 bits of block `block` for the samples.
static inline Philox draw(const Scene* s, const PhiloxKeys* keys, vuint pixel, vuint sample,
                          vuint block) {
    Philox c;
    c.x = pixel;
    c.y = sample;
    c.z = block;
    c.w = splat_uint(s->p->frame);
    return philox(c, keys);
}

#if PAVE_SOBOL
/// Philox's `sample` for what all samples of a block of the table share; no sample has such a
/// number.
static inline vuint table_block(vuint sample) {
    return (sample / SOBOL_SAMPLES) | splat_uint(0x80000000u);
}

#if PAVE_BUILTINS
static inline SobolParts sobol_parts(__global const float8* table) {
    SobolParts parts;
    const vint vertex = LANE_INDEX & 1, four_bits = LANE_INDEX >> 1;
#pragma unroll
    for (int part = 0; part < SOBOL_PARTS; ++part) {
        const vint row = vertex + (four_bits << (4 * part + 1));
        const vint last = splat_int(SOBOL_SAMPLES * SOBOL_VERTICES - 2) + vertex;
        parts.part[part] = few_rows(table, min(row, last), min(row + (16 << 4 * part), last));
    }
    return parts;
}
#endif

/// Row of the table for the samples at their vertex 0 or 1. The table is linear in the bits of the
/// index, so that it can be had from the parts that four bits each contribute.
static inline Row sobol_row(const Scene* s, vuint sample, vint vertex) {
    const vint point = as_vint(sample & splat_uint(SOBOL_SAMPLES - 1u));
#if PAVE_BUILTINS
    Row row = pick_row(&s->sobol->part[0], (point & 15) << 1 | vertex);
#pragma unroll
    for (int part = 1; part < SOBOL_PARTS; ++part)
        row =
            xor_rows(row, pick_row(&s->sobol->part[part], (point >> 4 * part & 15) << 1 | vertex));
    return row;
#else
    return gather_row(s->tables + s->p->sobol_row, point * SOBOL_VERTICES + vertex);
#endif
}
#endif

/// What all samples of a unit share.
static inline CameraNumbers camera_shift(const Scene* s, const PhiloxKeys* keys, vuint pixel,
                                         vuint sample) {
    CameraNumbers shift;
    shift.x = shift.y = splat_uint(0);
#if PAVE_SOBOL
    const Philox r = draw(s, keys, pixel, table_block(sample), splat_uint(BLOCK_CAMERA));
    shift.x = r.x;
    shift.y = r.y;
#endif
    return shift;
}
static inline CameraNumbers camera_numbers(const Scene* s, const PhiloxKeys* keys, vuint pixel,
                                           vuint sample, CameraNumbers shift) {
    CameraNumbers n;
#if PAVE_SOBOL
    const Row row = sobol_row(s, sample, splat_int(0));
    n.x = as_vuint(row.s4) ^ shift.x;
    n.y = as_vuint(row.s5) ^ shift.y;
#else
    const Philox r = draw(s, keys, pixel, sample, splat_uint(BLOCK_CAMERA));
    n.x = r.x;
    n.y = r.y;
#endif
    return n;
}

/// The numbers of the vertex that ends edge `depth`.
static inline VertexNumbers vertex_numbers(const Scene* s, const PhiloxKeys* keys, vuint pixel,
                                           vuint sample, vint depth) {
    VertexNumbers n;
    n.choice = n.lobe = splat_uint(0);
#if PAVE_SOBOL
    const vmask tabled = depth < SOBOL_VERTICES;
    const vuint index = tabled ? table_block(sample) : sample;
#else
    const vuint index = sample;
#endif
    n.u = draw(s, keys, pixel, index, block_of_vertex(as_vuint(depth)));
#if !PAVE_ONE_LIGHT || PAVE_HAS_ROUGH_DIELECTRIC
    const Philox more = draw(s, keys, pixel, index, block_of_light(as_vuint(depth)));
    n.choice = more.x;
    n.lobe = more.y;
#endif
#if PAVE_SOBOL
    const Row row = sobol_row(s, sample, tabled ? depth : splat_int(SOBOL_VERTICES - 1));
    n.u.x ^= tabled ? as_vuint(row.s0) : splat_uint(0);
    n.u.y ^= tabled ? as_vuint(row.s1) : splat_uint(0);
    n.u.z ^= tabled ? as_vuint(row.s2) : splat_uint(0);
    n.u.w ^= tabled ? as_vuint(row.s3) : splat_uint(0);
    n.choice ^= tabled ? as_vuint(row.s6) : splat_uint(0);
    n.lobe ^= tabled ? as_vuint(row.s7) : splat_uint(0);
#endif
    return n;
}
