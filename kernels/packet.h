// PAVE_LANES rays that go the same way, as a camera's do, together through the tree: a node or leaf
// is read once for all of them. Every ray gets the numbers that it gets alone.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "tree.h"

#define PAVE_HAS_PACKETS \
    (PAVE_LANES > 1 && PAVE_HAS_TRIANGLES && !PAVE_TREE_SHAPES && !PAVE_HAS_INSTANCES)

#if PAVE_HAS_PACKETS

/// What the rays have in common: the signs of their slopes, and their longest axis.
typedef struct {
    int near_row[3];
    int longest;
} PacketFrame;

/// 0 if the rays have too little in common to go together.
static inline int packet_frame(const RayFrames* r, PacketFrame* f) {
#pragma unroll
    for (int a = 0; a < 3; ++a) {
        const vmask back = r->near_row[a] != 0;
        f->near_row[a] = lane_any(back);
        if (f->near_row[a] && lane_any(lane_not(back))) return 0;
    }
    f->longest = lane_any(r->longest == 0) ? 0 : (lane_any(r->longest == 1) ? 1 : 2);
    return !lane_any(r->longest != f->longest);
}

/// As closest_in_triangles, triangle by triangle.
static inline void closest_of_packet_in_leaf(__global const float* leaf, const RayFrames* r,
                                             const PacketFrame* f, Skip skip, int first_triangle_id,
                                             Hit* hit) {
    const int kz = f->longest, kx = kz == 2 ? 0 : kz + 1, ky = kx == 2 ? 0 : kx + 1;
    const vfloat ox = r->origin[0], oy = r->origin[1], oz = r->origin[2];
    const vfloat sx = -r->shear[0], sy = -r->shear[1];
    __global const float *px = leaf + 8 * kx, *py = leaf + 8 * ky, *pz = leaf + 8 * kz;
    for (int i = 0; i < TREE_WIDTH; ++i) {
        if (isnan(leaf[i])) return;  // spare lanes come last
        const vfloat az = pz[i] - oz, bz = pz[24 + i] - oz, cz = pz[48 + i] - oz;
        const vfloat ax = mad_f(sx, az, px[i] - ox), ay = mad_f(sy, az, py[i] - oy);
        const vfloat bx = mad_f(sx, bz, px[24 + i] - ox), by = mad_f(sy, bz, py[24 + i] - oy);
        const vfloat cx = mad_f(sx, cz, px[48 + i] - ox), cy = mad_f(sy, cz, py[48 + i] - oy);
        const vfloat u = cx * by - cy * bx, v = ax * cy - ay * cx, w = bx * ay - by * ax;
        const vfloat least = vmin(vmin(u, v), w), most = vmax(vmax(u, v), w);
        const vmask inside = (least >= 0.0f) | (most <= 0.0f);
        if (!lane_any(inside)) continue;
        const vfloat scale = 1.0f / ((u + v) + w);
        const vfloat t = mad_f(u, az, mad_f(v, bz, w * cz)) * r->shear[2] * scale;
        const vint id = splat_int(first_triangle_id + ((__global const int*)(leaf + 72))[i]);
        const vmask m = inside & (t > 0.0f) & (t < hit->t) & (id != skip.id);
        take_hit(hit, m, t, id);
        hit->b1 = m ? v * scale : hit->b1;
        hit->b2 = m ? w * scale : hit->b2;
    }
}

/// Pushes the children of a node that some ray enters, the one that the first ray would enter first
/// on top; returns the new depth.
static inline int push_children(__global const float* node, const RayFrames* r,
                                const PacketFrame* f, vfloat t_max, int* codes, vfloat* entries,
                                int depth) {
    __global const int* child = (__global const int*)(node + 48);
    vfloat entry[TREE_WIDTH];
    float keys[TREE_WIDTH];
    int order[TREE_WIDTH];
    int count = 0;
    for (int c = 0; c < TREE_WIDTH; ++c) {
        __global const float* child_rows = node + c;
        if (child_rows[0] == INFINITY) break;  // empty children come last
        vfloat t_in = splat(0.0f), t_out = t_max;
#pragma unroll
        for (int a = 0; a < 3; ++a) {
            __global const float* slab = child_rows + 16 * a;
            const vfloat near = splat(slab[8 * f->near_row[a]]);
            const vfloat far = splat(slab[8 - 8 * f->near_row[a]]);
            t_in = vmax(mad_f(near, r->slope[a], r->near_offset[a]), t_in);
            t_out = vmin(mad_f(far, r->slope[a], r->far_offset[a]), t_out);
        }
        const vmask enters = t_in <= t_out;
        if (!lane_any(enters)) continue;
        entry[c] = enters ? t_in : splat(INFINITY);
        float first[PAVE_LANES];
        lane_store(t_in, first);
        keys[c] = first[0];
        int place = count++;
        for (; place > 0 && keys[order[place - 1]] < keys[c]; --place)
            order[place] = order[place - 1];
        order[place] = c;
    }
    for (int i = 0; i < count; ++i) {
        codes[depth + i] = child[order[i]];
        entries[depth + i] = entry[order[i]];
    }
    return depth + count;
}

/// As tree_closest for the rays of all lanes.
static inline void packet_closest(const Scene* s, const RayFrames* r, const PacketFrame* f,
                                  Skip skip, Hit* hit) {
    int codes[PAVE_STACK];
    vfloat entries[PAVE_STACK];
    int depth = 1;
    codes[0] = 0;
    entries[0] = splat(0.0f);
    while (depth > 0) {
        --depth;
        if (!lane_any(entries[depth] < hit->t)) continue;
        const int code = codes[depth];
        if (code >= 0)
            depth = push_children((__global const float*)(s->tree + (uint)code * NODE_ROWS), r, f,
                                  hit->t, codes, entries, depth);
        else
            closest_of_packet_in_leaf((__global const float*)(s->tree + s->p->leaf_row +
                                                              (uint)leaf_index(code) * LEAF_ROWS),
                                      r, f, skip, s->p->surface_count, hit);
    }
}

#endif  // PAVE_HAS_PACKETS
