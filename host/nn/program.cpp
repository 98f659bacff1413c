// Lowering: fused activations, joins that nobody copies, steps in place; then the layout.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/program.h"

#include <algorithm>
#include <limits>
#include <string>

#include "kernels/nn_types.h"
#include "pave/error.h"

namespace pave::nn {
namespace {

constexpr size_t kArenaAlignment =
    256;  // bytes: no two tensors share a cache line, vector loads start aligned

bool is_activation(const Node& node) {
    return node.op == Op::kLeakyRelu || node.op == Op::kRelu || node.op == Op::kSigmoid ||
           node.op == Op::kTanh;
}

Activation activation_of(const Node& node) {
    switch (node.op) {
        case Op::kLeakyRelu:
            return {NN_ACT_LEAKY, node.slope};
        case Op::kRelu:
            return {NN_ACT_LEAKY, 0.0f};
        case Op::kSigmoid:
            return {NN_ACT_SIGMOID, 0.0f};
        case Op::kTanh:
            return {NN_ACT_TANH, 0.0f};
        default:
            return {};
    }
}

/// True if the op's output element depends on the same element of its inputs alone (and on sums
/// made before).
bool works_in_place(const Node& node) {
    return is_activation(node) || node.op == Op::kBatchNorm || node.op == Op::kInstanceNorm ||
           node.op == Op::kAdd || node.op == Op::kMul;
}

class Lowering {
   public:
    Lowering(const Graph& graph, bool fuse_activations)
        : graph_(graph), fuse_activations_(fuse_activations), readers_(graph.nodes.size()) {
        for (size_t i = 0; i < graph.nodes.size(); ++i)
            for (int input : graph.nodes[i].inputs)
                readers_[static_cast<size_t>(input)].push_back(static_cast<int>(i));
        // The result is read after all nodes.
        readers_[static_cast<size_t>(graph.result)].push_back(static_cast<int>(graph.nodes.size()));
        program_.values.resize(graph.nodes.size());
        channels_ = channel_counts();
    }

    Program run() {
        std::vector<bool> fused(graph_.nodes.size(), false);
        for (int i = 1; i < static_cast<int>(graph_.nodes.size()); ++i) {
            const Node& node = graph_.nodes[static_cast<size_t>(i)];
            if (fused[static_cast<size_t>(i)]) continue;
            if (node.op == Op::kSliceChannels) {
                value(i).parent = node.inputs[0];
                value(i).channel_first = node.first;
                continue;
            }
            if (node.op == Op::kConcat) {
                lower_concat(i);
                continue;
            }
            Step step;
            step.node = i;
            step.inputs = node.inputs;
            step.output = i;
            step.activation = activation_of(node);
            const int reader = sole_reader(i);
            if (fuse_activations_ && !is_activation(node) && reader > 0 &&
                is_activation(graph_.nodes[static_cast<size_t>(reader)])) {
                step.activation = activation_of(graph_.nodes[static_cast<size_t>(reader)]);
                step.output = reader;
                value(i).exists = false;
                fused[static_cast<size_t>(reader)] = true;
            }
            if (works_in_place(node)) place_in_place(step);
            program_.steps.push_back(std::move(step));
        }
        note_completion();
        return std::move(program_);
    }

   private:
    void note_completion() {
        std::vector<int>& complete = program_.complete_after;
        complete.assign(graph_.nodes.size(), 0);
        for (size_t i = 0; i < program_.steps.size(); ++i)
            complete[static_cast<size_t>(program_.steps[i].output)] = static_cast<int>(i) + 1;
        for (size_t i = 1; i < graph_.nodes.size(); ++i) {
            const Node& node = graph_.nodes[i];
            if (node.op != Op::kConcat && node.op != Op::kSliceChannels) continue;
            for (int input : node.inputs)
                complete[i] = std::max(complete[i], complete[static_cast<size_t>(input)]);
        }
    }

    Value& value(int index) { return program_.values[static_cast<size_t>(index)]; }

    /// The one node that reads `index`, or -1.
    int sole_reader(int index) const {
        const std::vector<int>& readers = readers_[static_cast<size_t>(index)];
        return readers.size() == 1 && readers[0] < static_cast<int>(graph_.nodes.size())
                   ? readers[0]
                   : -1;
    }

    std::vector<int> channel_counts() const {
        std::vector<int> counts;
        counts.push_back(graph_.input_channels);
        for (size_t i = 1; i < graph_.nodes.size(); ++i) {
            const Node& node = graph_.nodes[i];
            int count = counts[static_cast<size_t>(node.inputs[0])];
            if (node.out_channels != 0) count = node.out_channels;
            if (node.op == Op::kSliceChannels) count = node.count;
            for (size_t j = 1; node.op == Op::kConcat && j < node.inputs.size(); ++j)
                count += counts[static_cast<size_t>(node.inputs[j])];
            counts.push_back(count);
        }
        return counts;
    }

    /// An input that owns its memory is made to lie in the concat's from the start; any other is
    /// copied there.
    void lower_concat(int index) {
        int channel = 0;
        for (int input : graph_.nodes[static_cast<size_t>(index)].inputs) {
            if (value(input).parent < 0) {
                value(input).parent = index;
                value(input).channel_first = channel;
            } else {
                Step copy;
                copy.node = index;
                copy.inputs = {input};
                copy.output = index;
                copy.copies = true;
                copy.channel_first = channel;
                program_.steps.push_back(std::move(copy));
            }
            channel += channels_[static_cast<size_t>(input)];
        }
    }

    int root_of(int index) const {
        while (program_.values[static_cast<size_t>(index)].parent >= 0)
            index = program_.values[static_cast<size_t>(index)].parent;
        return index;
    }

    /// Lets an input of `step` lie where its output does, if nothing that lies in that input's
    /// memory is read later, and nothing but the input itself is read by this step (a slice of it
    /// would be read after it was overwritten).
    void place_in_place(const Step& step) {
        for (int input : step.inputs) {
            if (value(input).parent >= 0 || !overwritable(input, step.node)) continue;
            value(input).parent = step.output;
            return;
        }
    }

    bool overwritable(int input, int node) const {
        for (int i = 0; i < static_cast<int>(readers_.size()); ++i) {
            if (root_of(i) != input) continue;
            const bool read_too_late = std::any_of(
                readers_[static_cast<size_t>(i)].begin(), readers_[static_cast<size_t>(i)].end(),
                [&](int reader) { return i == input ? reader > node : reader >= node; });
            if (read_too_late) return false;
        }
        return true;
    }

    const Graph& graph_;
    const bool fuse_activations_;
    std::vector<std::vector<int>> readers_;  // nodes that read each node, rising
    std::vector<int> channels_;
    Program program_;
};

/// The value whose memory `index` lies in, and the channel of it at which it starts.
std::pair<int, int> resolve(const Program& program, int index) {
    int channel = 0;
    const Value* value = &program.values[static_cast<size_t>(index)];
    while (value->parent >= 0) {
        channel += value->channel_first;
        index = value->parent;
        value = &program.values[static_cast<size_t>(index)];
    }
    return {index, channel};
}

size_t byte_size_of(const Extent& extent) {
    return sizeof(float) * static_cast<size_t>(extent.channels) *
           static_cast<size_t>(extent.width) * static_cast<size_t>(extent.height);
}

}  // namespace

Program lower(const Graph& graph, bool fuse_activations) {
    return Lowering(graph, fuse_activations).run();
}

Layout lay_out(const Graph& graph, const Program& program, const std::vector<Extent>& extents,
               size_t guard_byte_size) {
    Layout layout;
    std::vector<int> slot_of(program.values.size(), -1);
    const auto slot = [&](int index) -> int& { return slot_of[static_cast<size_t>(index)]; };
    for (int i = 0; i < static_cast<int>(program.values.size()); ++i) {
        if (!program.values[static_cast<size_t>(i)].exists) continue;
        layout.unplanned_byte_size += byte_size_of(extents[static_cast<size_t>(i)]);
        if (program.values[static_cast<size_t>(i)].parent >= 0) continue;
        slot(i) = static_cast<int>(layout.roots.size());
        layout.roots.push_back(i);
        layout.lifetimes.push_back(
            {byte_size_of(extents[static_cast<size_t>(i)]), std::numeric_limits<int>::max(), -1});
    }
    const auto touch = [&](int index, int step) {
        Lifetime& life = layout.lifetimes[static_cast<size_t>(slot(resolve(program, index).first))];
        life.first = std::min(life.first, step);
        life.last = std::max(life.last, step);
    };
    touch(0, 0);
    for (size_t i = 0; i < program.steps.size(); ++i) {
        for (int input : program.steps[i].inputs) touch(input, static_cast<int>(i) + 1);
        touch(program.steps[i].output, static_cast<int>(i) + 1);
    }
    touch(graph.result, static_cast<int>(program.steps.size()) + 1);
    if (guard_byte_size > 0)
        for (Lifetime& life : layout.lifetimes) life = {life.byte_size, 0, 0};
    layout.memory = plan_memory(layout.lifetimes, kArenaAlignment, guard_byte_size);
    if (layout.memory.byte_size / sizeof(float) >
        static_cast<size_t>(std::numeric_limits<int>::max()))
        throw UsageError("an image of " + std::to_string(extents[0].width) + " x " +
                         std::to_string(extents[0].height) + " needs " +
                         std::to_string(layout.memory.byte_size >> 20) +
                         " MiB of activations, at most 8192 are taken; draw smaller images");
    for (int i = 0; i < static_cast<int>(program.values.size()); ++i) {
        const auto [root, channel] = resolve(program, i);
        const Extent& extent = extents[static_cast<size_t>(i)];
        View view{0, extents[static_cast<size_t>(root)].channels, extent.width, extent.height,
                  extent.channels};
        if (program.values[static_cast<size_t>(i)].exists)
            view.first =
                static_cast<int>(layout.memory.byte_offsets[static_cast<size_t>(slot(root))] /
                                 sizeof(float)) +
                channel;
        layout.views.push_back(view);
    }
    return layout;
}

}  // namespace pave::nn
