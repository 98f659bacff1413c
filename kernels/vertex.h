// From a hit to a path vertex: position on the surface, normals, material word, and where new rays
// start.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "tree.h"

// A new ray starts this far off its surface, relative to the coordinates that its position was
// computed from: 16 roundings. Positions are put back onto their surface below, so their error
// along the normal is a few roundings (see test_self_hit).
#define OFFSET_RELATIVE 9.5367431640625e-7f  // 2^-20

typedef struct {
    vmask valid;
    vec3 p;
    vec3 n_geom, n_shade;  // as the surface defines them, not turned to the ray
    vec3
        albedo;  // diffuse reflectance; rough conductors: at normal incidence; 0 if purely specular
    vint bits;   // BITS of render_types.h
    vint light;  // triangles only; see light_of_vertex
    vint id;
#if PAVE_HAS_INSTANCES
    vint instance;  // -1: none
#endif
    vfloat offset;
#if PAVE_HAS_TEXTURES
    vfloat tu, tv;  // texture coordinates, where the material has a texture
#endif
} Vertex;

static inline vfloat offset_at(const Scene* s, vfloat scale) {
    return mad_f(splat(OFFSET_RELATIVE), scale, splat(s->p->offset_floor));
}

/// For rays from the vertex, which do not hit its triangle again.
static inline Skip skip_of(const Vertex* v) {
    Skip skip;
    skip.id = v->id;
#if PAVE_HAS_INSTANCES
    skip.instance = v->instance;
#endif
    return skip;
}

/// Start of a ray from p towards w, on w's side of the surface.
static inline vec3 leave_surface(vec3 p, vec3 n_geom, vfloat offset, vec3 w) {
    return mad3(n_geom, mul_sign(offset, dot3(n_geom, w)), p);
}

#if PAVE_HAS_SMOOTH
/// Unit normal out of a word; 0 of the word 0. Cigolle et al. 2014, "Survey of efficient
/// representations for independent unit vectors": an octahedron unfolded into the unit square, 16
/// bits a coordinate, which is within 7e-5.
static inline vec3 unpack_normal(vfloat word) {
    const vuint bits = as_vuint(word);
    vfloat x = to_vfloat(as_vint(bits & 0xffffu) - 32768) * (1.0f / 32767.0f);
    vfloat y = to_vfloat(as_vint(bits >> 16) - 32768) * (1.0f / 32767.0f);
    const vfloat z = 1.0f - vabs(x) - vabs(y), fold = vmax(-z, splat(0.0f));
    x -= with_sign(fold, x);
    y -= with_sign(fold, y);
    const vfloat scale = keep(bits != 0u, inverse_sqrt(mad_f(x, x, mad_f(y, y, z * z))));
    return vec3_of(x * scale, y * scale, z * scale);
}
/// Interpolated vertex normal where the triangle, of whose second row these are columns, has them
/// and they do not cancel; else n_geom.
static inline vec3 smooth_normal(const Row* r, vfloat b1, vfloat b2, vec3 n_geom) {
    vec3 n = scale3(unpack_normal(r->s4), 1.0f - b1 - b2);
    n = mad3(unpack_normal(r->s5), b1, n);
    n = mad3(unpack_normal(r->s6), b2, n);
    const vfloat squared = dot3(n, n);
    return select3(squared > 1e-20f, scale3(n, inverse_sqrt(squared)), n_geom);
}
#endif

#if PAVE_HAS_TRIANGLES
/// Overwrites the lanes of `m`, whose hits are triangles.
static inline void triangle_vertex(const Scene* s, const Hit* hit, vmask m, Vertex* v) {
    __global const float8* table = s->tables + s->p->triangle_row;
    const vint row = (m ? hit->id - s->p->surface_count : splat_int(0)) * TRIANGLE_ROWS;
    const Row r0 = gather_row(table, row), r1 = gather_row(table, row + 1);
    const vec3 v0 = vec3_of(r0.s0, r0.s1, r0.s2), v1 = vec3_of(r0.s4, r0.s5, r0.s6),
               v2 = vec3_of(r1.s0, r1.s1, r1.s2);
    const vec3 e1 = sub3(v1, v0), e2 = sub3(v2, v0);
    vec3 n_geom = normalize3(cross3(e1, e2)), n_shade = n_geom;
#if PAVE_HAS_SMOOTH
    n_shade = smooth_normal(&r1, hit->b1, hit->b2, n_geom);
#endif
    vfloat scale = vmax(max_abs_component(v0), vmax(max_abs_component(v1), max_abs_component(v2)));
    // From the vertices, not along the ray: the error does not grow with the ray's length.
    vec3 p = mad3(e2, hit->b2, mad3(e1, hit->b1, v0));
#if PAVE_HAS_INSTANCES
    place_vertex(s, m ? hit->instance : splat_int(-1), &p, &n_geom, &n_shade, &scale);
#endif
    v->p = select3(m, p, v->p);
    v->n_geom = select3(m, n_geom, v->n_geom);
    v->n_shade = select3(m, n_shade, v->n_shade);
    v->bits = m ? as_vint(r0.s3) : v->bits;
    v->light = m ? as_vint(r0.s7) : v->light;
    v->offset = m ? offset_at(s, scale) : v->offset;
}
#endif

#if PAVE_HAS_SHAPES || PAVE_TREE_SHAPES
static inline void shape_vertex(const Scene* s, const Hit* hit, vmask triangle, vec3 o, vec3 d,
                                Vertex* v) {
    const Row r = surface_row(s, triangle ? splat_int(0) : hit->id);
    const vec3 q = vec3_of(r.s0, r.s1, r.s2);
    const vec3 p = mad3(d, hit->t, o);
    v->bits = as_vint(r.s3);
    v->albedo = vec3_of(r.s4, r.s5, r.s6);
    v->n_geom = q;
    v->p = mad3(q, r.s7 - dot3(q, p), p);  // onto the plane
    vfloat scale = max_abs_component(v->p);
#if PAVE_HAS_SPHERES || PAVE_TREE_SHAPES
    const vmask sphere = bits_kind(v->bits) == SURFACE_SPHERE;
    if (lane_any(sphere)) {
        const vec3 out = normalize3(sub3(p, q));
        const vmask inverted = sphere & bits_inverted(v->bits);
        v->p = select3(sphere, mad3(out, r.s7, q), v->p);
        v->n_geom = select3(sphere, select3(inverted, neg3(out), out), v->n_geom);
        scale = sphere ? max_abs_component(q) + r.s7 : scale;
    }
#endif
    v->n_shade = v->n_geom;
    v->offset = offset_at(s, scale);
}
#endif

static inline Vertex vertex_of(const Scene* s, const Hit* hit, vec3 o, vec3 d) {
    Vertex v;
    v.valid = hit->t < INFINITY;
    v.id = hit->id;
#if PAVE_HAS_INSTANCES
    v.instance = hit->instance;
#endif
    v.light = splat_int(0);
#if PAVE_HAS_TRIANGLES
    const vmask triangle = hit->id >= s->p->surface_count;
#else
    const vmask triangle = mask_of(0);
#endif
#if PAVE_HAS_SHAPES || PAVE_TREE_SHAPES
    shape_vertex(s, hit, triangle, o, d, &v);
#else
    v.p = v.n_geom = v.n_shade = v.albedo = splat3(0.0f, 0.0f, 0.0f);
    v.bits = splat_int(0);
    v.offset = splat(0.0f);
#endif
#if PAVE_HAS_TRIANGLES
    triangle_vertex(s, hit, triangle, &v);
    const Row b = gather_row(s->tables + s->p->bsdf_row, bits_bsdf(v.bits) * BSDF_ROWS);
    v.albedo = vec3_of(b.s0, b.s1, b.s2);
#endif
    return v;
}

/// Second row of the vertex's surface or triangle, for what few vertices need: { tangent, light,
/// object } or { v2, object, .. }.
static inline Row cold_row(const Scene* s, const Vertex* v, vmask* triangle) {
#if PAVE_HAS_TRIANGLES
    *triangle = v->id >= s->p->surface_count;
    const vint shape_row = (int)s->p->surface_row + v->id * SURFACE_ROWS + 1;
    const vint triangle_row =
        (int)s->p->triangle_row + (v->id - s->p->surface_count) * TRIANGLE_ROWS + 1;
    return gather_row(s->tables, *triangle ? triangle_row : shape_row);
#else
    *triangle = mask_of(0);
    return gather_row(s->tables + s->p->surface_row, v->id * SURFACE_ROWS + 1);
#endif
}

/// Row of the light table that the vertex lies on; lanes that do not emit get a row that exists.
static inline vint light_of_vertex(const Scene* s, const Vertex* v) {
#if PAVE_ONE_LIGHT
    return splat_int(0);
#else
    vmask triangle;
    const Row r = cold_row(s, v, &triangle);
    const vint light = triangle ? v->light : as_vint(r.s3);
    return bits_emits(v->bits) ? light : splat_int(0);
#endif
}

static inline vint object_of_vertex(const Scene* s, const Vertex* v) {
    vmask triangle;
    const Row r = cold_row(s, v, &triangle);
    const vint object = as_vint(triangle ? r.s3 : r.s4);
#if PAVE_HAS_INSTANCES
    return object_of_instance(s, v->instance, object);
#else
    return object;
#endif
}

/// Basis around n_shade. Its tangent follows the shape's own where a material asks for it
/// (anisotropic), as in Mitsuba: rectangles and cubes by their first axis, disks radially, spheres
/// along the parallels, triangles arbitrarily.
static inline Basis basis_of_vertex(const Scene* s, const Vertex* v) {
    Basis b = basis_around(v->n_shade);
#if PAVE_HAS_ANISOTROPIC && (PAVE_HAS_SHAPES || PAVE_TREE_SHAPES)
    vmask triangle;
    const Row r = cold_row(s, v, &triangle);
    vec3 tangent = vec3_of(r.s0, r.s1, r.s2);  // sphere: its pole's direction
    const vmask disk = bits_kind(v->bits) == SURFACE_DISK,
                sphere = bits_kind(v->bits) == SURFACE_SPHERE;
    tangent = select3(disk, sub3(v->p, tangent), tangent);
    tangent = select3(sphere, cross3(tangent, v->n_geom), tangent);
    tangent = select3(sphere & bits_inverted(v->bits), neg3(tangent), tangent);
    tangent = mad3(v->n_shade, -dot3(v->n_shade, tangent), tangent);
    const vfloat squared = dot3(tangent, tangent);
    const vmask m = lane_not(triangle) & (squared > 1e-20f);
    b.s = select3(m, scale3(tangent, inverse_sqrt(squared)), b.s);
    b.t = select3(m, cross3(b.n, b.s), b.t);
#endif
    return b;
}
