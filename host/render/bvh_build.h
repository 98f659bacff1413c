// Builds an 8-wide bounding volume hierarchy over any primitives by binned SAH; knows only their
// boxes.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

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
    std::vector<Bvh8Node> nodes;
    std::vector<Bvh8Leaf> leaves;
    std::vector<uint32_t>
        order;  // primitive indices; every leaf is a run of it, every primitive is in one leaf
    Aabb bounds;
    int depth = 0;  // inner nodes on the longest way down
};

struct BvhBuildOptions {
    int max_leaf = 8;        // primitives a leaf, 1..64; a leaf of n costs ceil(n / packet)
    int packet = 8;          // primitives that are tested together
    float leaf_cost = 1.0f;  // one packet test against one test of eight boxes
};

/// `boxes` must be finite and not empty. Deterministic.
Bvh8 build_bvh8(std::span<const Aabb> boxes, const BvhBuildOptions& options = {});

}  // namespace pave
