// Pixels of one work-item: what paths add to their lanes' sums, and how the sums become channels.
// SPDX-License-Identifier: BSD-3-Clause
// Sums are float32: of a unit (some samples of one pixel, in a lane), of a pixel over one pass
// (PASS_SPP samples at most), of all passes; so sums stay exact enough at 2^24 samples. The order
// of additions follows from the segment alone, never from the launch.
#pragma once
#include "features.h"
#include "vec3.h"

// Places of the sums of a pixel.
enum {
    SUM_COLOR = 0,
    SUM_DIRECT = SUM_COLOR + 3 * HAS_RADIANCE,
    SUM_ALBEDO = SUM_DIRECT + 3 * HAS_DIRECT,
    SUM_NORMAL = SUM_ALBEDO + 3 * HAS_ALBEDO,
    SUM_POSITION = SUM_NORMAL + 3 * HAS_NORMAL,
    SUM_HITS = SUM_POSITION + 3 * HAS_POSITION,
    SUM_DEPTH = SUM_HITS + 1,
    SUM_DISTANCE = SUM_DEPTH + HAS_DEPTH,
    SUM_SQUARES = SUM_DISTANCE + HAS_DISTANCE,  // of differences from the mean
    SUM_OBJECT = SUM_SQUARES + 3 * HAS_VARIANCE,
    SUM_KEPT = SUM_OBJECT + HAS_OBJECT,  // floats a pixel keeps between passes
    SUM_PATHS = SUM_KEPT,                // within a pass: how many were added
    SUM_ALL = SUM_PATHS + 1,
    LANE_SUMS = SUM_SQUARES,                         // those that are mere sums
    LANE_SHIFT = LANE_SUMS,                          // in a lane: color of the unit's first path,
    LANE_SHIFTED = LANE_SHIFT + 3 * HAS_VARIANCE,    // sum of differences from it,
    LANE_SQUARES = LANE_SHIFTED + 3 * HAS_VARIANCE,  // and of their squares
    LANE_ALL = LANE_SQUARES + 3 * HAS_VARIANCE
};

/// What the lanes have gathered of their units so far.
typedef struct {
    vfloat sums[LANE_ALL];
#if HAS_VARIANCE
    vec3 color;  // of the path in flight
    vmask shifted;
#endif
#if HAS_OBJECT
    vint object;
#endif
} LaneFilm;

static inline void clear_units(LaneFilm* f, vmask lanes) {
    const vmask others = lane_not(lanes);
#pragma unroll
    for (int k = 0; k < LANE_ALL; ++k) f->sums[k] = keep(others, f->sums[k]);
#if HAS_VARIANCE
    f->shifted &= others;
#endif
#if HAS_OBJECT
    f->object = lanes ? splat_int(-1) : f->object;
#endif
}
static inline void clear_film(LaneFilm* f) {
#if HAS_VARIANCE
    f->color = splat3(0.0f, 0.0f, 0.0f);
    f->shifted = mask_of(0);
#endif
#if HAS_OBJECT
    f->object = splat_int(-1);
#endif
    for (int k = 0; k < LANE_ALL; ++k) f->sums[k] = splat(0.0f);
}

/// One value of a path, in lanes that have it.
static inline void add_value(LaneFilm* f, int sum, vmask on, vfloat value) {
    f->sums[sum] += keep(on, value);
}
static inline void add_values(LaneFilm* f, int sum, vmask on, vec3 value) {
    f->sums[sum] += keep(on, value.x);
    f->sums[sum + 1] += keep(on, value.y);
    f->sums[sum + 2] += keep(on, value.z);
}
static inline void add_color(LaneFilm* f, vmask on, vec3 value) {
#if HAS_VARIANCE
    f->color = add3(f->color, keep3(on, value));
#elif HAS_COLOR
    add_values(f, SUM_COLOR, on, value);
#endif
}

/// Only the variance asks for the color of whole paths.
static inline void end_paths(LaneFilm* f, vmask ended) {
#if HAS_VARIANCE
    add_values(f, SUM_COLOR, ended, f->color);
    const vfloat color[3] = {f->color.x, f->color.y, f->color.z};
    const vmask first = ended & lane_not(f->shifted);
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        vfloat* shift = f->sums + LANE_SHIFT + c;
        *shift = first ? color[c] : *shift;
        const vfloat difference = keep(ended, color[c] - *shift);
        f->sums[LANE_SHIFTED + c] += difference;
        f->sums[LANE_SQUARES + c] = mad_f(difference, difference, f->sums[LANE_SQUARES + c]);
    }
    f->shifted |= ended;
    f->color = keep3(lane_not(ended), f->color);
#endif
}

/// Sum of squared differences from the mean of two groups together, less what each has of its own.
/// Chan et al. 1979, eq. 2.1.
static inline float between_groups(float sum_a, float n_a, float sum_b, float n_b) {
    const float gap = sum_a / n_a - sum_b / n_b;
    return gap * gap * (n_a * n_b / (n_a + n_b));
}

/// Adds the units of the lanes of `bits` to their pixels; `paths[lane]` were in each.
static inline void add_units(const LaneFilm* f, float (*sums)[SUM_ALL], const int* pixels,
                             const uint* paths, uint bits) {
    float lanes[LANE_ALL][PAVE_LANES];
#pragma unroll
    for (int k = 0; k < LANE_ALL; ++k) lane_store(f->sums[k], lanes[k]);
#if HAS_OBJECT
    int object[PAVE_LANES];
    lane_store(f->object, object);
#endif
    for (; bits; bits &= bits - 1u) {
        const uint i = lowest_bit(bits);
        float* pixel = sums[pixels[i]];
        const float n = (float)paths[i];
#if HAS_VARIANCE
        for (int c = 0; c < 3; ++c) {
            const float shifted = lanes[LANE_SHIFTED + c][i];
            pixel[SUM_SQUARES + c] +=
                fmax(lanes[LANE_SQUARES + c][i] - shifted * shifted / n, 0.0f);
            if (pixel[SUM_PATHS] > 0.0f)
                pixel[SUM_SQUARES + c] += between_groups(lanes[SUM_COLOR + c][i], n,
                                                         pixel[SUM_COLOR + c], pixel[SUM_PATHS]);
        }
#endif
#pragma unroll
        for (int k = 0; k < LANE_SUMS; ++k) pixel[k] += lanes[k][i];
        pixel[SUM_PATHS] += n;
#if HAS_OBJECT
        if (object[i] >= 0) pixel[SUM_OBJECT] = (float)object[i];
#endif
    }
}

/// Joins a pass of `n` samples with `before` earlier ones.
static inline void merge_pass(float* sums, __global float* kept, float n, float before) {
    if (before == 0.0f) return;
#if HAS_VARIANCE
    for (int c = 0; c < 3; ++c)
        sums[SUM_SQUARES + c] +=
            kept[SUM_SQUARES + c] +
            between_groups(sums[SUM_COLOR + c], n, kept[SUM_COLOR + c], before);
#endif
    for (int k = 0; k < LANE_SUMS; ++k) sums[k] += kept[k];
#if HAS_OBJECT
    sums[SUM_OBJECT] = kept[SUM_OBJECT];
#endif
}

static inline void write_3(__global float* frame, __constant const PathParams* p, int channel,
                           ulong pixel, const float* v, float scale) {
    __global float* plane = frame + p->channel_offset[channel] + pixel;
    for (int c = 0; c < 3; ++c) plane[c * p->plane] = v[c] * scale;
}

/// Channels of one pixel from its sums over `n` samples.
static inline void write_pixel(__global float* frame, __constant const PathParams* p, ulong pixel,
                               const float* sums, float n) {
    const float hits = sums[SUM_HITS];
#if HAS_COLOR
    write_3(frame, p, CHANNEL_COLOR, pixel, sums + SUM_COLOR, 1.0f / n);
#endif
#if HAS_VARIANCE
    // Of the mean; one sample says nothing about its own spread.
    write_3(frame, p, CHANNEL_VARIANCE, pixel, sums + SUM_SQUARES,
            n > 1.0f ? 1.0f / (n * (n - 1.0f)) : 0.0f);
#endif
#if HAS_DIRECT
    write_3(frame, p, CHANNEL_DIRECT, pixel, sums + SUM_DIRECT, 1.0f / n);
#endif
#if HAS_ALBEDO
    float albedo[3];
    for (int c = 0; c < 3; ++c) albedo[c] = clamp(sums[SUM_ALBEDO + c] / n, 0.0f, 1.0f);
    write_3(frame, p, CHANNEL_ALBEDO, pixel, albedo, 1.0f);
#endif
#if HAS_NORMAL
    const float x = sums[SUM_NORMAL], y = sums[SUM_NORMAL + 1], z = sums[SUM_NORMAL + 2];
    const float squared = x * x + y * y + z * z;
    write_3(frame, p, CHANNEL_NORMAL, pixel, sums + SUM_NORMAL,
            squared > 0.0f ? 1.0f / sqrt(squared) : 0.0f);
#endif
#if HAS_POSITION
    write_3(frame, p, CHANNEL_POSITION, pixel, sums + SUM_POSITION,
            hits > 0.0f ? 1.0f / hits : 0.0f);
#endif
#if HAS_DEPTH
    frame[p->channel_offset[CHANNEL_DEPTH] + pixel] =
        hits > 0.0f ? sums[SUM_DEPTH] / hits : INFINITY;
#endif
#if HAS_DISTANCE
    frame[p->channel_offset[CHANNEL_DISTANCE] + pixel] =
        hits > 0.0f ? sums[SUM_DISTANCE] / hits : INFINITY;
#endif
#if HAS_OBJECT
    frame[p->channel_offset[CHANNEL_OBJECT] + pixel] = sums[SUM_OBJECT];
#endif
}
