// Fresnel's equations: reflectance of conductors and dielectrics.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "vec3.h"

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
static inline vfloat dielectric_reflectance(vfloat cos_i, vfloat eta) {
    vfloat cos_t, eta_ti;
    return fresnel_dielectric(cos_i, eta, &cos_t, &eta_ti);
}
