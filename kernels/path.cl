// The path tracer: every channel of a row of pixels in one pass, by paths with next-event
// estimation.
// SPDX-License-Identifier: BSD-3-Clause
// Radiance is defined as Mitsuba 3's `path` integrator defines it. A work-item renders `segment`
// pixels of one row; a lane whose path ends starts the next one at once (see schedule.h).
#include "bsdf.h"
#include "film.h"
#include "light.h"
#include "schedule.h"
#include "trace.h"

/// The paths in flight, one a lane.
typedef struct {
    vmask alive;
    vec3 o, d;  // ray
    vec3 throughput;
    vfloat bsdf_pdf;  // density of d; INFINITY: light samples could not have found it
    vint depth;       // edges before this ray
    Skip skip;        // what the ray starts on
#if PAVE_HAS_REFRACTION
    vfloat eta;  // product of index ratios, so that roulette does not mistake refraction for loss
#endif
#if PAVE_HAS_SPECULAR
    vmask specular_chain;  // only specular vertices so far
    vfloat chain_gain;     // what roulette owes to the albedo behind such a chain
#endif
    uint dropped;  // paths of this work-item whose radiance was not finite
} Paths;

static inline Paths no_paths(void) {
    Paths p;
    p.alive = mask_of(0);
    p.o = p.d = p.throughput = splat3(0.0f, 0.0f, 0.0f);
    p.bsdf_pdf = splat(1.0f);
    p.depth = splat_int(0);
    p.skip = no_skip();
#if PAVE_HAS_REFRACTION
    p.eta = splat(1.0f);
#endif
#if PAVE_HAS_SPECULAR
    p.specular_chain = mask_of(0);
    p.chain_gain = splat(1.0f);
#endif
    p.dropped = 0;
    return p;
}

/// Puts new paths into the lanes of `fresh`.
static inline void start_paths(const Scene* s, const Schedule* w, Paths* paths, vmask fresh) {
    __constant const PathParams* p = s->p;
    paths->o = select3(fresh, splat3(p->eye[0], p->eye[1], p->eye[2]), paths->o);
    paths->d = select3(fresh, w->ahead, paths->d);
    paths->throughput = select3(fresh, splat3(1.0f, 1.0f, 1.0f), paths->throughput);
    paths->bsdf_pdf = fresh ? splat(INFINITY) : paths->bsdf_pdf;
    paths->depth = fresh ? splat_int(0) : paths->depth;
    paths->skip = select_skip(fresh, no_skip(), paths->skip);
#if PAVE_HAS_REFRACTION
    paths->eta = fresh ? splat(1.0f) : paths->eta;
#endif
#if PAVE_HAS_SPECULAR
    paths->specular_chain |= fresh;
    paths->chain_gain = fresh ? splat(1.0f) : paths->chain_gain;
#endif
    paths->alive |= fresh;
}

/// Radiance that arrives along a path of depth + 1 edges (emission), or depth + 2 (a light sample).
/// What is not finite is left out, and its path ends.
static inline void add_radiance(Paths* paths, LaneFilm* film, vmask on, vmask is_direct,
                                vec3 value) {
    const vmask fine = is_finite(value.x + value.y + value.z);
    const vmask spoiled = on & lane_not(fine);
    if (lane_any(spoiled)) {
        paths->dropped += popcount(lane_bits(spoiled));
        paths->alive &= fine | lane_not(on);
    }
    add_color(film, on & fine, value);
#if HAS_DIRECT
    add_values(film, SUM_DIRECT, on & fine & is_direct, value);
#endif
}

/// Geometry channels from the first hit, albedo from the first vertex that is not specular.
static inline void record_vertex(const Scene* s, Paths* paths, LaneFilm* film, const Vertex* v,
                                 vfloat t, vuint sample) {
    const vmask hit = paths->alive & v->valid;
    const vmask first = hit & (paths->depth == 0);
    if (lane_any(first)) {
        add_value(film, SUM_HITS, first, splat(1.0f));
#if HAS_NORMAL
        add_values(film, SUM_NORMAL, first, v->n_shade);
#endif
#if HAS_POSITION
        add_values(film, SUM_POSITION, first, v->p);
#endif
#if HAS_DISTANCE
        add_value(film, SUM_DISTANCE, first, t);
#endif
#if HAS_DEPTH
        __constant const float* f = s->p->forward;
        add_value(film, SUM_DEPTH, first, t * dot3(paths->d, splat3(f[0], f[1], f[2])));
#endif
#if HAS_OBJECT
        film->object = (first & (sample == 0u)) ? object_of_vertex(s, v) : film->object;
#endif
#if HAS_ALBEDO && !PAVE_HAS_SPECULAR
        add_values(film, SUM_ALBEDO, first, v->albedo);
#endif
    }
#if PAVE_HAS_SPECULAR
    const vmask settled = hit & paths->specular_chain & lane_not(is_specular(v->bits));
    paths->specular_chain &= lane_not(settled);
#if HAS_ALBEDO
    add_values(film, SUM_ALBEDO, settled, scale3(v->albedo, paths->chain_gain));
#endif
#endif
}

/// Emission that the ray meets, weighted against the light sample that could have found it.
static inline void add_emission(const Scene* s, Paths* paths, LaneFilm* film, const Vertex* v) {
    const vmask is_direct = paths->depth <= 1;
#if PAVE_HAS_AREA_LIGHT
    const vmask lit =
        paths->alive & v->valid & bits_emits(v->bits) & (dot3(v->n_shade, paths->d) < 0.0f);
    if (lane_any(lit)) {
        const Light l = light_at(s, light_of_vertex(s, v));
        const vfloat weight = mis_weight(paths->bsdf_pdf, pdf_light(&l, paths->o, v->p, v->n_geom));
        add_radiance(paths, film, lit, is_direct,
                     mul3(paths->throughput, scale3(l.radiance, weight)));
    }
#endif
#if PAVE_HAS_ENVIRONMENT
    const vmask away = paths->alive & lane_not(v->valid);
    if (lane_any(away)) {
        vfloat pdf;
        const vec3 l = environment_radiance(s, paths->d, away, &pdf);
        const vfloat weight = mis_weight(paths->bsdf_pdf, pdf);
        add_radiance(paths, film, away, is_direct, mul3(paths->throughput, scale3(l, weight)));
    }
#endif
}

#if PAVE_HAS_LIGHTS
/// Next-event estimation at the lanes of `on`.
static inline void add_light_sample(const Scene* s, Paths* paths, LaneFilm* film, vmask on,
                                    const Vertex* v, const Material* m, Basis basis, vec3 wi,
                                    const VertexNumbers* n) {
    const vint light = choose_light(s, n->choice);
    const LightSample ls = sample_light(s, v->p, light, unit_float(n->u.x), unit_float(n->u.y));
    vfloat bsdf_pdf;
    const vec3 f = eval_bsdf(m, wi, to_local(basis, ls.wi), &bsdf_pdf);
    const vmask useful = on & (ls.pdf > 0.0f) & (max_component(f) > 0.0f);
    if (!lane_any(useful)) return;
    // The power heuristic's weight over the density; no square of the light's, which may be huge.
    const vfloat alone = reciprocal(ls.pdf);
    const vfloat by_both = reciprocal(mad_f(bsdf_pdf * bsdf_pdf, alone, ls.pdf));
    const vfloat weight = ls.delta ? alone : by_both;
    const vec3 value = mul3(mul3(paths->throughput, f), scale3(ls.radiance, weight));
    const vec3 start = leave_surface(v->p, v->n_geom, v->offset, ls.wi);
    const vec3 to = select3(ls.unbounded, ls.wi, sub3(ls.end, start));
    const vfloat t_max = ls.unbounded ? splat(INFINITY) : splat(1.0f);
    const vmask blocked = trace_any(s, start, to, t_max, useful, skip_of(v));
    add_radiance(paths, film, useful & lane_not(blocked), paths->depth == 0, value);
}
#endif

/// One edge of every path: hit, emission, light sample, next direction, roulette.
static inline void extend_paths(const Scene* s, const PhiloxKeys* keys, const Schedule* w,
                                Paths* paths, LaneFilm* film) {
    __constant const PathParams* p = s->p;
    // First, so that their long chain of multiplications runs beside the intersections.
    const VertexNumbers n = vertex_numbers(s, keys, image_pixel(s, w), w->sample_of, paths->depth);
    const Hit hit =
        trace_closest(s, paths->o, paths->d, splat(INFINITY), paths->alive, paths->skip);
    Vertex v = vertex_of(s, &hit, paths->o, paths->d);
#if PAVE_HAS_TEXTURES
    apply_textures(s, &hit, &v);
#endif
    record_vertex(s, paths, film, &v, hit.t, w->sample_of);
    add_emission(s, paths, film, &v);
    vint limit = splat_int(p->shade_depth);
#if PAVE_HAS_SPECULAR && HAS_ALBEDO
    // Channels that see only the first vertices need no longer paths, but albedo follows specular
    // chains.
    limit = paths->specular_chain ? splat_int(p->max_depth) : limit;
#endif
    const vmask on = paths->alive & v.valid & (paths->depth + 1 < limit);
    const Basis basis = basis_of_vertex(s, &v);
    const vec3 wi = to_local(basis, neg3(paths->d));
    const Material m = material_of(s, &v);
    const BsdfSample b =
        sample_bsdf(&m, wi, unit_float(n.u.z), unit_float(n.u.w), unit_float(n.lobe));
    const vec3 d = to_world(basis, b.wo), o = leave_surface(v.p, v.n_geom, v.offset, d);
#if PAVE_HAS_LIGHTS
    const vmask diffusing = on & lane_not(is_specular(v.bits));
    if (lane_any(diffusing)) add_light_sample(s, paths, film, diffusing, &v, &m, basis, wi, &n);
#endif
    paths->throughput = mul3(paths->throughput, b.weight);
    paths->bsdf_pdf = b.pdf;
    paths->d = d;
    paths->o = o;
    paths->skip = skip_of(&v);
    paths->depth += 1;
    const vfloat brightest = max_component(paths->throughput);
    vfloat survival = brightest;
#if PAVE_HAS_REFRACTION
    paths->eta *= b.eta;
    survival *= square(paths->eta);
#endif
    survival = vmin(survival, splat(0.95f));
    const vmask roulette = paths->depth >= p->rr_depth;
    const vfloat gain = roulette ? reciprocal(survival) : splat(1.0f);
    paths->throughput = scale3(paths->throughput, gain);
#if PAVE_HAS_SPECULAR
    paths->chain_gain *= gain;
#endif
    paths->alive &=
        on & (brightest > 0.0f) & (lane_not(roulette) | (unit_float_of_rest(n.u) < survival));
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
#if SURFACES_IN_REGISTERS
    const int last = params->surface_count - 1;
    const FewRows surfaces =
        few_rows(tables + params->surface_row, min(LANE_INDEX, splat_int(last)) * SURFACE_ROWS,
                 min(LANE_INDEX + 16, splat_int(last)) * SURFACE_ROWS);
    s.surfaces = &surfaces;
#endif
#if PAVE_BUILTINS && PAVE_SOBOL
    const SobolParts sobol = sobol_parts(tables + params->sobol_row);
    s.sobol = &sobol;
#endif
    float sums[PAVE_SEGMENT][SUM_ALL];
    PhiloxKeys keys;
    set_keys(&keys, params->seed_low, params->seed_high);
    Schedule w;
    start_schedule(&w, params, first_row + (int)get_global_id(1),
                   (int)get_global_id(0) * params->segment, (uint)first_sample, (uint)samples);
    for (int i = 0; i < w.pixels; ++i) {
        for (int k = 0; k < SUM_ALL; ++k) sums[i][k] = 0.0f;
#if HAS_OBJECT
        sums[i][SUM_OBJECT] = -1.0f;
#endif
    }
    LaneFilm film;
    clear_film(&film);
    Paths paths = no_paths();
    for (;;) {
        if (lane_any(lane_not(paths.alive))) {
            const vmask fresh = next_paths(&s, &keys, &w, paths.alive, &film, sums);
            if (!lane_any(paths.alive | fresh)) break;
            start_paths(&s, &w, &paths, fresh);
        }
        extend_paths(&s, &keys, &w, &paths, &film);
    }

    const int before = first_sample, total = first_sample + samples;
    for (int i = 0; i < w.pixels; ++i) {
        const ulong at = (ulong)w.row * params->width + (ulong)(w.x0 + i);
        __global float* mine =
            kept + ((ulong)get_global_id(1) * params->width + (ulong)(w.x0 + i)) * SUM_KEPT;
        merge_pass(sums[i], mine, (float)samples, (float)before);
        if (total == params->spp)
            write_pixel(frame, params, at, sums[i], (float)total);
        else
            for (int k = 0; k < SUM_KEPT; ++k) mine[k] = sums[i][k];
    }
    if (paths.dropped) atomic_add(dropped, paths.dropped);
}
