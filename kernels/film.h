// Pixels of one work-item: what a finished path adds, and how the sums of a pass become channels.
// SPDX-License-Identifier: BSD-3-Clause
// Sums are float32 over one pass (PASS_SPP samples at most), then passes are added up: so sums stay
// exact enough at 2^24 samples. The order of additions follows from the segment alone, never from
// the launch.
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
    STAGED = SUM_DISTANCE + HAS_DISTANCE,  // so far one value a path; below is derived
    SUM_SQUARES =
        STAGED,  // in accumulators between passes: sum of squared differences from the mean
    SUM_OBJECT = SUM_SQUARES + 3 * HAS_VARIANCE,
    SUM_KEPT = SUM_OBJECT + HAS_OBJECT,  // floats a pixel keeps between passes
    SUM_SHIFT = SUM_KEPT,  // within a pass: the value added first, and sum of differences from it
    SUM_SHIFTED = SUM_SHIFT + 3 * HAS_VARIANCE,
    SUM_PATHS = SUM_SHIFTED + 3 * HAS_VARIANCE,  // within a pass: how many were added
    SUM_ALL = SUM_PATHS + HAS_VARIANCE
};

/// What the lanes' paths have gathered so far.
typedef struct {
    vec3 color, direct, albedo, normal, position;
    vfloat hits, depth, distance;
    vint object;
} PathRecord;

static inline PathRecord empty_record(void) {
    PathRecord r;
    r.color = r.direct = r.albedo = r.normal = r.position = splat3(0.0f, 0.0f, 0.0f);
    r.hits = r.depth = r.distance = splat(0.0f);
    r.object = splat_int(-1);
    return r;
}

/// One value a path and sum, transposed so that lane i's are values[k][i].
typedef struct {
    float values[STAGED][PAVE_LANES];
    int object[PAVE_LANES];
} Stage;

/// Lanes of v to three rows.
static inline void store_vec3(float (*values)[PAVE_LANES], vec3 v) {
    lane_store(v.x, values[0]);
    lane_store(v.y, values[1]);
    lane_store(v.z, values[2]);
}

static inline void stage_record(Stage* stage, const PathRecord* r) {
#if HAS_RADIANCE
    store_vec3(stage->values + SUM_COLOR, r->color);
#endif
#if HAS_DIRECT
    store_vec3(stage->values + SUM_DIRECT, r->direct);
#endif
#if HAS_ALBEDO
    store_vec3(stage->values + SUM_ALBEDO, r->albedo);
#endif
#if HAS_NORMAL
    store_vec3(stage->values + SUM_NORMAL, r->normal);
#endif
#if HAS_POSITION
    store_vec3(stage->values + SUM_POSITION, r->position);
#endif
    lane_store(r->hits, stage->values[SUM_HITS]);
#if HAS_DEPTH
    lane_store(r->depth, stage->values[SUM_DEPTH]);
#endif
#if HAS_DISTANCE
    lane_store(r->distance, stage->values[SUM_DISTANCE]);
#endif
#if HAS_OBJECT
    lane_store(r->object, stage->object);
#endif
}

/// Adds lane i of the stage to its pixel. Paths come in the order in which they end, not in that of
/// their samples; `sample` is the path's number of all.
static inline void add_path(float* sums, const Stage* stage, uint i, uint sample) {
#if HAS_VARIANCE
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        const float x = stage->values[SUM_COLOR + c][i];
        if (sums[SUM_PATHS] == 0.0f) sums[SUM_SHIFT + c] = x;
        const float d = x - sums[SUM_SHIFT + c];
        sums[SUM_SHIFTED + c] += d;
        sums[SUM_SQUARES + c] += d * d;
    }
    sums[SUM_PATHS] += 1.0f;
#endif
#pragma unroll
    for (int k = 0; k < STAGED; ++k) sums[k] += stage->values[k][i];
#if HAS_OBJECT
    if (sample == 0) sums[SUM_OBJECT] = (float)stage->object[i];
#endif
}

/// Joins a pass of `n` samples with `before` earlier ones. Chan et al. 1979 for the squares.
static inline void merge_pass(float* sums, __global float* kept, float n, float before) {
#if HAS_VARIANCE
    for (int c = 0; c < 3; ++c) {
        const float shifted = sums[SUM_SHIFTED + c];
        float squares = fmax(sums[SUM_SQUARES + c] - shifted * shifted / n, 0.0f);
        if (before > 0.0f) {
            const float gap = sums[SUM_COLOR + c] / n - kept[SUM_COLOR + c] / before;
            squares += kept[SUM_SQUARES + c] + gap * gap * (n * before / (n + before));
        }
        sums[SUM_SQUARES + c] = squares;
    }
#endif
    if (before > 0.0f) {
        for (int k = 0; k < STAGED; ++k) sums[k] += kept[k];
#if HAS_OBJECT
        sums[SUM_OBJECT] = kept[SUM_OBJECT];
#endif
    }
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
