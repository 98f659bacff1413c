// Materials in the local frame of the shading normal (+z): each kind's value, density and sampling.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "plastic.h"
#include "rough_conductor.h"
#include "rough_dielectric.h"

/// f * cos for the pair and *pdf, the density that sample_bsdf has for wo; 0 for specular
/// materials.
static inline vec3 eval_bsdf(const Material* m, vec3 wi, vec3 wo, vfloat* pdf) {
#if PAVE_HAS_ROUGH_DIELECTRIC
    const vmask frosted = is_type(m->bits, BSDF_ROUGH_DIELECTRIC);
    const vec3 wi_in = wi, wo_in = wo;
#endif
    const vmask flip = flipped(m->bits, wi);
    wi.z = flip ? -wi.z : wi.z;
    wo.z = flip ? -wo.z : wo.z;
    vmask m_on = (wi.z > 0.0f) & (wo.z > 0.0f);
    *pdf = pdf_cosine_hemisphere(wo);
    vec3 value = scale3(m->albedo, *pdf);
#if PAVE_HAS_ROUGH
    const vmask rough = is_type(m->bits, BSDF_ROUGH_CONDUCTOR);
    if (lane_any(rough)) {
        vfloat rough_pdf;
        const vec3 rough_value = rough_eval(m, wi, wo, &rough_pdf);
        value = select3(rough, rough_value, value);
        *pdf = rough ? rough_pdf : *pdf;
    }
#endif
#if PAVE_HAS_PLASTIC
    const vmask plastic = is_type(m->bits, BSDF_PLASTIC);
    if (lane_any(plastic)) {
        vfloat plastic_pdf;
        const vec3 plastic_value = plastic_eval(m, wi, wo, &plastic_pdf);
        value = select3(plastic, plastic_value, value);
        *pdf = plastic ? plastic_pdf : *pdf;
    }
#endif
#if PAVE_HAS_ROUGH_DIELECTRIC
    if (lane_any(frosted)) {
        vfloat frosted_pdf;
        const vec3 frosted_value = rough_dielectric_eval(m, wi_in, wo_in, &frosted_pdf);
        value = select3(frosted, frosted_value, value);
        *pdf = frosted ? frosted_pdf : *pdf;
        m_on |= frosted & is_finite(frosted_pdf);
    }
#endif
    m_on &= lane_not(is_specular(m->bits));
    *pdf = keep(m_on, *pdf);
    return keep3(m_on, value);
}

#if PAVE_HAS_DIELECTRIC
static inline void sample_dielectric(const Material* m, vec3 wi, vfloat u, vmask on,
                                     BsdfSample* out) {
    vfloat cos_t, eta_ti;
    const vfloat r = fresnel_dielectric(wi.z, m->eta, &cos_t, &eta_ti);
    const vmask reflect = u <= r;
    const vec3 refracted = vec3_of(-eta_ti * wi.x, -eta_ti * wi.y, cos_t);
    out->wo = select3(on, select3(reflect, vec3_of(-wi.x, -wi.y, wi.z), refracted), out->wo);
    // Radiance is squeezed by the square of the index ratio on entry and stretched again on exit.
    const vec3 weight = select3(reflect, m->reflectance, scale3(m->transmittance, eta_ti * eta_ti));
    out->weight = select3(on, weight, out->weight);
    out->pdf = on ? splat(INFINITY) : out->pdf;
    out->eta = (on & lane_not(reflect)) ? 1.0f / eta_ti : out->eta;
}
#endif

/// A direction for wi; weight 0 where there is none (the back of a one-sided material). u_lobe is
/// used if PAVE_HAS_ROUGH_DIELECTRIC.
static inline BsdfSample sample_bsdf(const Material* m, vec3 wi_in, vfloat u1, vfloat u2,
                                     vfloat u_lobe) {
    const vmask flip = flipped(m->bits, wi_in);
    vec3 wi = wi_in;
    wi.z = flip ? -wi.z : wi.z;
    BsdfSample out;
    out.wo = sample_cosine_hemisphere(u1, u2);
    out.pdf = pdf_cosine_hemisphere(out.wo);
    out.weight = m->albedo;
    out.eta = splat(1.0f);
#if PAVE_HAS_ROUGH
    const vmask rough = is_type(m->bits, BSDF_ROUGH_CONDUCTOR);
    if (lane_any(rough)) sample_rough_conductor(m, wi, u1, u2, rough, &out);
#endif
#if PAVE_HAS_CONDUCTOR
    const vmask mirror = is_type(m->bits, BSDF_CONDUCTOR);
    if (lane_any(mirror)) {
        out.wo = select3(mirror, vec3_of(-wi.x, -wi.y, wi.z), out.wo);
        const vec3 f = mul3(fresnel_conductor(wi.z, m->eta_complex, m->k), m->reflectance);
        out.weight = select3(mirror, f, out.weight);
        out.pdf = mirror ? splat(INFINITY) : out.pdf;
    }
#endif
#if PAVE_HAS_PLASTIC
    const vmask plastic = is_type(m->bits, BSDF_PLASTIC);
    if (lane_any(plastic)) sample_plastic(m, wi, u1, u2, plastic, &out);
#endif
    vmask front = (wi.z > 0.0f) & (out.wo.z > 0.0f);
    out.wo.z = flip ? -out.wo.z : out.wo.z;
#if PAVE_HAS_DIELECTRIC
    const vmask glass = is_type(m->bits, BSDF_DIELECTRIC);
    if (lane_any(glass)) {
        sample_dielectric(m, wi_in, u1, glass, &out);
        front |= glass;
    }
#endif
#if PAVE_HAS_ROUGH_DIELECTRIC
    const vmask frosted = is_type(m->bits, BSDF_ROUGH_DIELECTRIC);
    if (lane_any(frosted)) {
        sample_rough_dielectric(m, wi_in, u1, u2, u_lobe, frosted, &out);
        front |= frosted & is_finite(out.pdf);
    }
#endif
    out.weight = keep3(front & (out.pdf > 0.0f), out.weight);
    return out;
}
