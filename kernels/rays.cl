// Ray queries over buffers: the closest hit of every ray, or whether it meets anything at all.
// SPDX-License-Identifier: BSD-3-Clause
// A work-item takes `segment` rays, a multiple of PAVE_LANES, and traces PAVE_LANES of them at a
// time.
#include "trace.h"
// After the lane width, which the structs of render_types.h depend on.
#include "ray_types.h"

static inline Scene ray_scene(__constant const PathParams* p, __global const float8* shapes,
                              __global const float8* tree) {
    Scene s;
    s.p = p;
    s.shapes = shapes;
    s.tree = tree;
    s.tables = 0;
    s.light_cdf = 0;
    return s;
}

/// Rays with a number that is not finite, or without a direction or length, meet nothing.
static inline int is_sound(__global const RayRecord* ray) {
    const float o = fabs(ray->origin[0]) + fabs(ray->origin[1]) + fabs(ray->origin[2]);
    const float d = fabs(ray->direction[0]) + fabs(ray->direction[1]) + fabs(ray->direction[2]);
    return o < INFINITY && d > 0.0f && d < INFINITY && ray->t_max > 0.0f;
}

static inline void write_miss(__global HitRecord* hit) {
    hit->t = INFINITY;
    hit->shape = -1;
    hit->part = -1;
    hit->primitive = -1;
    hit->b1 = 0.0f;
    hit->b2 = 0.0f;
}
static inline void write_hit(const Scene* s, __global HitRecord* hit, float t, int id, int instance,
                             float b1, float b2, __global const IdRun* runs, int run_count) {
    int low = 0, high = run_count;  // the last run that begins at or before id is in [low, high)
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (runs[middle].first_id <= id)
            low = middle;
        else
            high = middle;
    }
    hit->t = t;
    hit->shape = runs[low].shape;
#if PAVE_HAS_INSTANCES
    if (instance >= 0) hit->shape = as_int(instance_at(s, instance)[1].s5);
#endif
    hit->part = runs[low].part;
    hit->primitive = runs[low].first_primitive + id - runs[low].first_id;
    hit->b1 = b1;
    hit->b2 = b2;
}

/// PAVE_LANES rays; those from `count` on are copies of the last one.
typedef struct {
    vec3 o, d;
    vfloat t_max;
    vmask active;
} RayPacket;
static inline RayPacket load_rays(__global const RayRecord* rays, int count) {
    float o[3][PAVE_LANES], d[3][PAVE_LANES], t[PAVE_LANES];
    int sound[PAVE_LANES];
    for (int lane = 0; lane < PAVE_LANES; ++lane) {
        __global const RayRecord* ray = rays + min(lane, count - 1);
        for (int a = 0; a < 3; ++a) {
            o[a][lane] = ray->origin[a];
            d[a][lane] = ray->direction[a];
        }
        t[lane] = ray->t_max;
        sound[lane] = lane < count && is_sound(ray) ? MASK_BITS : 0;
    }
    RayPacket r;
    r.o = vec3_of(lane_load(o[0]), lane_load(o[1]), lane_load(o[2]));
    r.d = vec3_of(lane_load(d[0]), lane_load(d[1]), lane_load(d[2]));
    r.t_max = lane_load(t);
    r.active = lane_load(sound);
    return r;
}

static inline void closest_of_rays(const Scene* s, __global const RayRecord* rays,
                                   __global HitRecord* hits, int count, __global const IdRun* runs,
                                   int run_count) {
    for (int first = 0; first < count; first += PAVE_LANES) {
        const RayPacket r = load_rays(rays + first, count - first);
        const Hit hit = trace_closest(s, r.o, r.d, r.t_max, r.active, no_skip());
        float t[PAVE_LANES], b1[PAVE_LANES], b2[PAVE_LANES];
        int id[PAVE_LANES], instance[PAVE_LANES], found[PAVE_LANES];
        lane_store(hit.t, t);
        lane_store(hit.b1, b1);
        lane_store(hit.b2, b2);
        lane_store(hit.id, id);
#if PAVE_HAS_INSTANCES
        lane_store(hit.instance, instance);
#else
        lane_store(splat_int(-1), instance);
#endif
        lane_store(r.active & (hit.t < r.t_max), found);
        for (int lane = 0; lane < min(PAVE_LANES, count - first); ++lane) {
            __global HitRecord* to = hits + first + lane;
            if (found[lane])
                write_hit(s, to, t[lane], id[lane], instance[lane], b1[lane], b2[lane], runs,
                          run_count);
            else
                write_miss(to);
        }
    }
}
static inline void any_of_rays(const Scene* s, __global const RayRecord* rays,
                               __global uchar* occluded, int count) {
    for (int first = 0; first < count; first += PAVE_LANES) {
        const RayPacket r = load_rays(rays + first, count - first);
        int found[PAVE_LANES];
        lane_store(trace_any(s, r.o, r.d, r.t_max, r.active, no_skip()), found);
        for (int lane = 0; lane < min(PAVE_LANES, count - first); ++lane)
            occluded[first + lane] = found[lane] != 0;
    }
}

/// hits[i] is the closest hit of rays[i] before its t_max, for i in [first, first + count).
__kernel void trace_closest_rays(__constant const PathParams* p, __global const float8* shapes,
                                 __global const float8* tree, __global const IdRun* runs,
                                 int run_count, __global const RayRecord* rays,
                                 __global HitRecord* hits, ulong first, int count, int segment) {
    const Scene s = ray_scene(p, shapes, tree);
    const int begin = (int)get_global_id(0) * segment;
    if (begin >= count) return;
    closest_of_rays(&s, rays + first + begin, hits + first + begin, min(segment, count - begin),
                    runs, run_count);
}

/// occluded[i] is 1 if rays[i] meets anything before its t_max, else 0.
__kernel void trace_any_rays(__constant const PathParams* p, __global const float8* shapes,
                             __global const float8* tree, __global const RayRecord* rays,
                             __global uchar* occluded, ulong first, int count, int segment) {
    const Scene s = ray_scene(p, shapes, tree);
    const int begin = (int)get_global_id(0) * segment;
    if (begin >= count) return;
    any_of_rays(&s, rays + first + begin, occluded + first + begin, min(segment, count - begin));
}

/// Sizes of the records as this device's compiler sees them.
__kernel void record_sizes(__global uint* sizes) {
    sizes[0] = sizeof(RayRecord);
    sizes[1] = sizeof(HitRecord);
    sizes[2] = sizeof(IdRun);
}
