// Smooth plastic: a clear coat that mirrors, over a diffuse base that the coat's inner side lights
// again.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "fresnel.h"
#include "material.h"
#include "sampling.h"

#if PAVE_HAS_PLASTIC

/// Probability of the mirror lobe where the coat reflects `f_i`.
static inline vfloat plastic_mirror_chance(const Material* m, vfloat f_i) {
    const vfloat mirror = f_i * m->share, base = (1.0f - f_i) * (1.0f - m->share);
    return mirror / vmax(mirror + base, splat(1e-20f));
}

/// The base's f * pi for light that the coat lets in (1 - f_i) and out (1 - f_o), with all its
/// reflections between base and coat.
static inline vec3 plastic_base(const Material* m, vfloat f_i, vfloat f_o) {
    const vec3 again = scale3(select3(m->nonlinear, m->albedo, splat3(1.0f, 1.0f, 1.0f)), m->inner);
    const vfloat passed = (1.0f - f_i) * (1.0f - f_o) / (m->eta * m->eta);
    return vec3_of(m->albedo.x * passed / (1.0f - again.x), m->albedo.y * passed / (1.0f - again.y),
                   m->albedo.z * passed / (1.0f - again.z));
}

/// f * cos of the diffuse lobe for wi, wo in front, and the density of wo.
static inline vec3 plastic_eval(const Material* m, vec3 wi, vec3 wo, vfloat* pdf) {
    const vfloat f_i = dielectric_reflectance(wi.z, m->eta),
                 f_o = dielectric_reflectance(wo.z, m->eta);
    const vfloat cosine = pdf_cosine_hemisphere(wo);
    *pdf = (1.0f - plastic_mirror_chance(m, f_i)) * cosine;
    return scale3(plastic_base(m, f_i, f_o), cosine);
}

/// u1 chooses the lobe, and what is left of it is uniform again.
static inline void sample_plastic(const Material* m, vec3 wi, vfloat u1, vfloat u2, vmask on,
                                  BsdfSample* out) {
    const vfloat f_i = dielectric_reflectance(wi.z, m->eta);
    const vfloat chance = plastic_mirror_chance(m, f_i), other = 1.0f - chance;
    const vmask mirror = u1 < chance;
    const vfloat rest = vmin(vmax((u1 - chance) / other, splat(0.0f)), splat(0x1.fffffep-1f));
    const vec3 scattered = sample_cosine_hemisphere(rest, u2);
    const vfloat f_o = dielectric_reflectance(scattered.z, m->eta);
    const vec3 base = scale3(plastic_base(m, f_i, f_o), 1.0f / other);
    const vec3 coat = scale3(m->reflectance, f_i / chance);
    out->wo = select3(on, select3(mirror, vec3_of(-wi.x, -wi.y, wi.z), scattered), out->wo);
    out->weight = select3(on, select3(mirror, coat, base), out->weight);
    const vfloat pdf = mirror ? splat(INFINITY) : other * pdf_cosine_hemisphere(scattered);
    out->pdf = on ? pdf : out->pdf;
}

#endif  // PAVE_HAS_PLASTIC
