// Which path each lane carries: a work-item's pixels and samples, handed out in units.
// SPDX-License-Identifier: BSD-3-Clause
// A unit is some consecutive samples of one pixel. A lane takes a unit, renders its samples one
// after another and then takes the next one, so that lanes are rarely idle and a pixel's sums stay
// in the lane. Units shrink towards the end of the work-item, so that all lanes end together.
#pragma once
#include "film.h"
#include "sampler.h"

#if PAVE_LANES == 1
#define LARGEST_UNIT 0x1000000u
#else
#define LARGEST_UNIT 32u
#endif

typedef struct {
    int row;          // of the image
    int x0, pixels;   // this segment
    uint first, end;  // samples of this pass
    // What no lane has taken yet: from sample `sample` of pixel `pixel` on, `left` paths.
    int pixel;
    uint sample, left;
    // By lane.
    vint pixel_of;             // of the segment; -1: no unit any more
    vuint sample_of;           // of the path in flight
    vint left_of;              // samples of the unit after that one
    uint unit_of[PAVE_LANES];  // all samples of the unit
    CameraNumbers shift;
    vec3 ahead;  // camera direction of the sample after sample_of, in lanes of `ready`
    vmask ready;
} Schedule;

static inline void start_schedule(Schedule* w, __constant const PathParams* p, int row, int x0,
                                  uint first, uint samples) {
    w->row = row;
    w->x0 = x0;
    w->pixels = min(p->segment, p->width - x0);
    w->first = w->sample = first;
    w->end = first + samples;
    w->left = (uint)w->pixels * samples;
    w->pixel = 0;
    w->pixel_of = splat_int(-1);
    w->left_of = splat_int(0);
    w->sample_of = splat_uint(0);
    w->shift.x = w->shift.y = splat_uint(0);
    w->ahead = splat3(0.0f, 0.0f, 0.0f);
    w->ready = mask_of(0);
}

static inline vuint image_pixel(const Scene* s, const Schedule* w) {
    return splat_uint((uint)w->row * (uint)s->p->width + (uint)w->x0) + as_vuint(w->pixel_of);
}

/// Gives each lane of `bits` the next unit, as far as there are.
static inline void take_units(Schedule* w, uint bits) {
    int pixel[PAVE_LANES], left[PAVE_LANES];
    uint sample[PAVE_LANES];
    lane_store(w->pixel_of, pixel);
    lane_store(w->left_of, left);
    lane_store(w->sample_of, sample);
    for (; bits; bits &= bits - 1u) {
        const uint i = lowest_bit(bits);
        pixel[i] = -1;
        left[i] = 0;
        if (w->left == 0) continue;
        const uint fair = clamp(w->left / (2u * PAVE_LANES), 1u, LARGEST_UNIT);
        const uint unit = min(fair, w->end - w->sample);
        pixel[i] = w->pixel;
        left[i] = (int)unit;
        sample[i] = w->sample - 1u;  // one before: the path starts by taking the next sample
        w->unit_of[i] = unit;
        w->left -= unit;
        w->sample += unit;
        if (w->sample == w->end) {
            w->sample = w->first;
            ++w->pixel;
        }
    }
    w->pixel_of = lane_load(pixel);
    w->left_of = lane_load(left);
    w->sample_of = lane_load(sample);
}

/// Makes the camera directions of all lanes' next samples: at full width, while paths end one by
/// one.
static inline void aim_ahead(const Scene* s, const PhiloxKeys* keys, Schedule* w) {
    __constant const PathParams* p = s->p;
    const CameraNumbers n = camera_numbers(s, keys, image_pixel(s, w), w->sample_of + 1u, w->shift);
    const vfloat x = to_vfloat(w->pixel_of + w->x0) + unit_float(n.x);
    const vfloat y = (float)w->row + unit_float(n.y);
    const vec3 d = mad3(splat3(p->down[0], p->down[1], p->down[2]), y,
                        splat3(p->corner[0], p->corner[1], p->corner[2]));
    w->ahead = normalize3(mad3(splat3(p->right[0], p->right[1], p->right[2]), x, d));
    w->ready = mask_of(1);
}

/// Ends the paths of the lanes that are not `alive`, adds finished units to their pixels and hands
/// out new ones. Gives the lanes that shall start a path: `sample_of` is then the path's, `ahead`
/// its direction.
static inline vmask next_paths(const Scene* s, const PhiloxKeys* keys, Schedule* w, vmask alive,
                               LaneFilm* film, float (*sums)[SUM_ALL]) {
    const vmask idle = lane_not(alive);
    end_paths(film, idle & (w->pixel_of >= 0));
    const vmask done = idle & (w->left_of == 0);
    // Lanes without a unit ask again in vain: the last few rounds of a work-item.
    if (lane_any(done & ((w->pixel_of >= 0) | mask_of(w->left != 0)))) {
        int pixel[PAVE_LANES];
        lane_store(w->pixel_of, pixel);
        add_units(film, sums, pixel, w->unit_of, lane_bits(done & (w->pixel_of >= 0)));
        clear_units(film, done);
        take_units(w, lane_bits(done));
        w->ready &= lane_not(done);
        w->shift = camera_shift(s, keys, image_pixel(s, w), w->sample_of + 1u);
    }
    const vmask fresh = idle & (w->left_of > 0);
    if (lane_any(fresh & lane_not(w->ready))) aim_ahead(s, keys, w);
    w->ready &= lane_not(fresh);
    w->sample_of += fresh ? splat_uint(1) : splat_uint(0);
    w->left_of -= fresh ? splat_int(1) : splat_int(0);
    return fresh;
}
