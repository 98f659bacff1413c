// Boxes as vectors, and the binned surface area heuristic over them: where a range of primitives is
// best cut in two. Wald 2007, "On fast construction of SAH-based bounding volume hierarchies".
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <span>

namespace pave {

using Float4 = float __attribute__((vector_size(16)));
using Int4 = int32_t __attribute__((vector_size(16)));

inline Float4 larger(const Float4& a, const Float4& b) { return a > b ? a : b; }

/// A box whose lower corner is kept with its sign flipped: so both corners grow by a maximum. The
/// fourth numbers are not the box's: the primitive's index lies in one.
struct alignas(32) Box {
    Float4 minus_lower, upper;
    static Box none() {
        constexpr float kFar = -std::numeric_limits<float>::infinity();
        const Float4 far{kFar, kFar, kFar, kFar};
        return {far, far};
    }
    void grow(const Box& other) {
        minus_lower = larger(minus_lower, other.minus_lower);
        upper = larger(upper, other.upper);
    }
    void grow(const Float4& point) {
        minus_lower = larger(minus_lower, -point);
        upper = larger(upper, point);
    }
    Float4 center() const { return 0.5f * upper - 0.5f * minus_lower; }
    Float4 extent() const { return upper + minus_lower; }
    float half_area() const {
        const Float4 e = extent();
        return e[0] < 0 ? 0.0f : e[0] * e[1] + e[1] * e[2] + e[2] * e[0];
    }
};

/// A primitive's box with its index, which is below 2^28. With the exponent bit the fourth number
/// is an ordinary float: small ones are slow to compute with.
inline constexpr uint32_t kIndexMark = 0x40000000;
inline uint32_t index_of(const Box& primitive) {
    return std::bit_cast<uint32_t>(float{primitive.upper[3]}) ^ kIndexMark;
}
inline void set_index(Box& primitive, uint32_t index) {
    primitive.minus_lower[3] = 0;
    primitive.upper[3] = std::bit_cast<float>(index ^ kIndexMark);
}

/// Cost of a leaf: `cost` for every packet of primitives begun.
struct LeafCost {
    uint32_t packet;
    float cost;
    float operator()(uint32_t count) const {
        // A division by a number that is not known would cost more than all else here.
        const uint32_t packets = packet == 8 ? (count + 7) / 8 : (count + packet - 1) / packet;
        return cost * static_cast<float>(packets);
    }
};

/// Which centers go where: bin = (center - low) * scale per axis; 0 where an axis has no extent.
class BinFrame {
   public:
    /// `centers`: bounds of the centers.
    BinFrame(const Box& centers, int bins);
    int bins() const { return bins_; }
    bool has(size_t axis) const { return scale_[axis] > 0; }
    Int4 bins_of(const Box& primitive) const {
        const Int4 bin = __builtin_convertvector((primitive.center() - low_) * scale_, Int4);
        return bin & mask_;  // no number there is, not a NaN either, leads out of the bins
    }
    int bin_of(const Box& primitive, size_t axis) const {
        const float center = 0.5f * primitive.upper[axis] - 0.5f * primitive.minus_lower[axis];
        return static_cast<int>((center - low_[axis]) * scale_[axis]) & mask_[0];
    }

   private:
    int bins_;
    Float4 low_, scale_;
    Int4 mask_;
};

struct Split {
    int axis = -1;  // none: all centers are the same
    int bin = 0;    // the last one on the left
    uint32_t left = 0;
    float cost = std::numeric_limits<float>::infinity();  // in units of the range's own area
};

/// Boxes and counts of up to kMost bins, a power of two, on each axis.
struct Bins {
    static constexpr int kMost = 32;
    std::array<std::array<Box, kMost>, 3> boxes;
    std::array<std::array<uint32_t, kMost>, 3> counts;

    explicit Bins(int bins);
    void add(std::span<const Box> primitives, const BinFrame& frame);
    void add(const Bins& other, int bins);
    Box bounds(int bins) const;
    /// The cheapest cut; `count` primitives are in the bins.
    Split best(const BinFrame& frame, uint32_t count, const LeafCost& leaf_cost) const;
};

}  // namespace pave
