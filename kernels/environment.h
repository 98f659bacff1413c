// What lies around the scene: one radiance, or an image over all directions and its samples.
// SPDX-License-Identifier: BSD-3-Clause
// Definitions are Mitsuba 3's: u = atan2(x, -z) / 2 pi with pixels at (i + 1/2) / width, v =
// acos(y) / pi with pixels at j / (height - 1). A cell is the patch between four pixels; samples
// choose a cell by the row's and the column's share, then an angle each, evenly.
#pragma once
#include "sampling.h"
#include "tree.h"

#if PAVE_HAS_ENVIRONMENT

#if PAVE_HAS_ENVMAP
/// The image, or width 0: everything is p->environment.
typedef struct {
    int width, height;
    __global const float4* pixels;
    __global const float* row_ends;     // height: 0, ..., 1
    __global const float* column_ends;  // width + 1 a row of cells
    float m[9];                         // map from world
} Sky;

static inline Sky sky_of(const Scene* s) {
    __global const float8* rows = s->tables + s->p->environment_row;
    const float8 head = rows[0], a = rows[1], b = rows[2];
    Sky sky;
    sky.width = as_int(head.s0);
    sky.height = as_int(head.s1);
    sky.pixels = (__global const float4*)(rows + as_int(head.s2));
    sky.row_ends = (__global const float*)(rows + as_int(head.s3));
    sky.column_ends = (__global const float*)(rows + as_int(head.s4));
    sky.m[0] = a.s0;
    sky.m[1] = a.s1;
    sky.m[2] = a.s2;
    sky.m[3] = a.s4;
    sky.m[4] = a.s5;
    sky.m[5] = a.s6;
    sky.m[6] = b.s0;
    sky.m[7] = b.s1;
    sky.m[8] = b.s2;
    return sky;
}

/// Probability of cell (i, j): of its row, then of its column.
static inline float cell_chance(const Sky* sky, int i, int j) {
    __global const float* columns = sky->column_ends + (ulong)j * (ulong)(sky->width + 1);
    return (sky->row_ends[j + 1] - sky->row_ends[j]) * (columns[i + 1] - columns[i]);
}

/// Cell of `u` in the ends[0..count], and what is left of u there: uniform again.
static inline int choose_cell(__global const float* ends, int count, float* u) {
    int low = 0, high = count - 1;
    while (low < high) {
        const int middle = (low + high) >> 1;
        if (*u < ends[middle + 1])
            high = middle;
        else
            low = middle + 1;
    }
    const float left = (*u - ends[low]) / (ends[low + 1] - ends[low]);
    *u = fmin(fmax(left, 0.0f), 1.0f);
    return low;
}

/// Between the four pixels of a cell.
static inline float4 sky_colour(const Sky* sky, int i, int j, float x, float y) {
    const int next = i + 1 == sky->width ? 0 : i + 1;
    __global const float4* above = sky->pixels + (ulong)j * (ulong)sky->width;
    __global const float4* below = above + sky->width;
    return (above[i] * (1.0f - x) + above[next] * x) * (1.0f - y) +
           (below[i] * (1.0f - x) + below[next] * x) * y;
}

/// Density by solid angle of a cell's directions with this sine of colatitude.
static inline vfloat pdf_in_cell(const Sky* sky, vfloat chance, vfloat sine) {
    const float cells = (float)sky->width * (float)(sky->height - 1);
    return chance * cells / (2.0f * PI_F * PI_F * vmax(sine, splat(1e-20f)));
}

/// Radiance from direction `d`, and the density with which sample_sky finds it.
static inline vec3 sky_radiance(const Sky* sky, vec3 d, vmask on, vfloat* pdf) {
    const float* m = sky->m;
    const vec3 w =
        vec3_of(m[0] * d.x + m[1] * d.y + m[2] * d.z, m[3] * d.x + m[4] * d.y + m[5] * d.z,
                m[6] * d.x + m[7] * d.y + m[8] * d.z);
    const vfloat sine = sqrt(mad_f(w.x, w.x, w.z * w.z));
    const vfloat turn = atan2(w.x, -w.z) * (0.5f * INV_PI_F);
    vfloat x = mad_f(turn, splat((float)sky->width), splat(-0.5f));
    x = x < 0.0f ? x + (float)sky->width : x;
    const vfloat y = atan2(sine, w.y) * INV_PI_F * (float)(sky->height - 1);
    float xs[PAVE_LANES], ys[PAVE_LANES], rgb[3][PAVE_LANES], chance[PAVE_LANES];
    lane_store(keep(on & is_finite(x), x), xs);
    lane_store(keep(on & is_finite(y), y), ys);
    for (int k = 0; k < PAVE_LANES; ++k) {
        const int i = max(0, min((int)xs[k], sky->width - 1)),
                  j = max(0, min((int)ys[k], sky->height - 2));
        const float4 c = sky_colour(sky, i, j, xs[k] - (float)i, ys[k] - (float)j);
        rgb[0][k] = c.x;
        rgb[1][k] = c.y;
        rgb[2][k] = c.z;
        chance[k] = cell_chance(sky, i, j);
    }
    *pdf = pdf_in_cell(sky, lane_load(chance), sine);
    return vec3_of(lane_load(rgb[0]), lane_load(rgb[1]), lane_load(rgb[2]));
}

/// A direction towards where the sky is bright, its radiance and density.
static inline vec3 sample_sky(const Sky* sky, vfloat u1, vfloat u2, vec3* radiance, vfloat* pdf) {
    float us[PAVE_LANES], vs[PAVE_LANES], rgb[3][PAVE_LANES], chance[PAVE_LANES];
    lane_store(u1, us);
    lane_store(u2, vs);
    for (int k = 0; k < PAVE_LANES; ++k) {
        float x = vs[k], y = us[k];
        const int j = choose_cell(sky->row_ends, sky->height - 1, &y);
        const int i =
            choose_cell(sky->column_ends + (ulong)j * (ulong)(sky->width + 1), sky->width, &x);
        const float4 c = sky_colour(sky, i, j, x, y);
        rgb[0][k] = c.x;
        rgb[1][k] = c.y;
        rgb[2][k] = c.z;
        chance[k] = cell_chance(sky, i, j);
        us[k] = ((float)i + 0.5f + x) / (float)sky->width;
        vs[k] = ((float)j + y) / (float)(sky->height - 1);
    }
    vfloat turn = lane_load(us), sin_phi, cos_phi, sine, cosine;
    turn = turn >= 1.0f ? turn - 1.0f : turn;
    sincos_turn(turn, &sin_phi, &cos_phi);
    sincos_turn(0.5f * lane_load(vs), &sine, &cosine);
    sine = vmax(sine, splat(0.0f));
    *radiance = vec3_of(lane_load(rgb[0]), lane_load(rgb[1]), lane_load(rgb[2]));
    *pdf = pdf_in_cell(sky, lane_load(chance), sine);
    const vec3 w = vec3_of(sine * sin_phi, cosine, -sine * cos_phi);
    const float* m = sky->m;  // orthogonal: its inverse is its transpose
    return vec3_of(m[0] * w.x + m[3] * w.y + m[6] * w.z, m[1] * w.x + m[4] * w.y + m[7] * w.z,
                   m[2] * w.x + m[5] * w.y + m[8] * w.z);
}
#endif

/// Radiance from direction `d` where nothing is in the way, and the density with which light
/// samples find it.
static inline vec3 environment_radiance(const Scene* s, vec3 d, vmask on, vfloat* pdf) {
    __constant const PathParams* p = s->p;
#if PAVE_HAS_ENVMAP
    const Sky sky = sky_of(s);
    if (sky.width > 0) {
        const vec3 l = sky_radiance(&sky, d, on, pdf);
        *pdf *= p->environment_pmf;
        return l;
    }
#endif
    *pdf = p->environment_pmf * pdf_sphere();
    return splat3(p->environment[0], p->environment[1], p->environment[2]);
}

/// A direction, its radiance and its density, without the choice of this light.
static inline vec3 sample_environment(const Scene* s, vfloat u1, vfloat u2, vec3* radiance,
                                      vfloat* pdf) {
#if PAVE_HAS_ENVMAP
    const Sky sky = sky_of(s);
    if (sky.width > 0) return sample_sky(&sky, u1, u2, radiance, pdf);
#endif
    *pdf = pdf_sphere();
    return sample_sphere(u1, u2);
}

#endif  // PAVE_HAS_ENVIRONMENT
