// Samplers as triples: sample_X(u), pdf_X(w) and, where a shape has one, invert_X(w).
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "vec3.h"

/// sin and cos of x in [-pi/4, pi/4]; minimax polynomials, absolute error below 8e-8.
static inline void sincos_small(vfloat x, vfloat* s, vfloat* c) {
    const vfloat z = x * x;
    const vfloat p =
        mad_f(mad_f(splat(-1.9517298e-4f), z, splat(8.332178e-3f)), z, splat(-0.16666655f));
    const vfloat q =
        mad_f(mad_f(splat(2.443845e-5f), z, splat(-1.3887368e-3f)), z, splat(4.1666646e-2f));
    *s = mad_f(p * z, x, x);
    *c = mad_f(q * z, z, mad_f(splat(-0.5f), z, splat(1.0f)));
}

/// sin and cos of 2 pi u, u in [0, 1].
static inline void sincos_turn(vfloat u, vfloat* s, vfloat* c) {
    const vint quarter = to_vint(mad_f(splat(4.0f), u, splat(0.5f)));
    vfloat ps, pc;
    sincos_small((mad_f(splat(4.0f), u, -to_vfloat(quarter))) * (0.5f * PI_F), &ps, &pc);
    const vmask swap = (quarter & 1) != 0;
    const vfloat as = swap ? pc : ps, ac = swap ? ps : pc;
    // Quadrants 2, 3 flip the sine, 1, 2 the cosine.
    *s = as_vfloat(as_vuint(as) ^ ((as_vuint(quarter) & 2u) << 30));
    *c = as_vfloat(as_vuint(ac) ^ ((as_vuint(quarter + 1) & 2u) << 30));
}

// ---- Disk, area measure. Shirley and Chiu 1997 ----

static inline void sample_disk(vfloat u1, vfloat u2, vfloat* x, vfloat* y) {
    const vfloat a = mad_f(splat(2.0f), u1, splat(-1.0f)), b = mad_f(splat(2.0f), u2, splat(-1.0f));
    const vmask steep = vabs(b) > vabs(a);
    const vfloat r = steep ? b : a, other = steep ? a : b;
    vfloat s, c;
    sincos_small((0.25f * PI_F) * other * reciprocal(r == 0.0f ? splat(1.0f) : r), &s, &c);
    *x = r * (steep ? s : c);
    *y = r * (steep ? c : s);
}
static inline vfloat pdf_disk(vfloat x, vfloat y) {
    return x * x + y * y <= 1.0f ? splat(INV_PI_F) : splat(0.0f);
}
static inline void invert_disk(vfloat x, vfloat y, vfloat* u1, vfloat* u2) {
    const vmask steep = vabs(y) > vabs(x);
    const vfloat r = mul_sign(sqrt(x * x + y * y), steep ? y : x);
    const vfloat angle = atan(steep ? x / y : y / (x == 0.0f ? splat(1.0f) : x)) * (4.0f / PI_F);
    const vfloat a = steep ? r * angle : r, b = steep ? r : r * angle;
    *u1 = mad_f(splat(0.5f), a, splat(0.5f));
    *u2 = mad_f(splat(0.5f), b, splat(0.5f));
}

// ---- Hemisphere around +z, cosine-weighted solid angle ----

static inline vec3 sample_cosine_hemisphere(vfloat u1, vfloat u2) {
    vec3 w;
    sample_disk(u1, u2, &w.x, &w.y);
    w.z = safe_sqrt(1.0f - w.x * w.x - w.y * w.y);
    return w;
}
static inline vfloat pdf_cosine_hemisphere(vec3 w) { return vmax(w.z, splat(0.0f)) * INV_PI_F; }
static inline void invert_cosine_hemisphere(vec3 w, vfloat* u1, vfloat* u2) {
    invert_disk(w.x, w.y, u1, u2);
}

// ---- Whole sphere, solid angle ----

static inline vec3 sample_sphere(vfloat u1, vfloat u2) {
    const vfloat z = mad_f(splat(-2.0f), u1, splat(1.0f));
    const vfloat r = 2.0f * safe_sqrt(u1 * (1.0f - u1));
    vec3 w;
    sincos_turn(u2, &w.y, &w.x);
    w.x *= r;
    w.y *= r;
    w.z = z;
    return w;
}
static inline vfloat pdf_sphere(void) { return splat(0.25f * INV_PI_F); }
static inline void invert_sphere(vec3 w, vfloat* u1, vfloat* u2) {
    const vfloat turn = atan2(w.y, w.x) * (0.5f * INV_PI_F);
    *u1 = 0.5f * (1.0f - w.z);
    *u2 = turn < 0.0f ? turn + 1.0f : turn;
}

// ---- Cone around +z with 1 - cos(half angle) = `height`, solid angle; `height` keeps small cones
// exact ----

static inline vec3 sample_cone(vfloat u1, vfloat u2, vfloat height) {
    const vfloat h = u1 * height;  // 1 - cos
    const vfloat r = safe_sqrt(h * (2.0f - h));
    vec3 w;
    sincos_turn(u2, &w.y, &w.x);
    w.x *= r;
    w.y *= r;
    w.z = 1.0f - h;
    return w;
}
static inline vfloat pdf_cone(vfloat height) { return (0.5f * INV_PI_F) / height; }
static inline void invert_cone(vec3 w, vfloat height, vfloat* u1, vfloat* u2) {
    const vfloat turn = atan2(w.y, w.x) * (0.5f * INV_PI_F);
    *u1 = (w.x * w.x + w.y * w.y) / ((1.0f + w.z) * height);
    *u2 = turn < 0.0f ? turn + 1.0f : turn;
}

// ---- Triangle, area measure: weights of its second and third vertex ----

static inline void sample_triangle(vfloat u1, vfloat u2, vfloat* b1, vfloat* b2) {
    const vfloat root = safe_sqrt(1.0f - u1);
    *b1 = 1.0f - root;
    *b2 = u2 * root;
}
static inline vfloat pdf_triangle(vfloat area) { return 1.0f / area; }
static inline void invert_triangle(vfloat b1, vfloat b2, vfloat* u1, vfloat* u2) {
    const vfloat root = 1.0f - b1;
    *u1 = 1.0f - root * root;
    *u2 = b2 / (root == 0.0f ? splat(1.0f) : root);
}
