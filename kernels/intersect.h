// Rays against rectangles, disks, cubes and spheres: one shape, PAVE_LANES rays.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "features.h"
#include "vec3.h"

/// Closest hit so far. `t` counts in lengths of the ray's direction.
typedef struct {
    vfloat t;  // INFINITY: none
    vint id;   // surface, or surface_count + triangle
#if PAVE_HAS_INSTANCES
    vint instance;  // that the triangle is seen in, -1: none
#endif
    vfloat b1, b2;  // weights of a triangle's second and third vertex
} Hit;

static inline Hit no_hit(void) {
    Hit hit;
    hit.t = splat(INFINITY);
    hit.id = splat_int(0);
#if PAVE_HAS_INSTANCES
    hit.instance = splat_int(-1);
#endif
    hit.b1 = splat(0.0f);
    hit.b2 = splat(0.0f);
    return hit;
}

/// Where `m`, which is closer than all before.
static inline void take_hit(Hit* hit, vmask m, vfloat t, vint id) {
    hit->t = m ? t : hit->t;
    hit->id = m ? id : hit->id;
}

static inline vfloat linear(__global const ShapeFloat* row, vec3 p) {
    return mad_f(splat(row[0]), p.x, mad_f(splat(row[1]), p.y, splat(row[2]) * p.z));
}
static inline vfloat affine(__global const ShapeFloat* row, vec3 p) {
    return mad_f(splat(row[0]), p.x,
                 mad_f(splat(row[1]), p.y, mad_f(splat(row[2]), p.z, splat(row[3]))));
}

/// Where the ray meets the flat shape: t, and whether that is inside and ahead.
static inline vmask meet_flat(__global const FlatShape* s, int kind, vec3 o, vec3 d, vfloat* t) {
    *t = (s->n[3] - linear(s->n, o)) * reciprocal(linear(s->n, d));
    const vec3 p = mad3(d, *t, o);
    const vfloat x = affine(s->u, p), y = affine(s->v, p);
    const vfloat extent = kind == FLAT_RECT   ? vmax(vabs(x), vabs(y))
                          : kind == FLAT_DISK ? mad_f(x, x, y * y)
                                              : vmax(vmax(-x, -y), x + y - 1.0f);
    // vmax(NaN, y) is y, but then t is NaN or infinite too and the caller's t < t_max fails.
    return (extent <= s->limit) & (*t > 0.0f);
}
static inline void closest_flat(__global const FlatShape* s, int kind, vec3 o, vec3 d, Hit* hit) {
    vfloat t;
    const vmask m = meet_flat(s, kind, o, d, &t) & (t < hit->t);
    take_hit(hit, m, t, as_vint(splat_uint(s->surface)));
}
static inline vmask occludes_flat(__global const FlatShape* s, int kind, vec3 o, vec3 d,
                                  vfloat t_max) {
    vfloat t;
    return meet_flat(s, kind, o, d, &t) & (t < t_max);
}

/// Slabs of a cube: per axis the entry and exit, and the direction's sign in `pace`.
typedef struct {
    vec3 enter, leave, pace;
    vfloat t_in, t_out;
} Slabs;
/// From object coordinates: the origin's, and the reciprocal of the direction's.
static inline Slabs slabs_of(vec3 at, vec3 pace) {
    Slabs r;
    const vec3 across = vec3_of(vabs(pace.x), vabs(pace.y), vabs(pace.z));
    r.pace = pace;
    r.enter = vec3_of(mad_f(-at.x, pace.x, -across.x), mad_f(-at.y, pace.y, -across.y),
                      mad_f(-at.z, pace.z, -across.z));
    r.leave = vec3_of(mad_f(-at.x, pace.x, across.x), mad_f(-at.y, pace.y, across.y),
                      mad_f(-at.z, pace.z, across.z));
    r.t_in = vmax(vmax(r.enter.x, r.enter.y), r.enter.z);
    r.t_out = vmin(vmin(r.leave.x, r.leave.y), r.leave.z);
    return r;
}
static inline Slabs meet_cube(__global const CubeShape* s, vec3 o, vec3 d) {
    return slabs_of(vec3_of(affine(s->row[0], o), affine(s->row[1], o), affine(s->row[2], o)),
                    vec3_of(slope_of(linear(s->row[0], d)), slope_of(linear(s->row[1], d)),
                            slope_of(linear(s->row[2], d))));
}

/// 0 or 1 by the sign.
static inline vint sign_bit(vfloat x) { return as_vint(as_vuint(x) >> 31); }
/// Takes the face of the cube that the ray meets first; x, y and z are the low faces' surfaces.
static inline void closest_slabs(const Slabs* r, vint x, vint y, vint z, Hit* hit) {
    const vmask through = r->t_in <= r->t_out;
    // Entering against an axis passes its high face, which has the next number.
    vint face = z + sign_bit(r->pace.z);
    face = r->enter.y == r->t_in ? y + sign_bit(r->pace.y) : face;
    face = r->enter.x == r->t_in ? x + sign_bit(r->pace.x) : face;
    const vmask enters = through & (r->t_in > 0.0f) & (r->t_in < hit->t);
    take_hit(hit, enters, r->t_in, face);
    const vmask leaves = through & (r->t_in <= 0.0f) & (r->t_out > 0.0f) & (r->t_out < hit->t);
    if (!lane_any(leaves)) return;  // only rays that start inside
    face = z + 1 - sign_bit(r->pace.z);
    face = r->leave.y == r->t_out ? y + 1 - sign_bit(r->pace.y) : face;
    face = r->leave.x == r->t_out ? x + 1 - sign_bit(r->pace.x) : face;
    take_hit(hit, leaves, r->t_out, face);
}
static inline vmask occludes_slabs(const Slabs* r, vfloat t_max) {
    const vfloat t = r->t_in > 0.0f ? r->t_in : r->t_out;
    return (r->t_in <= r->t_out) & (t > 0.0f) & (t < t_max);
}
static inline void closest_cube(__global const CubeShape* s, vec3 o, vec3 d, Hit* hit) {
    const Slabs r = meet_cube(s, o, d);
    const vint face = as_vint(splat_uint(s->surface));
    closest_slabs(&r, face, face + 2, face + 4, hit);
}
static inline vmask occludes_cube(__global const CubeShape* s, vec3 o, vec3 d, vfloat t_max) {
    const Slabs r = meet_cube(s, o, d);
    return occludes_slabs(&r, t_max);
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
    take_hit(hit, m, t, as_vint(splat_uint(s->surface)));
}
static inline vmask occludes_sphere(__global const SphereShape* s, vec3 o, vec3 d, vfloat t_max) {
    vfloat t;
    return meet_sphere(s, o, d, &t) & (t < t_max);
}
