// What a vertex is made of, and what sampling a material returns.
// SPDX-License-Identifier: BSD-3-Clause
// wi points back along the path, wo onwards, both in the local frame of the shading normal (+z).
// Definitions are Mitsuba 3's, in its radiance transport mode.
#pragma once
#include "texture.h"

typedef struct {
    vint bits;
    vec3 albedo;                      // diffuse reflectance
    vfloat alpha_u, alpha_v;          // rough materials
    vfloat eta;                       // dielectrics, plastic: inside over outside
    vec3 eta_complex, k;              // conductors
    vec3 reflectance, transmittance;  // specular tints
#if PAVE_HAS_PLASTIC
    vfloat inner;     // how much of the diffuse light its surface throws back inside
    vfloat share;     // of the specular lobe in choosing one, before Fresnel
    vmask nonlinear;  // what is thrown back is coloured again
#endif
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
#if PAVE_HAS_MATERIALS
    m.alpha_u = m.alpha_v = m.eta = splat(1.0f);
    m.eta_complex = m.k = m.reflectance = m.transmittance = splat3(1.0f, 1.0f, 1.0f);
#if PAVE_HAS_PLASTIC
    m.inner = m.share = splat(0.0f);
    m.nonlinear = mask_of(0);
#endif
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
#if PAVE_HAS_PLASTIC
        m.inner = r1.s0;
        m.share = r1.s1;
        m.nonlinear = r1.s2 > 0.0f;
#endif
        m.reflectance = vec3_of(r2.s0, r2.s1, r2.s2);
        m.transmittance = vec3_of(r2.s4, r2.s5, r2.s6);
#if PAVE_HAS_TEXTURES
        const vmask textured = other & bits_textured(v->bits);
        if (lane_any(textured)) {
            const vint first = textured ? as_vint(r2.s3) : splat_int(-1),
                       second = textured ? as_vint(r2.s7) : splat_int(-1);
            m.reflectance = mul3(m.reflectance, texture_colour(s, first, v->tu, v->tv));
            m.transmittance = mul3(m.transmittance, texture_colour(s, second, v->tu, v->tv));
        }
#endif
    }
#endif
    return m;
}
