// Rough dielectric: GGX microfacets that each mirror or refract (Walter et al. 2007).
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "fresnel.h"
#include "material.h"
#include "microfacet.h"

/// Density of facet h, seen from either side, and the part of it that wo sees too: together D * G
/// |wi.h| / |wi.z|.
static inline vfloat rough_dielectric_facets(const Material* m, vec3 wi, vec3 h) {
    const vec3 up = scale3(wi, mul_sign(splat(1.0f), wi.z));
    return pdf_ggx_visible(up, h, m->alpha_u, m->alpha_v);
}

/// f * cos for the pair, on whichever sides they are, and the density of wo.
static inline vec3 rough_dielectric_eval(const Material* m, vec3 wi, vec3 wo, vfloat* pdf) {
    const vmask reflect = wi.z * wo.z > 0.0f;
    const vfloat eta = wi.z > 0.0f ? m->eta : 1.0f / m->eta;  // of wo's side over wi's
    vec3 h = mad3(wo, reflect ? splat(1.0f) : eta, wi);
    h = normalize3(h);
    h = scale3(h, mul_sign(splat(1.0f), h.z));
    const vfloat wi_h = dot3(wi, h), wo_h = dot3(wo, h);
    const vfloat f = dielectric_reflectance(wi_h, m->eta);
    // Solid angle of facets over that of wo.
    const vfloat mirrored = 1.0f / (4.0f * vabs(wo_h));
    const vfloat bent = eta * eta * vabs(wo_h) / square(mad_f(eta, wo_h, wi_h));
    const vmask seen = (wi_h * wi.z > 0.0f) & (wo_h * wo.z > 0.0f);
    const vfloat chance = (reflect ? f : 1.0f - f) * (reflect ? mirrored : bent);
    *pdf = keep(seen, rough_dielectric_facets(m, wi, h) * chance);
    // Radiance is squeezed by the square of the index ratio, as in a smooth dielectric.
    const vec3 tint =
        select3(reflect, m->reflectance, scale3(m->transmittance, 1.0f / (eta * eta)));
    return scale3(tint, *pdf * ggx_g1(wo, h, m->alpha_u, m->alpha_v));
}

/// u1, u2 choose the facet, u_lobe whether it mirrors.
static inline void sample_rough_dielectric(const Material* m, vec3 wi, vfloat u1, vfloat u2,
                                           vfloat u_lobe, vmask on, BsdfSample* out) {
    const vec3 up = scale3(wi, mul_sign(splat(1.0f), wi.z));
    const vec3 h = sample_ggx_visible(up, u1, u2, m->alpha_u, m->alpha_v);
    const vfloat wi_h = dot3(wi, h);
    vfloat cos_t, eta_ti;
    const vfloat f = fresnel_dielectric(wi_h, m->eta, &cos_t, &eta_ti);
    const vmask reflect = u_lobe <= f;
    const vec3 mirrored = sub3(scale3(h, 2.0f * wi_h), wi);
    const vec3 bent = sub3(scale3(h, mad_f(wi_h, eta_ti, cos_t)), scale3(wi, eta_ti));
    const vec3 wo = select3(reflect, mirrored, bent);
    vfloat pdf;
    (void)rough_dielectric_eval(m, wi, wo, &pdf);
    const vec3 tint = select3(reflect, m->reflectance, scale3(m->transmittance, eta_ti * eta_ti));
    const vmask fine = reflect ? (wi.z * wo.z > 0.0f) : (wi.z * wo.z < 0.0f);
    const vfloat g = keep(fine, ggx_g1(wo, h, m->alpha_u, m->alpha_v));
    out->wo = select3(on, wo, out->wo);
    out->weight = select3(on, scale3(tint, g), out->weight);
    out->pdf = on ? pdf : out->pdf;
    out->eta = (on & lane_not(reflect)) ? 1.0f / eta_ti : out->eta;
}
