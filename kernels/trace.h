// Closest hit and occlusion of PAVE_LANES rays: broadcast shapes first, then the tree ray by ray.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "axis_shapes.h"
#include "tree.h"

#if PAVE_HAS_TREE
/// Rays as arrays, for the lane-by-lane walk.
typedef struct {
    float o[3][PAVE_LANES], d[3][PAVE_LANES], t[PAVE_LANES];
    int skip[PAVE_LANES];
#if PAVE_HAS_INSTANCES
    int skip_instance[PAVE_LANES];
#endif
} LaneRays;

static inline void store_rays(LaneRays* rays, vec3 o, vec3 d, vfloat t, Skip skip) {
    lane_store(o.x, rays->o[0]);
    lane_store(o.y, rays->o[1]);
    lane_store(o.z, rays->o[2]);
    lane_store(d.x, rays->d[0]);
    lane_store(d.y, rays->d[1]);
    lane_store(d.z, rays->d[2]);
    lane_store(t, rays->t);
    lane_store(skip.id, rays->skip);
#if PAVE_HAS_INSTANCES
    lane_store(skip.instance, rays->skip_instance);
#endif
}
static inline TreeRay ray_of_lane(const LaneRays* rays, uint i) {
    TreeRay r;
    for (int a = 0; a < 3; ++a) {
        r.o[a] = rays->o[a][i];
        r.d[a] = rays->d[a][i];
    }
    r.t = rays->t[i];
    r.id = -1;
    r.b1 = 0.0f;
    r.b2 = 0.0f;
    r.skip = rays->skip[i];
#if PAVE_HAS_INSTANCES
    r.instance = -1;
    r.skip_instance = rays->skip_instance[i];
#endif
    return r;
}
#endif

static inline void closest_flats(const Scene* s, int kind, vec3 o, vec3 d, Hit* hit) {
    __global const FlatShape* first = flat_shapes(s, kind);
    for (int i = 0; i < s->p->flat_count[kind]; ++i) closest_flat(first + i, kind, o, d, hit);
}
/// The first flat_shadow[kind] of a kind are those that can block.
static inline vmask any_flats(const Scene* s, int kind, vec3 o, vec3 d, vfloat t_max) {
    __global const FlatShape* first = flat_shapes(s, kind);
    vmask blocked = mask_of(0);
    for (int i = 0; i < s->p->flat_shadow[kind]; ++i)
        blocked |= occludes_flat(first + i, kind, o, d, t_max);
    return blocked;
}

/// Closest hit of the active lanes; the others get nothing of use. `skip`: what the ray starts on,
/// for triangles.
static inline Hit trace_closest(const Scene* s, vec3 o, vec3 d, vmask active, Skip skip) {
    Hit hit = no_hit();
    __constant const PathParams* p = s->p;
#if PAVE_HAS_AXIS_RECTS || PAVE_HAS_AXIS_CUBES
    const AxisRays axis = axis_rays(o, d);
#endif
#if PAVE_HAS_AXIS_RECTS
    closest_axis_rects(s, &axis, &hit);
#endif
#if PAVE_HAS_AXIS_CUBES
    closest_axis_cubes(s, &axis, &hit);
#endif
#if PAVE_HAS_RECTS
    closest_flats(s, FLAT_RECT, o, d, &hit);
#endif
#if PAVE_HAS_DISKS
    closest_flats(s, FLAT_DISK, o, d, &hit);
#endif
#if PAVE_HAS_FLAT_TRIANGLES
    closest_flats(s, FLAT_TRIANGLE, o, d, &hit);
#endif
#if PAVE_HAS_CUBES
    for (int i = 0; i < p->cube_count; ++i) closest_cube(cube_shapes(s) + i, o, d, &hit);
#endif
#if PAVE_HAS_SPHERES
    for (int i = 0; i < p->sphere_count; ++i) closest_sphere(sphere_shapes(s) + i, o, d, &hit);
#endif
#if PAVE_HAS_TREE
    LaneRays rays;
    store_rays(&rays, o, d, hit.t, skip);
    float b1[PAVE_LANES], b2[PAVE_LANES];
    int id[PAVE_LANES];
    lane_store(hit.b1, b1);
    lane_store(hit.b2, b2);
    lane_store(hit.id, id);
#if PAVE_HAS_INSTANCES
    int instance[PAVE_LANES];
    lane_store(hit.instance, instance);
#endif
    for (uint bits = lane_bits(active); bits; bits &= bits - 1u) {
        const uint i = lowest_bit(bits);
        TreeRay r = ray_of_lane(&rays, i);
        tree_closest(s, &r);
        if (r.id >= 0) {
            rays.t[i] = r.t;
            id[i] = r.id;
#if PAVE_HAS_INSTANCES
            instance[i] = r.instance;
#endif
            b1[i] = r.b1;
            b2[i] = r.b2;
        }
    }
    hit.t = lane_load(rays.t);
    hit.id = lane_load(id);
#if PAVE_HAS_INSTANCES
    hit.instance = lane_load(instance);
#endif
    hit.b1 = lane_load(b1);
    hit.b2 = lane_load(b2);
#endif
    return hit;
}

/// Lanes of `active` whose ray meets something between 0 and t_max. For rays from a surface to a
/// light: shapes that can not stand between them (those from flat_shadow[kind] on) are left out.
static inline vmask trace_any(const Scene* s, vec3 o, vec3 d, vfloat t_max, vmask active,
                              Skip skip) {
    vmask blocked = mask_of(0);
    __constant const PathParams* p = s->p;
#if PAVE_HAS_AXIS_RECTS || PAVE_HAS_AXIS_CUBES
    const AxisRays axis = axis_rays(o, d);
#endif
#if PAVE_HAS_AXIS_RECTS
    blocked |= any_axis_rects(s, &axis, t_max);
#endif
#if PAVE_HAS_AXIS_CUBES
    blocked |= any_axis_cubes(s, &axis, t_max);
#endif
#if PAVE_HAS_RECTS
    blocked |= any_flats(s, FLAT_RECT, o, d, t_max);
#endif
#if PAVE_HAS_DISKS
    blocked |= any_flats(s, FLAT_DISK, o, d, t_max);
#endif
#if PAVE_HAS_FLAT_TRIANGLES
    blocked |= any_flats(s, FLAT_TRIANGLE, o, d, t_max);
#endif
#if PAVE_HAS_CUBES
    for (int i = 0; i < p->cube_count; ++i)
        blocked |= occludes_cube(cube_shapes(s) + i, o, d, t_max);
#endif
#if PAVE_HAS_SPHERES
    for (int i = 0; i < p->sphere_count; ++i)
        blocked |= occludes_sphere(sphere_shapes(s) + i, o, d, t_max);
#endif
#if PAVE_HAS_TREE
    LaneRays rays;
    store_rays(&rays, o, d, t_max, skip);
    int found[PAVE_LANES];
    lane_store(blocked, found);
    for (uint bits = lane_bits(active & lane_not(blocked)); bits; bits &= bits - 1u) {
        const uint i = lowest_bit(bits);
        TreeRay r = ray_of_lane(&rays, i);
        if (tree_any(s, &r)) found[i] = MASK_BITS;
    }
    blocked = lane_load(found);
#endif
    return blocked & active;
}
