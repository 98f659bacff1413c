// Texture coordinates of a vertex, and textures looked up there.
// SPDX-License-Identifier: BSD-3-Clause
// Definitions are Mitsuba 3's: v = 0 is an image's first row, texel i lies at (i + 1/2) / size.
#pragma once
#include "vertex.h"

#if PAVE_HAS_TEXTURES

// ---- One lane ----

static inline int wrapped(int i, int size, int wrap) {
    // Only a neighbour of a texel inside comes here, so one step is enough. Mirrored, the edge's
    // neighbour is the edge itself.
    if (wrap == TEXTURE_REPEAT) i = i < 0 ? i + size : (i >= size ? i - size : i);
    return max(0, min(i, size - 1));
}

/// Coordinate inside [0, 1] that `x` stands for.
static inline float folded(float x, int wrap) {
    if (wrap == TEXTURE_REPEAT) return x - floor(x);
    if (wrap == TEXTURE_CLAMP) return fmin(fmax(x, 0.0f), 1.0f);
    const float turn = x - 2.0f * floor(0.5f * x);
    return turn > 1.0f ? 2.0f - turn : turn;
}

static inline float4 texel(__global const float8* rows, float8 head, int x, int y) {
    const int at = y * as_int(head.s1) + x;
    __global const float8* data = rows + as_int(head.s3);
    if (as_int(head.s0) == TEXTURE_FLOATS) return ((__global const float4*)data)[at];
    // Bytes, and what each of the 256 stands for.
    const uint word = ((__global const uint*)data)[at];
    __global const float* decoded = (__global const float*)(rows + as_int(head.s4));
    return (float4)(decoded[word & 0xffu], decoded[word >> 8 & 0xffu], decoded[word >> 16 & 0xffu],
                    0.0f);
}

static inline float4 sample_bitmap(__global const float8* rows, float8 head, float u, float v) {
    const int width = as_int(head.s1), height = as_int(head.s2), wrap = as_int(head.s5);
    const float x = folded(u, wrap) * (float)width, y = folded(v, wrap) * (float)height;
    if (as_int(head.s6) == TEXTURE_NEAREST)
        return texel(rows, head, wrapped((int)x, width, wrap), wrapped((int)y, height, wrap));
    const float left = floor(x - 0.5f), top = floor(y - 0.5f);
    const float wx = x - 0.5f - left, wy = y - 0.5f - top;
    const int x0 = wrapped((int)left, width, wrap), x1 = wrapped((int)left + 1, width, wrap);
    const int y0 = wrapped((int)top, height, wrap), y1 = wrapped((int)top + 1, height, wrap);
    const float4 above = texel(rows, head, x0, y0) * (1.0f - wx) + texel(rows, head, x1, y0) * wx;
    const float4 below = texel(rows, head, x0, y1) * (1.0f - wx) + texel(rows, head, x1, y1) * wx;
    return above * (1.0f - wy) + below * wy;
}

static inline float4 sample_texture(__global const float8* rows, int texture, float u, float v) {
    __global const float8* t = rows + texture * TEXTURE_ROWS;
    const float8 head = t[0], map = t[1];
    const float x = map.s0 * u + map.s1 * v + map.s2, y = map.s3 * u + map.s4 * v + map.s5;
    if (as_int(head.s0) != TEXTURE_CHECKERS) return sample_bitmap(rows, head, x, y);
    const float8 colours = t[2];
    return (x - floor(x) > 0.5f) == (y - floor(y) > 0.5f) ? colours.lo : colours.hi;
}

// ---- All lanes ----

/// Colour of every lane's own texture; 1 where `texture` is negative.
static inline vec3 texture_colour(const Scene* s, vint texture, vfloat u, vfloat v) {
    float us[PAVE_LANES], vs[PAVE_LANES], rgb[3][PAVE_LANES];
    int index[PAVE_LANES];
    lane_store(u, us);
    lane_store(v, vs);
    lane_store(texture, index);
    __global const float8* rows = s->tables + s->p->texture_row;
    for (int i = 0; i < PAVE_LANES; ++i) {
        const float4 c =
            index[i] < 0 ? (float4)(1.0f) : sample_texture(rows, index[i], us[i], vs[i]);
        rgb[0][i] = c.x;
        rgb[1][i] = c.y;
        rgb[2][i] = c.z;
    }
    return vec3_of(lane_load(rgb[0]), lane_load(rgb[1]), lane_load(rgb[2]));
}

static inline vfloat turn_of(vfloat x, vfloat y) {
    const vfloat turn = atan2(y, x) * (0.5f * INV_PI_F);
    return turn < 0.0f ? turn + 1.0f : turn;
}

/// (u, v) as Mitsuba has them: over the square of a rectangle and of a cube's faces, radius and
/// angle of a disk, longitude and colatitude of a sphere, interpolated on a triangle.
static inline void find_uv(const Scene* s, const Hit* hit, Vertex* v) {
    __global const float8* table = s->tables + s->p->uv_row;
    vmask triangle;
    const Row cold = cold_row(s, v, &triangle);
    v->tu = v->tv = splat(0.0f);
#if PAVE_HAS_SHAPES || PAVE_TREE_SHAPES
    const vint at = (triangle ? splat_int(0) : v->id) * UV_ROWS;
    const Row r = gather_row(table, at);
    const vfloat x = mad_f(r.s0, v->p.x, mad_f(r.s1, v->p.y, mad_f(r.s2, v->p.z, r.s3)));
    const vfloat y = mad_f(r.s4, v->p.x, mad_f(r.s5, v->p.y, mad_f(r.s6, v->p.z, r.s7)));
    const vmask disk = bits_kind(v->bits) == SURFACE_DISK,
                sphere = bits_kind(v->bits) == SURFACE_SPHERE;
    v->tu = x;
    v->tv = y;
    if (lane_any(v->valid & (disk | sphere))) {
        const Row q = gather_row(table, at + 1);
        const vfloat z = mad_f(q.s0, v->p.x, mad_f(q.s1, v->p.y, mad_f(q.s2, v->p.z, q.s3)));
        const vfloat turn = turn_of(x, y), r2 = mad_f(x, x, y * y);
        const vfloat cosine = vmin(vmax(z / sqrt(mad_f(z, z, r2)), splat(-1.0f)), splat(1.0f));
        v->tu = disk ? sqrt(r2) : (sphere ? turn : x);
        v->tv = disk ? turn : (sphere ? acos(cosine) * INV_PI_F : y);
    }
#endif
#if PAVE_HAS_TRIANGLES
    const vint uvs = as_vint(cold.s7);
    const vmask mapped = triangle & v->valid & (uvs >= 0);
    if (lane_any(mapped)) {
        const Row t = gather_row(table, mapped ? uvs : splat_int(0));
        const vfloat b0 = 1.0f - hit->b1 - hit->b2;
        v->tu = mapped ? mad_f(t.s0, b0, mad_f(t.s2, hit->b1, t.s4 * hit->b2)) : v->tu;
        v->tv = mapped ? mad_f(t.s1, b0, mad_f(t.s3, hit->b1, t.s5 * hit->b2)) : v->tv;
    }
#endif
}

/// Texture coordinates, and the albedo that they give.
static inline void apply_textures(const Scene* s, const Hit* hit, Vertex* v) {
    v->tu = v->tv = splat(0.0f);
    const vmask textured = v->valid & bits_textured(v->bits);
    if (!lane_any(textured)) return;
    find_uv(s, hit, v);
    const Row r = gather_row(s->tables + s->p->bsdf_row, bits_bsdf(v->bits) * BSDF_ROWS);
    const vint texture = textured ? as_vint(r.s3) : splat_int(-1);
    v->albedo = mul3(v->albedo, texture_colour(s, texture, v->tu, v->tv));
}

#endif  // PAVE_HAS_TEXTURES
