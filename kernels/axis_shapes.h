// Rays against rectangles and cubes that have edges along a coordinate axis: a third less work than
// turned ones.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "intersect.h"
#include "scene.h"

/// What is worth computing once for all of them.
typedef struct {
    vfloat o[3], d[3], slope[3];
} AxisRays;
static inline AxisRays axis_rays(vec3 o, vec3 d) {
    AxisRays r = {{o.x, o.y, o.z}, {d.x, d.y, d.z}, {slope_of(d.x), slope_of(d.y), slope_of(d.z)}};
    return r;
}

#if PAVE_HAS_AXIS_RECTS
/// Where rays meet a rectangle across axis k.
static inline vmask meet_axis_rect(__global const AxisRect* s, const AxisRays* r, int k,
                                   vfloat* t) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    *t = (s->plane - r->o[k]) * r->slope[k];
    const vfloat x = mad_f(r->d[i], *t, r->o[i]) - s->center[0];
    const vfloat y = mad_f(r->d[j], *t, r->o[j]) - s->center[1];
    return (vabs(x) <= s->reach[0]) & (vabs(y) <= s->reach[1]) & (*t > 0.0f);
}
static inline void closest_axis_rects(const Scene* s, const AxisRays* rays, Hit* hit) {
    __global const AxisRect* rect = axis_rects(s);
#pragma unroll
    for (int k = 0; k < 3; ++k)
        for (int i = 0; i < s->p->axis_rects[k]; ++i, ++rect) {
            vfloat t;
            const vmask m = meet_axis_rect(rect, rays, k, &t) & (t < hit->t);
            take_hit(hit, m, t, as_vint(splat_uint(rect->surface)));
        }
}
/// The first axis_shadow[k] across each axis are those that can block.
static inline vmask any_axis_rects(const Scene* s, const AxisRays* rays, vfloat t_max) {
    __global const AxisRect* first = axis_rects(s);
    vmask blocked = mask_of(0);
#pragma unroll
    for (int k = 0; k < 3; ++k) {
        for (int i = 0; i < s->p->axis_shadow[k]; ++i) {
            vfloat t;
            blocked |= meet_axis_rect(first + i, rays, k, &t) & (t < t_max);
        }
        first += s->p->axis_rects[k];
    }
    return blocked;
}
#endif

#if PAVE_HAS_AXIS_CUBES
static inline Slabs meet_axis_cube(__global const AxisCube* s, const AxisRays* r, int k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    const vec3 at = vec3_of(mad_f(s->u[0], r->o[i], mad_f(s->u[1], r->o[j], s->u[2])),
                            mad_f(s->v[0], r->o[i], mad_f(s->v[1], r->o[j], s->v[2])),
                            mad_f(s->along[0], r->o[k], s->along[1]));
    const vec3 pace =
        vec3_of(slope_of(mad_f(s->u[0], r->d[i], s->u[1] * r->d[j])),
                slope_of(mad_f(s->v[0], r->d[i], s->v[1] * r->d[j])), s->half_length * r->slope[k]);
    return slabs_of(at, pace);
}
static inline void closest_axis_cubes(const Scene* s, const AxisRays* rays, Hit* hit) {
    __global const AxisCube* cube = axis_cubes(s);
#pragma unroll
    for (int k = 0; k < 3; ++k)
        for (int i = 0; i < s->p->axis_cubes[k]; ++i, ++cube) {
            const Slabs r = meet_axis_cube(cube, rays, k);
            closest_slabs(&r, as_vint(splat_uint(cube->face_u)), as_vint(splat_uint(cube->face_v)),
                          as_vint(splat_uint(cube->face_along)), hit);
        }
}
static inline vmask any_axis_cubes(const Scene* s, const AxisRays* rays, vfloat t_max) {
    __global const AxisCube* cube = axis_cubes(s);
    vmask blocked = mask_of(0);
#pragma unroll
    for (int k = 0; k < 3; ++k)
        for (int i = 0; i < s->p->axis_cubes[k]; ++i, ++cube) {
            const Slabs r = meet_axis_cube(cube, rays, k);
            blocked |= occludes_slabs(&r, t_max);
        }
    return blocked;
}
#endif
