// Kernels that show single parts of the path tracer to the tests: the very functions that path.cl
// calls.
// SPDX-License-Identifier: BSD-3-Clause
// Arrays are planar: value k of item i is array[k * count + i]; count is a multiple of 16, a work-
// item takes PAVE_LANES items.
#undef PAVE_FEW_SURFACES
#define PAVE_FEW_SURFACES 0
#define PAVE_SOBOL 0
#include "bsdf.h"
#include "light.h"
#include "rng.h"
#include "trace.h"

#define FIRST ((int)get_global_id(0) * PAVE_LANES)
static inline vec3 load3(__global const float* a, int count, int i) {
    return vec3_of(lane_load(a + i), lane_load(a + count + i), lane_load(a + 2 * count + i));
}
static inline void store3(__global float* a, int count, int i, vec3 v) {
    lane_store(v.x, a + i);
    lane_store(v.y, a + count + i);
    lane_store(v.z, a + 2 * count + i);
}
static inline Scene scene_of(__constant const PathParams* p, __global const float8* shapes,
                             __global const float8* tree, __global const float8* tables,
                             __global const uint* light_cdf) {
    Scene s;
    s.p = p;
    s.shapes = shapes;
    s.tree = tree;
    s.tables = tables;
    s.light_cdf = light_cdf;
    return s;
}
/// Four uniform numbers for item i.
static inline Philox numbers(int i, uint seed) {
    Philox c;
    c.x = splat_uint((uint)i) + as_vuint(LANE_INDEX);
    c.y = c.z = c.w = splat_uint(0);
    PhiloxKeys keys;
    set_keys(&keys, seed, 0);
    return philox(c, &keys);
}

/// Sizes of the shared structs as this device's compiler sees them.
__kernel void struct_sizes(__global uint* sizes) {
    sizes[0] = sizeof(FlatShape);
    sizes[1] = sizeof(CubeShape);
    sizes[2] = sizeof(SphereShape);
    sizes[3] = sizeof(PathParams);
}

/// counters: 4 planes, out: 4 planes of bits.
__kernel void philox_bits(__global const uint* counters, uint key_low, uint key_high,
                          __global uint* out, int count) {
    const int i = FIRST;
    Philox c;
    c.x = lane_load(counters + i);
    c.y = lane_load(counters + count + i);
    c.z = lane_load(counters + 2 * count + i);
    c.w = lane_load(counters + 3 * count + i);
    PhiloxKeys keys;
    set_keys(&keys, key_low, key_high);
    c = philox(c, &keys);
    lane_store(c.x, out + i);
    lane_store(c.y, out + count + i);
    lane_store(c.z, out + 2 * count + i);
    lane_store(c.w, out + 3 * count + i);
}

/// The five uniform numbers of a block: 5 planes.
__kernel void philox_units(uint seed, __global float* out, int count) {
    const int i = FIRST;
    const Philox r = numbers(i, seed);
    lane_store(unit_float(r.x), out + i);
    lane_store(unit_float(r.y), out + count + i);
    lane_store(unit_float(r.z), out + 2 * count + i);
    lane_store(unit_float(r.w), out + 3 * count + i);
    lane_store(unit_float_of_rest(r), out + 4 * count + i);
}

#define SHAPE_DISK 0
#define SHAPE_COSINE 1
#define SHAPE_SPHERE 2
#define SHAPE_CONE 3
#define SHAPE_TRIANGLE 4
/// One sampler of sampling.h. in: u1, u2; out: w (3), pdf, inverse u1, u2.
__kernel void sample_shape(int shape, float parameter, __global const float* in,
                           __global float* out, int count) {
    const int i = FIRST;
    const vfloat u1 = lane_load(in + i), u2 = lane_load(in + count + i), h = splat(parameter);
    vec3 w = splat3(0.0f, 0.0f, 0.0f);
    vfloat pdf = splat(0.0f), v1 = splat(0.0f), v2 = splat(0.0f);
    if (shape == SHAPE_DISK) {
        sample_disk(u1, u2, &w.x, &w.y);
        pdf = pdf_disk(w.x, w.y);
        invert_disk(w.x, w.y, &v1, &v2);
    } else if (shape == SHAPE_COSINE) {
        w = sample_cosine_hemisphere(u1, u2);
        pdf = pdf_cosine_hemisphere(w);
        invert_cosine_hemisphere(w, &v1, &v2);
    } else if (shape == SHAPE_SPHERE) {
        w = sample_sphere(u1, u2);
        pdf = pdf_sphere();
        invert_sphere(w, &v1, &v2);
    } else if (shape == SHAPE_CONE) {
        w = sample_cone(u1, u2, h);
        pdf = pdf_cone(h);
        invert_cone(w, h, &v1, &v2);
    } else {
        sample_triangle(u1, u2, &w.x, &w.y);
        pdf = pdf_triangle(splat(0.5f));
        invert_triangle(w.x, w.y, &v1, &v2);
    }
    store3(out, count, i, w);
    lane_store(pdf, out + 3 * count + i);
    lane_store(v1, out + 4 * count + i);
    lane_store(v2, out + 5 * count + i);
}

/// The material of surface `surface` as the path tracer would have it there.
static inline Material material_of_surface(const Scene* s, int surface) {
    const Row r = gather_row(s->tables + s->p->surface_row, splat_int(surface * SURFACE_ROWS));
    Vertex v;
    v.valid = mask_of(1);
    v.bits = as_vint(r.s3);
    v.albedo = vec3_of(r.s4, r.s5, r.s6);
#if PAVE_HAS_TEXTURES
    v.tu = v.tv = splat(0.0f);
#endif
    return material_of(s, &v);
}

/// Directions sampled for wi (local). out: wo (3), weight (3), pdf, eta.
__kernel void sample_bsdf_many(__constant const PathParams* p, __global const float8* tables,
                               int surface, float4 wi, uint seed, __global float* out, int count) {
    const Scene s = scene_of(p, 0, 0, tables, 0);
    const int i = FIRST;
    const Material m = material_of_surface(&s, surface);
    const Philox r = numbers(i, seed);
    const BsdfSample b = sample_bsdf(&m, splat3(wi.x, wi.y, wi.z), unit_float(r.x), unit_float(r.y),
                                     unit_float(r.z));
    store3(out, count, i, b.wo);
    store3(out + 3 * count, count, i, b.weight);
    lane_store(b.pdf, out + 6 * count + i);
    lane_store(b.eta, out + 7 * count + i);
}

/// out: sums (3) of the power of `samples` samples an item.
__kernel void bsdf_power_many(__constant const PathParams* p, __global const float8* tables,
                              int surface, float4 wi, uint seed, int samples, __global float* out,
                              int count) {
    const Scene s = scene_of(p, 0, 0, tables, 0);
    const int i = FIRST;
    const Material m = material_of_surface(&s, surface);
    vec3 sum = splat3(0.0f, 0.0f, 0.0f);
    for (int k = 0; k < samples; ++k) {
        const Philox r = numbers(i + k * count, seed);
        const BsdfSample b = sample_bsdf(&m, splat3(wi.x, wi.y, wi.z), unit_float(r.x),
                                         unit_float(r.y), unit_float(r.z));
        sum = mad3(b.weight, b.eta * b.eta, sum);
    }
    store3(out, count, i, sum);
}

/// in: wi (3), wo (3); out: f * cos (3), pdf.
__kernel void eval_bsdf_many(__constant const PathParams* p, __global const float8* tables,
                             int surface, __global const float* in, __global float* out,
                             int count) {
    const Scene s = scene_of(p, 0, 0, tables, 0);
    const int i = FIRST;
    const Material m = material_of_surface(&s, surface);
    vfloat pdf;
    const vec3 f = eval_bsdf(&m, load3(in, count, i), load3(in + 3 * count, count, i), &pdf);
    store3(out, count, i, f);
    lane_store(pdf, out + 3 * count + i);
}

#if PAVE_HAS_TEXTURES
/// in: u, v; out: colour (3).
__kernel void texture_many(__constant const PathParams* p, __global const float8* tables,
                           int texture, __global const float* in, __global float* out, int count) {
    const Scene s = scene_of(p, 0, 0, tables, 0);
    const int i = FIRST;
    store3(out, count, i,
           texture_colour(&s, splat_int(texture), lane_load(in + i), lane_load(in + count + i)));
}
#endif

/// Light samples from point `at`. out: wi (3), pdf, radiance (3), end (3).
__kernel void sample_light_many(__constant const PathParams* p, __global const float8* tables,
                                __global const uint* light_cdf, float4 at, uint seed,
                                __global float* out, int count) {
    const Scene s = scene_of(p, 0, 0, tables, light_cdf);
    const int i = FIRST;
    const Philox r = numbers(i, seed);
    const vint light = choose_light(&s, numbers(i, seed + 1u).x);
    const LightSample ls =
        sample_light(&s, splat3(at.x, at.y, at.z), light, unit_float(r.x), unit_float(r.y));
    store3(out, count, i, ls.wi);
    lane_store(ls.pdf, out + 3 * count + i);
    store3(out + 4 * count, count, i, ls.radiance);
    store3(out + 7 * count, count, i, ls.end);
}

/// Density that light samples from `at` have for direction w (in: 3 planes), as a ray that hits a
/// light there computes it.
__kernel void light_pdf_many(__constant const PathParams* p, __global const float8* shapes,
                             __global const float8* tree, __global const float8* tables,
                             __global const uint* light_cdf, float4 at, __global const float* in,
                             __global float* out, int count) {
    const Scene s = scene_of(p, shapes, tree, tables, light_cdf);
    const int i = FIRST;
    const vec3 o = splat3(at.x, at.y, at.z), d = load3(in, count, i);
    const Hit hit = trace_closest(&s, o, d, splat(INFINITY), mask_of(1), no_skip());
    const Vertex v = vertex_of(&s, &hit, o, d);
    const vmask lit = v.valid & bits_emits(v.bits) & (dot3(v.n_shade, d) < 0.0f);
    vfloat pdf = splat(0.0f);
    if (lane_any(lit)) {  // a scene of sky alone has no row of lights to read
        const Light l = light_at(&s, light_of_vertex(&s, &v));
        pdf = keep(lit, pdf_light(&l, o, v.p, v.n_geom));
    }
    vfloat away = splat(0.0f);
#if PAVE_HAS_ENVIRONMENT
    (void)environment_radiance(&s, d, lane_not(v.valid), &away);
#endif
    pdf = v.valid ? pdf : away;
    lane_store(pdf, out + i);
}

/// in: origin (3), direction (3), t_max, skip and its instance (as int bits). out: t, id (int
/// bits), b1, b2, position (3), n_geom (3), n_shade (3), offset, any hit before t_max (0 or 1),
/// instance.
__kernel void trace_many(__constant const PathParams* p, __global const float8* shapes,
                         __global const float8* tree, __global const float8* tables,
                         __global const float* in, __global float* out, int count) {
    const Scene s = scene_of(p, shapes, tree, tables, 0);
    const int i = FIRST;
    const vec3 o = load3(in, count, i), d = load3(in + 3 * count, count, i);
    const vfloat t_max = lane_load(in + 6 * count + i);
    Skip skip;
    skip.id = as_vint(lane_load(in + 7 * count + i));
#if PAVE_HAS_INSTANCES
    skip.instance = as_vint(lane_load(in + 8 * count + i));
#endif
    const Hit hit = trace_closest(&s, o, d, splat(INFINITY), mask_of(1), skip);
    const Vertex v = vertex_of(&s, &hit, o, d);
    const vmask any = trace_any(&s, o, d, t_max, mask_of(1), skip);
    lane_store(hit.t, out + i);
    lane_store(as_vfloat(v.valid ? hit.id : splat_int(-1)), out + count + i);
    lane_store(hit.b1, out + 2 * count + i);
    lane_store(hit.b2, out + 3 * count + i);
    store3(out + 4 * count, count, i, v.p);
    store3(out + 7 * count, count, i, v.n_geom);
    store3(out + 10 * count, count, i, v.n_shade);
    lane_store(v.offset, out + 13 * count + i);
    lane_store(keep(any, splat(1.0f)), out + 14 * count + i);
#if PAVE_HAS_INSTANCES
    lane_store(as_vfloat(v.valid ? v.instance : splat_int(-1)), out + 15 * count + i);
#endif
}
