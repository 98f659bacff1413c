// Greedy placement by size, as in Pisarchyk and Lee 2020 (arXiv 2001.03288).
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/memory_plan.h"

#include <algorithm>
#include <numeric>

namespace pave::nn {
namespace {

struct Interval {
    size_t begin, end;
};

}  // namespace

MemoryPlan plan_memory(std::span<const Lifetime> lifetimes, size_t alignment,
                       size_t guard_byte_size) {
    std::vector<size_t> order(lifetimes.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
        return lifetimes[a].byte_size > lifetimes[b].byte_size;
    });
    const auto rounded = [&](size_t bytes) {
        return (bytes + guard_byte_size + alignment - 1) / alignment * alignment;
    };
    MemoryPlan plan{std::vector<size_t>(lifetimes.size(), 0), 0};
    std::vector<size_t> placed;
    std::vector<Interval> taken;
    for (size_t index : order) {
        const Lifetime& life = lifetimes[index];
        taken.clear();
        for (size_t other : placed)
            if (lifetimes[other].first <= life.last && life.first <= lifetimes[other].last)
                taken.push_back({plan.byte_offsets[other],
                                 plan.byte_offsets[other] + rounded(lifetimes[other].byte_size)});
        std::sort(taken.begin(), taken.end(),
                  [](const Interval& a, const Interval& b) { return a.begin < b.begin; });
        size_t offset = 0;
        for (const Interval& interval : taken) {
            if (offset + rounded(life.byte_size) <= interval.begin) break;
            offset = std::max(offset, interval.end);
        }
        plan.byte_offsets[index] = offset;
        plan.byte_size = std::max(plan.byte_size, offset + rounded(life.byte_size));
        placed.push_back(index);
    }
    return plan;
}

}  // namespace pave::nn
