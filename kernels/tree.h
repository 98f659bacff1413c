// Rays and the 8-wide tree: which children of a node a ray enters, what it meets in a leaf.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "instance.h"
#include "intersect.h"
#include "scene.h"

#if PAVE_HAS_TREE

// Axis-parallel rays would divide by zero; this slope is less than a rounding error over any scene.
#define LEAST_SLOPE 1e-18f
// Bounds of a box test's and a hit's rounding, in units of the coordinates (2^-23 * 4): see
// slab_offsets.
#define BOX_SLACK 4.8e-7f

#define RAYS_KEEP_DIRECTION (PAVE_TREE_SHAPES || PAVE_HAS_INSTANCES)

/// What is common to the box and triangle tests of a ray. Boxes: reciprocal slopes, and offsets
/// that make every box wider by more than the rounding of its own test and of the triangle test
/// inside it, at no cost per box; without them rays along shared edges slip through (see
/// test_watertight). Triangles: the shear that turns the ray into its longest axis. Woop, Benthin,
/// Wald 2013, "Watertight ray/triangle intersection".
typedef struct {
    vfloat slope[3], near_offset[3], far_offset[3];
    vint near_row[3];  // 1 if the ray enters boxes at their high side, else 0
    vint longest;
    vfloat origin[3], shear[3];  // along the two axes that follow the longest cyclically, and that
} RayFrames;

/// `bound`: largest |x|, |y|, |z| of the tree.
static inline RayFrames ray_frames(const float* bound, vec3 o, vec3 d) {
    RayFrames f;
    const vfloat from[3] = {o.x, o.y, o.z}, to[3] = {d.x, d.y, d.z};
#pragma unroll
    for (int a = 0; a < 3; ++a) {
        const vmask flat = vabs(to[a]) < LEAST_SLOPE;
        const vfloat slope = 1.0f / (flat ? with_sign(splat(LEAST_SLOPE), to[a]) : to[a]);
        const vfloat base = -from[a] * slope;
        const vfloat slack = BOX_SLACK * (vabs(from[a]) + bound[a]) * vabs(slope);
        f.slope[a] = slope;
        f.near_offset[a] = base - slack;
        f.far_offset[a] = base + slack;
        f.near_row[a] = slope < 0.0f ? splat_int(1) : splat_int(0);
    }
    const vfloat x = vabs(d.x), y = vabs(d.y), z = vabs(d.z);
    const vmask along_x = (x > y) & (x > z), along_y = lane_not(x > y) & (y > z);
    f.longest = along_x ? splat_int(0) : (along_y ? splat_int(1) : splat_int(2));
    f.origin[0] = along_x ? o.y : (along_y ? o.z : o.x);
    f.origin[1] = along_x ? o.z : (along_y ? o.x : o.y);
    f.origin[2] = along_x ? o.x : (along_y ? o.y : o.z);
    f.shear[2] = 1.0f / (along_x ? d.x : (along_y ? d.y : d.z));
    f.shear[0] = (along_x ? d.y : (along_y ? d.z : d.x)) * f.shear[2];
    f.shear[1] = (along_x ? d.z : (along_y ? d.x : d.y)) * f.shear[2];
    return f;
}

/// One of them on its way through the tree.
typedef struct {
    float slope[3], near_offset[3], far_offset[3];
    int near_row[3], longest;
    float origin[3], shear[3];
#if RAYS_KEEP_DIRECTION
    float o[3], d[3];
#endif
    int skip;  // triangle that the ray starts on; a plane is never hit twice
    float t;   // closest so far
    int id;    // -1: nothing yet
    float b1, b2;
#if PAVE_HAS_INSTANCES
    int instance, skip_instance;  // of the hit, and of `skip`
#endif
} TreeRay;

/// Rays of all lanes as arrays, from which each is taken in turn.
typedef struct {
    float slope[3][PAVE_LANES], near_offset[3][PAVE_LANES], far_offset[3][PAVE_LANES];
    int near_row[3][PAVE_LANES], longest[PAVE_LANES], skip[PAVE_LANES];
    float origin[3][PAVE_LANES], shear[3][PAVE_LANES];
#if RAYS_KEEP_DIRECTION
    float o[3][PAVE_LANES], d[3][PAVE_LANES];
#endif
#if PAVE_HAS_INSTANCES
    int instance[PAVE_LANES], skip_instance[PAVE_LANES];
#endif
    float t[PAVE_LANES], b1[PAVE_LANES], b2[PAVE_LANES];
    int id[PAVE_LANES];
} LaneRays;

static inline void store_rays(LaneRays* rays, const RayFrames* f, vec3 o, vec3 d, const Hit* before,
                              Skip skip) {
#pragma unroll
    for (int a = 0; a < 3; ++a) {
        lane_store(f->slope[a], rays->slope[a]);
        lane_store(f->near_offset[a], rays->near_offset[a]);
        lane_store(f->far_offset[a], rays->far_offset[a]);
        lane_store(f->near_row[a], rays->near_row[a]);
        lane_store(f->origin[a], rays->origin[a]);
        lane_store(f->shear[a], rays->shear[a]);
    }
#if RAYS_KEEP_DIRECTION
    lane_store(o.x, rays->o[0]);
    lane_store(o.y, rays->o[1]);
    lane_store(o.z, rays->o[2]);
    lane_store(d.x, rays->d[0]);
    lane_store(d.y, rays->d[1]);
    lane_store(d.z, rays->d[2]);
#endif
    lane_store(f->longest, rays->longest);
    lane_store(skip.id, rays->skip);
#if PAVE_HAS_INSTANCES
    lane_store(before->instance, rays->instance);
    lane_store(skip.instance, rays->skip_instance);
#endif
    lane_store(before->t, rays->t);
    lane_store(before->id, rays->id);
    lane_store(before->b1, rays->b1);
    lane_store(before->b2, rays->b2);
}
static inline TreeRay ray_of_lane(const LaneRays* rays, uint i) {
    TreeRay r;
#pragma unroll
    for (int a = 0; a < 3; ++a) {
        r.slope[a] = rays->slope[a][i];
        r.near_offset[a] = rays->near_offset[a][i];
        r.far_offset[a] = rays->far_offset[a][i];
        r.near_row[a] = rays->near_row[a][i];
        r.origin[a] = rays->origin[a][i];
        r.shear[a] = rays->shear[a][i];
#if RAYS_KEEP_DIRECTION
        r.o[a] = rays->o[a][i];
        r.d[a] = rays->d[a][i];
#endif
    }
    r.longest = rays->longest[i];
    r.skip = rays->skip[i];
    r.t = rays->t[i];
    r.id = -1;
    r.b1 = 0.0f;
    r.b2 = 0.0f;
#if PAVE_HAS_INSTANCES
    r.instance = -1;
    r.skip_instance = rays->skip_instance[i];
#endif
    return r;
}

#if PAVE_HAS_INSTANCES
/// Sets the ray on the way of the frames' first lane.
static inline void aim_ray(TreeRay* r, const RayFrames* f) {
#pragma unroll
    for (int a = 0; a < 3; ++a) {
        r->slope[a] = first_lane(f->slope[a]);
        r->near_offset[a] = first_lane(f->near_offset[a]);
        r->far_offset[a] = first_lane(f->far_offset[a]);
        r->near_row[a] = first_lane(f->near_row[a]);
        r->origin[a] = first_lane(f->origin[a]);
        r->shear[a] = first_lane(f->shear[a]);
    }
    r->longest = first_lane(f->longest);
}
#endif

static inline float8 min_8(float8 a, float8 b) { return a < b ? a : b; }
static inline float8 max_8(float8 a, float8 b) { return a > b ? a : b; }

/// Broadcast once a ray, not once a box.
typedef struct {
    float8 slope[3], near_offset[3], far_offset[3];
    int near_row[3];
} TreeSlabs;
static inline TreeSlabs tree_slabs(const TreeRay* r) {
    TreeSlabs k;
#pragma unroll
    for (int a = 0; a < 3; ++a) {
        k.slope[a] = (float8)(r->slope[a]);
        k.near_offset[a] = (float8)(r->near_offset[a]);
        k.far_offset[a] = (float8)(r->far_offset[a]);
        k.near_row[a] = r->near_row[a];
    }
    return k;
}

/// Bits of the children that the ray enters before `t`; `entry` gets where.
static inline uint enter_children(__global const float8* node, const TreeSlabs* k, float t,
                                  float8* entry) {
    const float8 x0 = mad_f(node[k->near_row[0]], k->slope[0], k->near_offset[0]);
    const float8 x1 = mad_f(node[1 - k->near_row[0]], k->slope[0], k->far_offset[0]);
    const float8 y0 = mad_f(node[2 + k->near_row[1]], k->slope[1], k->near_offset[1]);
    const float8 y1 = mad_f(node[3 - k->near_row[1]], k->slope[1], k->far_offset[1]);
    const float8 z0 = mad_f(node[4 + k->near_row[2]], k->slope[2], k->near_offset[2]);
    const float8 z1 = mad_f(node[5 - k->near_row[2]], k->slope[2], k->far_offset[2]);
    const float8 t_in = max_8(max_8(x0, y0), max_8(z0, (float8)(0.0f)));
    const float8 t_out = min_8(min_8(x1, y1), min_8(z1, (float8)(t)));
    *entry = t_in;
    return bits_of_8(t_in <= t_out);
}

/// Bits of the leaf's triangles that the ray meets before r->t, not yet without r->skip. Edge
/// functions are products without a fused multiply-add: so two triangles get exactly opposite
/// values on a shared edge, and no ray falls between them.
static inline uint meet_triangles(__global const float8* leaf, const TreeRay* r, float8* t,
                                  float8* b1, float8* b2) {
    const int kz = r->longest, kx = kz == 2 ? 0 : kz + 1, ky = kx == 2 ? 0 : kx + 1;
    const float ox = r->origin[0], oy = r->origin[1], oz = r->origin[2];
    const float8 az = leaf[kz] - oz, bz = leaf[3 + kz] - oz, cz = leaf[6 + kz] - oz;
    const float8 sx = (float8)(-r->shear[0]), sy = (float8)(-r->shear[1]);
    const float8 ax = mad_f(sx, az, leaf[kx] - ox), ay = mad_f(sy, az, leaf[ky] - oy);
    const float8 bx = mad_f(sx, bz, leaf[3 + kx] - ox), by = mad_f(sy, bz, leaf[3 + ky] - oy);
    const float8 cx = mad_f(sx, cz, leaf[6 + kx] - ox), cy = mad_f(sy, cz, leaf[6 + ky] - oy);
    const float8 u = cx * by - cy * bx, v = ax * cy - ay * cx, w = bx * ay - by * ax;
    const float8 least = min_8(min_8(u, v), w), most = max_8(max_8(u, v), w);
    const float8 det = (u + v) + w;
    const float8 scale = 1.0f / det;
    *t = mad_f(u, az, mad_f(v, bz, w * cz)) * r->shear[2] * scale;
    *b1 = v * scale;
    *b2 = w * scale;
    // An edge function of 0 belongs to both sides. NaN lanes (spare) fail on t.
    const int8 inside = (least >= 0.0f) | (most <= 0.0f);
    return bits_of_8(inside & (*t > 0.0f) & (*t < (float8)(r->t)));
}

static inline void closest_in_triangles(__global const float8* leaf, TreeRay* r,
                                        int first_triangle_id) {
    float8 t, b1, b2;
    uint m = meet_triangles(leaf, r, &t, &b1, &b2);
    if (m == 0) return;
    float ts[8], b1s[8], b2s[8];
    vstore8(t, 0, ts);
    vstore8(b1, 0, b1s);
    vstore8(b2, 0, b2s);
    __global const int* ids = (__global const int*)(leaf + 9);
    for (; m; m &= m - 1u) {
        const uint i = lowest_bit(m);
        const int id = first_triangle_id + ids[i];
        if (ts[i] < r->t && id != r->skip) {
            r->t = ts[i];
            r->id = id;
            r->b1 = b1s[i];
            r->b2 = b2s[i];
        }
    }
}
static inline int any_in_triangles(__global const float8* leaf, const TreeRay* r,
                                   int first_triangle_id) {
    float8 t, b1, b2;
    uint m = meet_triangles(leaf, r, &t, &b1, &b2);
    __global const int* ids = (__global const int*)(leaf + 9);
    for (; m; m &= m - 1u)
        if (first_triangle_id + ids[lowest_bit(m)] != r->skip) return 1;
    return 0;
}

#if PAVE_TREE_SHAPES
/// A shape's leaf: the broadcast test with the same ray in every lane, which costs no more than a
/// scalar one.
static inline void closest_in_shape(const Scene* s, int code, TreeRay* r) {
    const vec3 o = splat3(r->o[0], r->o[1], r->o[2]), d = splat3(r->d[0], r->d[1], r->d[2]);
    const int kind = leaf_kind(code), index = leaf_index(code);
    Hit hit = no_hit();
    hit.t = splat(r->t);
    hit.id = splat_int(r->id);
    if (kind == LEAF_FLAT) {
        __global const FlatShape* f = flat_shapes(s, FLAT_RECT) + index;
        closest_flat(f, (int)f->kind, o, d, &hit);
    } else if (kind == LEAF_CUBE) {
        closest_cube(cube_shapes(s) + index, o, d, &hit);
    } else {
        closest_sphere(sphere_shapes(s) + index, o, d, &hit);
    }
    float t[PAVE_LANES];
    int id[PAVE_LANES];
    lane_store(hit.t, t);
    lane_store(hit.id, id);
    r->t = t[0];
    r->id = id[0];
}
static inline int any_in_shape(const Scene* s, int code, const TreeRay* r) {
    const vec3 o = splat3(r->o[0], r->o[1], r->o[2]), d = splat3(r->d[0], r->d[1], r->d[2]);
    const int kind = leaf_kind(code), index = leaf_index(code);
    const vfloat t = splat(r->t);
    if (kind == LEAF_FLAT) {
        __global const FlatShape* f = flat_shapes(s, FLAT_RECT) + index;
        return lane_any(occludes_flat(f, (int)f->kind, o, d, t));
    }
    if (kind == LEAF_CUBE) return lane_any(occludes_cube(cube_shapes(s) + index, o, d, t));
    return lane_any(occludes_sphere(sphere_shapes(s) + index, o, d, t));
}
#endif

static inline void closest_in_leaf(const Scene* s, int code, TreeRay* r) {
#if PAVE_TREE_SHAPES
    if (leaf_kind(code) != LEAF_TRIANGLES) {
        closest_in_shape(s, code, r);
        return;
    }
#endif
#if PAVE_HAS_TRIANGLES
    closest_in_triangles(s->tree + s->p->leaf_row + (uint)leaf_index(code) * LEAF_ROWS, r,
                         s->p->surface_count);
#endif
}
static inline int any_in_leaf(const Scene* s, int code, const TreeRay* r) {
#if PAVE_TREE_SHAPES
    if (leaf_kind(code) != LEAF_TRIANGLES) return any_in_shape(s, code, r);
#endif
#if PAVE_HAS_TRIANGLES
    return any_in_triangles(s->tree + s->p->leaf_row + (uint)leaf_index(code) * LEAF_ROWS, r,
                            s->p->surface_count);
#else
    return 0;
#endif
}

/// Lanes whose ray enters a child of the root before `t`: most rays of a scene with some room
/// around its tree do not, and are told here all at once.
static inline vmask enter_root(const Scene* s, const RayFrames* f, vfloat t) {
    __global const float* node = (__global const float*)s->tree;
    const vmask back[3] = {f->near_row[0] != 0, f->near_row[1] != 0, f->near_row[2] != 0};
    vmask enters = mask_of(0);
    for (int c = 0; c < TREE_WIDTH; ++c) {
        if (node[c] == INFINITY) break;  // empty children come last
        vfloat t_in = splat(0.0f), t_out = t;
#pragma unroll
        for (int a = 0; a < 3; ++a) {
            const vfloat low = splat(node[16 * a + c]), high = splat(node[16 * a + 8 + c]);
            const vfloat near = mad_f(back[a] ? high : low, f->slope[a], f->near_offset[a]);
            const vfloat far = mad_f(back[a] ? low : high, f->slope[a], f->far_offset[a]);
            t_in = vmax(near, t_in);
            t_out = vmin(far, t_out);
        }
        enters |= t_in <= t_out;
    }
    return enters;
}

#endif  // PAVE_HAS_TREE
