// Lights: one is chosen by its share of the power, then a point on it; densities are by solid
// angle and include the choice.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "environment.h"
#include "rng.h"
#include "sampling.h"
#include "vertex.h"

/// One row triple of the light table, in every lane.
typedef struct {
    vint kind;
    vec3 p, e1, e2, n;
    vfloat pmf, radius, pdf_area;
    vec3 radiance;
    vint normals;    // triangle that has them, -1: flat
    vfloat largest;  // coordinate, of what the light reaches
} Light;

typedef struct {
    vec3 wi;          // unit, from the surface to the light
    vec3 end;         // where the shadow ray ends, just off the light; for the environment not used
    vfloat pdf;       // 0: no light this way. Point lights: only the probability of the choice
    vec3 radiance;    // arriving if nothing is between; point lights: intensity / distance^2
    vmask delta;      // can not be hit by chance
    vmask unbounded;  // environment: the shadow ray has no end
} LightSample;

/// Weight of a sample with density `pdf` against the other strategy's `other`. Power heuristic,
/// Veach 1997, eq. 9.13; as a ratio, so that an infinite density (delta lobe) gets weight 1.
static inline vfloat mis_weight(vfloat pdf, vfloat other) {
    const vfloat r = vmin(other, splat(3e38f)) * reciprocal(pdf);
    return reciprocal(mad_f(r, r, splat(1.0f)));
}

#if PAVE_HAS_LIGHTS

static inline Light light_of_rows(Row r0, Row r1, Row r2) {
    Light l;
    l.p = vec3_of(r0.s0, r0.s1, r0.s2);
    l.kind = as_vint(r0.s3);
    l.e1 = vec3_of(r0.s4, r0.s5, r0.s6);
    l.pmf = r0.s7;
    l.e2 = vec3_of(r1.s0, r1.s1, r1.s2);
    l.radius = r1.s3;
    l.n = vec3_of(r1.s4, r1.s5, r1.s6);
    l.pdf_area = r1.s7;
    l.radiance = vec3_of(r2.s0, r2.s1, r2.s2);
    l.normals = as_vint(r2.s3);
    l.largest = r2.s4;
    return l;
}

static inline Row broadcast_row(__global const float8* row) {
    const float8 f = *row;
    Row r;
    r.s0 = splat(f.s0);
    r.s1 = splat(f.s1);
    r.s2 = splat(f.s2);
    r.s3 = splat(f.s3);
    r.s4 = splat(f.s4);
    r.s5 = splat(f.s5);
    r.s6 = splat(f.s6);
    r.s7 = splat(f.s7);
    return r;
}

static inline Light light_at(const Scene* s, vint index) {
    __global const float8* table = s->tables + s->p->light_row;
#if PAVE_ONE_LIGHT
    return light_of_rows(broadcast_row(table), broadcast_row(table + 1), broadcast_row(table + 2));
#else
    const vint row = index * LIGHT_ROWS;
    return light_of_rows(gather_row(table, row), gather_row(table, row + 1),
                         gather_row(table, row + 2));
#endif
}

/// The light whose part of the 32-bit number line `bits` falls into. The table holds the upper ends
/// as integers and `pmf` is exactly the length, so that choice and density agree to the last bit.
static inline vint choose_light(const Scene* s, vuint bits) {
#if PAVE_ONE_LIGHT
    return splat_int(0);
#else
    vint low = splat_int(0), high = splat_int(s->p->light_count - 1);
    for (int span = s->p->light_count - 1; span > 0; span >>= 1) {
        const vint middle = (low + high) >> 1;
        const vmask below = bits < gather_uint(s->light_cdf, middle);
        high = below ? middle : high;
        low = below ? low : min(middle + 1, high);
    }
    return low;
#endif
}

/// Density by solid angle of a point chosen evenly over the light's area; `to` leads from where one
/// stands to the point, n is its normal.
static inline vfloat pdf_by_area(const Light* l, vec3 to, vec3 n) {
    const vfloat d2 = dot3(to, to), d = d2 * inverse_sqrt(d2);
    return l->pdf_area * d2 * d * reciprocal(vabs(dot3(n, to)));
}

// ---- Spheres: by the cone that they fill; from inside, by area ----

#if PAVE_HAS_SPHERE_LIGHT
/// Whether p lies outside, and then 1 - cos of the cone's half angle.
static inline vmask cone_to_sphere(vec3 center, vfloat radius, vec3 p, vfloat* height) {
    const vec3 to = sub3(center, p);
    const vfloat d2 = dot3(to, to), sin2 = radius * radius / d2;
    // 1 - sqrt(1 - x) without the cancellation.
    *height = sin2 / (1.0f + safe_sqrt(1.0f - sin2));
    return sin2 < 0.9999f;
}
static inline vfloat pdf_sphere_light(const Light* l, vec3 p, vec3 on, vec3 n_geom) {
    vfloat height;
    const vmask outside = cone_to_sphere(l->p, l->radius, p, &height);
    return outside ? l->pmf * pdf_cone(height) : pdf_by_area(l, sub3(on, p), n_geom);
}
/// Point on the sphere and its outward normal; *pdf by solid angle.
static inline vec3 sample_sphere_light(const Light* l, vec3 p, vfloat u1, vfloat u2, vec3* n,
                                       vfloat* pdf) {
    vfloat height;
    const vmask outside = cone_to_sphere(l->p, l->radius, p, &height);
    const vec3 to = sub3(l->p, p);
    const vfloat d2 = dot3(to, to), d = sqrt(d2);
    const Basis axis = basis_around(scale3(to, 1.0f / d));
    const vec3 w = to_world(axis, sample_cone(u1, u2, height));
    // Distance to the near side: foot of the perpendicular from the center, minus half the chord.
    const vfloat along = dot3(w, to);
    const vec3 foot = mad3(w, along, neg3(to));  // from the center
    const vfloat half_chord = safe_sqrt(l->radius * l->radius - dot3(foot, foot));
    const vec3 near_side = normalize3(mad3(w, -half_chord, foot));
    *n = select3(outside, near_side, sample_sphere(u1, u2));
    const vec3 on = mad3(*n, l->radius, l->p);
    *pdf = pdf_sphere_light(l, p, on, *n);
    return on;
}
#endif

// ---- All lights ----

/// Density with which sample_light would have found the point `on` of light l from p.
static inline vfloat pdf_light(const Light* l, vec3 p, vec3 on, vec3 n_geom) {
    vfloat pdf = pdf_by_area(l, sub3(on, p), n_geom);
#if PAVE_HAS_SPHERE_LIGHT
    const vmask sphere = l->kind == LIGHT_SPHERE;
    if (lane_any(sphere)) pdf = sphere ? pdf_sphere_light(l, p, on, n_geom) : pdf;
#endif
    return pdf;
}

#if PAVE_HAS_AREA_LIGHT
/// Point of an area light; n gets its geometric normal on the emitting side, n_side the normal that
/// says which side emits.
static inline vec3 sample_area_light(const Scene* s, const Light* l, vec3 p, vfloat u1, vfloat u2,
                                     vec3* n, vec3* n_side, vfloat* pdf) {
    vfloat a = u1, b = u2;
#if PAVE_HAS_DISK_LIGHT
    const vmask disk = l->kind == LIGHT_DISK;
    if (lane_any(disk)) {
        vfloat x, y;
        sample_disk(u1, u2, &x, &y);
        a = disk ? x : a;
        b = disk ? y : b;
    }
#endif
#if PAVE_HAS_TRIANGLE_LIGHT
    const vmask triangle = l->kind == LIGHT_TRIANGLE;
    if (lane_any(triangle)) {
        vfloat b1, b2;
        sample_triangle(u1, u2, &b1, &b2);
        a = triangle ? b1 : a;
        b = triangle ? b2 : b;
    }
#endif
    vec3 on = mad3(l->e2, b, mad3(l->e1, a, l->p));
    *n = l->n;
    *pdf = pdf_by_area(l, sub3(on, p), *n);
    *n_side = *n;
#if PAVE_HAS_TRIANGLE_LIGHT && PAVE_HAS_SMOOTH
    const vmask smooth = triangle & (l->normals >= 0);
    if (lane_any(smooth)) {
        const vint row = (smooth ? l->normals : splat_int(0)) * TRIANGLE_ROWS + 1;
        const Row r = gather_row(s->tables + s->p->triangle_row, row);
        *n_side = select3(smooth, smooth_normal(&r, a, b, *n), *n);
    }
#endif
#if PAVE_HAS_SPHERE_LIGHT
    const vmask sphere = l->kind == LIGHT_SPHERE;
    if (lane_any(sphere)) {
        vec3 out;
        vfloat sphere_pdf;
        const vec3 on_sphere = sample_sphere_light(l, p, u1, u2, &out, &sphere_pdf);
        const vec3 emitting = scale3(out, l->n.x);
        on = select3(sphere, on_sphere, on);
        *n = select3(sphere, emitting, *n);
        *n_side = select3(sphere, emitting, *n_side);
        *pdf = sphere ? sphere_pdf : *pdf;
    }
#endif
    return on;
}
#endif

/// A direction from p towards some light.
static inline LightSample sample_light(const Scene* s, vec3 p, vint index, vfloat u1, vfloat u2) {
    const Light l = light_at(s, index);
    LightSample out;
    out.delta = mask_of(0);
    out.unbounded = mask_of(0);
    out.radiance = l.radiance;
#if PAVE_HAS_AREA_LIGHT
    vec3 n, n_side;
    const vec3 on = sample_area_light(s, &l, p, u1, u2, &n, &n_side, &out.pdf);
    const vec3 to = sub3(on, p);
    const vfloat d2 = dot3(to, to);
    out.wi = scale3(to, inverse_sqrt(d2));
    out.pdf = keep((dot3(n_side, out.wi) < 0.0f) & (d2 > 0.0f), out.pdf);
    out.end = leave_surface(on, n, offset_at(s, l.largest), neg3(out.wi));
#else
    out.wi = out.end = splat3(0.0f, 0.0f, 0.0f);
    out.pdf = splat(0.0f);
#endif
#if PAVE_HAS_ENVIRONMENT
    const vmask environment = l.kind == LIGHT_ENVIRONMENT;
    if (lane_any(environment)) {
        vfloat pdf;
        vec3 radiance = l.radiance;
        const vec3 wi = sample_environment(s, u1, u2, &radiance, &pdf);
        out.wi = select3(environment, wi, out.wi);
        out.pdf = environment ? l.pmf * pdf : out.pdf;
        out.radiance = select3(environment, radiance, out.radiance);
        out.unbounded = environment;
    }
#endif
#if PAVE_HAS_POINT_LIGHT
    const vmask point = l.kind == LIGHT_POINT;
    if (lane_any(point)) {
        const vec3 to_point = sub3(l.p, p);
        const vfloat squared = dot3(to_point, to_point);
        out.wi = select3(point, scale3(to_point, inverse_sqrt(squared)), out.wi);
        out.end = select3(point, l.p, out.end);
        out.pdf = point ? keep(squared > 0.0f, l.pmf) : out.pdf;
        out.radiance = select3(point, scale3(l.radiance, reciprocal(squared)), out.radiance);
        out.delta = point;
    }
#endif
    return out;
}

#endif  // PAVE_HAS_LIGHTS
