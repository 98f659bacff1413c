// First cuts over a grid of 64^3 cells.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/bvh_grid.h"

#include <algorithm>
#include <utility>

namespace pave {
namespace {

constexpr int kSide = 64;      // cells along an axis
constexpr int kLeastSpan = 8;  // fewer cells are too coarse to choose a cut by
constexpr size_t kCells = static_cast<size_t>(kSide) * kSide * kSide;
constexpr size_t kSlices = 4;         // tables of cells that are filled at the same time
constexpr uint32_t kChunk = 1 << 14;  // primitives that a thread moves

/// A cell that holds centers. `place` is a box of its place in the grid alone.
struct Cell {
    Box bounds, place;
    uint32_t count, id;
};

class GridCutter {
   public:
    GridCutter(const Block<Box>& from, Block<Box>& to, uint32_t run_size, const LeafCost& leaf_cost,
               Workers& workers)
        : from_(from), to_(to), run_size_(run_size), leaf_cost_(leaf_cost), workers_(workers) {}

    std::vector<GridNode> cut(const Box& centers) {
        fill_cells(BinFrame(centers, kSide));
        run_of_cell_ = Block<uint32_t>(kCells);
        cut_cells(0, cells_.size());
        uint32_t first = 0;
        for (int32_t run : runs_) {
            nodes_[static_cast<size_t>(run)].first = first;
            first += nodes_[static_cast<size_t>(run)].count;
        }
        move();
        return std::move(nodes_);
    }

   private:
    struct Slice {
        Block<Box> bounds{kCells};  // of cells with a count
        std::vector<uint32_t> counts = std::vector<uint32_t>(kCells, 0);
    };

    void fill_cells(const BinFrame& frame) {
        cell_of_ = Block<uint32_t>(from_.size());
        std::vector<Slice> slices(kSlices);
        const size_t grain = (from_.size() + kSlices - 1) / kSlices;
        run_chunks(workers_, from_.size(), grain, [&](size_t piece, size_t first, size_t last) {
            Slice& slice = slices[piece];
            for (size_t i = first; i < last; ++i) {
                const Int4 at = frame.bins_of(from_[i]);
                const auto cell = static_cast<uint32_t>(at[0] + kSide * (at[1] + kSide * at[2]));
                cell_of_[i] = cell;
                if (slice.counts[cell]++ == 0)
                    slice.bounds[cell] = from_[i];
                else
                    slice.bounds[cell].grow(from_[i]);
            }
        });
        for (uint32_t id = 0; id < kCells; ++id) {
            Cell cell{Box::none(), Box::none(), 0, id};
            for (const Slice& slice : slices) {
                if (slice.counts[id] == 0) continue;
                cell.count += slice.counts[id];
                cell.bounds.grow(slice.bounds[id]);
            }
            if (cell.count == 0) continue;
            cell.place.grow(Float4{static_cast<float>(id % kSide),
                                   static_cast<float>(id / kSide % kSide),
                                   static_cast<float>(id / kSide / kSide), 0});
            cells_.push_back(cell);
        }
    }

    int32_t cut_cells(size_t first, size_t last) {
        const auto index = static_cast<int32_t>(nodes_.size());
        GridNode node;
        Box places = Box::none();
        for (size_t i = first; i < last; ++i) {
            places.grow(cells_[i].place);
            node.count += cells_[i].count;
        }
        nodes_.push_back(node);
        const BinFrame frame(places, Bins::kMost);
        Bins bins(Bins::kMost);
        for (size_t i = first; i < last; ++i) {
            const Int4 at = frame.bins_of(cells_[i].place);
            for (size_t axis = 0; axis < 3; ++axis) {
                bins.boxes[axis][static_cast<size_t>(at[axis])].grow(cells_[i].bounds);
                bins.counts[axis][static_cast<size_t>(at[axis])] += cells_[i].count;
            }
        }
        const Float4 span = places.extent();
        const bool coarse = std::max({span[0], span[1], span[2]}) < kLeastSpan;
        const Split split =
            node.count <= run_size_ || coarse ? Split{} : bins.best(frame, node.count, leaf_cost_);
        node.bounds = bins.bounds(Bins::kMost);
        if (split.axis < 0) {
            for (size_t i = first; i < last; ++i)
                run_of_cell_[cells_[i].id] = static_cast<uint32_t>(runs_.size());
            runs_.push_back(index);
        } else {
            const auto middle = std::partition(
                cells_.begin() + static_cast<std::ptrdiff_t>(first),
                cells_.begin() + static_cast<std::ptrdiff_t>(last), [&](const Cell& cell) {
                    return frame.bin_of(cell.place, static_cast<size_t>(split.axis)) <= split.bin;
                });
            const auto at = static_cast<size_t>(middle - cells_.begin());
            node.left = cut_cells(first, at);
            node.right = cut_cells(at, last);
        }
        nodes_[static_cast<size_t>(index)] = node;
        return index;
    }

    /// In the order of the primitives within a run.
    void move() {
        const size_t runs = runs_.size(), chunks = (from_.size() + kChunk - 1) / kChunk;
        std::vector<uint32_t> next(chunks * runs, 0);  // first counts, then where a chunk writes
        run_chunks(workers_, from_.size(), kChunk, [&](size_t piece, size_t first, size_t last) {
            for (size_t i = first; i < last; ++i) ++next[piece * runs + run_of_cell_[cell_of_[i]]];
        });
        for (size_t run = 0; run < runs; ++run) {
            uint32_t place = nodes_[static_cast<size_t>(runs_[run])].first;
            for (size_t chunk = 0; chunk < chunks; ++chunk)
                place += std::exchange(next[chunk * runs + run], place);
        }
        std::vector<Box> centers(chunks * runs, Box::none());
        run_chunks(workers_, from_.size(), kChunk, [&](size_t piece, size_t first, size_t last) {
            for (size_t i = first; i < last; ++i) {
                const size_t at = piece * runs + run_of_cell_[cell_of_[i]];
                to_[next[at]++] = from_[i];
                centers[at].grow(from_[i].center());
            }
        });
        for (size_t run = 0; run < runs; ++run)
            for (size_t chunk = 0; chunk < chunks; ++chunk)
                nodes_[static_cast<size_t>(runs_[run])].centers.grow(centers[chunk * runs + run]);
    }

    const Block<Box>& from_;
    Block<Box>& to_;
    uint32_t run_size_;
    LeafCost leaf_cost_;
    Workers& workers_;
    Block<uint32_t> cell_of_, run_of_cell_;
    std::vector<Cell> cells_;
    std::vector<GridNode> nodes_;
    std::vector<int32_t> runs_;  // nodes
};

}  // namespace

std::vector<GridNode> cut_by_grid(const Block<Box>& from, Block<Box>& to, const Box& centers,
                                  uint32_t run_size, const LeafCost& leaf_cost, Workers& workers) {
    return GridCutter(from, to, run_size, leaf_cost, workers).cut(centers);
}

}  // namespace pave
