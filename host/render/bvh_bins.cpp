// The binned surface area heuristic.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/bvh_bins.h"

#include <algorithm>
#include <cmath>

namespace pave {

BinFrame::BinFrame(const Box& centers, int bins) : bins_(bins), low_(-centers.minus_lower) {
    const Float4 extent = centers.extent();
    for (int axis = 0; axis < 4; ++axis) {
        // Just below the number of bins, so that the last center does not fall behind them.
        const float scale = static_cast<float>(bins) * (1.0f - 1e-6f) / extent[axis];
        scale_[axis] = axis < 3 && std::isfinite(scale) && std::isfinite(extent[axis]) ? scale : 0;
    }
    low_[3] = 0;
    mask_ = Int4{bins - 1, bins - 1, bins - 1, bins - 1};
}

Bins::Bins(int bins) {
    for (size_t axis = 0; axis < 3; ++axis)
        for (size_t bin = 0; bin < static_cast<size_t>(bins); ++bin) {
            boxes[axis][bin] = Box::none();
            counts[axis][bin] = 0;
        }
}

void Bins::add(std::span<const Box> primitives, const BinFrame& frame) {
    for (const Box& primitive : primitives) {
        const Int4 bin = frame.bins_of(primitive);
        for (size_t axis = 0; axis < 3; ++axis) {
            const auto at = static_cast<size_t>(bin[axis]);
            boxes[axis][at].grow(primitive);
            ++counts[axis][at];
        }
    }
}

void Bins::add(const Bins& other, int bins) {
    for (size_t axis = 0; axis < 3; ++axis)
        for (size_t bin = 0; bin < static_cast<size_t>(bins); ++bin) {
            boxes[axis][bin].grow(other.boxes[axis][bin]);
            counts[axis][bin] += other.counts[axis][bin];
        }
}

Box Bins::bounds(int bins) const {
    Box all = Box::none();
    for (size_t bin = 0; bin < static_cast<size_t>(bins); ++bin) all.grow(boxes[0][bin]);
    return all;
}

Split Bins::best(const BinFrame& frame, uint32_t count, const LeafCost& leaf_cost) const {
    const auto bins = static_cast<size_t>(frame.bins());
    const float area =
        std::max(bounds(frame.bins()).half_area(), std::numeric_limits<float>::min());
    Split best;
    for (size_t axis = 0; axis < 3; ++axis) {
        if (!frame.has(axis)) continue;
        std::array<float, kMost> right_cost;
        Box right = Box::none();
        uint32_t right_count = 0;
        for (size_t bin = bins - 1; bin > 0; --bin) {
            right.grow(boxes[axis][bin]);
            right_count += counts[axis][bin];
            right_cost[bin] = right.half_area() * leaf_cost(right_count);
        }
        Box left = Box::none();
        uint32_t left_count = 0;
        for (size_t bin = 0; bin + 1 < bins; ++bin) {
            left.grow(boxes[axis][bin]);
            left_count += counts[axis][bin];
            if (left_count == 0 || left_count == count) continue;
            const float cost = left.half_area() * leaf_cost(left_count) + right_cost[bin + 1];
            if (cost < best.cost)
                best = {static_cast<int>(axis), static_cast<int>(bin), left_count, cost};
        }
    }
    best.cost /= area;
    return best;
}

}  // namespace pave
