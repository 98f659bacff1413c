// The tree in the kernels' layout: nodes of eight boxes, leaves of up to eight triangles, shapes
// one by one.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <bit>
#include <limits>

#include "host/render/scene_data.h"

namespace pave {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

struct Child {
    Aabb bounds;
    int32_t code = 0;
};

class TreeWriter {
   public:
    TreeWriter(SceneData& data, std::vector<Primitive> primitives)
        : data_(data), primitives_(std::move(primitives)) {}

    void write() {
        std::vector<Aabb> boxes;
        for (const Primitive& primitive : primitives_) boxes.push_back(primitive.bounds);
        tree_ = build_bvh8(boxes);
        for (size_t a = 0; a < 3 && !primitives_.empty(); ++a)
            data_.tree_bound[a] =
                std::max(std::abs(tree_.bounds.lower[a]), std::abs(tree_.bounds.upper[a]));
        data_.stack = write_node(0).stack;
    }

   private:
    struct Written {
        int32_t code = 0;
        int stack = 0;  // entries that walking it needs
    };

    Written write_node(uint32_t index) {
        const Bvh8Node& node = tree_.nodes[index];
        const size_t row = reserve_node();
        std::vector<Child> children;
        int below = 0;
        for (size_t slot = 0; slot < TREE_WIDTH; ++slot) {
            if (node.kinds[slot] == Bvh8Node::Kind::kNone) continue;
            const Written child = node.kinds[slot] == Bvh8Node::Kind::kInner
                                      ? write_node(node.children[slot])
                                      : write_leaf(node.children[slot]);
            children.push_back({node.bounds[slot], child.code});
            below = std::max(below, child.stack);
        }
        return {fill_node(row, children), stack_of(children.size(), below)};
    }

    /// All children of a node are pushed before one is taken off.
    static int stack_of(size_t children, int below) {
        const int count = static_cast<int>(children);
        return std::max(count, count - 1 + below);
    }

    /// A leaf of one shape or of triangles only; a mixed one becomes a node over such leaves.
    Written write_leaf(uint32_t index) {
        const Bvh8Leaf& leaf = tree_.leaves[index];
        std::vector<Child> children;
        std::vector<uint32_t> triangles;
        Aabb triangle_bounds;
        for (uint32_t i = leaf.first; i < leaf.first + leaf.count; ++i) {
            const Primitive& primitive = primitives_[tree_.order[i]];
            if (primitive.kind == Primitive::Kind::kTriangle) {
                triangles.push_back(primitive.index);
                triangle_bounds.grow(primitive.bounds);
            } else {
                children.push_back(
                    {primitive.bounds, leaf_code(primitive.index, kind_code(primitive.kind))});
            }
        }
        if (!triangles.empty()) children.push_back({triangle_bounds, write_triangles(triangles)});
        if (children.size() == 1) return {children[0].code, 0};
        return {fill_node(reserve_node(), children), stack_of(children.size(), 0)};
    }

    static int kind_code(Primitive::Kind kind) {
        if (kind == Primitive::Kind::kFlat) return LEAF_FLAT;
        return kind == Primitive::Kind::kCube ? LEAF_CUBE : LEAF_SPHERE;
    }

    int32_t write_triangles(const std::vector<uint32_t>& triangles) {
        const auto index = static_cast<int>(data_.leaves.size() / LEAF_ROWS);
        std::array<Row, LEAF_ROWS> rows;
        for (Row& row : rows) row.fill(kNaN);
        for (size_t lane = 0; lane < triangles.size(); ++lane) {
            for (size_t corner = 0; corner < 3; ++corner)
                for (size_t axis = 0; axis < 3; ++axis)
                    rows[3 * corner + axis][lane] = data_.corners[triangles[lane]][corner][axis];
            rows[9][lane] = as_float_bits(triangles[lane]);
        }
        data_.leaves.insert(data_.leaves.end(), rows.begin(), rows.end());
        return leaf_code(index, LEAF_TRIANGLES);
    }

    size_t reserve_node() {
        data_.nodes.resize(data_.nodes.size() + NODE_ROWS, Row{});
        return data_.nodes.size() - NODE_ROWS;
    }

    int32_t fill_node(size_t row, const std::vector<Child>& children) {
        for (size_t slot = 0; slot < TREE_WIDTH; ++slot)
            for (size_t axis = 0; axis < 3; ++axis) {
                const bool used = slot < children.size();
                data_.nodes[row + 2 * axis][slot] =
                    used ? children[slot].bounds.lower[axis] : kInfinity;
                data_.nodes[row + 2 * axis + 1][slot] =
                    used ? children[slot].bounds.upper[axis] : -kInfinity;
            }
        for (size_t slot = 0; slot < children.size(); ++slot)
            data_.nodes[row + 6][slot] = std::bit_cast<float>(children[slot].code);
        return static_cast<int32_t>(row / NODE_ROWS);
    }

    SceneData& data_;
    std::vector<Primitive> primitives_;
    Bvh8 tree_;
};

}  // namespace

void add_tree(SceneData& data) {
    std::vector<Primitive> primitives;
    for (uint32_t i = 0; i < data.corners.size(); ++i) {
        Primitive triangle{Primitive::Kind::kTriangle, i, {}};
        for (const auto& corner : data.corners[i]) triangle.bounds.grow_to(corner);
        primitives.push_back(triangle);
    }
    if (!data.broadcast) {
        for (uint32_t i = 0; i < data.flats.size(); ++i)
            primitives.push_back({Primitive::Kind::kFlat, i, bounds_of(data.flats[i])});
        for (uint32_t i = 0; i < data.cubes.size(); ++i)
            primitives.push_back({Primitive::Kind::kCube, i, bounds_of(data.cubes[i])});
        for (uint32_t i = 0; i < data.spheres.size(); ++i)
            primitives.push_back({Primitive::Kind::kSphere, i, bounds_of(data.spheres[i])});
    }
    TreeWriter(data, std::move(primitives)).write();
}

}  // namespace pave
