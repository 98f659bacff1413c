// Rough conductor: GGX microfacets that are mirrors of metal.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "fresnel.h"
#include "material.h"
#include "microfacet.h"

/// f * cos of the rough conductor for wi, wo in front, and the density of wo.
static inline vec3 rough_eval(const Material* m, vec3 wi, vec3 wo, vfloat* pdf) {
    const vec3 h = normalize3(add3(wi, wo));
    const vfloat d = ggx_d(h, m->alpha_u, m->alpha_v);
    const vfloat g_i = ggx_g1(wi, h, m->alpha_u, m->alpha_v),
                 g_o = ggx_g1(wo, h, m->alpha_u, m->alpha_v);
    const vfloat base = d * g_i / (4.0f * wi.z);
    *pdf = base;  // visible normals: d * g1 * (wi.h) / wi.z over the half vector's 4 (wi.h)
    return mul3(scale3(fresnel_conductor(dot3(wi, h), m->eta_complex, m->k), base * g_o),
                m->reflectance);
}

static inline void sample_rough_conductor(const Material* m, vec3 wi, vfloat u1, vfloat u2,
                                          vmask on, BsdfSample* out) {
    const vec3 h = sample_ggx_visible(wi, u1, u2, m->alpha_u, m->alpha_v);
    const vec3 wo = sub3(scale3(h, 2.0f * dot3(wi, h)), wi);
    vfloat pdf;
    (void)rough_eval(m, wi, wo, &pdf);
    const vec3 f = mul3(fresnel_conductor(dot3(wi, h), m->eta_complex, m->k), m->reflectance);
    out->wo = select3(on, wo, out->wo);
    out->weight = select3(on, scale3(f, ggx_g1(wo, h, m->alpha_u, m->alpha_v)), out->weight);
    out->pdf = on ? pdf : out->pdf;
}
