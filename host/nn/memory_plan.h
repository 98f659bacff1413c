// Where in one arena each tensor lies, so that tensors that live at the same time never overlap.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace pave::nn {

/// A stretch of memory that is needed from step `first` to step `last`, both included.
struct Lifetime {
    size_t byte_size = 0;
    int first = 0, last = 0;
};

struct MemoryPlan {
    std::vector<size_t> byte_offsets;  // one a lifetime
    size_t byte_size = 0;              // of the arena
};

/// Offsets are multiples of `alignment` (a power of two); after each tensor at least
/// `guard_byte_size` bytes belong to nobody. Largest first, each at the lowest offset that is free
/// for all of its life.
MemoryPlan plan_memory(std::span<const Lifetime> lifetimes, size_t alignment,
                       size_t guard_byte_size = 0);

}  // namespace pave::nn
