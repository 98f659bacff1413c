// Materials in the local frame of the shading normal (+z): diffuse, smooth and rough conductor,
// smooth dielectric.
// SPDX-License-Identifier: BSD-3-Clause
// wi points back along the path, wo onwards. Definitions are Mitsuba 3's, in its radiance
// transport mode.
#pragma once
#include "sampling.h"
#include "vertex.h"

typedef struct {
    vint bits;
    vec3 albedo;                      // diffuse reflectance
    vfloat alpha_u, alpha_v;          // rough conductor
    vfloat eta;                       // dielectric: inside over outside
    vec3 eta_complex, k;              // conductors
    vec3 reflectance, transmittance;  // specular tints
} Material;

typedef struct {
    vec3 wo;
    vec3 weight;  // f * cos / pdf
    vfloat pdf;   // INFINITY for a delta lobe: then a light sample can not compete (see mis_weight)
    vfloat eta;   // relative index of the medium entered, for roulette
} BsdfSample;

/// Flips wi and wo of a two-sided material to the front; the flip is undone on what is sampled.
static inline vmask flipped(vint bits, vec3 wi) {
#if PAVE_HAS_TWO_SIDED
    return bits_two_sided(bits) & (wi.z < 0.0f);
#else
    return mask_of(0);
#endif
}

#define is_type(bits, type) (bits_type(bits) == (type))
static inline vmask is_specular(vint bits) {
#if PAVE_HAS_SPECULAR
    return is_type(bits, BSDF_CONDUCTOR) | is_type(bits, BSDF_DIELECTRIC);
#else
    return mask_of(0);
#endif
}

static inline Material material_of(const Scene* s, const Vertex* v) {
    Material m;
    m.bits = v->bits;
    m.albedo = v->albedo;
#if PAVE_HAS_SPECULAR || PAVE_HAS_ROUGH
    m.alpha_u = m.alpha_v = m.eta = splat(1.0f);
    m.eta_complex = m.k = m.reflectance = m.transmittance = splat3(1.0f, 1.0f, 1.0f);
    const vmask other = v->valid & (bits_type(v->bits) != BSDF_DIFFUSE);
    if (lane_any(other)) {
        __global const float8* table = s->tables + s->p->bsdf_row;
        const vint row = bits_bsdf(v->bits) * BSDF_ROWS;
        const Row r0 = gather_row(table, row), r1 = gather_row(table, row + 1),
                  r2 = gather_row(table, row + 2);
        m.alpha_u = r0.s4;
        m.alpha_v = r0.s5;
        m.eta = r0.s6;
        m.eta_complex = vec3_of(r1.s0, r1.s1, r1.s2);
        m.k = vec3_of(r1.s4, r1.s5, r1.s6);
        m.reflectance = vec3_of(r2.s0, r2.s1, r2.s2);
        m.transmittance = vec3_of(r2.s4, r2.s5, r2.s6);
    }
#endif
    return m;
}

// ---- Fresnel ----

/// Reflectance of a conductor with complex index eta + i k seen at cosine c.
static inline vfloat fresnel_conductor_1(vfloat c, vfloat eta, vfloat k) {
    const vfloat c2 = c * c, s2 = 1.0f - c2;
    const vfloat inner = eta * eta - k * k - s2;
    const vfloat a2_b2 = safe_sqrt(mad_f(inner, inner, 4.0f * k * k * eta * eta));
    const vfloat a = safe_sqrt(0.5f * (a2_b2 + inner));
    const vfloat sum_s = a2_b2 + c2, twice = 2.0f * c * a;
    const vfloat r_s = (sum_s - twice) / (sum_s + twice);
    const vfloat sum_p = mad_f(a2_b2, c2, s2 * s2), twice_p = twice * s2;
    const vfloat r_p = r_s * (sum_p - twice_p) / (sum_p + twice_p);
    return 0.5f * (r_s + r_p);
}
static inline vec3 fresnel_conductor(vfloat c, vec3 eta, vec3 k) {
    return vec3_of(fresnel_conductor_1(c, eta.x, k.x), fresnel_conductor_1(c, eta.y, k.y),
                   fresnel_conductor_1(c, eta.z, k.z));
}

/// Reflectance of a dielectric; cos_i is signed, *cos_t gets the opposite sign, *eta_ti the index
/// ratio incident over transmitted. Total reflection gives 1.
static inline vfloat fresnel_dielectric(vfloat cos_i, vfloat eta, vfloat* cos_t, vfloat* eta_ti) {
    const vmask outside = cos_i >= 0.0f;
    const vfloat inverse = 1.0f / eta;
    const vfloat eta_it = outside ? eta : inverse;
    *eta_ti = outside ? inverse : eta;
    const vfloat ci = vabs(cos_i);
    const vfloat ct = safe_sqrt(1.0f - (1.0f - ci * ci) * *eta_ti * *eta_ti);
    const vfloat r_s = (ci - eta_it * ct) / (ci + eta_it * ct);
    const vfloat r_p = (ct - eta_it * ci) / (ct + eta_it * ci);
    *cos_t = outside ? -ct : ct;
    return ci == 0.0f ? splat(1.0f) : 0.5f * (r_s * r_s + r_p * r_p);
}

// ---- GGX microfacets ----

#if PAVE_HAS_ROUGH
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
#endif

// ---- All materials ----

/// f * cos for the pair and *pdf, the density that sample_bsdf has for wo; 0 for specular
/// materials.
static inline vec3 eval_bsdf(const Material* m, vec3 wi, vec3 wo, vfloat* pdf) {
    const vmask flip = flipped(m->bits, wi);
    wi.z = flip ? -wi.z : wi.z;
    wo.z = flip ? -wo.z : wo.z;
    const vmask front = (wi.z > 0.0f) & (wo.z > 0.0f);
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
    const vmask m_on = front & lane_not(is_specular(m->bits));
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
    out->eta = on & lane_not(reflect) ? 1.0f / eta_ti : out->eta;
}
#endif

/// A direction for wi; weight 0 where there is none (the back of a one-sided material).
static inline BsdfSample sample_bsdf(const Material* m, vec3 wi_in, vfloat u1, vfloat u2) {
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
    if (lane_any(rough)) {
        const vec3 h = sample_ggx_visible(wi, u1, u2, m->alpha_u, m->alpha_v);
        const vec3 wo = sub3(scale3(h, 2.0f * dot3(wi, h)), wi);
        vfloat pdf;
        (void)rough_eval(m, wi, wo, &pdf);
        const vec3 f = mul3(fresnel_conductor(dot3(wi, h), m->eta_complex, m->k), m->reflectance);
        out.wo = select3(rough, wo, out.wo);
        out.weight = select3(rough, scale3(f, ggx_g1(wo, h, m->alpha_u, m->alpha_v)), out.weight);
        out.pdf = rough ? pdf : out.pdf;
    }
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
    vmask front = (wi.z > 0.0f) & (out.wo.z > 0.0f);
    out.wo.z = flip ? -out.wo.z : out.wo.z;
#if PAVE_HAS_DIELECTRIC
    const vmask glass = is_type(m->bits, BSDF_DIELECTRIC);
    if (lane_any(glass)) {
        sample_dielectric(m, wi_in, u1, glass, &out);
        front |= glass;
    }
#endif
    out.weight = keep3(front & (out.pdf > 0.0f), out.weight);
    return out;
}
