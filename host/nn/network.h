// A checked network on one device: plans for an image size, then runs.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <memory>

#include "host/nn/conv_plan.h"

namespace pave::nn {

struct NetworkOptions {
    ConvPolicy conv_policy = ConvPolicy::kRemember;
    // Kept free after each tensor, for tests that look whether it stays untouched.
    size_t guard_byte_size = 0;
};

/// One size of image: program, layout, arena and bound convolutions.
class Session;

/// Runs a graph. One thread at a time.
class Network {
   public:
    Network(const Device& device, Graph graph, NetworkOptions options);
    ~Network();

    const Graph& graph() const { return graph_; }  // folded
    Runtime& runtime() { return *runtime_; }
    ConvPlan& plan() { return *plan_; }

    /// Gets ready for images of this size; the last size (with or without layers) is kept. Throws
    /// UsageError or InputError when the size cannot be.
    void prepare(int width, int height, bool layers);
    /// Of the prepared size: memory that all views lie in, and the ends of the network.
    const cl::Buffer& arena() const;
    const View& input() const;
    const View& result() const;
    const Layout& layout() const;

    /// Called with the index of each value that is in memory, right after the step that completed
    /// it was enqueued.
    using Visit = std::function<void(int value)>;
    /// Enqueues all steps; non-blocking but for what `visit` does.
    void enqueue(const Visit& visit = {});
    /// Planes (C, H, W) of a value, read back. Blocking.
    std::vector<float> read(int value);
    /// Writes planes (C, H, W) into the input. Blocking.
    void write_input(std::span<const float> planes);

    /// Bytes of the arena for this size, and without reuse.
    size_t planned_byte_size(int width, int height, size_t* unplanned) const;

   private:
    void visit_complete(const Visit& visit, int steps_done);
    void run_step(const Step& step, size_t index);
    const cl::Buffer& parameters_of(int node);

    Device device_;
    NetworkOptions options_;
    Graph graph_;
    std::unique_ptr<Runtime> runtime_;
    std::unique_ptr<WeightStore> store_;
    std::unique_ptr<ConvPlan> plan_;
    std::map<int, cl::Buffer> parameters_;  // of norms that stand alone, by node
    std::unique_ptr<Session> session_;
};

}  // namespace pave::nn
