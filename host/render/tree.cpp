// The trees in the kernels' layout: nodes of eight boxes, leaves of up to eight triangles, shapes
// and instances one by one.
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

/// What the builder knows by a number: triangles, then shapes and instances.
class Primitives {
   public:
    /// Those of the scene's own tree.
    explicit Primitives(const SceneData& data) : data_(data), count_(data.own_triangles) {
        for (uint32_t i = 0; i < data.instances.size(); ++i)
            shapes_.push_back({leaf_code(i, LEAF_INSTANCE), data.instances[i].bounds});
        if (data.broadcast) return;
        for (uint32_t i = 0; i < data.flats.size(); ++i)
            shapes_.push_back({leaf_code(i, LEAF_FLAT), bounds_of(data.flats[i])});
        for (uint32_t i = 0; i < data.cubes.size(); ++i)
            shapes_.push_back({leaf_code(i, LEAF_CUBE), bounds_of(data.cubes[i])});
        for (uint32_t i = 0; i < data.spheres.size(); ++i)
            shapes_.push_back({leaf_code(i, LEAF_SPHERE), bounds_of(data.spheres[i])});
    }
    Primitives(const SceneData& data, const GroupData& group)
        : data_(data), first_(group.first), count_(group.count) {}

    struct Shape {
        int32_t code;
        Aabb bounds;
    };
    bool has_shapes() const { return !shapes_.empty(); }
    bool is_shape(uint32_t primitive) const { return primitive >= count_; }
    const Shape& shape(uint32_t primitive) const { return shapes_[primitive - count_]; }
    /// Its number in the scene.
    size_t triangle(uint32_t primitive) const { return first_ + primitive; }
    Aabb triangle_bounds(uint32_t primitive) const {
        Aabb bounds;
        for (const auto& corner : data_.corners[triangle(primitive)]) bounds.grow_to(corner);
        return bounds;
    }
    Block<Box> boxes(Workers& workers) const {
        Block<Box> boxes = triangle_boxes(data_, first_, count_, shapes_.size(), workers);
        for (size_t i = 0; i < shapes_.size(); ++i)
            boxes[count_ + i] = primitive_box(shapes_[i].bounds, static_cast<uint32_t>(count_ + i));
        return boxes;
    }

   private:
    const SceneData& data_;
    size_t first_ = 0, count_;
    std::vector<Shape> shapes_;
};

struct Child {
    Aabb bounds;
    int32_t code = 0;
};

/// Places in SceneData::tree.
struct TreePlace {
    size_t node = 0, leaf = 0;  // of triangles
};

/// One of the trees. First it finds out how much room it needs, then it is written.
class TreeWriter {
   public:
    TreeWriter(SceneData& data, Workers& workers, Primitives primitives, Bvh8 tree)
        : data_(data),
          workers_(workers),
          primitives_(std::move(primitives)),
          tree_(std::move(tree)) {}

    /// Takes its place from `at` on; returns where the next tree goes.
    TreePlace place(TreePlace at) {
        at_ = at;
        place_leaves();
        return {at.node + tree_.nodes.size() + mixed_.size(), at.leaf + triangle_leaves_};
    }

    void write() {
        run_chunks(workers_, tree_.nodes.size(), kNodeChunk,
                   [&](size_t, size_t first, size_t last) {
                       for (size_t i = first; i < last; ++i) write_node(i);
                   });
        run_chunks(workers_, tree_.leaves.size(), kNodeChunk,
                   [&](size_t, size_t first, size_t last) {
                       for (size_t i = first; i < last; ++i)
                           if (!primitives_.has_shapes()) write_triangles(i, at_.leaf + i);
                   });
        if (primitives_.has_shapes())
            for (size_t i = 0; i < tree_.leaves.size(); ++i) write_mixed_leaf(i);
    }

    uint32_t root() const { return static_cast<uint32_t>(at_.node); }

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
                place.triangle_leaf = static_cast<int32_t>(at_.leaf + triangle_leaves_++);
            if (shapes == 0) {
                place.code = leaf_code(place.triangle_leaf, LEAF_TRIANGLES);
            } else if (leaf.count == 1) {
                place.code = primitives_.shape(shape).code;
            } else {
                place.code = static_cast<int32_t>(at_.node + tree_.nodes.size() + mixed_.size());
                place.entries = shapes + (place.triangle_leaf >= 0 ? 1 : 0);
                mixed_.push_back(places_.size());
            }
            places_.push_back(place);
        }
    }
    int32_t code_of_leaf(uint32_t leaf) const {
        return places_.empty() ? leaf_code(at_.leaf + leaf, LEAF_TRIANGLES) : places_[leaf].code;
    }

    void write_node(size_t index) {
        const Bvh8Node& node = tree_.nodes[index];
        std::array<Child, TREE_WIDTH> children;
        size_t count = 0;
        for (size_t slot = 0; slot < TREE_WIDTH; ++slot) {
            if (node.kinds[slot] == Bvh8Node::Kind::kNone) continue;
            const uint32_t child = node.children[slot];
            children[count++] = {node.bounds[slot], node.kinds[slot] == Bvh8Node::Kind::kInner
                                                        ? static_cast<int32_t>(at_.node + child)
                                                        : code_of_leaf(child)};
        }
        fill_node(at_.node + index, {children.data(), count});
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
            if (primitives_.is_shape(tree_.order[i])) continue;
            const size_t triangle = primitives_.triangle(tree_.order[i]);
            const Corners& corners = data_.corners[triangle];
            for (size_t corner = 0; corner < 3; ++corner)
                for (size_t axis = 0; axis < 3; ++axis)
                    rows[3 * corner + axis][lane] = corners[corner][axis];
            rows[9][lane++] = as_float_bits(static_cast<uint32_t>(triangle));
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

    SceneData& data_;
    Workers& workers_;
    Primitives primitives_;
    Bvh8 tree_;
    TreePlace at_;
    std::vector<Place> places_;  // of leaves
    std::vector<size_t> mixed_;  // leaves that become nodes
    size_t triangle_leaves_ = 0;
};

}  // namespace

Block<Box> triangle_boxes(const SceneData& data, size_t first, size_t count, size_t spare,
                          Workers& workers) {
    Block<Box> boxes(count + spare);
    run_chunks(workers, count, kChunk, [&](size_t, size_t begin, size_t end) {
        for (size_t i = begin; i < end; ++i) {
            boxes[i] = Box::none();
            for (const auto& corner : data.corners[first + i])
                boxes[i].grow(Float4{corner[0], corner[1], corner[2], 0});
            set_index(boxes[i], static_cast<uint32_t>(i));
        }
    });
    return boxes;
}

void add_tree(SceneData& data, Workers& workers) {
    std::vector<TreeWriter> trees;  // the scene's, then the groups'
    trees.reserve(1 + data.groups.size());
    Primitives own(data);
    Block<Box> boxes = own.boxes(workers);
    const bool empty = boxes.empty();
    Bvh8 tree = build_bvh8(std::move(boxes), workers);
    for (size_t a = 0; a < 3 && !empty; ++a)
        data.tree_bound[a] =
            std::max(std::abs(tree.bounds.lower[a]), std::abs(tree.bounds.upper[a]));
    trees.emplace_back(data, workers, std::move(own), std::move(tree));
    for (GroupData& group : data.groups)
        trees.emplace_back(data, workers, Primitives(data, group), std::move(group.tree));
    TreePlace end;
    for (TreeWriter& writer : trees) end = writer.place(end);
    data.leaf_row = end.node * NODE_ROWS;
    data.instance_row = data.leaf_row + end.leaf * LEAF_ROWS;
    data.tree = Block<Row>(data.instance_row + data.instances.size() * INSTANCE_ROWS);
    for (TreeWriter& writer : trees) writer.write();
    for (size_t i = 0; i < data.instances.size(); ++i) {
        const InstanceData& instance = data.instances[i];
        write_instance(instance, data.groups[instance.group], trees[1 + instance.group].root(),
                       &data.tree[data.instance_row + i * INSTANCE_ROWS]);
    }
    int below = 0;
    for (size_t i = 1; i < trees.size(); ++i) below = std::max(below, trees[i].stack_entries());
    data.stack = trees[0].stack_entries() + below;
}

}  // namespace pave
