// Binned SAH to a binary tree (Wald 2007), collapsed to eight children by opening the largest
// child first.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/bvh_build.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "pave/error.h"

namespace pave {
namespace {

constexpr int kBins = 16;
constexpr int kMaxSahDepth =
    48;  // below it ranges are halved, so that the depth stays bounded for any input

struct BinaryNode {
    Aabb bounds;
    int left = -1, right = -1;  // -1: a leaf over order[first, first + count)
    uint32_t first = 0, count = 0;
};

struct Split {
    int axis = -1, bin = 0;
    float cost = std::numeric_limits<float>::infinity();
};

class Builder {
   public:
    Builder(std::span<const Aabb> boxes, const BvhBuildOptions& options)
        : boxes_(boxes), options_(options), order_(boxes.size()), centers_(boxes.size()) {
        std::iota(order_.begin(), order_.end(), 0u);
        for (size_t i = 0; i < boxes.size(); ++i)
            for (size_t axis = 0; axis < 3; ++axis)
                centers_[i][axis] = 0.5f * boxes[i].lower[axis] + 0.5f * boxes[i].upper[axis];
        nodes_.reserve(2 * boxes.size());
    }

    Bvh8 build() {
        Bvh8 tree;
        if (boxes_.empty()) {
            tree.nodes.emplace_back();
            return tree;
        }
        const int root = build_range(0, static_cast<uint32_t>(boxes_.size()), 0);
        tree.bounds = nodes_[static_cast<size_t>(root)].bounds;
        collapse(root, tree, 1);
        tree.order = std::move(order_);
        return tree;
    }

   private:
    float leaf_cost(uint32_t count) const {
        const uint32_t packet = static_cast<uint32_t>(options_.packet);
        return options_.leaf_cost * static_cast<float>((count + packet - 1) / packet);
    }

    int bin_of(uint32_t primitive, size_t axis, const Aabb& centers, float scale) const {
        const int bin = static_cast<int>((centers_[primitive][axis] - centers.lower[axis]) * scale);
        return std::clamp(bin, 0, kBins - 1);
    }

    static float bin_scale(const Aabb& centers, size_t axis) {
        const float extent = centers.upper[axis] - centers.lower[axis];
        const float scale = static_cast<float>(kBins) * (1.0f - 1e-6f) / extent;
        return std::isfinite(scale) ? scale : 0.0f;  // no extent, or one too small to divide by
    }

    Split best_split(uint32_t first, uint32_t count, const Aabb& bounds,
                     const Aabb& centers) const {
        Split best;
        for (size_t axis = 0; axis < 3; ++axis) {
            const float scale = bin_scale(centers, axis);
            if (scale == 0.0f) continue;
            std::array<Aabb, kBins> boxes;
            std::array<uint32_t, kBins> counts{};
            for (uint32_t i = first; i < first + count; ++i) {
                const auto bin = static_cast<size_t>(bin_of(order_[i], axis, centers, scale));
                boxes[bin].grow(boxes_[order_[i]]);
                ++counts[bin];
            }
            std::array<float, kBins> right_cost{};
            Aabb right;
            uint32_t right_count = 0;
            for (size_t bin = kBins - 1; bin > 0; --bin) {
                right.grow(boxes[bin]);
                right_count += counts[bin];
                right_cost[bin] = right.half_area() * leaf_cost(right_count);
            }
            Aabb left;
            uint32_t left_count = 0;
            for (size_t bin = 0; bin + 1 < kBins; ++bin) {
                left.grow(boxes[bin]);
                left_count += counts[bin];
                if (left_count == 0 || left_count == count) continue;
                const float area = std::max(bounds.half_area(), std::numeric_limits<float>::min());
                const float cost =
                    (left.half_area() * leaf_cost(left_count) + right_cost[bin + 1]) / area;
                if (cost < best.cost) best = {static_cast<int>(axis), static_cast<int>(bin), cost};
            }
        }
        return best;
    }

    /// Where to cut order_[first, first + count): after this many primitives; 0 makes a leaf.
    uint32_t partition(uint32_t first, uint32_t count, const Aabb& bounds, int depth) {
        if (count <= 1) return 0;
        Aabb centers;
        for (uint32_t i = first; i < first + count; ++i) centers.grow_to(centers_[order_[i]]);
        const Split split =
            depth < kMaxSahDepth ? best_split(first, count, bounds, centers) : Split{};
        const bool fits = count <= static_cast<uint32_t>(options_.max_leaf);
        // Eight boxes are tested at once, so a binary step costs an eighth of a node's test.
        if (fits && (split.axis < 0 || leaf_cost(count) <= 0.125f + split.cost)) return 0;
        if (split.axis < 0) return count / 2;
        const auto axis = static_cast<size_t>(split.axis);
        const float scale = bin_scale(centers, axis);
        const auto begin = order_.begin() + first;
        const auto middle = std::stable_partition(begin, begin + count, [&](uint32_t primitive) {
            return bin_of(primitive, axis, centers, scale) <= split.bin;
        });
        return static_cast<uint32_t>(middle - begin);
    }

    int build_range(uint32_t first, uint32_t count, int depth) {
        Aabb bounds;
        for (uint32_t i = first; i < first + count; ++i) bounds.grow(boxes_[order_[i]]);
        const uint32_t left_count = partition(first, count, bounds, depth);
        const int index = static_cast<int>(nodes_.size());
        nodes_.push_back({bounds, -1, -1, first, count});
        if (left_count > 0) {
            const int left = build_range(first, left_count, depth + 1);
            const int right = build_range(first + left_count, count - left_count, depth + 1);
            nodes_[static_cast<size_t>(index)].left = left;
            nodes_[static_cast<size_t>(index)].right = right;
        }
        return index;
    }

    bool is_leaf(int index) const { return nodes_[static_cast<size_t>(index)].left < 0; }

    /// Up to eight descendants that stand for `index`: the inner one with the largest surface is
    /// opened first.
    std::vector<int> eight_children(int index) const {
        std::vector<int> children{index};
        while (children.size() < 8) {
            int largest = -1;
            float area = -1.0f;
            for (size_t i = 0; i < children.size(); ++i) {
                const BinaryNode& node = nodes_[static_cast<size_t>(children[i])];
                if (!is_leaf(children[i]) && node.bounds.half_area() > area) {
                    largest = static_cast<int>(i);
                    area = node.bounds.half_area();
                }
            }
            if (largest < 0) break;
            const BinaryNode& node =
                nodes_[static_cast<size_t>(children[static_cast<size_t>(largest)])];
            children[static_cast<size_t>(largest)] = node.left;
            children.push_back(node.right);
        }
        return children;
    }

    uint32_t collapse(int index, Bvh8& tree, int depth) const {
        tree.depth = std::max(tree.depth, depth);
        const auto node = static_cast<uint32_t>(tree.nodes.size());
        tree.nodes.emplace_back();
        const std::vector<int> children = eight_children(index);
        for (size_t slot = 0; slot < children.size(); ++slot) {
            const BinaryNode& child = nodes_[static_cast<size_t>(children[slot])];
            uint32_t target;
            if (is_leaf(children[slot])) {
                target = static_cast<uint32_t>(tree.leaves.size());
                tree.leaves.push_back({child.first, child.count});
            } else {
                target = collapse(children[slot], tree, depth + 1);
            }
            Bvh8Node& out = tree.nodes[node];
            out.bounds[slot] = child.bounds;
            out.kinds[slot] =
                is_leaf(children[slot]) ? Bvh8Node::Kind::kLeaf : Bvh8Node::Kind::kInner;
            out.children[slot] = target;
        }
        return node;
    }

    std::span<const Aabb> boxes_;
    BvhBuildOptions options_;
    std::vector<uint32_t> order_;
    std::vector<std::array<float, 3>> centers_;
    std::vector<BinaryNode> nodes_;
};

}  // namespace

void Aabb::grow_to(const std::array<float, 3>& point) {
    for (size_t axis = 0; axis < 3; ++axis) {
        lower[axis] = std::min(lower[axis], point[axis]);
        upper[axis] = std::max(upper[axis], point[axis]);
    }
}

void Aabb::grow(const Aabb& other) {
    for (size_t axis = 0; axis < 3; ++axis) {
        lower[axis] = std::min(lower[axis], other.lower[axis]);
        upper[axis] = std::max(upper[axis], other.upper[axis]);
    }
}

float Aabb::half_area() const {
    if (empty()) return 0.0f;
    const float x = upper[0] - lower[0], y = upper[1] - lower[1], z = upper[2] - lower[2];
    return x * y + y * z + z * x;
}

Bvh8 build_bvh8(std::span<const Aabb> boxes, const BvhBuildOptions& options) {
    if (options.max_leaf < 1 || options.max_leaf > 64 || options.packet < 1)
        throw InternalError("BVH leaf size " + std::to_string(options.max_leaf));
    for (const Aabb& box : boxes)
        for (size_t axis = 0; axis < 3; ++axis)
            if (!(box.lower[axis] <= box.upper[axis]) || !std::isfinite(box.lower[axis]) ||
                !std::isfinite(box.upper[axis]))
                throw InternalError("BVH over an empty or non-finite box");
    return Builder(boxes, options).build();
}

}  // namespace pave
