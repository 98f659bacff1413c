// GGX microfacets (Walter et al. 2007) with Smith's masking, drawn as they are visible.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "sampling.h"

static inline vfloat ggx_d(vec3 m, vfloat au, vfloat av) {
    const vfloat x = m.x / au, y = m.y / av;
    const vfloat e = mad_f(x, x, mad_f(y, y, m.z * m.z));
    return m.z > 0.0f ? INV_PI_F / (au * av * e * e) : splat(0.0f);
}
/// Smith's masking of direction v on the visible side of facet m.
static inline vfloat ggx_g1(vec3 v, vec3 m, vfloat au, vfloat av) {
    const vfloat x = au * v.x, y = av * v.y;
    const vfloat g = 2.0f / (1.0f + sqrt(1.0f + mad_f(x, x, y * y) / (v.z * v.z)));
    return dot3(v, m) * v.z > 0.0f ? g : splat(0.0f);
}
/// Density of the facet normals seen from wi (wi.z > 0).
static inline vfloat pdf_ggx_visible(vec3 wi, vec3 m, vfloat au, vfloat av) {
    return ggx_d(m, au, av) * ggx_g1(wi, m, au, av) * vabs(dot3(wi, m)) / wi.z;
}
/// Facet normal seen from wi. Dupuy and Benyoub 2023, "Sampling visible GGX normals with spherical
/// caps".
static inline vec3 sample_ggx_visible(vec3 wi, vfloat u1, vfloat u2, vfloat au, vfloat av) {
    const vec3 i = normalize3(vec3_of(au * wi.x, av * wi.y, wi.z));
    const vfloat z = mad_f(1.0f - u1, 1.0f + i.z, -i.z);
    const vfloat r = safe_sqrt(1.0f - z * z);
    vfloat sn, cs;
    sincos_turn(u2, &sn, &cs);
    const vec3 h = vec3_of(mad_f(r, cs, i.x), mad_f(r, sn, i.y), z + i.z);
    return normalize3(vec3_of(au * h.x, av * h.y, vmax(h.z, splat(0.0f))));
}
