// The 8-wide tree out of the binary one: which nodes become children follows from their plans.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/bvh_build.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "host/render/bvh_binary.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr uint32_t kChunk = 1 << 14;      // boxes
constexpr uint32_t kLeastPart = 1 << 12;  // primitives under a node that one thread writes

Aabb aabb_of(const Box& box) {
    return {{-box.minus_lower[0], -box.minus_lower[1], -box.minus_lower[2]},
            {box.upper[0], box.upper[1], box.upper[2]}};
}

struct Children {
    std::array<int32_t, 8> nodes;
    size_t count = 0;
};

/// Writes the wide nodes, depth first: those near the root alone, then parts of the tree in
/// parallel, each from the place that the sizes of the parts before give it.
class Collapser {
   public:
    Collapser(const BinaryNode* binary, size_t primitives, Workers& workers, Bvh8& tree)
        : binary_(binary),
          part_size_(std::max(kLeastPart, static_cast<uint32_t>(primitives / 64))),
          workers_(workers),
          tree_(tree) {}

    void write(int32_t root) {
        // How much there is is not known before the parts are counted, so the top goes to vectors.
        write_top(root, 1);
        std::vector<Size> sizes(parts_.size());
        workers_.run(parts_.size(), [&](size_t i) { sizes[i] = size_of(parts_[i].root); });
        Size all{static_cast<uint32_t>(top_nodes_.size()),
                 static_cast<uint32_t>(top_leaves_.size()), 0};
        for (size_t i = 0; i < parts_.size(); ++i) {
            parts_[i].place = {all.nodes, all.leaves, 0};
            all.nodes += sizes[i].nodes;
            all.leaves += sizes[i].leaves;
            tree_.depth = std::max(tree_.depth, parts_[i].depth - 1 + sizes[i].depth);
            top_nodes_[parts_[i].parent].children[parts_[i].slot] = parts_[i].place.nodes;
        }
        tree_.nodes = Block<Bvh8Node>(all.nodes);
        tree_.leaves = Block<Bvh8Leaf>(all.leaves);
        std::copy(top_nodes_.begin(), top_nodes_.end(), tree_.nodes.begin());
        std::copy(top_leaves_.begin(), top_leaves_.end(), tree_.leaves.begin());
        workers_.run(parts_.size(), [&](size_t i) { write_part(parts_[i].root, parts_[i].place); });
    }

   private:
    struct Size {
        uint32_t nodes = 0, leaves = 0;
        int depth = 0;
    };
    struct Part {
        int32_t root;
        uint32_t parent;
        size_t slot;
        int depth;
        Size place;
    };

    const BinaryNode& at(int32_t index) const { return binary_[index]; }

    void gather(int32_t index, size_t most, Children& children) const {
        const BinaryNode& node = at(index);
        most = std::min<size_t>(most, 7);
        while (most > 1 && node.cuts[most] == 0) --most;
        if (most == 1) {
            children.nodes[children.count++] = index;
            return;
        }
        gather(node.left, node.cuts[most], children);
        gather(node.right, most - node.cuts[most], children);
    }
    Children children_of(int32_t index) const {
        const BinaryNode& node = at(index);
        Children children;
        if (node.is_leaf) {  // the root alone can be one
            children.nodes[children.count++] = index;
            return children;
        }
        gather(node.left, node.cuts[8], children);
        gather(node.right, 8u - node.cuts[8], children);
        return children;
    }

    static void set_child(Bvh8Node& to, size_t slot, const BinaryNode& child, uint32_t target) {
        to.bounds[slot] = aabb_of(child.bounds);
        to.kinds[slot] = child.is_leaf ? Bvh8Node::Kind::kLeaf : Bvh8Node::Kind::kInner;
        to.children[slot] = target;
    }

    uint32_t write_top(int32_t index, int depth) {
        tree_.depth = std::max(tree_.depth, depth);
        const auto number = static_cast<uint32_t>(top_nodes_.size());
        top_nodes_.emplace_back();
        const Children children = children_of(index);
        for (size_t slot = 0; slot < children.count; ++slot) {
            const BinaryNode& child = at(children.nodes[slot]);
            uint32_t target = 0;
            if (child.is_leaf) {
                target = static_cast<uint32_t>(top_leaves_.size());
                top_leaves_.push_back({child.first, child.count});
            } else if (child.count <= part_size_) {
                parts_.push_back({children.nodes[slot], number, slot, depth + 1, {}});
            } else {
                target = write_top(children.nodes[slot], depth + 1);
            }
            set_child(top_nodes_[number], slot, child, target);
        }
        return number;
    }

    Size size_of(int32_t index) const {
        Size size{1, 0, 1};
        const Children children = children_of(index);
        for (size_t slot = 0; slot < children.count; ++slot) {
            if (at(children.nodes[slot]).is_leaf) {
                ++size.leaves;
                continue;
            }
            const Size below = size_of(children.nodes[slot]);
            size.nodes += below.nodes;
            size.leaves += below.leaves;
            size.depth = std::max(size.depth, 1 + below.depth);
        }
        return size;
    }

    uint32_t write_part(int32_t index, Size& place) {
        const uint32_t number = place.nodes++;
        Bvh8Node node{};
        const Children children = children_of(index);
        for (size_t slot = 0; slot < children.count; ++slot) {
            const BinaryNode& child = at(children.nodes[slot]);
            uint32_t target = place.leaves;
            if (child.is_leaf)
                tree_.leaves[place.leaves++] = {child.first, child.count};
            else
                target = write_part(children.nodes[slot], place);
            set_child(node, slot, child, target);
        }
        tree_.nodes[number] = node;
        return number;
    }

    const BinaryNode* binary_;
    uint32_t part_size_;
    Workers& workers_;
    Bvh8& tree_;
    std::vector<Bvh8Node> top_nodes_;
    std::vector<Bvh8Leaf> top_leaves_;
    std::vector<Part> parts_;
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

Bvh8 build_bvh8(Block<Box> primitives, Workers& workers, const BvhBuildOptions& options) {
    if (options.max_leaf < 1 || options.max_leaf > 64 || options.packet < 1)
        throw InternalError("BVH leaf size " + std::to_string(options.max_leaf));
    Bvh8 tree;
    if (primitives.empty()) {
        tree.nodes = Block<Bvh8Node>(1);
        tree.nodes[0] = {};
        return tree;
    }
    const size_t count = primitives.size();
    if (count > kMaxPrimitives)
        throw InputError(std::to_string(count) + " triangles and shapes, at most " +
                         std::to_string(kMaxPrimitives));
    tree.order = Block<uint32_t>(count);
    BinaryBuilder builder(std::move(primitives), options, workers, tree.order);
    const int32_t root = builder.build();
    tree.bounds = aabb_of(builder.nodes()[root].bounds);
    Collapser(builder.nodes(), count, workers, tree).write(root);
    return tree;
}

Bvh8 build_bvh8(std::span<const Aabb> boxes, const BvhBuildOptions& options) {
    Workers workers(options.threads);
    Block<Box> primitives(boxes.size());
    run_chunks(workers, boxes.size(), kChunk, [&](size_t, size_t first, size_t last) {
        for (size_t i = first; i < last; ++i) {
            const Aabb& box = boxes[i];
            for (size_t axis = 0; axis < 3; ++axis)
                if (!(box.lower[axis] <= box.upper[axis]) || !std::isfinite(box.lower[axis]) ||
                    !std::isfinite(box.upper[axis]))
                    throw InternalError("BVH over an empty or non-finite box");
            primitives[i] = primitive_box(box, static_cast<uint32_t>(i));
        }
    });
    return build_bvh8(std::move(primitives), workers, options);
}

}  // namespace pave
