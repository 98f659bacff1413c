// Structs, table layouts and packed words that the host writes and the path tracing kernels read:
// one source for both.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#ifdef __OPENCL_VERSION__
#define PAVE_STRUCT(name)     \
    typedef struct name name; \
    struct name
#define PAVE_SIZEOF(name, bytes)
#define PAVE_U32 uint
#define PAVE_U64 ulong
#else
#include <cstdint>
#define PAVE_STRUCT(name) struct name
#define PAVE_SIZEOF(name, bytes) static_assert(sizeof(name) == (bytes), #name)
#define PAVE_U32 uint32_t
#define PAVE_U64 uint64_t
namespace pave::kernel {
#endif

// ---- Channels: bit i of PAVE_CHANNELS says that a program writes channel i ----

#define CHANNEL_COLOR 0
#define CHANNEL_ALBEDO 1
#define CHANNEL_DIRECT 2
#define CHANNEL_NORMAL 3
#define CHANNEL_DEPTH 4
#define CHANNEL_DISTANCE 5
#define CHANNEL_VARIANCE 6
#define CHANNEL_POSITION 7
#define CHANNEL_OBJECT 8
#define CHANNEL_COUNT 9

// ---- Shapes: intersected in broadcast loops, or as leaves of the tree ----
//
// For the loops every number is stored once a lane, so that a broadcast costs no instruction: a
// kernel's ShapeFloat is then a vector and its structs are PAVE_LANES times as large. For the tree,
// and on the host, it is a plain float.

#ifndef __OPENCL_VERSION__
using ShapeFloat = float;
using ShapeWord = uint32_t;
#endif

/// A rectangle, disk or triangle. Object coordinates of a world point P: x = dot(u.xyz, P) + u[3],
/// y likewise with v; of a triangle, the weights of its second and third corner.
PAVE_STRUCT(FlatShape) {
    ShapeFloat u[4];
    ShapeFloat v[4];
    ShapeFloat n[4];    // unit normal; dot(n.xyz, P) == n[3] on the plane
    ShapeFloat limit;   // of max(|x|, |y|), x*x + y*y, or max(-x, -y, x + y - 1); 1 (or 0) plus
                        // rounding, so that shared edges have no gap
    ShapeWord surface;  // its surface (see below)
    ShapeWord kind;     // FLAT_*
    ShapeWord pad;
};
PAVE_SIZEOF(FlatShape, 64);

#define FLAT_RECT 0
#define FLAT_DISK 1
#define FLAT_TRIANGLE 2
#define FLAT_KINDS 3

/// A rectangle whose edges run along the axes: axes (k + 1) % 3 and (k + 2) % 3 of a normal along
/// k.
PAVE_STRUCT(AxisRect) {
    ShapeFloat plane;      // coordinate k of all its points
    ShapeFloat center[2];  // the other two
    ShapeFloat reach[2];   // half its sides plus rounding
    ShapeWord surface;
    ShapeWord pad[2];
};
PAVE_SIZEOF(AxisRect, 32);

/// A cube under any affine map: its object coordinates are dot(row[a].xyz, P) + row[a][3], from -1
/// to 1.
PAVE_STRUCT(CubeShape) {
    ShapeFloat row[3][4];
    ShapeWord surface;  // first of its six faces: low x, high x, low y, high y, low z, high z
    ShapeWord pad[3];
};
PAVE_SIZEOF(CubeShape, 64);

/// A cube with four edges along axis k, turned about it in any way. Its object coordinates are u
/// and v, of axes i = (k + 1) % 3 and j = (k + 2) % 3, and one along k; all from -1 to 1.
PAVE_STRUCT(AxisCube) {
    ShapeFloat u[3], v[3];   // u[0] * P[i] + u[1] * P[j] + u[2]
    ShapeFloat along[2];     // along[0] * P[k] + along[1]
    ShapeFloat half_length;  // 1 / along[0]
    ShapeWord face_u, face_v,
        face_along;  // surfaces of the low faces; those of the high ones follow
    ShapeWord pad[4];
};
PAVE_SIZEOF(AxisCube, 64);

PAVE_STRUCT(SphereShape) {
    ShapeFloat center[3];
    ShapeFloat radius;
    ShapeWord surface;
    ShapeWord pad[3];
};
PAVE_SIZEOF(SphereShape, 32);

// ---- Tables: rows of 8 floats in one buffer, gathered per lane ----
//
// clang-format off
// surface, 2 rows:
//   { normal xyz (sphere: center), BITS, albedo rgb, plane offset (sphere: radius) }
//   { tangent xyz (disk: center), light (int), object (int), part (int), -, - }
// triangle, 2 rows:
//   { v0 xyz, BITS, v1 xyz, light (int) }
//   { v2 xyz, object (int), normals of v0, v1, v2 (packed; 0: flat), uvs (int, row of them, -1:
//     none) }
// bsdf, 3 rows; a colour with a texture is a factor of it:
//   { albedo rgb, its texture (int, -1: none), alpha_u, alpha_v, eta (inside over outside), - }
//   { eta rgb, -, k rgb, - }; plastic: { reflectance from inside, share of the specular lobe,
//     nonlinear (0 or 1), -, -, -, -, - }
//   { reflectance rgb, its texture, transmittance rgb, its texture }
// uvs, only in scenes with textures; 2 rows a surface, which give a world point's coordinates:
//   { x: linear part xyz, offset; y: the same }; { z, of spheres: the same, -, -, -, - }
//   x, y: (u, v) of flat ones, else object coordinates. Then 1 row a triangle that has them:
//   { uv of v0, of v1, of v2, -, - }
// texture, 3 rows:
//   { TEXTURE_* kind, width, height, first row of texels, of the 256 values of a byte, TEXTURE_*
//     wrap, TEXTURE_* filter (all int; rows counted from the table's first), - }
//   { texture coordinates from (u, v): x = m0 u + m1 v + m2, y = m3 u + m4 v + m5; -, - }
//   { checkers: colour rgb, -, other colour rgb, - }
//   then what they name: texels as bytes r, g, b, - or floats r, g, b, -; values of bytes
// light, 3 rows:
//   { p xyz, KIND (int), e1 xyz, pmf }
//   { e2 xyz, radius, normal xyz, pdf by area (with pmf) }
//   { radiance or intensity rgb, triangle that has normals (int, -1: flat), largest coordinate, -, -, - }
//   quad: p + a*e1 + b*e2, a and b in [0,1]; triangle: p + b1*e1 + b2*e2; disk: p + x*e1 + y*e2;
//   sphere: center p, radius, +1 or -1 in normal.x for light on its outside or inside; point: p.
// environment, 3 rows:
//   { width (0: no image), height, first row of pixels, of row ends, of column ends (all int; rows
//     counted from the table's first), -, -, - }
//   { map from world, row 0, -, row 1, - }
//   { row 2, -, -, -, -, - }
//   then what they name, as kernels/environment.h reads it
// clang-format on
#define SURFACE_ROWS 2
#define TRIANGLE_ROWS 2
#define BSDF_ROWS 3
#define LIGHT_ROWS 3
#define UV_ROWS 2
#define TEXTURE_ROWS 3
#define ENVIRONMENT_ROWS 3

#define TEXTURE_CHECKERS 0
#define TEXTURE_BYTES 1
#define TEXTURE_FLOATS 2
#define TEXTURE_REPEAT 0
#define TEXTURE_MIRROR 1
#define TEXTURE_CLAMP 2
#define TEXTURE_BILINEAR 0
#define TEXTURE_NEAREST 1

// Sobol table, behind the other tables: for each sample and vertex a row
//   { light u1, u2, bsdf u1, u2, camera x, y, choice of the light, lobe of a rough dielectric }
#define SOBOL_SAMPLES 1024
#define SOBOL_VERTICES 2

// BITS: [22:0] bsdf, [25:23] BSDF_* type, [26] two sided, [27] emits, [29:28] SURFACE_* kind, [30]
// sphere seen from inside out, [31] has a texture
#define BSDF_DIFFUSE 0
#define BSDF_CONDUCTOR 1
#define BSDF_ROUGH_CONDUCTOR 2
#define BSDF_DIELECTRIC 3
#define BSDF_PLASTIC 4
#define BSDF_ROUGH_DIELECTRIC 5
#define SURFACE_FLAT 0
#define SURFACE_DISK 1
#define SURFACE_SPHERE 2
#define MAX_BSDFS 0x800000
#define make_bits(bsdf, type, two_sided, emits, kind, inverted, textured)            \
    ((PAVE_U32)(bsdf) | (PAVE_U32)(type) << 23 | (PAVE_U32)(two_sided) << 26 |       \
     (PAVE_U32)(emits) << 27 | (PAVE_U32)(kind) << 28 | (PAVE_U32)(inverted) << 30 | \
     (PAVE_U32)(textured) << 31)
#define bits_bsdf(b) ((b)&0x7fffff)
#define bits_type(b) (((b) >> 23) & 7)
#define bits_two_sided(b) (((b) & (1 << 26)) != 0)
#define bits_emits(b) (((b) & (1 << 27)) != 0)
#define bits_kind(b) (((b) >> 28) & 3)
#define bits_inverted(b) (((b) & (1 << 30)) != 0)
#define bits_textured(b) ((b) < 0)  // of the int that a kernel has

#define LIGHT_QUAD 0
#define LIGHT_TRIANGLE 1
#define LIGHT_DISK 2
#define LIGHT_SPHERE 3
#define LIGHT_ENVIRONMENT 4
#define LIGHT_POINT 5

// ---- Tree: 8-wide nodes and leaves of up to 8 triangles, rows of 8 floats in one buffer ----
//
// node, 8 rows: low x, high x, low y, high y, low z, high z, children (int), -.
//   Row i of lane c belongs to child c; an empty child has low = +inf, high = -inf.
//   A child code >= 0 is a node; else ~code = index << 3 | LEAF_*.
// leaf of triangles, 10 rows: v0 x, y, z, v1 x, y, z, v2 x, y, z, triangle (int).
//   Spare lanes are NaN.
// instance, 4 rows; L maps directions from the world to the group, M back, T is the group's origin:
//   { L row 0, T x, L row 1, T y }
//   { L row 2, T z, root of the group's tree (int), object (int), largest |x|, |y| of the group }
//   { M row 0, largest |z|, M row 1, - }
//   { M row 2, -, -, -, -, - }
// Node 0 is the root of the scene's tree, whose leaves can be instances; the trees of groups, whose
// leaves are triangles in the group's space, lie behind it.
#define NODE_ROWS 8
#define LEAF_ROWS 10
#define INSTANCE_ROWS 4
#define TREE_WIDTH 8
#define LEAF_TRIANGLES 0
#define LEAF_FLAT 1
#define LEAF_CUBE 2
#define LEAF_SPHERE 3
#define LEAF_INSTANCE 4
#define leaf_code(index, kind) (~((int)(index) << 3 | (kind)))
#define leaf_kind(code) (~(code)&7)
#define leaf_index(code) (~(code) >> 3)

// ---- What one render is told ----

PAVE_STRUCT(PathParams) {
    PAVE_U64 channel_offset[CHANNEL_COUNT];  // floats from the slot's first byte to plane 0
    PAVE_U64 plane;                          // floats from one plane to the next: width * height

    // Ray of the film point (x, y) in pixels: eye, corner + x * right + y * down (not normalised).
    float eye[3];
    float corner[3];
    float right[3];
    float down[3];
    float forward[3];       // unit view axis; depth = dot(P - eye, forward)
    float environment[3];   // radiance
    float environment_pmf;  // probability that a light sample is the environment
    float offset_floor;     // least distance that a new ray's origin is moved off its surface
    float tree_bound[3];    // largest |x|, |y|, |z| of the tree

    int width, height;
    int segment;      // pixels of a row that a work-item renders
    int spp;          // all samples of a pixel
    int max_depth;    // edges of the longest path
    int shade_depth;  // edges that the channels need: max_depth, or less if only first vertices and
                      // direct light are asked
    int rr_depth;

    PAVE_U32 seed_low, seed_high, frame;

    int axis_rects[3], axis_shadow[3];  // across x, y, z, one after another
    int axis_cubes[3];                  // along x, y, z
    // Broadcast shapes; the first *_shadow of each kind can stand between a surface and a light.
    int flat_count[FLAT_KINDS], flat_shadow[FLAT_KINDS];  // one kind after another
    int cube_count;
    int sphere_count;
    int surface_count;
    int light_count;

    // First rows in their buffers.
    PAVE_U32 flat_row, axis_rect_row, axis_cube_row, cube_row, sphere_row;  // shapes
    PAVE_U32 surface_row, triangle_row, bsdf_row, light_row;                // tables
    PAVE_U32 uv_row, texture_row, environment_row, sobol_row;
    PAVE_U32 leaf_row, instance_row;  // tree; nodes begin at row 0
};
PAVE_SIZEOF(PathParams, 352);

#ifndef __OPENCL_VERSION__
}  // namespace pave::kernel
#endif
