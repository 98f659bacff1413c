// Rays one by one through the tree: closest hit in order of entry, any hit unordered.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "tree.h"

#if PAVE_HAS_TREE

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

/// The hit triangle's row, which the shading will ask for.
static inline void fetch_triangle(const Scene* s, int id) {
#ifdef prefetch_line
    if (id >= s->p->surface_count)
        prefetch_line((__global const char*)(s->tables + s->p->triangle_row +
                                             (uint)(id - s->p->surface_count) * TRIANGLE_ROWS));
#endif
}

#if PAVE_HAS_INSTANCES
/// The instance that a ray is in, and what the ray is outside of it.
typedef struct {
    int instance;  // -1: in none
    int depth;     // of the stack, when it came in; -1: in none
    TreeRay outside;
} Visit;
#endif

/// Where a ray is in the tree, and what it has still to visit.
typedef struct {
    int current, depth;
#if PAVE_HAS_INSTANCES
    Visit visit;
#endif
} Place;
static inline Place root_place(void) {
    Place at;
    at.current = at.depth = 0;
#if PAVE_HAS_INSTANCES
    at.visit.instance = at.visit.depth = -1;
#endif
    return at;
}
typedef struct {
    int codes[PAVE_STACK];
    float entries[PAVE_STACK];
} Stack;

#if PAVE_HAS_INSTANCES
/// The ray goes on in the instance of the leaf that it is at.
static inline void enter_instance(const Scene* s, TreeRay* r, Place* at) {
    const int instance = leaf_index(at->current);
    __global const float8* rows = instance_at(s, instance);
    at->visit.instance = instance;
    at->visit.depth = at->depth;
    at->visit.outside = *r;
    float o[3], d[3];
    map_to_group(rows, r->o, r->d, o, d);
    const float bound[3] = {rows[1].s6, rows[1].s7, rows[2].s3};
    const RayFrames f = ray_frames(bound, splat3(o[0], o[1], o[2]), splat3(d[0], d[1], d[2]));
    aim_ray(r, &f);
    if (r->skip_instance != instance) r->skip = -1;
    at->current = as_int(rows[1].s4);
}
/// Back outside, with what the ray has met since.
static inline void leave_instance(TreeRay* r, Visit* visit) {
    TreeRay back = visit->outside;
    back.t = r->t;
    back.id = r->id;
    back.b1 = r->b1;
    back.b2 = r->b2;
    back.instance = r->instance;
    *r = back;
    visit->instance = visit->depth = -1;
}
#endif

/// Goes on with what was put aside last; 0 at the end. What lies behind the closest hit is dropped
/// unread.
static inline int take_from_stack(TreeRay* r, Place* at, const Stack* stack) {
    int depth = at->depth;
    do {
#if PAVE_HAS_INSTANCES
        if (depth == at->visit.depth) leave_instance(r, &at->visit);
#endif
        if (depth == 0) return 0;
        --depth;
    } while (stack->entries[depth] >= r->t);
    at->current = stack->codes[depth];
    at->depth = depth;
    return 1;
}

/// From the node to the nearest child that the ray enters before r->t, the others put aside in
/// order; 0 at the end.
static inline int step_from_node(const Scene* s, TreeRay* r, Place* at, Stack* stack) {
    const TreeSlabs k = tree_slabs(r);
    __global const float8* node = s->tree + (uint)at->current * NODE_ROWS;
    float8 entry;
    uint m = enter_children(node, &k, r->t, &entry);
    if (!m) return take_from_stack(r, at, stack);
    __global const int* child = (__global const int*)(node + 6);
    float where[8];
    vstore8(entry, 0, where);
    const uint i = lowest_bit(m);
    m &= m - 1u;
    fetch_ahead(s, child[i]);
    at->current = child[i];
    if (!m) return 1;  // one child: about half of all visits
    const uint j = lowest_bit(m);
    m &= m - 1u;
    fetch_ahead(s, child[j]);
    const uint nearer = where[j] < where[i] ? j : i, farther = i + j - nearer;
    const int base = at->depth;
    int depth = base;
    stack->codes[depth] = child[farther];
    stack->entries[depth++] = where[farther];
    at->current = child[nearer];
    at->depth = depth;
    if (!m) return 1;  // two: no sorting
    stack->codes[depth] = child[nearer];
    stack->entries[depth++] = where[nearer];
    do {  // more: insertion keeps the stack's top nearest
        const uint c = lowest_bit(m);
        m &= m - 1u;
        const float t = where[c];
        fetch_ahead(s, child[c]);
        int place = depth++;
        while (place > base && stack->entries[place - 1] < t) {
            stack->entries[place] = stack->entries[place - 1];
            stack->codes[place] = stack->codes[place - 1];
            --place;
        }
        stack->entries[place] = t;
        stack->codes[place] = child[c];
    } while (m);
    at->current = stack->codes[--depth];
    at->depth = depth;
    return 1;
}
/// r->t, id, b1, b2 get the leaf's closest hit before r->t; 0 at the end.
static inline int step_from_leaf(const Scene* s, TreeRay* r, Place* at, const Stack* stack) {
#if PAVE_HAS_INSTANCES
    if (leaf_kind(at->current) == LEAF_INSTANCE) {
        enter_instance(s, r, at);
        return 1;
    }
    const float before = r->t;
#endif
    closest_in_leaf(s, at->current, r);
#if PAVE_HAS_INSTANCES
    if (r->t < before) r->instance = at->visit.instance;
#endif
    return take_from_stack(r, at, stack);
}

static inline int take_any_from_stack(TreeRay* r, Place* at, const Stack* stack) {
#if PAVE_HAS_INSTANCES
    if (at->depth == at->visit.depth) leave_instance(r, &at->visit);
#endif
    if (at->depth == 0) return 0;
    at->current = stack->codes[--at->depth];
    return 1;
}
/// As step_from_node, in any order.
static inline int any_from_node(const Scene* s, TreeRay* r, Place* at, Stack* stack) {
    const TreeSlabs k = tree_slabs(r);
    __global const float8* node = s->tree + (uint)at->current * NODE_ROWS;
    __global const int* child = (__global const int*)(node + 6);
    float8 entry;
    int depth = at->depth;
    for (uint m = enter_children(node, &k, r->t, &entry); m; m &= m - 1u) {
        const uint c = lowest_bit(m);
        fetch_ahead(s, child[c]);
        stack->codes[depth++] = child[c];
    }
    at->depth = depth;
    return take_any_from_stack(r, at, stack);
}
/// `found` gets whether the leaf is hit; 0 then, and at the end.
static inline int any_from_leaf(const Scene* s, TreeRay* r, Place* at, const Stack* stack,
                                int* found) {
#if PAVE_HAS_INSTANCES
    if (leaf_kind(at->current) == LEAF_INSTANCE) {
        enter_instance(s, r, at);
        *found = 0;
        return 1;
    }
#endif
    *found = any_in_leaf(s, at->current, r);
    return *found ? 0 : take_any_from_stack(r, at, stack);
}

/// A walk's end: what the ray has met goes to its lane.
static inline void keep_hit(const Scene* s, const TreeRay* r, LaneRays* rays, uint lane) {
    if (r->id < 0) return;
    fetch_triangle(s, r->id);
    rays->t[lane] = r->t;
    rays->id[lane] = r->id;
#if PAVE_HAS_INSTANCES
    rays->instance[lane] = r->instance;
#endif
    rays->b1[lane] = r->b1;
    rays->b2[lane] = r->b2;
}

#if PAVE_TREE_TURNS && !PAVE_HAS_INSTANCES

// In a tree larger than the caches rays take turns, a node or leaf each: while the others are at
// theirs, a ray's next one comes from memory. All at nodes go before all at leaves, which the
// processor foresees.
typedef struct {
    uint at_node, at_leaf;  // bits of lanes
    Place at[PAVE_LANES];
    Stack stack[PAVE_LANES];
} Turns;

static inline void start_turns(Turns* w, uint lanes) {
    w->at_node = lanes;
    w->at_leaf = 0;
    for (int i = 0; i < PAVE_LANES; ++i) w->at[i] = root_place();
}
static inline void end_turn(Turns* w, uint lane, Place at, int more) {
    const uint bit = 1u << lane, leaf = as_uint(at.current) >> 31;
    w->at[lane] = at;
    w->at_node &= ~bit;
    w->at_leaf &= ~bit;
    if (more) {
        w->at_node |= bit & (leaf - 1u);
        w->at_leaf |= bit & (0u - leaf);
    }
}

/// The rays of `lanes` get their closest hits.
static inline void walk_to_closest(const Scene* s, LaneRays* rays, uint lanes) {
    Turns w;
    start_turns(&w, lanes);
    while (w.at_node | w.at_leaf) {
        for (uint m = w.at_node; m; m &= m - 1u) {
            const uint i = lowest_bit(m);
            TreeRay r = ray_of_lane(rays, i);
            Place at = w.at[i];
            const int more = step_from_node(s, &r, &at, &w.stack[i]);
            end_turn(&w, i, at, more);
        }
        for (uint m = w.at_leaf; m; m &= m - 1u) {
            const uint i = lowest_bit(m);
            TreeRay r = ray_of_lane(rays, i);
            Place at = w.at[i];
            const int more = step_from_leaf(s, &r, &at, &w.stack[i]);
            end_turn(&w, i, at, more);
            keep_hit(s, &r, rays, i);
        }
    }
}

/// Bits of those of `lanes` whose ray meets anything.
static inline uint walk_to_any(const Scene* s, const LaneRays* rays, uint lanes) {
    Turns w;
    start_turns(&w, lanes);
    uint found = 0;
    while (w.at_node | w.at_leaf) {
        for (uint m = w.at_node; m; m &= m - 1u) {
            const uint i = lowest_bit(m);
            TreeRay r = ray_of_lane(rays, i);
            Place at = w.at[i];
            const int more = any_from_node(s, &r, &at, &w.stack[i]);
            end_turn(&w, i, at, more);
        }
        for (uint m = w.at_leaf; m; m &= m - 1u) {
            const uint i = lowest_bit(m);
            TreeRay r = ray_of_lane(rays, i);
            Place at = w.at[i];
            int hit;
            const int more = any_from_leaf(s, &r, &at, &w.stack[i], &hit);
            end_turn(&w, i, at, more);
            found |= (uint)hit << i;
        }
    }
    return found;
}

#else

/// The rays of `lanes` get their closest hits.
static inline void walk_to_closest(const Scene* s, LaneRays* rays, uint lanes) {
    for (; lanes; lanes &= lanes - 1u) {
        const uint i = lowest_bit(lanes);
        TreeRay r = ray_of_lane(rays, i);
        Place at = root_place();
        Stack stack;
        while (at.current < 0 ? step_from_leaf(s, &r, &at, &stack)
                              : step_from_node(s, &r, &at, &stack)) {
        }
        keep_hit(s, &r, rays, i);
    }
}

/// Bits of those of `lanes` whose ray meets anything.
static inline uint walk_to_any(const Scene* s, const LaneRays* rays, uint lanes) {
    uint found = 0;
    for (; lanes; lanes &= lanes - 1u) {
        const uint i = lowest_bit(lanes);
        TreeRay r = ray_of_lane(rays, i);
        Place at = root_place();
        Stack stack;
        int hit = 0;
        while (at.current < 0 ? any_from_leaf(s, &r, &at, &stack, &hit)
                              : any_from_node(s, &r, &at, &stack)) {
        }
        found |= (uint)hit << i;
    }
    return found;
}

#endif

#endif  // PAVE_HAS_TREE
