// PAVE_LANES rays that go the same way, as a camera's do, together through the tree: a node or leaf
// is read once for all of them. Every ray gets the numbers that it gets alone.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "tree.h"

#define PAVE_HAS_PACKETS \
    (PAVE_LANES > 1 && PAVE_HAS_TRIANGLES && !PAVE_TREE_SHAPES && !PAVE_HAS_INSTANCES)

#if PAVE_HAS_PACKETS

typedef struct {
    vfloat o[3], d[3];
    Hit hit;  // t: where the ray ends so far
} PacketRays;

/// What the rays have in common: signs of the slopes, and the axis they go along most.
typedef struct {
    vfloat slope[3], near_offset[3], far_offset[3];
    int near_row[3];
    int kx, ky, kz;
    vfloat sx, sy, sz;
} PacketFrame;

/// As tree_slabs and shear_of; 0 if the rays have too little in common to go together.
static inline int packet_frame(const PacketRays* r, __constant const PathParams* p,
                               PacketFrame* f) {
    for (int a = 0; a < 3; ++a) {
        const vmask small = vabs(r->d[a]) < LEAST_SLOPE;
        const vfloat d = small ? with_sign(splat(LEAST_SLOPE), r->d[a]) : r->d[a];
        const vfloat slope = 1.0f / d;
        const vfloat base = -r->o[a] * slope;
        const vfloat slack = BOX_SLACK * (vabs(r->o[a]) + p->tree_bound[a]) * vabs(slope);
        const vmask back = slope < 0.0f;
        f->near_row[a] = lane_any(back);
        if (f->near_row[a] && lane_any(lane_not(back))) return 0;
        f->slope[a] = slope;
        f->near_offset[a] = base - slack;
        f->far_offset[a] = base + slack;
    }
    const vfloat x = vabs(r->d[0]), y = vabs(r->d[1]), z = vabs(r->d[2]);
    const vmask along_x = (x > y) & (x > z), along_y = lane_not(x > y) & (y > z);
    if (lane_any(along_x)) {
        if (lane_any(lane_not(along_x))) return 0;
        f->kz = 0;
    } else {
        f->kz = lane_any(along_y) ? 1 : 2;
        if (f->kz == 1 && lane_any(lane_not(along_y))) return 0;
    }
    f->kx = f->kz == 2 ? 0 : f->kz + 1;
    f->ky = f->kx == 2 ? 0 : f->kx + 1;
    f->sz = 1.0f / r->d[f->kz];
    f->sx = r->d[f->kx] * f->sz;
    f->sy = r->d[f->ky] * f->sz;
    return 1;
}

/// As closest_in_triangles, triangle by triangle.
static inline void closest_of_packet_in_leaf(__global const float* leaf, PacketRays* r,
                                             const PacketFrame* f, int first_triangle_id) {
    const vfloat ox = r->o[f->kx], oy = r->o[f->ky], oz = r->o[f->kz];
    __global const float *px = leaf + 8 * f->kx, *py = leaf + 8 * f->ky, *pz = leaf + 8 * f->kz;
    for (int i = 0; i < TREE_WIDTH; ++i) {
        if (isnan(leaf[i])) return;  // spare lanes come last
        const vfloat az = pz[i] - oz, bz = pz[24 + i] - oz, cz = pz[48 + i] - oz;
        const vfloat ax = mad_f(-f->sx, az, px[i] - ox), ay = mad_f(-f->sy, az, py[i] - oy);
        const vfloat bx = mad_f(-f->sx, bz, px[24 + i] - ox),
                     by = mad_f(-f->sy, bz, py[24 + i] - oy);
        const vfloat cx = mad_f(-f->sx, cz, px[48 + i] - ox),
                     cy = mad_f(-f->sy, cz, py[48 + i] - oy);
        const vfloat u = cx * by - cy * bx, v = ax * cy - ay * cx, w = bx * ay - by * ax;
        const vfloat least = vmin(vmin(u, v), w), most = vmax(vmax(u, v), w);
        const vmask inside = (least >= 0.0f) | (most <= 0.0f);
        if (!lane_any(inside)) continue;
        const vfloat scale = 1.0f / ((u + v) + w);
        const vfloat t = mad_f(u, az, mad_f(v, bz, w * cz)) * f->sz * scale;
        const vmask m = inside & (t > 0.0f) & (t < r->hit.t);
        const int id = first_triangle_id + ((__global const int*)(leaf + 72))[i];
        r->hit.t = m ? t : r->hit.t;
        r->hit.id = m ? splat_int(id) : r->hit.id;
        r->hit.b1 = m ? v * scale : r->hit.b1;
        r->hit.b2 = m ? w * scale : r->hit.b2;
    }
}

/// Pushes the children of a node that some ray enters, the one that the first ray would enter first
/// on top; returns the new depth.
static inline int push_children(__global const float* node, const PacketRays* r,
                                const PacketFrame* f, int* codes, vfloat* entries, int depth) {
    __global const int* child = (__global const int*)(node + 48);
    vfloat entry[TREE_WIDTH];
    float keys[TREE_WIDTH];
    int order[TREE_WIDTH];
    int count = 0;
    for (int c = 0; c < TREE_WIDTH; ++c) {
        __global const float* low = node + c;
        if (low[0] == INFINITY) break;  // empty children come last
        const vfloat x0 = mad_f(splat(low[8 * f->near_row[0]]), f->slope[0], f->near_offset[0]);
        const vfloat x1 = mad_f(splat(low[8 - 8 * f->near_row[0]]), f->slope[0], f->far_offset[0]);
        const vfloat y0 =
            mad_f(splat(low[16 + 8 * f->near_row[1]]), f->slope[1], f->near_offset[1]);
        const vfloat y1 = mad_f(splat(low[24 - 8 * f->near_row[1]]), f->slope[1], f->far_offset[1]);
        const vfloat z0 =
            mad_f(splat(low[32 + 8 * f->near_row[2]]), f->slope[2], f->near_offset[2]);
        const vfloat z1 = mad_f(splat(low[40 - 8 * f->near_row[2]]), f->slope[2], f->far_offset[2]);
        const vfloat t_in = vmax(vmax(x0, y0), vmax(z0, splat(0.0f)));
        const vfloat t_out = vmin(vmin(x1, y1), vmin(z1, r->hit.t));
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

/// Fills r->hit with the closest hits before r->hit.t.
static inline void packet_closest(const Scene* s, PacketRays* r, const PacketFrame* f) {
    int codes[PAVE_STACK];
    vfloat entries[PAVE_STACK];
    int depth = 1;
    codes[0] = 0;
    entries[0] = splat(0.0f);
    while (depth > 0) {
        --depth;
        if (!lane_any(entries[depth] < r->hit.t)) continue;
        const int code = codes[depth];
        if (code >= 0)
            depth = push_children((__global const float*)(s->tree + (uint)code * NODE_ROWS), r, f,
                                  codes, entries, depth);
        else
            closest_of_packet_in_leaf((__global const float*)(s->tree + s->p->leaf_row +
                                                              (uint)leaf_index(code) * LEAF_ROWS),
                                      r, f, s->p->surface_count);
    }
}

#endif  // PAVE_HAS_PACKETS
