// The binary tree that the 8-wide one is made of: built top down over all cores, the same for any
// number of them.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

#include "host/render/block.h"
#include "host/render/bvh_bins.h"
#include "host/render/bvh_build.h"
#include "host/render/bvh_grid.h"
#include "host/render/workers.h"

namespace pave {

/// With `left` < 0 a leaf over order[first, first + count).
struct BinaryNode {
    Box bounds;
    uint32_t first, count;
    int32_t left, right;

    // The cheapest way to stand for this subtree by at most i nodes of the 8-wide tree, i of 1 to 7
    // (see plan): its cost, and how many of them are on the left; 0: as by i - 1. cuts[8] is for
    // the eight children of a wide node here.
    std::array<float, 8> costs;
    std::array<uint8_t, 9> cuts;
    bool is_leaf;  // stands for its whole range best as a leaf

    bool has_children() const { return left >= 0; }
};

/// Fills in costs, cuts and is_leaf of a node whose children have theirs. Wald, Benthin, Boulos
/// 2008 and Ylitie, Karras, Laine 2017, "Efficient incoherent ray traversal on GPUs through
/// compressed wide BVHs", section 4.1.
void plan(BinaryNode& node, const BinaryNode* nodes, const BvhBuildOptions& options);

class BinaryBuilder {
   public:
    /// `primitives` is used up. `order` gets their indices, leaf by leaf.
    BinaryBuilder(Block<Box> primitives, const BvhBuildOptions& options, Workers& workers,
                  Block<uint32_t>& order);
    /// Index of the root. There is at least one primitive.
    int32_t build();
    const BinaryNode* nodes() const { return nodes_.data(); }

   private:
    /// A run of primitives, which lie in the second array if they were moved an odd number of
    /// times.
    struct Range {
        uint32_t first, count;
        int depth;
        bool moved;
        Box centers;  // bounds of the centers
    };
    struct Task {
        Range range;
        int32_t node;
    };
    /// Nodes are handed out by the piece, so that threads seldom meet.
    struct Piece {
        int32_t next = 0, end = 0;
    };

    Box* primitives_of(const Range& range) {
        return (range.moved ? second_ : first_).data() + range.first;
    }
    int32_t new_node(Piece& piece);
    Range whole();
    int32_t take_over(const std::vector<GridNode>& grid, int32_t from, int depth);
    int32_t build_top(const Range& range);
    std::array<Range, 2> cut_in_parallel(const Range& range, Box& bounds);
    void build_task(const Task& task);
    void build_subtree(int32_t node, const Range& range, Piece& piece);
    uint32_t cut(const Range& range, Box& bounds, std::array<Range, 2>& halves);

    BvhBuildOptions options_;
    LeafCost leaf_cost_;
    Workers& workers_;
    Block<Box> first_, second_;
    Block<uint32_t>& order_;
    Block<BinaryNode> nodes_;
    std::atomic<int32_t> handed_out_{0};
    uint32_t task_size_;
    Piece top_piece_;
    std::vector<int32_t> top_nodes_;
    std::vector<Task> tasks_;
};

}  // namespace pave
