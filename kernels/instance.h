// Instances: a ray goes on in the space of a group, through the group's own tree, and comes back.
// SPDX-License-Identifier: BSD-3-Clause
// The direction keeps its mapped length, so that t means the same in both spaces and the closest
// hit so far ends the ray in either.
#pragma once
#include "scene.h"

/// What a ray starts on and does not hit again: a triangle, and the instance that it is seen in.
typedef struct {
    vint id;
#if PAVE_HAS_INSTANCES
    vint instance;
#endif
} Skip;
static inline Skip no_skip(void) {
    Skip skip;
    skip.id = splat_int(-1);
#if PAVE_HAS_INSTANCES
    skip.instance = splat_int(-1);
#endif
    return skip;
}
static inline Skip select_skip(vmask m, Skip a, Skip b) {
    Skip skip;
    skip.id = m ? a.id : b.id;
#if PAVE_HAS_INSTANCES
    skip.instance = m ? a.instance : b.instance;
#endif
    return skip;
}

#if PAVE_HAS_INSTANCES

static inline __global const float8* instance_at(const Scene* s, int instance) {
    return s->tree + s->p->instance_row + (uint)instance * INSTANCE_ROWS;
}

/// Maps origin and direction to the group's space. The difference from the group's origin comes
/// first: near the instance it is exact, however far that is from the world's.
static inline void map_to_group(__global const float8* rows, const float* o, const float* d,
                                float* group_o, float* group_d) {
    const float8 a = rows[0], b = rows[1];
    const float x = o[0] - a.s3, y = o[1] - a.s7, z = o[2] - b.s3;
    group_o[0] = mad_f(a.s0, x, mad_f(a.s1, y, a.s2 * z));
    group_o[1] = mad_f(a.s4, x, mad_f(a.s5, y, a.s6 * z));
    group_o[2] = mad_f(b.s0, x, mad_f(b.s1, y, b.s2 * z));
    group_d[0] = mad_f(a.s0, d[0], mad_f(a.s1, d[1], a.s2 * d[2]));
    group_d[1] = mad_f(a.s4, d[0], mad_f(a.s5, d[1], a.s6 * d[2]));
    group_d[2] = mad_f(b.s0, d[0], mad_f(b.s1, d[1], b.s2 * d[2]));
}

/// Moves a vertex from a group's space to the world where `instance` >= 0; normals go by the
/// inverse transpose. `scale` is the largest of the coordinates that p came from; it becomes that
/// of all that the ways there and back add up, seen along the normal: new rays start off the
/// surface in proportion to it.
static inline void place_vertex(const Scene* s, vint instance, vec3* p, vec3* n_geom, vec3* n_shade,
                                vfloat* scale) {
    const vmask placed = instance >= 0;
    if (!lane_any(placed)) return;
    __global const float8* table = s->tree + s->p->instance_row;
    const vint row = (placed ? instance : splat_int(0)) * INSTANCE_ROWS;
    const Row r0 = gather_row(table, row), r1 = gather_row(table, row + 1),
              r2 = gather_row(table, row + 2), r3 = gather_row(table, row + 3);
    const vec3 l0 = vec3_of(r0.s0, r0.s1, r0.s2), l1 = vec3_of(r0.s4, r0.s5, r0.s6),
               l2 = vec3_of(r1.s0, r1.s1, r1.s2);
    const vec3 m0 = vec3_of(r2.s0, r2.s1, r2.s2), m1 = vec3_of(r2.s4, r2.s5, r2.s6),
               m2 = vec3_of(r3.s0, r3.s1, r3.s2);
    const vec3 q = vec3_of(dot3(m0, *p), dot3(m1, *p), dot3(m2, *p));  // from the group's origin
    const vec3 origin = vec3_of(r0.s3, r0.s7, r1.s3), world = add3(q, origin);
    const vec3 n = mad3(l0, n_geom->x, mad3(l1, n_geom->y, scale3(l2, n_geom->z)));
    const vec3 m = mad3(l0, n_shade->x, mad3(l1, n_shade->y, scale3(l2, n_shade->z)));
    const vfloat shrink = inverse_sqrt(dot3(n, n));
    const vec3 a = abs3(q), b = abs3(*p);
    const vec3 on_way_in = vec3_of(dot3(abs3(l0), a), dot3(abs3(l1), a), dot3(abs3(l2), a));
    const vec3 on_way_out = vec3_of(dot3(abs3(m0), b), dot3(abs3(m1), b), dot3(abs3(m2), b));
    const vfloat in_group = dot3(abs3(*n_geom), on_way_in) + *scale;
    const vfloat in_world = max_component(add3(on_way_out, abs3(origin)));
    *scale = placed ? mad_f(in_group, shrink, in_world) : *scale;
    *p = select3(placed, world, *p);
    *n_geom = select3(placed, scale3(n, shrink), *n_geom);
    *n_shade = select3(placed, normalize3(m), *n_shade);
}

/// The object that channel `object` shows, where `instance` >= 0.
static inline vint object_of_instance(const Scene* s, vint instance, vint otherwise) {
    const vmask placed = instance >= 0;
    if (!lane_any(placed)) return otherwise;
    const vint row = (placed ? instance : splat_int(0)) * INSTANCE_ROWS + 1;
    const Row r = gather_row(s->tree + s->p->instance_row, row);
    return placed ? as_vint(r.s5) : otherwise;
}

#endif  // PAVE_HAS_INSTANCES
