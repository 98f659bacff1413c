// First cuts of a large scene over the cells of a grid: primitives are moved once, not at each cut.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include "host/render/block.h"
#include "host/render/bvh_bins.h"
#include "host/render/workers.h"

namespace pave {

/// With `left` < 0 a run of primitives that is not cut further here.
struct GridNode {
    Box bounds = Box::none();
    Box centers = Box::none();  // bounds of the centers; of runs only
    uint32_t first = 0, count = 0;
    int32_t left = -1, right = -1;
};

/// Cuts `from` by SAH into runs of at most `run_size` primitives, or that reach over few cells, and
/// writes them run by run to `to`. `centers` bounds the centers. Node 0 is the root; children come
/// after their parents. The same for any number of threads.
std::vector<GridNode> cut_by_grid(const Block<Box>& from, Block<Box>& to, const Box& centers,
                                  uint32_t run_size, const LeafCost& leaf_cost, Workers& workers);

}  // namespace pave
