// Rays against rectangles, disks, cubes and spheres: one shape, PAVE_LANES rays.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "features.h"
#include "vec3.h"

/// Closest hit so far. `t` counts in lengths of the ray's direction.
typedef struct {
    vfloat t;       // INFINITY: none
    vint id;        // surface, or surface_count + triangle
    vfloat b1, b2;  // weights of a triangle's second and third vertex
} Hit;

static inline Hit no_hit(void) {
    Hit hit;
    hit.t = splat(INFINITY);
    hit.id = splat_int(0);
    hit.b1 = splat(0.0f);
    hit.b2 = splat(0.0f);
    return hit;
}

static inline vfloat linear(__global const ShapeFloat* row, vec3 p) {
    return mad_f(splat(row[0]), p.x, mad_f(splat(row[1]), p.y, splat(row[2]) * p.z));
}
static inline vfloat affine(__global const ShapeFloat* row, vec3 p) {
    return mad_f(splat(row[0]), p.x,
                 mad_f(splat(row[1]), p.y, mad_f(splat(row[2]), p.z, splat(row[3]))));
}

/// Where the ray meets the rectangle or disk: t, and whether that is inside and ahead.
static inline vmask meet_flat(__global const FlatShape* s, int is_disk, vec3 o, vec3 d, vfloat* t) {
    *t = (s->n[3] - linear(s->n, o)) / linear(s->n, d);
    const vec3 p = mad3(d, *t, o);
    const vfloat x = affine(s->u, p), y = affine(s->v, p);
    const vfloat extent = is_disk ? mad_f(x, x, y * y) : vmax(vabs(x), vabs(y));
    // vmax(NaN, y) is y, but then t is NaN or infinite too and the caller's t < t_max fails.
    return (extent <= s->limit) & (*t > 0.0f);
}
static inline void closest_flat(__global const FlatShape* s, int is_disk, vec3 o, vec3 d,
                                Hit* hit) {
    vfloat t;
    const vmask m = meet_flat(s, is_disk, o, d, &t) & (t < hit->t);
    hit->t = m ? t : hit->t;
    hit->id = m ? as_vint(splat_uint(s->surface)) : hit->id;
}
static inline vmask occludes_flat(__global const FlatShape* s, int is_disk, vec3 o, vec3 d,
                                  vfloat t_max) {
    vfloat t;
    return meet_flat(s, is_disk, o, d, &t) & (t < t_max);
}

/// Slabs of a cube: per axis the entry and exit, and the direction's sign in `pace`.
typedef struct {
    vec3 enter, leave, pace;
    vfloat t_in, t_out;
} Slabs;
static inline Slabs meet_slabs(__global const CubeShape* s, vec3 o, vec3 d) {
    Slabs r;
    r.pace = vec3_of(1.0f / linear(s->row[0], d), 1.0f / linear(s->row[1], d),
                     1.0f / linear(s->row[2], d));
    const vec3 at = vec3_of(linear(s->row[0], o), linear(s->row[1], o), linear(s->row[2], o));
    const vec3 low = vec3_of((s->row[0][3] - at.x) * r.pace.x, (s->row[1][3] - at.y) * r.pace.y,
                             (s->row[2][3] - at.z) * r.pace.z);
    const vec3 high = vec3_of((s->high[0] - at.x) * r.pace.x, (s->high[1] - at.y) * r.pace.y,
                              (s->high[2] - at.z) * r.pace.z);
    r.enter = vec3_of(vmin(low.x, high.x), vmin(low.y, high.y), vmin(low.z, high.z));
    r.leave = vec3_of(vmax(low.x, high.x), vmax(low.y, high.y), vmax(low.z, high.z));
    r.t_in = vmax(vmax(r.enter.x, r.enter.y), r.enter.z);
    r.t_out = vmin(vmin(r.leave.x, r.leave.y), r.leave.z);
    return r;
}
static inline void closest_cube(__global const CubeShape* s, vec3 o, vec3 d, Hit* hit) {
    const Slabs r = meet_slabs(s, o, d);
    const vmask entering = r.t_in > 0.0f;
    const vfloat t = entering ? r.t_in : r.t_out;
    const vmask m = (r.t_in <= r.t_out) & (t > 0.0f) & (t < hit->t);
    const vmask is_x = (entering ? r.enter.x : r.leave.x) == t;
    const vmask is_y = (entering ? r.enter.y : r.leave.y) == t;
    const vfloat pace = is_x ? r.pace.x : (is_y ? r.pace.y : r.pace.z);
    // Entering against the axis and leaving along it both pass the high face.
    const vmask high = entering ? (pace < 0.0f) : (pace > 0.0f);
    const vint face = (is_x ? splat_int(0) : (is_y ? splat_int(2) : splat_int(4))) +
                      (high ? splat_int(1) : splat_int(0));
    hit->t = m ? t : hit->t;
    hit->id = m ? face + as_vint(splat_uint(s->surface)) : hit->id;
}
static inline vmask occludes_cube(__global const CubeShape* s, vec3 o, vec3 d, vfloat t_max) {
    const Slabs r = meet_slabs(s, o, d);
    const vfloat t = r.t_in > 0.0f ? r.t_in : r.t_out;
    return (r.t_in <= r.t_out) & (t > 0.0f) & (t < t_max);
}

/// First root ahead. The discriminant comes from the ray's distance to the center and the roots
/// from a product, which keeps large and distant spheres exact: Haines et al. 2019, "Precision
/// improvements for ray/sphere intersection".
static inline vmask meet_sphere(__global const SphereShape* s, vec3 o, vec3 d, vfloat* t) {
    const vec3 f = vec3_of(o.x - s->center[0], o.y - s->center[1], o.z - s->center[2]);
    const vfloat a = dot3(d, d), b = dot3(f, d);
    const vec3 nearest = mad3(d, -b / a, f);
    const vfloat r = splat(s->radius);
    const vfloat root = a * (r * r - dot3(nearest, nearest));
    const vfloat q = -b - with_sign(safe_sqrt(root), b);
    const vfloat t_a = (dot3(f, f) - r * r) / q, t_b = q / a;
    const vfloat t_in = vmin(t_a, t_b), t_out = vmax(t_a, t_b);
    *t = t_in > 0.0f ? t_in : t_out;
    return (root >= 0.0f) & (*t > 0.0f);
}
static inline void closest_sphere(__global const SphereShape* s, vec3 o, vec3 d, Hit* hit) {
    vfloat t;
    const vmask m = meet_sphere(s, o, d, &t) & (t < hit->t);
    hit->t = m ? t : hit->t;
    hit->id = m ? as_vint(splat_uint(s->surface)) : hit->id;
}
static inline vmask occludes_sphere(__global const SphereShape* s, vec3 o, vec3 d, vfloat t_max) {
    vfloat t;
    return meet_sphere(s, o, d, &t) & (t < t_max);
}
