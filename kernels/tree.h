// One ray at a time through the 8-wide tree: closest hit in order of entry, any hit unordered.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "instance.h"
#include "intersect.h"
#include "scene.h"

#if PAVE_HAS_TREE

// Axis-parallel rays would divide by zero; this slope is less than a rounding error over any scene.
#define LEAST_SLOPE 1e-18f
// Bounds of a box test's and a hit's rounding, in units of the coordinates (2^-23 * 4): see
// slab_offsets.
#define BOX_SLACK 4.8e-7f

typedef struct {
    float o[3], d[3];
    float t;  // closest so far
    int id;
    float b1, b2;
    int skip;  // triangle that the ray starts on; a plane is never hit twice
#if PAVE_HAS_INSTANCES
    int instance, skip_instance;  // of the hit, and of `skip`
#endif
} TreeRay;

/// Per ray: reciprocal slopes, and offsets that make every box wider by more than the rounding of
/// its own test and of the triangle test inside it, at no cost per box. Without them rays along
/// shared edges slip through (see test_watertight).
typedef struct {
    float8 slope[3], near_offset[3], far_offset[3];
    int near_row[3];
} TreeSlabs;

static inline TreeSlabs tree_slabs(const TreeRay* r, const float* bound) {
    TreeSlabs k;
    for (int a = 0; a < 3; ++a) {
        const float d = fabs(r->d[a]) < LEAST_SLOPE ? copysign(LEAST_SLOPE, r->d[a]) : r->d[a];
        const float slope = 1.0f / d;
        const float base = -r->o[a] * slope;
        const float slack = BOX_SLACK * (fabs(r->o[a]) + bound[a]) * fabs(slope);
        k.slope[a] = (float8)(slope);
        k.near_offset[a] = (float8)(base - slack);
        k.far_offset[a] = (float8)(base + slack);
        k.near_row[a] = slope < 0.0f ? 1 : 0;
    }
    return k;
}

static inline TreeSlabs scene_slabs(const Scene* s, const TreeRay* r) {
    const float bound[3] = {s->p->tree_bound[0], s->p->tree_bound[1], s->p->tree_bound[2]};
    return tree_slabs(r, bound);
}

static inline float8 min_8(float8 a, float8 b) { return a < b ? a : b; }
static inline float8 max_8(float8 a, float8 b) { return a > b ? a : b; }

/// Bytes 0xff of the children that the ray enters before `t`; `entry` gets where.
static inline ulong enter_children(__global const float8* node, const TreeSlabs* k, float t,
                                   float8* entry) {
    const float8 x0 = mad_f(node[k->near_row[0]], k->slope[0], k->near_offset[0]);
    const float8 x1 = mad_f(node[1 - k->near_row[0]], k->slope[0], k->far_offset[0]);
    const float8 y0 = mad_f(node[2 + k->near_row[1]], k->slope[1], k->near_offset[1]);
    const float8 y1 = mad_f(node[3 - k->near_row[1]], k->slope[1], k->far_offset[1]);
    const float8 z0 = mad_f(node[4 + k->near_row[2]], k->slope[2], k->near_offset[2]);
    const float8 z1 = mad_f(node[5 - k->near_row[2]], k->slope[2], k->far_offset[2]);
    const float8 t_in = max_8(max_8(x0, y0), max_8(z0, (float8)(0.0f)));
    const float8 t_out = min_8(min_8(x1, y1), min_8(z1, (float8)(t)));
    *entry = t_in;
    return as_ulong(convert_char8(t_in <= t_out));
}
#define first_byte(m) (popcount(~(m) & ((m)-1UL)) >> 3)
#define without_byte(m, i) ((m) & ~(0xffUL << ((i)*8u)))

/// Shear that turns the ray into the z axis. Woop, Benthin, Wald 2013, "Watertight ray/triangle
/// intersection".
typedef struct {
    int kx, ky, kz;
    float sx, sy, sz;
} Shear;
static inline Shear shear_of(const TreeRay* r) {
    Shear s;
    const float x = fabs(r->d[0]), y = fabs(r->d[1]), z = fabs(r->d[2]);
    s.kz = x > y ? (x > z ? 0 : 2) : (y > z ? 1 : 2);
    s.kx = s.kz == 2 ? 0 : s.kz + 1;
    s.ky = s.kx == 2 ? 0 : s.kx + 1;
    s.sz = 1.0f / r->d[s.kz];
    s.sx = r->d[s.kx] * s.sz;
    s.sy = r->d[s.ky] * s.sz;
    return s;
}

/// Bytes 0xff of the leaf's triangles that the ray meets before r->t, not yet without r->skip. Edge
/// functions are products without a fused multiply-add: so two triangles get exactly opposite
/// values on a shared edge, and no ray falls between them.
static inline ulong meet_triangles(__global const float8* leaf, const TreeRay* r, const Shear* k,
                                   float8* t, float8* b1, float8* b2) {
    const float ox = r->o[k->kx], oy = r->o[k->ky], oz = r->o[k->kz];
    const float8 az = leaf[k->kz] - oz, bz = leaf[3 + k->kz] - oz, cz = leaf[6 + k->kz] - oz;
    const float8 sx = (float8)(-k->sx), sy = (float8)(-k->sy);
    const float8 ax = mad_f(sx, az, leaf[k->kx] - ox), ay = mad_f(sy, az, leaf[k->ky] - oy);
    const float8 bx = mad_f(sx, bz, leaf[3 + k->kx] - ox), by = mad_f(sy, bz, leaf[3 + k->ky] - oy);
    const float8 cx = mad_f(sx, cz, leaf[6 + k->kx] - ox), cy = mad_f(sy, cz, leaf[6 + k->ky] - oy);
    const float8 u = cx * by - cy * bx, v = ax * cy - ay * cx, w = bx * ay - by * ax;
    const float8 least = min_8(min_8(u, v), w), most = max_8(max_8(u, v), w);
    const float8 det = (u + v) + w;
    const float8 scale = 1.0f / det;
    *t = mad_f(u, az, mad_f(v, bz, w * cz)) * k->sz * scale;
    *b1 = v * scale;
    *b2 = w * scale;
    // An edge function of 0 belongs to both sides. NaN lanes (spare) fail on t.
    const int8 inside = (least >= 0.0f) | (most <= 0.0f);
    return as_ulong(convert_char8(inside & (*t > 0.0f) & (*t < (float8)(r->t))));
}

static inline void closest_in_triangles(__global const float8* leaf, TreeRay* r, const Shear* k,
                                        int first_triangle_id) {
    float8 t, b1, b2;
    ulong m = meet_triangles(leaf, r, k, &t, &b1, &b2);
    if (m == 0) return;
    float ts[8], b1s[8], b2s[8];
    vstore8(t, 0, ts);
    vstore8(b1, 0, b1s);
    vstore8(b2, 0, b2s);
    __global const int* ids = (__global const int*)(leaf + 9);
    do {
        const uint i = first_byte(m);
        m = without_byte(m, i);
        const int id = first_triangle_id + ids[i];
        if (ts[i] < r->t && id != r->skip) {
            r->t = ts[i];
            r->id = id;
            r->b1 = b1s[i];
            r->b2 = b2s[i];
        }
    } while (m);
}
static inline int any_in_triangles(__global const float8* leaf, const TreeRay* r, const Shear* k,
                                   int first_triangle_id) {
    float8 t, b1, b2;
    ulong m = meet_triangles(leaf, r, k, &t, &b1, &b2);
    __global const int* ids = (__global const int*)(leaf + 9);
    while (m) {
        const uint i = first_byte(m);
        m = without_byte(m, i);
        if (first_triangle_id + ids[i] != r->skip) return 1;
    }
    return 0;
}

#if PAVE_TREE_SHAPES
/// A shape's leaf: the broadcast test with the same ray in every lane, which costs no more than a
/// scalar one.
static inline void closest_in_shape(const Scene* s, int code, TreeRay* r) {
    const vec3 o = splat3(r->o[0], r->o[1], r->o[2]), d = splat3(r->d[0], r->d[1], r->d[2]);
    const int kind = leaf_kind(code), index = leaf_index(code);
    Hit hit = no_hit();
    hit.t = splat(r->t);
    hit.id = splat_int(r->id);
    if (kind == LEAF_FLAT) {
        __global const FlatShape* f = flat_shapes(s, FLAT_RECT) + index;
        closest_flat(f, (int)f->kind, o, d, &hit);
    } else if (kind == LEAF_CUBE) {
        closest_cube(cube_shapes(s) + index, o, d, &hit);
    } else {
        closest_sphere(sphere_shapes(s) + index, o, d, &hit);
    }
    float t[PAVE_LANES];
    int id[PAVE_LANES];
    lane_store(hit.t, t);
    lane_store(hit.id, id);
    r->t = t[0];
    r->id = id[0];
}
static inline int any_in_shape(const Scene* s, int code, const TreeRay* r) {
    const vec3 o = splat3(r->o[0], r->o[1], r->o[2]), d = splat3(r->d[0], r->d[1], r->d[2]);
    const int kind = leaf_kind(code), index = leaf_index(code);
    const vfloat t = splat(r->t);
    if (kind == LEAF_FLAT) {
        __global const FlatShape* f = flat_shapes(s, FLAT_RECT) + index;
        return lane_any(occludes_flat(f, (int)f->kind, o, d, t));
    }
    if (kind == LEAF_CUBE) return lane_any(occludes_cube(cube_shapes(s) + index, o, d, t));
    return lane_any(occludes_sphere(sphere_shapes(s) + index, o, d, t));
}
#endif

static inline void closest_in_leaf(const Scene* s, int code, TreeRay* r, const Shear* k) {
#if PAVE_TREE_SHAPES
    if (leaf_kind(code) != LEAF_TRIANGLES) {
        closest_in_shape(s, code, r);
        return;
    }
#endif
#if PAVE_HAS_TRIANGLES
    closest_in_triangles(s->tree + s->p->leaf_row + (uint)leaf_index(code) * LEAF_ROWS, r, k,
                         s->p->surface_count);
#endif
}
static inline int any_in_leaf(const Scene* s, int code, const TreeRay* r, const Shear* k) {
#if PAVE_TREE_SHAPES
    if (leaf_kind(code) != LEAF_TRIANGLES) return any_in_shape(s, code, r);
#endif
#if PAVE_HAS_TRIANGLES
    return any_in_triangles(s->tree + s->p->leaf_row + (uint)leaf_index(code) * LEAF_ROWS, r, k,
                            s->p->surface_count);
#else
    return 0;
#endif
}

// A node or leaf is four or five cache lines, and a large tree is not in a cache: what goes onto
// the stack is asked for at once. Only where the compiler is known to make a processor's own code.
#if PAVE_LANES > 1 && defined(__clang__) && (defined(__x86_64__) || defined(__aarch64__))
#define prefetch_line(p) __builtin_prefetch((const void*)(uintptr_t)(p))
#endif
static inline void fetch_ahead(const Scene* s, int code) {
#ifdef prefetch_line
    __global const char* p =
        (__global const char*)(s->tree +
                               (code >= 0 ? (uint)code * NODE_ROWS
                                          : s->p->leaf_row + (uint)leaf_index(code) * LEAF_ROWS));
    prefetch_line(p);
    prefetch_line(p + 64);
    prefetch_line(p + 128);
    prefetch_line(p + 192);
    if (code < 0) prefetch_line(p + 256);
#endif
}

#if PAVE_HAS_INSTANCES
/// The ray goes on in the instance of the leaf `code`, from the root that is returned.
static inline int enter_instance(const Scene* s, int code, TreeRay* r, int depth, Visit* visit,
                                 TreeSlabs* k, Shear* shear) {
    __global const float8* rows = instance_at(s, leaf_index(code));
    visit->instance = leaf_index(code);
    visit->depth = depth;
    visit->skip = r->skip;
    for (int a = 0; a < 3; ++a) {
        visit->o[a] = r->o[a];
        visit->d[a] = r->d[a];
    }
    map_to_group(rows, visit->o, visit->d, r->o, r->d);
    if (r->skip_instance != visit->instance) r->skip = -1;
    const float bound[3] = {rows[1].s6, rows[1].s7, rows[2].s3};
    *k = tree_slabs(r, bound);
    *shear = shear_of(r);
    return as_int(rows[1].s4);
}
static inline void leave_instance(const Scene* s, TreeRay* r, Visit* visit, TreeSlabs* k,
                                  Shear* shear) {
    for (int a = 0; a < 3; ++a) {
        r->o[a] = visit->o[a];
        r->d[a] = visit->d[a];
    }
    r->skip = visit->skip;
    *visit = no_visit();
    *k = scene_slabs(s, r);
    *shear = shear_of(r);
}
#endif

/// Fills r->t, id, b1, b2 (and instance) with the closest hit before r->t.
static inline void tree_closest(const Scene* s, TreeRay* r) {
    TreeSlabs k = scene_slabs(s, r);
    Shear shear = shear_of(r);
#if PAVE_HAS_INSTANCES
    Visit visit = no_visit();
#endif
    int codes[PAVE_STACK];
    float entries[PAVE_STACK];
    int depth = 0, current = 0;
    for (;;) {
        if (current >= 0) {
            __global const float8* node = s->tree + (uint)current * NODE_ROWS;
            float8 entry;
            ulong m = enter_children(node, &k, r->t, &entry);
            if (m) {
                __global const int* child = (__global const int*)(node + 6);
                float at[8];
                vstore8(entry, 0, at);
                const uint i = first_byte(m);
                m = without_byte(m, i);
                if (!m) {  // one child: about half of all visits
                    current = child[i];
                    continue;
                }
                const uint j = first_byte(m);
                m = without_byte(m, j);
                fetch_ahead(s, child[i]);
                fetch_ahead(s, child[j]);
                const uint nearer = at[j] < at[i] ? j : i, farther = i + j - nearer;
                const int base = depth;
                codes[depth] = child[farther];
                entries[depth++] = at[farther];
                if (!m) {  // two: no sorting
                    current = child[nearer];
                    continue;
                }
                codes[depth] = child[nearer];
                entries[depth++] = at[nearer];
                do {  // more: insertion keeps the stack's top nearest
                    const uint c = first_byte(m);
                    m = without_byte(m, c);
                    const float t = at[c];
                    fetch_ahead(s, child[c]);
                    int place = depth++;
                    while (place > base && entries[place - 1] < t) {
                        entries[place] = entries[place - 1];
                        codes[place] = codes[place - 1];
                        --place;
                    }
                    entries[place] = t;
                    codes[place] = child[c];
                } while (m);
                current = codes[--depth];
                continue;
            }
#if PAVE_HAS_INSTANCES
        } else if (leaf_kind(current) == LEAF_INSTANCE) {
            current = enter_instance(s, current, r, depth, &visit, &k, &shear);
            continue;
#endif
        } else {
#if PAVE_HAS_INSTANCES
            const float before = r->t;
            closest_in_leaf(s, current, r, &shear);
            if (r->t < before) r->instance = visit.instance;
#else
            closest_in_leaf(s, current, r, &shear);
#endif
        }
        do {  // what lies behind the closest hit is dropped unread
#if PAVE_HAS_INSTANCES
            if (depth == visit.depth) leave_instance(s, r, &visit, &k, &shear);
#endif
            if (depth == 0) return;
            --depth;
        } while (entries[depth] >= r->t);
        current = codes[depth];
    }
}

/// Whether anything is hit before r->t.
static inline int tree_any(const Scene* s, TreeRay* r) {
    TreeSlabs k = scene_slabs(s, r);
    Shear shear = shear_of(r);
#if PAVE_HAS_INSTANCES
    Visit visit = no_visit();
#endif
    int codes[PAVE_STACK];
    int depth = 0, current = 0;
    for (;;) {
        if (current >= 0) {
            __global const float8* node = s->tree + (uint)current * NODE_ROWS;
            float8 entry;
            ulong m = enter_children(node, &k, r->t, &entry);
            __global const int* child = (__global const int*)(node + 6);
            while (m) {
                const uint c = first_byte(m);
                m = without_byte(m, c);
                fetch_ahead(s, child[c]);
                codes[depth++] = child[c];
            }
#if PAVE_HAS_INSTANCES
        } else if (leaf_kind(current) == LEAF_INSTANCE) {
            current = enter_instance(s, current, r, depth, &visit, &k, &shear);
            continue;
#endif
        } else if (any_in_leaf(s, current, r, &shear)) {
            return 1;
        }
#if PAVE_HAS_INSTANCES
        if (depth == visit.depth) leave_instance(s, r, &visit, &k, &shear);
#endif
        if (depth == 0) return 0;
        current = codes[--depth];
    }
}

#endif  // PAVE_HAS_TREE
