// The path tracer: every channel of a row of pixels in one pass, by paths with next-event
// estimation.
// SPDX-License-Identifier: BSD-3-Clause
// Radiance is defined as Mitsuba 3's `path` integrator defines it. A work-item renders `segment`
// pixels of one row; its lanes take (pixel, sample) pairs from one queue, and a lane whose path
// ends takes the next pair, so that lanes are rarely idle.
#include "bsdf.h"
#include "film.h"
#include "light.h"
#include "rng.h"
#include "trace.h"

/// The paths in flight, one a lane.
typedef struct {
    vmask alive;
    vec3 o, d;  // ray
    vec3 throughput;
    vfloat bsdf_pdf;  // density of d; INFINITY: light samples could not have found it
    vfloat eta;  // product of index ratios, so that roulette does not mistake refraction for loss
    vint depth;  // edges before this ray
    vint skip;   // id that the ray starts on
    vmask specular_chain;  // only specular vertices so far
    vfloat chain_gain;     // what roulette owes to the albedo behind such a chain
    PathRecord record;
} Paths;

/// What a work-item has left to do, and whose path each lane carries.
typedef struct {
    PhiloxKeys keys;
    int row;          // of the image
    int x0, pixels;   // this segment
    uint first, end;  // samples of this pass
    int pixel;        // next pair to make a ray for
    uint sample;
    // Camera rays made ahead, a lane each; `taken` of them are gone.
    int taken, made;
    float ahead_d[3][PAVE_LANES];
    int ahead_pixel[PAVE_LANES];
    uint ahead_sample[PAVE_LANES];
    // The lanes' paths; pixel -1: none.
    float d[3][PAVE_LANES];
    int pixel_of[PAVE_LANES];
    uint sample_of[PAVE_LANES];
} Queue;

/// Numbers of block `block` for the samples.
static inline Philox draw(const Scene* s, const PhiloxKeys* keys, vuint pixel, vuint sample,
                          vuint block) {
    Philox c;
    c.x = pixel;
    c.y = sample;
    c.z = block;
    c.w = splat_uint(s->p->frame);
    return philox(c, keys);
}
static inline vuint image_pixel(const Scene* s, const Queue* q, vint local_x) {
    return splat_uint((uint)q->row * (uint)s->p->width + (uint)q->x0) + as_vuint(local_x);
}

/// Camera rays for the next pairs, as many as there are lanes: at full width, while paths end one
/// by one.
static inline void make_rays(const Scene* s, Queue* q) {
    q->taken = q->made = 0;
    for (int i = 0; i < PAVE_LANES; ++i) {
        q->ahead_pixel[i] = q->pixel;
        q->ahead_sample[i] = q->sample;
        if (q->pixel < q->pixels) {
            ++q->made;
            if (++q->sample == q->end) {
                q->sample = q->first;
                ++q->pixel;
            }
        }
    }
    if (q->made == 0) return;
    __constant const PathParams* p = s->p;
    const vint x = lane_load(q->ahead_pixel);
    const Philox r = draw(s, &q->keys, image_pixel(s, q, x), lane_load(q->ahead_sample),
                          splat_uint(BLOCK_CAMERA));
    const vfloat fx = to_vfloat(x + q->x0) + unit_float(r.x), fy = (float)q->row + unit_float(r.y);
    vec3 d = mad3(splat3(p->down[0], p->down[1], p->down[2]), fy,
                  splat3(p->corner[0], p->corner[1], p->corner[2]));
    d = normalize3(mad3(splat3(p->right[0], p->right[1], p->right[2]), fx, d));
    store_vec3(q->ahead_d, d);
}

/// Adds the paths of idle lanes to their pixels and gives these lanes the next pairs, as far as
/// there are.
static inline void exchange(const Scene* s, Queue* q, Paths* paths, float (*sums)[SUM_ALL],
                            uint* dropped) {
    // A sample that is not finite counts as black, and is counted when its path ends.
    const vec3 c = paths->record.color, e = paths->record.direct;
    const vmask fine = paths->alive | (is_finite(c.x) & is_finite(c.y) & is_finite(c.z) &
                                       is_finite(e.x) & is_finite(e.y) & is_finite(e.z));
    const uint lanes = lane_bits(lane_not(paths->alive));
    const uint spoiled = lane_bits(lane_not(fine));
    paths->record.color = keep3(fine, c);
    paths->record.direct = keep3(fine, e);
    Stage stage;
    stage_record(&stage, &paths->record);
    for (uint bits = lanes; bits; bits &= bits - 1u) {
        const uint i = lowest_bit(bits);
        const int pixel = q->pixel_of[i];
        if (pixel >= 0) {
            add_path(sums[pixel], &stage, i, q->sample_of[i]);
            *dropped += (spoiled >> i) & 1u;
        }
        if (q->taken == q->made) make_rays(s, q);
        q->pixel_of[i] = -1;
        if (q->taken < q->made) {
            const int k = q->taken++;
            q->pixel_of[i] = q->ahead_pixel[k];
            q->sample_of[i] = q->ahead_sample[k];
            for (int a = 0; a < 3; ++a) q->d[a][i] = q->ahead_d[a][k];
        }
    }
}

/// Puts new paths into the lanes of `fresh`.
static inline void start_paths(const Scene* s, const Queue* q, Paths* paths, vmask fresh) {
    __constant const PathParams* p = s->p;
    const vmask old = lane_not(fresh);
    paths->o = select3(fresh, splat3(p->eye[0], p->eye[1], p->eye[2]), paths->o);
    paths->d = select3(fresh, vec3_of(lane_load(q->d[0]), lane_load(q->d[1]), lane_load(q->d[2])),
                       paths->d);
    paths->throughput = select3(fresh, splat3(1.0f, 1.0f, 1.0f), paths->throughput);
    paths->bsdf_pdf = fresh ? splat(INFINITY) : paths->bsdf_pdf;
    paths->eta = fresh ? splat(1.0f) : paths->eta;
    paths->depth = fresh ? splat_int(0) : paths->depth;
    paths->skip = fresh ? splat_int(-1) : paths->skip;
    paths->specular_chain |= fresh;
    paths->chain_gain = fresh ? splat(1.0f) : paths->chain_gain;
    PathRecord* k = &paths->record;
    k->color = keep3(old, k->color);
    k->direct = keep3(old, k->direct);
    k->albedo = keep3(old, k->albedo);
    k->normal = keep3(old, k->normal);
    k->position = keep3(old, k->position);
    k->hits = keep(old, k->hits);
    k->depth = keep(old, k->depth);
    k->distance = keep(old, k->distance);
    k->object = fresh ? splat_int(-1) : k->object;
}

/// Radiance that arrives along a path of depth + 1 edges (emission), or depth + 2 (a light sample).
static inline void add_radiance(Paths* paths, vmask on, vmask is_direct, vec3 value) {
    PathRecord* k = &paths->record;
#if HAS_RADIANCE
    k->color = add3(k->color, keep3(on, value));
#endif
#if HAS_DIRECT
    k->direct = add3(k->direct, keep3(on & is_direct, value));
#endif
}

/// Geometry channels from the first hit, albedo from the first vertex that is not specular.
static inline void record_vertex(const Scene* s, Paths* paths, const Vertex* v, vfloat t) {
    const vmask hit = paths->alive & v->valid;
    const vmask first = hit & (paths->depth == 0);
    PathRecord* k = &paths->record;
    k->hits = first ? splat(1.0f) : k->hits;
#if HAS_NORMAL
    k->normal = select3(first, v->n_shade, k->normal);
#endif
#if HAS_POSITION
    k->position = select3(first, v->p, k->position);
#endif
#if HAS_DISTANCE
    k->distance = first ? t : k->distance;
#endif
#if HAS_DEPTH
    __constant const float* f = s->p->forward;
    k->depth = first ? t * dot3(paths->d, splat3(f[0], f[1], f[2])) : k->depth;
#endif
#if HAS_OBJECT
    if (lane_any(first)) k->object = first ? object_of_vertex(s, v) : k->object;
#endif
    const vmask settled = hit & paths->specular_chain & lane_not(is_specular(v->bits));
#if HAS_ALBEDO
    k->albedo = select3(settled, scale3(v->albedo, paths->chain_gain), k->albedo);
#endif
    paths->specular_chain &= lane_not(settled);
}

/// Emission that the ray meets, weighted against the light sample that could have found it.
static inline void add_emission(const Scene* s, Paths* paths, const Vertex* v) {
    const vmask is_direct = paths->depth <= 1;
#if PAVE_HAS_AREA_LIGHT
    const vmask lit =
        paths->alive & v->valid & bits_emits(v->bits) & (dot3(v->n_shade, paths->d) < 0.0f);
    if (lane_any(lit)) {
        const Light l = light_at(s, light_of_vertex(s, v));
        const vfloat weight = mis_weight(paths->bsdf_pdf, pdf_light(&l, paths->o, v->p, v->n_geom));
        add_radiance(paths, lit, is_direct, mul3(paths->throughput, scale3(l.radiance, weight)));
    }
#endif
#if PAVE_HAS_ENVIRONMENT
    const vmask away = paths->alive & lane_not(v->valid);
    if (lane_any(away)) {
        vfloat pdf;
        const vec3 l = environment_radiance(s, paths->d, away, &pdf);
        const vfloat weight = mis_weight(paths->bsdf_pdf, pdf);
        add_radiance(paths, away, is_direct, mul3(paths->throughput, scale3(l, weight)));
    }
#endif
}

#if PAVE_HAS_LIGHTS
/// Next-event estimation at the lanes of `on`.
static inline void add_light_sample(const Scene* s, Paths* paths, vmask on, const Vertex* v,
                                    const Material* m, Basis basis, vec3 wi, vint light, vfloat u1,
                                    vfloat u2) {
    const LightSample ls = sample_light(s, v->p, light, u1, u2);
    vfloat bsdf_pdf;
    const vec3 f = eval_bsdf(m, wi, to_local(basis, ls.wi), &bsdf_pdf);
    const vmask useful = on & (ls.pdf > 0.0f) & (max_component(f) > 0.0f);
    if (!lane_any(useful)) return;
    const vfloat mis = mis_weight(ls.pdf, bsdf_pdf);
    const vfloat weight = (ls.delta ? splat(1.0f) : mis) / ls.pdf;
    const vec3 value = mul3(mul3(paths->throughput, f), scale3(ls.radiance, weight));
    const vec3 start = leave_surface(v->p, v->n_geom, v->offset, ls.wi);
    const vec3 to = select3(ls.unbounded, ls.wi, sub3(ls.end, start));
    const vfloat t_max = ls.unbounded ? splat(INFINITY) : splat(1.0f);
    const vmask blocked = trace_any(s, start, to, t_max, useful, v->id);
    add_radiance(paths, useful & lane_not(blocked), paths->depth == 0, value);
}
#endif

/// One edge of every path: hit, emission, light sample, next direction, roulette.
static inline void extend_paths(const Scene* s, const Queue* q, Paths* paths) {
    __constant const PathParams* p = s->p;
    const Hit hit = trace_closest(s, paths->o, paths->d, paths->alive, paths->skip);
    Vertex v = vertex_of(s, &hit, paths->o, paths->d);
#if PAVE_HAS_TEXTURES
    apply_textures(s, &hit, &v);
#endif
    record_vertex(s, paths, &v, hit.t);
    add_emission(s, paths, &v);
    // Channels that see only the first vertices need no longer paths, but albedo follows specular
    // chains.
    const vint limit =
        HAS_ALBEDO ? (paths->specular_chain ? splat_int(p->max_depth) : splat_int(p->shade_depth))
                   : splat_int(p->shade_depth);
    const vmask on = paths->alive & v.valid & (paths->depth + 1 < limit);
    const Basis basis = basis_of_vertex(s, &v);
    const vec3 wi = to_local(basis, neg3(paths->d));
    const Material m = material_of(s, &v);
    const vuint depth = as_vuint(paths->depth);
    const vuint pixel = image_pixel(s, q, lane_load(q->pixel_of)), sample = lane_load(q->sample_of);
    const Philox r = draw(s, &q->keys, pixel, sample, block_of_vertex(depth));
#if PAVE_HAS_LIGHTS
    const vmask diffusing = on & lane_not(is_specular(v.bits));
    if (lane_any(diffusing)) {
        vint light = splat_int(0);
#if !PAVE_ONE_LIGHT
        light = choose_light(s, draw(s, &q->keys, pixel, sample, block_of_light(depth)).x);
#endif
        add_light_sample(s, paths, diffusing, &v, &m, basis, wi, light, unit_float(r.x),
                         unit_float(r.y));
    }
#endif
    vfloat u_lobe = splat(0.0f);
#if PAVE_HAS_ROUGH_DIELECTRIC
    u_lobe = unit_float(draw(s, &q->keys, pixel, sample, block_of_light(depth)).y);
#endif
    const BsdfSample b = sample_bsdf(&m, wi, unit_float(r.z), unit_float(r.w), u_lobe);
    paths->throughput = mul3(paths->throughput, b.weight);
    paths->eta *= b.eta;
    paths->bsdf_pdf = b.pdf;
    paths->d = to_world(basis, b.wo);
    paths->o = leave_surface(v.p, v.n_geom, v.offset, paths->d);
    paths->skip = v.id;
    paths->depth += 1;
    const vfloat brightest = max_component(paths->throughput);
    const vfloat survival = vmin(brightest * square(paths->eta), splat(0.95f));
    const vmask roulette = paths->depth >= p->rr_depth;
    const vfloat gain = roulette ? 1.0f / survival : splat(1.0f);
    paths->throughput = scale3(paths->throughput, gain);
    paths->chain_gain *= gain;
    paths->alive =
        on & (brightest > 0.0f) & (lane_not(roulette) | (unit_float_of_rest(r) < survival));
}

__kernel void render_paths(__constant const PathParams* params, __global const float8* shapes,
                           __global const float8* tree, __global const float8* tables,
                           __global const uint* light_cdf, __global float* frame,
                           __global float* kept, __global uint* dropped, int first_row,
                           int first_sample, int samples) {
    Scene s;
    s.p = params;
    s.shapes = shapes;
    s.tree = tree;
    s.tables = tables;
    s.light_cdf = light_cdf;
    float sums[PAVE_SEGMENT][SUM_ALL];
    Queue q;
    set_keys(&q.keys, params->seed_low, params->seed_high);
    q.row = first_row + (int)get_global_id(1);
    q.x0 = (int)get_global_id(0) * params->segment;
    q.pixels = min(params->segment, params->width - q.x0);
    q.first = q.sample = (uint)first_sample;
    q.end = (uint)(first_sample + samples);
    q.pixel = q.taken = q.made = 0;
    for (int i = 0; i < PAVE_LANES; ++i) {
        q.pixel_of[i] = -1;
        q.sample_of[i] = 0;
        q.d[0][i] = q.d[1][i] = q.d[2][i] = 0.0f;
    }
    for (int i = 0; i < q.pixels; ++i)
        for (int k = 0; k < SUM_ALL; ++k) sums[i][k] = 0.0f;

    Paths paths;
    paths.alive = mask_of(0);
    paths.specular_chain = mask_of(0);
    paths.o = paths.d = paths.throughput = splat3(0.0f, 0.0f, 0.0f);
    paths.bsdf_pdf = paths.eta = paths.chain_gain = splat(1.0f);
    paths.depth = paths.skip = splat_int(0);
    paths.record = empty_record();
    uint lost = 0;
    for (;;) {
        const vmask idle = lane_not(paths.alive);
        if (lane_any(idle)) {
            exchange(&s, &q, &paths, sums, &lost);
            const vmask fresh = idle & (lane_load(q.pixel_of) >= 0);
            paths.alive |= fresh;
            if (!lane_any(paths.alive)) break;
            start_paths(&s, &q, &paths, fresh);
        }
        extend_paths(&s, &q, &paths);
    }

    const int before = first_sample, total = first_sample + samples;
    for (int i = 0; i < q.pixels; ++i) {
        const ulong at = (ulong)q.row * params->width + (ulong)(q.x0 + i);
        __global float* mine =
            kept + ((ulong)get_global_id(1) * params->width + (ulong)(q.x0 + i)) * SUM_KEPT;
        merge_pass(sums[i], mine, (float)samples, (float)before);
        if (total == params->spp)
            write_pixel(frame, params, at, sums[i], (float)total);
        else
            for (int k = 0; k < SUM_KEPT; ++k) mine[k] = sums[i][k];
    }
    if (lost) atomic_add(dropped, lost);
}
