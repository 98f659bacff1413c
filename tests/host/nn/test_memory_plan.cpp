// The memory planner on random lifetimes, and programs executed symbolically.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <random>

#include "host/nn/fold.h"
#include "host/nn/program.h"
#include "tests/host/nn/fixtures.h"

namespace pave::nn {
namespace {

using Random = std::mt19937;

int pick(Random& random, int low, int high) {
    return low + static_cast<int>(random() % static_cast<unsigned>(high - low + 1));
}

TEST(MemoryPlan, live_tensors_never_overlap) {
    for (unsigned seed = 0; seed < 500; ++seed) {
        Random random(seed);
        std::vector<Lifetime> lifetimes;
        size_t all = 0, alignment = 256, guard = seed % 3 == 0 ? 64 : 0;
        for (int i = pick(random, 1, 40); i > 0; --i) {
            const int first = pick(random, 0, 30);
            lifetimes.push_back(
                {static_cast<size_t>(pick(random, 1, 5000)), first, first + pick(random, 0, 8)});
            all += (lifetimes.back().byte_size + guard + alignment - 1) / alignment * alignment;
        }
        const MemoryPlan plan = plan_memory(lifetimes, alignment, guard);
        EXPECT_LE(plan.byte_size, all) << "seed " << seed;
        for (size_t i = 0; i < lifetimes.size(); ++i) {
            EXPECT_EQ(plan.byte_offsets[i] % alignment, 0u) << "seed " << seed;
            EXPECT_LE(plan.byte_offsets[i] + lifetimes[i].byte_size + guard, plan.byte_size);
            for (size_t j = 0; j < i; ++j) {
                const Lifetime &a = lifetimes[i], &b = lifetimes[j];
                if (a.last < b.first || b.last < a.first) continue;
                EXPECT_TRUE(plan.byte_offsets[i] + a.byte_size + guard <= plan.byte_offsets[j] ||
                            plan.byte_offsets[j] + b.byte_size + guard <= plan.byte_offsets[i])
                    << "seed " << seed << ", tensors " << j << " and " << i;
            }
        }
    }
}

TEST(MemoryPlan, a_chain_needs_two_tensors) {
    std::vector<Lifetime> chain;
    for (int i = 0; i < 20; ++i) chain.push_back({1024, i, i + 1});
    EXPECT_EQ(plan_memory(chain, 256).byte_size, 2048u);
    EXPECT_EQ(plan_memory({}, 256).byte_size, 0u);
}

/// A graph of random operations over tensors of one size; weights are left out, which planning does
/// not look at.
Graph random_graph(Random& random) {
    Graph graph;
    graph.file = "random";
    graph.input_channels = pick(random, 2, 5);
    graph.nodes.emplace_back().name = "input";
    std::vector<int> channels{graph.input_channels};
    for (int i = pick(random, 1, 25); i > 0; --i) {
        const int count = static_cast<int>(graph.nodes.size());
        // Mostly recent nodes, as networks do, so that chains and joins both occur.
        const auto any = [&] { return random() % 2 != 0 ? count - 1 : pick(random, 0, count - 1); };
        Node node;
        node.name = std::string(1, 'n').append(std::to_string(count));
        const int source = any();
        node.inputs = {source};
        int result = channels[static_cast<size_t>(source)];
        constexpr Op kOps[] = {Op::kConv2d,        Op::kInstanceNorm, Op::kRelu, Op::kTanh,
                               Op::kConcat,        Op::kConcat,       Op::kAdd,  Op::kMul,
                               Op::kSliceChannels, Op::kBatchNorm};
        node.op = kOps[static_cast<size_t>(pick(random, 0, 9))];
        if (node.op == Op::kConv2d) {
            result = node.out_channels = pick(random, 1, 5);
            node.kernel_w = node.kernel_h = 1;
        } else if (node.op == Op::kConcat) {
            for (int more = pick(random, 0, 3); more > 0; --more) {
                node.inputs.push_back(any());
                result += channels[static_cast<size_t>(node.inputs.back())];
            }
        } else if (node.op == Op::kAdd || node.op == Op::kMul) {
            std::vector<int> fitting;
            for (int j = 0; j < count; ++j)
                if (channels[static_cast<size_t>(j)] == result) fitting.push_back(j);
            node.inputs.push_back(fitting[random() % fitting.size()]);
        } else if (node.op == Op::kSliceChannels) {
            node.first = pick(random, 0, result - 1);
            result = node.count = pick(random, 1, result - node.first);
        }
        graph.nodes.push_back(std::move(node));
        channels.push_back(result);
    }
    graph.result = random() % 4 != 0 ? static_cast<int>(graph.nodes.size()) - 1
                                     : pick(random, 0, static_cast<int>(graph.nodes.size()) - 1);
    return graph;
}

/// Executes a program on an arena of (value, channel) tags instead of numbers.
class SymbolicRun {
   public:
    SymbolicRun(const Graph& graph, const Program& program, const std::vector<Extent>& extents)
        : graph_(graph),
          program_(program),
          layout_(lay_out(graph, program, extents)),
          memory_(layout_.memory.byte_size / sizeof(float), -1) {}

    /// The first fault in words, or "".
    std::string run() {
        write(0, 0, tags_of(0));
        check_complete(0);
        for (size_t i = 0; i < program_.steps.size(); ++i) {
            const Step& step = program_.steps[i];
            for (int input : step.inputs) expect(input, "step " + std::to_string(i + 1));
            if (step.copies)
                write(step.output, step.channel_first, tags_of(step.inputs[0]));
            else
                write(step.output, 0, tags_of(step.output));
            check_complete(static_cast<int>(i) + 1);
        }
        expect(graph_.result, "the end");
        return fault_;
    }
    const Layout& layout() const { return layout_; }

   private:
    /// What a value's channels hold: joins and slices hold what others made.
    std::vector<int> tags_of(int value) const {
        const Node& node = graph_.nodes[static_cast<size_t>(value)];
        std::vector<int> tags;
        if (node.op == Op::kConcat) {
            for (int input : node.inputs)
                for (int tag : tags_of(input)) tags.push_back(tag);
        } else if (node.op == Op::kSliceChannels) {
            const std::vector<int> all = tags_of(node.inputs[0]);
            tags.assign(all.begin() + node.first, all.begin() + node.first + node.count);
        } else {
            for (int c = 0; c < view(value).channels; ++c) tags.push_back(value * 1000 + c);
        }
        return tags;
    }

    const View& view(int value) const { return layout_.views[static_cast<size_t>(value)]; }

    int& at(const View& view, int pixel, int channel) {
        return memory_.at(static_cast<size_t>(view.first + pixel * view.step + channel));
    }

    void write(int value, int channel_first, const std::vector<int>& tags) {
        const View& to = view(value);
        for (int pixel = 0; pixel < to.width * to.height; ++pixel)
            for (size_t c = 0; c < tags.size(); ++c)
                at(to, pixel, channel_first + static_cast<int>(c)) = tags[c] * 64 + pixel;
    }

    void expect(int value, const std::string& when) {
        const View& from = view(value);
        const std::vector<int> tags = tags_of(value);
        for (int pixel = 0; pixel < from.width * from.height; ++pixel)
            for (size_t c = 0; c < tags.size(); ++c)
                if (fault_.empty() && at(from, pixel, static_cast<int>(c)) != tags[c] * 64 + pixel)
                    fault_ = when + ": " + graph_.nodes[static_cast<size_t>(value)].name +
                             " was overwritten";
    }

    void check_complete(int steps) {
        for (size_t i = 0; i < program_.values.size(); ++i)
            if (program_.values[i].exists && program_.complete_after[i] == steps)
                expect(static_cast<int>(i), "after step " + std::to_string(steps));
    }

    const Graph& graph_;
    const Program& program_;
    Layout layout_;
    std::vector<int> memory_;
    std::string fault_;
};

TEST(Program, no_step_reads_what_another_overwrote) {
    size_t planned = 0, unplanned = 0, shared = 0;
    for (unsigned seed = 0; seed < 2000; ++seed) {
        Random random(seed);
        const Graph graph = random_graph(random);
        const std::vector<Extent> extents = infer_extents(graph, 3, 2);
        for (bool fuse : {true, false}) {
            const Program program = lower(graph, fuse);
            SymbolicRun run(graph, program, extents);
            EXPECT_EQ(run.run(), "") << "seed " << seed << ", fuse " << fuse;
            // At a size whose planes fill whole multiples of the arena's alignment.
            const Layout layout = lay_out(graph, program, infer_extents(graph, 32, 32));
            EXPECT_LE(layout.memory.byte_size, layout.unplanned_byte_size) << "seed " << seed;
            planned += layout.memory.byte_size;
            unplanned += layout.unplanned_byte_size;
            for (const Value& value : program.values) shared += value.parent >= 0;
        }
    }
    EXPECT_GT(shared, 1000u);           // else the test looks at nothing
    EXPECT_LT(2 * planned, unplanned);  // reuse of memory saves more than half of it
}

TEST(Program, joins_of_a_unet_copy_nothing_and_memory_shrinks) {
    for (const char* name : {"unet_batch", "unet_instance"}) {
        const Graph graph = fold(fixture_case(name).schema().graph);
        const Program program = lower(graph, true);
        for (const Step& step : program.steps) EXPECT_FALSE(step.copies) << name;
        const Layout layout = lay_out(graph, program, infer_extents(graph, 128, 128));
        EXPECT_LT(layout.memory.byte_size, layout.unplanned_byte_size / 2) << name;
    }
}

}  // namespace
}  // namespace pave::nn
