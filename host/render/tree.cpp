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
constexpr size_t kChunk = 1 << 14;     // triangles that a thread takes
constexpr size_t kNodeChunk = 1 << 9;  // nodes or leaves

/// What the builder knows by a number: triangles, then shapes.
class Primitives {
   public:
    explicit Primitives(const SceneData& data) : data_(data) {
        if (data.broadcast) return;
        for (uint32_t i = 0; i < data.flats.size(); ++i)
            shapes_.push_back({leaf_code(i, LEAF_FLAT), bounds_of(data.flats[i])});
        for (uint32_t i = 0; i < data.cubes.size(); ++i)
            shapes_.push_back({leaf_code(i, LEAF_CUBE), bounds_of(data.cubes[i])});
        for (uint32_t i = 0; i < data.spheres.size(); ++i)
            shapes_.push_back({leaf_code(i, LEAF_SPHERE), bounds_of(data.spheres[i])});
    }
    struct Shape {
        int32_t code;
        Aabb bounds;
    };
    bool has_shapes() const { return !shapes_.empty(); }
    bool is_shape(uint32_t primitive) const { return primitive >= data_.corners.size(); }
    const Shape& shape(uint32_t primitive) const {
        return shapes_[primitive - data_.corners.size()];
    }
    Aabb triangle_bounds(uint32_t triangle) const {
        Aabb bounds;
        for (const auto& corner : data_.corners[triangle]) bounds.grow_to(corner);
        return bounds;
    }
    Block<Box> boxes(Workers& workers) const {
        const size_t triangles = data_.corners.size();
        Block<Box> boxes(triangles + shapes_.size());
        run_chunks(workers, triangles, kChunk, [&](size_t, size_t first, size_t last) {
            for (size_t i = first; i < last; ++i) boxes[i] = triangle_box(static_cast<uint32_t>(i));
        });
        for (size_t i = 0; i < shapes_.size(); ++i)
            boxes[triangles + i] =
                primitive_box(shapes_[i].bounds, static_cast<uint32_t>(triangles + i));
        return boxes;
    }

   private:
    Box triangle_box(uint32_t triangle) const {
        Box box = Box::none();
        for (const auto& corner : data_.corners[triangle])
            box.grow(Float4{corner[0], corner[1], corner[2], 0});
        set_index(box, triangle);
        return box;
    }

    const SceneData& data_;
    std::vector<Shape> shapes_;
};

struct Child {
    Aabb bounds;
    int32_t code = 0;
};

class TreeWriter {
   public:
    TreeWriter(SceneData& data, Workers& workers)
        : data_(data), workers_(workers), primitives_(data) {}

    void write() {
        Block<Box> boxes = primitives_.boxes(workers_);
        const bool empty = boxes.empty();
        tree_ = build_bvh8(std::move(boxes), workers_);
        for (size_t a = 0; a < 3 && !empty; ++a)
            data_.tree_bound[a] =
                std::max(std::abs(tree_.bounds.lower[a]), std::abs(tree_.bounds.upper[a]));
        place_leaves();
        data_.leaf_row = (tree_.nodes.size() + mixed_.size()) * NODE_ROWS;
        data_.tree = Block<Row>(data_.leaf_row + triangle_leaves_ * LEAF_ROWS);
        run_chunks(workers_, tree_.nodes.size(), kNodeChunk,
                   [&](size_t, size_t first, size_t last) {
                       for (size_t i = first; i < last; ++i) write_node(i);
                   });
        run_chunks(workers_, tree_.leaves.size(), kNodeChunk,
                   [&](size_t, size_t first, size_t last) {
                       for (size_t i = first; i < last; ++i)
                           if (!primitives_.has_shapes()) write_triangles(i, i);
                   });
        if (primitives_.has_shapes())
            for (size_t i = 0; i < tree_.leaves.size(); ++i) write_mixed_leaf(i);
        data_.stack = stack_entries();
    }

   private:
    /// A leaf that is not of triangles alone. Of one shape it is the shape's code; others become a
    /// node over the shapes and one leaf of all their triangles.
    struct Place {
        int32_t code;                // what the parent names
        int32_t triangle_leaf = -1;  // where the leaf's triangles are
        int entries = 0;             // of the stack, below the parent
    };

    /// Fills places_ if there are shapes: where each leaf will be.
    void place_leaves() {
        if (!primitives_.has_shapes()) {
            triangle_leaves_ = tree_.leaves.size();
            return;
        }
        for (const Bvh8Leaf& leaf : tree_.leaves) {
            int shapes = 0;
            uint32_t shape = 0;
            for (uint32_t i = leaf.first; i < leaf.first + leaf.count; ++i)
                if (primitives_.is_shape(tree_.order[i])) ++shapes, shape = tree_.order[i];
            Place place{0, -1, 0};
            if (static_cast<uint32_t>(shapes) < leaf.count)
                place.triangle_leaf = static_cast<int32_t>(triangle_leaves_++);
            if (shapes == 0) {
                place.code = leaf_code(place.triangle_leaf, LEAF_TRIANGLES);
            } else if (leaf.count == 1) {
                place.code = primitives_.shape(shape).code;
            } else {
                place.code = static_cast<int32_t>(tree_.nodes.size() + mixed_.size());
                place.entries = shapes + (place.triangle_leaf >= 0 ? 1 : 0);
                mixed_.push_back(places_.size());
            }
            places_.push_back(place);
        }
    }
    int32_t code_of_leaf(uint32_t leaf) const {
        return places_.empty() ? leaf_code(leaf, LEAF_TRIANGLES) : places_[leaf].code;
    }

    void write_node(size_t index) {
        const Bvh8Node& node = tree_.nodes[index];
        std::array<Child, TREE_WIDTH> children;
        size_t count = 0;
        for (size_t slot = 0; slot < TREE_WIDTH; ++slot) {
            if (node.kinds[slot] == Bvh8Node::Kind::kNone) continue;
            children[count++] = {node.bounds[slot], node.kinds[slot] == Bvh8Node::Kind::kInner
                                                        ? static_cast<int32_t>(node.children[slot])
                                                        : code_of_leaf(node.children[slot])};
        }
        fill_node(index, {children.data(), count});
    }

    void fill_node(size_t index, std::span<const Child> children) {
        Row* const row = &data_.tree[index * NODE_ROWS];
        for (size_t slot = 0; slot < TREE_WIDTH; ++slot) {
            const bool used = slot < children.size();
            for (size_t axis = 0; axis < 3; ++axis) {
                row[2 * axis][slot] = used ? children[slot].bounds.lower[axis] : kInfinity;
                row[2 * axis + 1][slot] = used ? children[slot].bounds.upper[axis] : -kInfinity;
            }
            row[6][slot] = used ? std::bit_cast<float>(children[slot].code) : 0.0f;
            row[7][slot] = 0.0f;
        }
    }

    /// The triangles of a leaf, at place `to` among the leaves of triangles.
    void write_triangles(size_t leaf, size_t to) {
        const Bvh8Leaf& run = tree_.leaves[leaf];
        Row* const rows = &data_.tree[data_.leaf_row + to * LEAF_ROWS];
        size_t lane = 0;
        for (uint32_t i = run.first; i < run.first + run.count; ++i) {
            const uint32_t triangle = tree_.order[i];
            if (primitives_.is_shape(triangle)) continue;
            const Corners& corners = data_.corners[triangle];
            for (size_t corner = 0; corner < 3; ++corner)
                for (size_t axis = 0; axis < 3; ++axis)
                    rows[3 * corner + axis][lane] = corners[corner][axis];
            rows[9][lane++] = as_float_bits(triangle);
        }
        for (; lane < TREE_WIDTH; ++lane)
            for (size_t row = 0; row < LEAF_ROWS; ++row) rows[row][lane] = kNaN;
    }

    void write_mixed_leaf(size_t leaf) {
        const Place& place = places_[leaf];
        if (place.triangle_leaf >= 0)
            write_triangles(leaf, static_cast<size_t>(place.triangle_leaf));
        if (place.entries == 0) return;
        std::vector<Child> children;
        Aabb triangles;
        const Bvh8Leaf& run = tree_.leaves[leaf];
        for (uint32_t i = run.first; i < run.first + run.count; ++i) {
            const uint32_t primitive = tree_.order[i];
            if (primitives_.is_shape(primitive))
                children.push_back(
                    {primitives_.shape(primitive).bounds, primitives_.shape(primitive).code});
            else
                triangles.grow(primitives_.triangle_bounds(primitive));
        }
        if (place.triangle_leaf >= 0)
            children.push_back({triangles, leaf_code(place.triangle_leaf, LEAF_TRIANGLES)});
        fill_node(static_cast<size_t>(place.code), children);
    }

    /// Entries that walking the tree needs at most: all children of a node are pushed before one is
    /// taken off. Children come after their parents.
    int stack_entries() const {
        std::vector<int> entries(tree_.nodes.size(), 0);
        for (size_t i = tree_.nodes.size(); i-- > 0;) {
            const Bvh8Node& node = tree_.nodes[i];
            int count = 0, below = 0;
            for (size_t slot = 0; slot < TREE_WIDTH; ++slot) {
                if (node.kinds[slot] == Bvh8Node::Kind::kNone) continue;
                ++count;
                if (node.kinds[slot] == Bvh8Node::Kind::kInner)
                    below = std::max(below, entries[node.children[slot]]);
                else if (!places_.empty())
                    below = std::max(below, places_[node.children[slot]].entries);
            }
            entries[i] = std::max(count, count - 1 + below);
        }
        return entries[0];
    }

    SceneData& data_;
    Workers& workers_;
    Primitives primitives_;
    Bvh8 tree_;
    std::vector<Place> places_;  // of leaves
    std::vector<size_t> mixed_;  // leaves that become nodes
    size_t triangle_leaves_ = 0;
};

}  // namespace

void add_tree(SceneData& data, Workers& workers) { TreeWriter(data, workers).write(); }

}  // namespace pave
