// A folded graph as a list of steps over values that share memory where they may.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

#include "host/nn/graph.h"
#include "host/nn/memory_plan.h"

namespace pave::nn {

/// What a step applies to its result before it stores it.
struct Activation {
    int kind = 0;  // NN_ACT_* of kernels/nn_types.h
    float slope = 0.0f;
};

/// One launch: graph.nodes[node] with its own weights and parameters, or a copy of one input of
/// that concat.
struct Step {
    int node = 0;
    std::vector<int> inputs;  // values
    int output = 0;           // value; the activation's if one is fused
    bool copies = false;      // inputs[0] into `output` from channel `channel_first` on
    int channel_first = 0;
    Activation activation;
};

/// The output of a node. One with a parent lies within the parent's memory, from the parent's
/// channel `channel_first` on: slices in what they are cut from, inputs of a concat in its result,
/// inputs of in-place steps in their output.
struct Value {
    bool exists = true;  // false: fused away, never in memory
    int parent = -1;
    int channel_first = 0;
};

struct Program {
    std::vector<Step> steps;
    std::vector<Value> values;        // one a node of the graph
    std::vector<int> complete_after;  // steps after which each value is whole; 0: with the input
};

/// Steps in the graph's order. With `fuse_activations` off every node but folded batch norms'
/// convolutions leaves its value.
Program lower(const Graph& graph, bool fuse_activations);

/// Where a value lies in the arena, in floats: `step` from a pixel to the next, `channels` of them
/// its own.
struct View {
    int first = 0, step = 0;
    int width = 0, height = 0, channels = 0;
};

struct Layout {
    std::vector<View> views;  // one a value
    std::vector<Lifetime>
        lifetimes;           // of the memory that values share: one for each value without a parent
    std::vector<int> roots;  // and which value that is
    MemoryPlan memory;
    size_t unplanned_byte_size = 0;  // if every node's output had memory of its own
};

/// Lifetimes by step: step 0 writes the input, step i + 1 is program.steps[i], the last reads the
/// result. Throws UsageError when the arena would not fit 2^31 floats.
Layout lay_out(const Graph& graph, const Program& program, const std::vector<Extent>& extents,
               size_t guard_byte_size = 0);

}  // namespace pave::nn
