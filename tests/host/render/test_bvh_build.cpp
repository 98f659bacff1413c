// The tree's shape: every primitive once, boxes nested, bounded depth, whatever the input.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "host/render/bvh_build.h"

namespace pave {
namespace {

std::vector<Aabb> random_boxes(size_t count, float extent, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<float> place(-1.0f, 1.0f), size(0.0f, extent);
    std::vector<Aabb> boxes(count);
    for (Aabb& box : boxes) {
        const std::array<float, 3> corner{place(rng), place(rng), place(rng)};
        box.grow_to(corner);
        box.grow_to({corner[0] + size(rng), corner[1] + size(rng), corner[2] + size(rng)});
    }
    return boxes;
}

bool contains(const Aabb& outer, const Aabb& inner) {
    for (size_t axis = 0; axis < 3; ++axis)
        if (inner.lower[axis] < outer.lower[axis] || inner.upper[axis] > outer.upper[axis])
            return false;
    return true;
}

/// Walks the tree; counts how often each primitive is met and checks that every box holds what is
/// below it.
Aabb walk(const Bvh8& tree, uint32_t index, const std::vector<Aabb>& boxes,
          const BvhBuildOptions& options, std::vector<int>& seen) {
    const Bvh8Node& node = tree.nodes[index];
    Aabb all;
    for (size_t slot = 0; slot < 8; ++slot) {
        if (node.kinds[slot] == Bvh8Node::Kind::kNone) continue;
        Aabb below;
        if (node.kinds[slot] == Bvh8Node::Kind::kInner) {
            below = walk(tree, node.children[slot], boxes, options, seen);
        } else {
            const Bvh8Leaf leaf = tree.leaves[node.children[slot]];
            EXPECT_GE(leaf.count, 1u);
            EXPECT_LE(leaf.count, static_cast<uint32_t>(options.max_leaf));
            for (uint32_t i = leaf.first; i < leaf.first + leaf.count; ++i) {
                ++seen[tree.order[i]];
                below.grow(boxes[tree.order[i]]);
            }
        }
        EXPECT_TRUE(contains(node.bounds[slot], below));
        all.grow(node.bounds[slot]);
    }
    return all;
}

void expect_sound(const std::vector<Aabb>& boxes, const BvhBuildOptions& options = {}) {
    const Bvh8 tree = build_bvh8(boxes, options);
    std::vector<int> seen(boxes.size(), 0);
    const Aabb all = walk(tree, 0, boxes, options, seen);
    for (size_t i = 0; i < seen.size(); ++i) EXPECT_EQ(seen[i], 1) << "primitive " << i;
    EXPECT_TRUE(boxes.empty() || (contains(tree.bounds, all) && contains(all, tree.bounds)));
    EXPECT_LE(tree.depth, 64);
}

TEST(BvhBuild, HoldsEveryPrimitiveOnce) {
    for (size_t count : {0, 1, 2, 7, 8, 9, 64, 1000, 5000})
        expect_sound(random_boxes(count, 0.05f, static_cast<uint32_t>(count)));
}

TEST(BvhBuild, KeepsToTheLeafSize) {
    for (int max_leaf : {1, 2, 4, 8, 64})
        expect_sound(random_boxes(500, 0.1f, 3), {.max_leaf = max_leaf});
}

TEST(BvhBuild, StandsEqualAndFlatBoxes) {
    expect_sound(std::vector<Aabb>(3000, random_boxes(1, 0.0f, 1)[0]));  // all in one point
    std::vector<Aabb> line = random_boxes(2000, 0.0f, 2);
    for (Aabb& box : line) box.lower[1] = box.upper[1] = box.lower[2] = box.upper[2] = 0.0f;
    expect_sound(line);
}

TEST(BvhBuild, StandsCoordinatesOverManyDecades) {
    std::vector<Aabb> boxes(200);
    float x = 1e-30f;
    for (Aabb& box : boxes) {
        box.grow_to({x, -x, 1.0f});
        box.grow_to({x * 1.5f, x, 1.0f});
        x *= 2.0f;
    }
    expect_sound(boxes);
}

bool same(const Bvh8& a, const Bvh8& b) {
    return a.nodes.size() == b.nodes.size() && a.leaves.size() == b.leaves.size() &&
           std::equal(a.order.begin(), a.order.end(), b.order.begin(), b.order.end()) &&
           std::equal(a.leaves.begin(), a.leaves.end(), b.leaves.begin(),
                      [](const Bvh8Leaf& x, const Bvh8Leaf& y) {
                          return x.first == y.first && x.count == y.count;
                      }) &&
           std::equal(a.nodes.begin(), a.nodes.end(), b.nodes.begin(),
                      [](const Bvh8Node& x, const Bvh8Node& y) {
                          for (size_t i = 0; i < 8; ++i)
                              if (x.bounds[i].lower != y.bounds[i].lower ||
                                  x.bounds[i].upper != y.bounds[i].upper)
                                  return false;
                          return x.kinds == y.kinds && x.children == y.children;
                      });
}

TEST(BvhBuild, IsTheSameForAnyNumberOfThreads) {
    // Large enough that all threads cut the upper ranges together.
    const std::vector<Aabb> boxes = random_boxes(150000, 0.01f, 11);
    const Bvh8 alone = build_bvh8(boxes, {.threads = 1});
    for (int threads : {2, 3, 8})
        for (int repeat = 0; repeat < 3; ++repeat)
            EXPECT_TRUE(same(alone, build_bvh8(boxes, {.threads = threads}))) << threads;
    expect_sound(boxes);
    std::vector<Aabb> equal(100000, boxes[0]);  // nothing to cut by: halves
    EXPECT_TRUE(same(build_bvh8(equal, {.threads = 1}), build_bvh8(equal, {.threads = 3})));
    expect_sound(equal);
}

TEST(BvhBuild, FillsItsNodes) {
    const std::vector<Aabb> boxes = random_boxes(20000, 0.01f, 12);
    const Bvh8 tree = build_bvh8(boxes);
    // Opening the largest child first gives 4.3; planning which nodes to keep gives more.
    EXPECT_GT(static_cast<double>(tree.leaves.size() + tree.nodes.size()) /
                  static_cast<double>(tree.nodes.size()),
              5.5);
}

TEST(BvhBuild, BeatsACutInHalf) {
    const std::vector<Aabb> boxes = random_boxes(4000, 0.02f, 7);
    const Bvh8 tree = build_bvh8(boxes);
    double cost = 0.0;
    for (const Bvh8Node& node : tree.nodes)
        for (size_t slot = 0; slot < 8; ++slot)
            cost += node.bounds[slot].half_area() / tree.bounds.half_area();
    EXPECT_LT(cost, 15.0)
        << "surface area below the root, in root areas: random order gives thousands";
}

}  // namespace
}  // namespace pave
