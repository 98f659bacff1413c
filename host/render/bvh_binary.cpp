// Binned SAH over all cores: large ranges are cut by all threads together, chunk by chunk, smaller
// ones by one thread each. Chunks and tasks follow from the number of primitives alone.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/bvh_binary.h"

#include <algorithm>
#include <limits>

namespace pave {
namespace {

constexpr uint32_t kChunk = 1 << 14;  // primitives that a thread takes of a large range
constexpr uint32_t kLeastTask = 1 << 12;
constexpr uint32_t kTasks = 64;      // at least, of many primitives: so that threads end together
constexpr int32_t kPiece = 1 << 10;  // nodes
constexpr uint32_t kGridPrimitives = 1 << 16;  // more are first cut over a grid
constexpr int kMaxSahDepth = 48;  // below it ranges are halved: depth is bounded for any input
constexpr uint32_t kFewPrimitives = 32;  // fewer bins will do
constexpr int kFewBins = 8;
constexpr uint32_t kLeafPrimitives = 8;
constexpr int kLeafBins = 4;
constexpr uint32_t kManyPrimitives = 1024;
constexpr int kSomeBins = 16;
// What opening a node costs against testing a leaf's packet. Below it a cut is not worth its boxes.
constexpr float kCutCost = 0.25f;

/// Large ranges get more: with 16 bins the walls of a room around a mesh of 2M triangles cost every
/// ray two nodes.
int bins_for(uint32_t count) {
    if (count <= kLeafPrimitives) return kLeafBins;
    if (count <= kFewPrimitives) return kFewBins;
    return count <= kManyPrimitives ? kSomeBins : Bins::kMost;
}

}  // namespace

void plan(BinaryNode& node, const BinaryNode* nodes, const BvhBuildOptions& options) {
    constexpr float kNever = std::numeric_limits<float>::infinity();
    const LeafCost leaf_cost{static_cast<uint32_t>(options.packet), options.leaf_cost};
    const float area = node.bounds.half_area();
    const bool fits = node.count <= static_cast<uint32_t>(options.max_leaf);
    const float as_leaf = fits ? area * leaf_cost(node.count) : kNever;
    node.cuts.fill(0);
    node.costs.fill(as_leaf);
    node.is_leaf = true;
    if (!node.has_children()) return;
    const auto& left = nodes[node.left].costs;
    const auto& right = nodes[node.right].costs;
    const auto best_cut = [&](size_t most) {
        float cost = kNever;
        for (size_t i = 1; i < most; ++i) {
            const size_t l = std::min<size_t>(i, 7), r = std::min<size_t>(most - i, 7);
            if (left[l] + right[r] < cost) {
                cost = left[l] + right[r];
                node.cuts[most] = static_cast<uint8_t>(i);
            }
        }
        if (node.cuts[most] == 0) node.cuts[most] = 1;  // infinite areas: any cut will do
        return cost;
    };
    const float as_node = area + best_cut(8);
    node.is_leaf = fits && as_leaf <= as_node;
    node.costs[1] = std::min(as_leaf, as_node);
    for (size_t most = 2; most < 8; ++most) {
        const float cost = best_cut(most);
        node.costs[most] = std::min(cost, node.costs[most - 1]);
        if (!(cost < node.costs[most - 1])) node.cuts[most] = 0;
    }
}

BinaryBuilder::BinaryBuilder(Block<Box> primitives, const BvhBuildOptions& options,
                             Workers& workers, Block<uint32_t>& order)
    : options_(options),
      leaf_cost_{static_cast<uint32_t>(options.packet), options.leaf_cost},
      workers_(workers),
      first_(std::move(primitives)),
      order_(order),
      task_size_(std::max(kLeastTask, static_cast<uint32_t>(first_.size()) / kTasks)) {
    const size_t count = first_.size();
    if (count > task_size_) second_ = Block<Box>(count);
    // A task or top node leaves a piece unfinished at most, and a task has been cut off a range
    // above the task size.
    nodes_ =
        Block<BinaryNode>(2 * count + static_cast<size_t>(kPiece) * (2 * count / kLeastTask + 4));
}

int32_t BinaryBuilder::new_node(Piece& piece) {
    if (piece.next == piece.end) {
        piece.next = handed_out_.fetch_add(kPiece);
        piece.end = piece.next + kPiece;
    }
    return piece.next++;
}

int32_t BinaryBuilder::build() {
    const Range all = whole();
    int32_t root = -1;
    if (all.count > kGridPrimitives) {
        const std::vector<GridNode> grid =
            cut_by_grid(first_, second_, all.centers, task_size_, leaf_cost_, workers_);
        root = take_over(grid, 0, 0);
    } else {
        root = build_top(all);
    }
    workers_.run(tasks_.size(), [&](size_t i) { build_task(tasks_[i]); });
    for (size_t i = top_nodes_.size(); i-- > 0;)
        plan(nodes_[static_cast<size_t>(top_nodes_[i])], nodes_.data(), options_);
    return root;
}

BinaryBuilder::Range BinaryBuilder::whole() {
    const auto count = static_cast<uint32_t>(first_.size());
    std::vector<Box> parts((count + kChunk - 1) / kChunk);
    run_chunks(workers_, count, kChunk, [&](size_t piece, size_t first, size_t last) {
        Box centers = Box::none();
        for (size_t i = first; i < last; ++i) centers.grow(first_[i].center());
        parts[piece] = centers;
    });
    Range range{0, count, 0, false, Box::none()};
    for (const Box& part : parts) range.centers.grow(part);
    return range;
}

/// The grid's cuts from `from` on as nodes; its runs are cut further.
int32_t BinaryBuilder::take_over(const std::vector<GridNode>& grid, int32_t from, int depth) {
    const GridNode& cut = grid[static_cast<size_t>(from)];
    if (cut.left < 0) return build_top({cut.first, cut.count, depth, true, cut.centers});
    const int32_t index = new_node(top_piece_);
    top_nodes_.push_back(index);
    BinaryNode node{};
    node.bounds = cut.bounds;
    node.count = cut.count;  // too many for a leaf, so their place is not asked for
    node.left = take_over(grid, cut.left, depth + 1);
    node.right = take_over(grid, cut.right, depth + 1);
    nodes_[static_cast<size_t>(index)] = node;
    return index;
}

int32_t BinaryBuilder::build_top(const Range& range) {
    const int32_t index = new_node(top_piece_);
    if (range.count <= task_size_) {
        tasks_.push_back({range, index});
        return index;
    }
    top_nodes_.push_back(index);
    BinaryNode node{};
    node.first = range.first;
    node.count = range.count;
    const std::array<Range, 2> halves = cut_in_parallel(range, node.bounds);
    node.left = build_top(halves[0]);
    node.right = build_top(halves[1]);
    nodes_[static_cast<size_t>(index)] = node;
    return index;
}

/// The two halves, moved to the other array.
std::array<BinaryBuilder::Range, 2> BinaryBuilder::cut_in_parallel(const Range& range,
                                                                   Box& bounds) {
    const BinFrame frame(range.centers, Bins::kMost);
    const Box* from = primitives_of(range);
    const size_t chunks = (range.count + kChunk - 1) / kChunk;
    std::vector<Bins> parts(chunks, Bins(Bins::kMost));
    run_chunks(workers_, range.count, kChunk, [&](size_t piece, size_t first, size_t last) {
        parts[piece].add({from + first, last - first}, frame);
    });
    Bins all(Bins::kMost);
    for (const Bins& part : parts) all.add(part, Bins::kMost);
    bounds = all.bounds(Bins::kMost);
    Split split = range.depth < kMaxSahDepth ? all.best(frame, range.count, leaf_cost_) : Split{};
    if (split.axis < 0) split.left = range.count / 2;
    const auto axis = static_cast<size_t>(split.axis);
    std::vector<uint32_t> lefts(chunks + 1, 0);  // how many of the chunks before go left
    for (size_t i = 0; i < chunks; ++i) {
        uint32_t left = 0;
        if (split.axis < 0)
            left = std::clamp<uint32_t>(
                split.left - std::min<uint32_t>(split.left, lefts[i]), 0,
                std::min<uint32_t>(kChunk, range.count - static_cast<uint32_t>(i) * kChunk));
        for (size_t bin = 0; split.axis >= 0 && bin <= static_cast<size_t>(split.bin); ++bin)
            left += parts[i].counts[axis][bin];
        lefts[i + 1] = lefts[i] + left;
    }
    std::array<Range, 2> halves{
        Range{range.first, split.left, range.depth + 1, !range.moved, Box::none()},
        Range{range.first + split.left, range.count - split.left, range.depth + 1, !range.moved,
              Box::none()}};
    Box* to = (range.moved ? first_ : second_).data() + range.first;
    std::vector<std::array<Box, 2>> centers(chunks, {Box::none(), Box::none()});
    run_chunks(workers_, range.count, kChunk, [&](size_t piece, size_t first, size_t last) {
        std::array<Box*, 2> next{to + lefts[piece], to + split.left + (first - lefts[piece])};
        std::array<Box, 2> bound{Box::none(), Box::none()};
        for (size_t i = first; i < last; ++i) {
            const size_t right =
                split.axis < 0 ? i >= split.left : frame.bin_of(from[i], axis) > split.bin;
            *next[right]++ = from[i];
            bound[right].grow(from[i].center());
        }
        centers[piece] = bound;
    });
    for (const auto& part : centers)
        for (size_t side = 0; side < 2; ++side) halves[side].centers.grow(part[side]);
    return halves;
}

void BinaryBuilder::build_task(const Task& task) {
    Piece piece;
    build_subtree(task.node, task.range, piece);
    const Box* primitives = primitives_of(task.range);
    for (uint32_t i = 0; i < task.range.count; ++i)
        order_[task.range.first + i] = index_of(primitives[i]);
}

/// Sets `bounds`, and `halves` cut in place; returns the primitives on the left, 0 for a leaf.
uint32_t BinaryBuilder::cut(const Range& range, Box& bounds, std::array<Range, 2>& halves) {
    Box* const begin = primitives_of(range);
    Box* const end = begin + range.count;
    const bool fits = range.count <= static_cast<uint32_t>(options_.max_leaf);
    const BinFrame frame(range.centers, bins_for(range.count));
    Bins bins(frame.bins());
    bins.add({begin, end}, frame);
    bounds = bins.bounds(frame.bins());
    const Split split =
        range.depth < kMaxSahDepth ? bins.best(frame, range.count, leaf_cost_) : Split{};
    if (fits && (split.axis < 0 || leaf_cost_(range.count) <= kCutCost + split.cost)) return 0;
    std::array<Box, 2> centers{Box::none(), Box::none()};
    Box *left = begin, *right = end;
    if (split.axis < 0) {
        for (left = begin; left < begin + range.count / 2; ++left) centers[0].grow(left->center());
        for (right = left; right < end; ++right) centers[1].grow(right->center());
    } else {
        const auto axis = static_cast<size_t>(split.axis);
        for (;;) {
            for (; left < right && frame.bin_of(*left, axis) <= split.bin; ++left)
                centers[0].grow(left->center());
            for (; left < right && frame.bin_of(right[-1], axis) > split.bin; --right)
                centers[1].grow(right[-1].center());
            if (left >= right) break;
            std::swap(*left, right[-1]);
        }
    }
    const auto left_count = static_cast<uint32_t>(left - begin);
    halves = {Range{range.first, left_count, range.depth + 1, range.moved, centers[0]},
              Range{range.first + left_count, range.count - left_count, range.depth + 1,
                    range.moved, centers[1]}};
    return left_count;
}

void BinaryBuilder::build_subtree(int32_t index, const Range& range, Piece& piece) {
    BinaryNode& node = nodes_[static_cast<size_t>(index)];
    node.first = range.first;
    node.count = range.count;
    node.left = node.right = -1;
    std::array<Range, 2> halves;
    if (range.count == 1) {
        node.bounds = *primitives_of(range);
    } else if (cut(range, node.bounds, halves) > 0) {
        node.left = new_node(piece);
        node.right = new_node(piece);
        build_subtree(node.left, halves[0], piece);
        build_subtree(node.right, halves[1], piece);
    }
    plan(node, nodes_.data(), options_);
}

}  // namespace pave
