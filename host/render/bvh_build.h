// Builds an 8-wide bounding volume hierarchy over any primitives over all cores; knows only their
// boxes.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>

#include "host/render/block.h"
#include "host/render/bvh_bins.h"
#include "host/render/workers.h"

namespace pave {

struct Aabb {
    std::array<float, 3> lower{std::numeric_limits<float>::infinity(),
                               std::numeric_limits<float>::infinity(),
                               std::numeric_limits<float>::infinity()};
    std::array<float, 3> upper{-std::numeric_limits<float>::infinity(),
                               -std::numeric_limits<float>::infinity(),
                               -std::numeric_limits<float>::infinity()};

    void grow_to(const std::array<float, 3>& point);
    void grow(const Aabb& other);
    bool empty() const { return lower[0] > upper[0]; }
    float half_area() const;  // 0 for an empty box
};

/// Up to eight children. A child is an inner node, a leaf or nothing.
struct Bvh8Node {
    enum class Kind : uint8_t { kNone, kInner, kLeaf };
    std::array<Aabb, 8> bounds;
    std::array<Kind, 8> kinds{};
    std::array<uint32_t, 8> children{};  // index into nodes or leaves
};

/// A run of Bvh8::order.
struct Bvh8Leaf {
    uint32_t first = 0, count = 0;
};

/// Node 0 is the root; it exists even for no primitives (then it has no children).
struct Bvh8 {
    Block<Bvh8Node> nodes;
    Block<Bvh8Leaf> leaves;
    Block<uint32_t>
        order;  // primitive indices; every leaf is a run of it, every primitive is in one leaf
    Aabb bounds;
    int depth = 0;  // inner nodes on the longest way down
};

struct BvhBuildOptions {
    int max_leaf = 8;        // primitives a leaf, 1..64; a leaf of n costs ceil(n / packet)
    int packet = 8;          // primitives that are tested together
    float leaf_cost = 1.0f;  // one packet test against one test of eight boxes
    int threads = 0;         // 0: all cores; no number changes the tree
};

inline constexpr size_t kMaxPrimitives = size_t{1} << 28;

/// `box`, which is finite and not empty, as the builder takes it.
inline Box primitive_box(const Aabb& box, uint32_t index) {
    Box primitive{{-box.lower[0], -box.lower[1], -box.lower[2], 0},
                  {box.upper[0], box.upper[1], box.upper[2], 0}};
    set_index(primitive, index);
    return primitive;
}

/// Deterministic, whatever the number of threads. Blocks. Throws InternalError for a box that is
/// empty or not finite.
Bvh8 build_bvh8(std::span<const Aabb> boxes, const BvhBuildOptions& options = {});
/// The same over boxes that the caller has checked, on the caller's workers.
Bvh8 build_bvh8(Block<Box> primitives, Workers& workers, const BvhBuildOptions& options = {});

}  // namespace pave
