// Closest hit and occlusion of PAVE_LANES rays: broadcast shapes first, then the tree, together if
// they go the same way, else one by one.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "axis_shapes.h"
#include "packet.h"
#include "walk.h"

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

#if PAVE_HAS_TREE
static inline RayFrames frames_of_scene(const Scene* s, vec3 o, vec3 d) {
    const float bound[3] = {s->p->tree_bound[0], s->p->tree_bound[1], s->p->tree_bound[2]};
    return ray_frames(bound, o, d);
}
static inline void closest_in_tree(const Scene* s, vec3 o, vec3 d, vmask active, Skip skip,
                                   Hit* hit) {
    const RayFrames frames = frames_of_scene(s, o, d);
#if PAVE_HAS_PACKETS
    PacketFrame packet;
    if (!lane_any(lane_not(active)) && packet_frame(&frames, &packet)) {
        packet_closest(s, &frames, &packet, skip, hit);
        return;
    }
#endif
    const uint bits = lane_bits(active & enter_root(s, &frames, hit->t));
    if (!bits) return;
    LaneRays rays;
    store_rays(&rays, &frames, o, d, hit, skip);
    walk_to_closest(s, &rays, bits);
    hit->t = lane_load(rays.t);
    hit->id = lane_load(rays.id);
#if PAVE_HAS_INSTANCES
    hit->instance = lane_load(rays.instance);
#endif
    hit->b1 = lane_load(rays.b1);
    hit->b2 = lane_load(rays.b2);
}
static inline vmask any_in_tree(const Scene* s, vec3 o, vec3 d, vfloat t_max, vmask active,
                                Skip skip) {
    const RayFrames frames = frames_of_scene(s, o, d);
    const uint bits = lane_bits(active & enter_root(s, &frames, t_max));
    if (!bits) return mask_of(0);
    Hit limit = no_hit();
    limit.t = t_max;
    LaneRays rays;
    store_rays(&rays, &frames, o, d, &limit, skip);
    return mask_of_bits(walk_to_any(s, &rays, bits));
}
#endif

/// Closest hit before t_max of the active lanes; the others get nothing of use. `skip`: what
/// the ray starts on, for triangles.
static inline Hit trace_closest(const Scene* s, vec3 o, vec3 d, vfloat t_max, vmask active,
                                Skip skip) {
    Hit hit = no_hit();
    hit.t = t_max;
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
    closest_in_tree(s, o, d, active, skip, &hit);
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
    blocked |= any_in_tree(s, o, d, t_max, active & lane_not(blocked), skip);
#endif
    return blocked & active;
}
