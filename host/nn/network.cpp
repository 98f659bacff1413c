// A checked network on one device.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/network.h"

#include <cmath>

#include "host/nn/fold.h"

namespace pave::nn {

class Session {
   public:
    int width = 0, height = 0;
    bool layers = false;
    Program program;
    Layout layout;
    cl::Buffer arena;
    std::vector<std::unique_ptr<Conv>> convs;  // one a step, null for steps that are none
};

namespace {

bool is_convolution(const Node& node) {
    return node.op == Op::kConv2d || node.op == Op::kConvTranspose2d;
}

const View& view_of(const Session& session, int value) {
    return session.layout.views[static_cast<size_t>(value)];
}

}  // namespace

Network::Network(const Device& device, Graph graph, NetworkOptions options)
    : device_(device),
      options_(options),
      graph_(fold(std::move(graph))),
      runtime_(std::make_unique<Runtime>(device)),
      store_(std::make_unique<WeightStore>(device)),
      plan_(std::make_unique<ConvPlan>(*runtime_, *store_, options.conv_policy)) {}

Network::~Network() = default;

void Network::prepare(int width, int height, bool layers) {
    if (session_ && session_->width == width && session_->height == height &&
        session_->layers == layers)
        return;
    session_.reset();  // its memory goes before the next one's comes
    auto session = std::make_unique<Session>();
    session->width = width;
    session->height = height;
    session->layers = layers;
    session->program = lower(graph_, !layers);
    session->layout = lay_out(graph_, session->program, infer_image_extents(graph_, width, height),
                              options_.guard_byte_size);
    session->arena =
        make_buffer(device_, session->layout.memory.byte_size, "activations of the network");
    session->convs.resize(session->program.steps.size());
    for (size_t i = 0; i < session->program.steps.size(); ++i) {
        const Step& step = session->program.steps[i];
        const Node& node = graph_.nodes[static_cast<size_t>(step.node)];
        if (step.copies || !is_convolution(node)) continue;
        const ConvSite site{&node, view_of(*session, step.inputs[0]),
                            view_of(*session, step.output), step.activation};
        session->convs[i] =
            make_conv(plan_->choose(site, session->arena), *runtime_, *store_, site);
    }
    plan_->save();
    session_ = std::move(session);
}

const cl::Buffer& Network::arena() const { return session_->arena; }
const View& Network::input() const { return session_->layout.views[0]; }
const View& Network::result() const { return view_of(*session_, graph_.result); }
const Layout& Network::layout() const { return session_->layout; }

void Network::enqueue(const Visit& visit) {
    const std::vector<Step>& steps = session_->program.steps;
    visit_complete(visit, 0);
    for (size_t i = 0; i < steps.size(); ++i) {
        run_step(steps[i], i);
        visit_complete(visit, static_cast<int>(i) + 1);
    }
}

void Network::visit_complete(const Visit& visit, int steps_done) {
    if (!visit) return;
    const Program& program = session_->program;
    for (size_t i = 0; i < program.values.size(); ++i)
        if (program.values[i].exists && program.complete_after[i] == steps_done)
            visit(static_cast<int>(i));
}

void Network::run_step(const Step& step, size_t index) {
    const Node& node = graph_.nodes[static_cast<size_t>(step.node)];
    const View& src = view_of(*session_, step.inputs[0]);
    View dst = view_of(*session_, step.output);
    const cl::Buffer& arena = session_->arena;
    if (step.copies) {
        dst.first += step.channel_first;
        dst.channels = src.channels;
        return runtime_->rows(NN_ROWS_COPY, arena, src, nullptr, dst, step.activation);
    }
    if (session_->convs[index]) return session_->convs[index]->enqueue(arena);
    switch (node.op) {
        case Op::kBatchNorm:
            return runtime_->rows(NN_ROWS_AFFINE, arena, src, nullptr, dst, step.activation,
                                  &parameters_of(step.node));
        case Op::kInstanceNorm:
            return runtime_->instance_norm(arena, src, dst, step.activation,
                                           parameters_of(step.node), node.eps);
        case Op::kAdd:
        case Op::kMul: {
            const View& other = view_of(*session_, step.inputs[1]);
            return runtime_->rows(node.op == Op::kAdd ? NN_ROWS_ADD : NN_ROWS_MUL, arena, src,
                                  &other, dst, step.activation);
        }
        case Op::kUpsampleNearest:
            return runtime_->rows(NN_ROWS_UPSAMPLE, arena, src, nullptr, dst, step.activation,
                                  nullptr, node.scale);
        default:
            return runtime_->rows(NN_ROWS_COPY, arena, src, nullptr, dst, step.activation);
    }
}

/// batch_norm: mean, weight / sqrt(var + eps), bias; instance_norm: weight, bias.
const cl::Buffer& Network::parameters_of(int index) {
    if (const auto found = parameters_.find(index); found != parameters_.end())
        return found->second;
    const Node& node = graph_.nodes[static_cast<size_t>(index)];
    const size_t channels = static_cast<size_t>(view_of(*session_, index).channels);
    std::vector<float> weight = node.weight, bias = node.bias;
    weight.resize(channels, 1.0f);
    bias.resize(channels, 0.0f);
    std::vector<float> parameters = node.mean;
    for (size_t c = 0; c < node.var.size(); ++c)
        weight[c] = static_cast<float>(
            static_cast<double>(weight[c]) /
            std::sqrt(static_cast<double>(node.var[c]) + static_cast<double>(node.eps)));
    parameters.insert(parameters.end(), weight.begin(), weight.end());
    parameters.insert(parameters.end(), bias.begin(), bias.end());
    return parameters_
        .emplace(index, make_buffer_of(device_, parameters, "parameters of " + node.name))
        .first->second;
}

std::vector<float> Network::read(int value) {
    const View& view = view_of(*session_, value);
    const size_t channels = static_cast<size_t>(view.channels);
    const size_t pixels = static_cast<size_t>(view.width) * static_cast<size_t>(view.height);
    std::vector<float> rows(pixels * channels), planes(pixels * channels);
    cl::Event event;
    cl_guard("activations of the network", [&] {
        queue_of(device_).enqueueReadBufferRect(
            session_->arena, CL_FALSE, {static_cast<size_t>(view.first) * sizeof(float), 0, 0},
            {0, 0, 0}, {channels * sizeof(float), pixels, 1},
            static_cast<size_t>(view.step) * sizeof(float), 0, channels * sizeof(float), 0,
            rows.data(), nullptr, &event);
    });
    wait(event, "reading activations");
    for (size_t n = 0; n < pixels; ++n)
        for (size_t c = 0; c < channels; ++c) planes[c * pixels + n] = rows[n * channels + c];
    return planes;
}

void Network::write_input(std::span<const float> planes) {
    const View& view = input();
    const size_t channels = static_cast<size_t>(view.channels);
    const size_t pixels = static_cast<size_t>(view.width) * static_cast<size_t>(view.height);
    std::vector<float> rows(pixels * channels);
    for (size_t n = 0; n < pixels; ++n)
        for (size_t c = 0; c < channels; ++c) rows[n * channels + c] = planes[c * pixels + n];
    cl::Event event;
    cl_guard("activations of the network", [&] {
        queue_of(device_).enqueueWriteBufferRect(
            session_->arena, CL_FALSE, {static_cast<size_t>(view.first) * sizeof(float), 0, 0},
            {0, 0, 0}, {channels * sizeof(float), pixels, 1},
            static_cast<size_t>(view.step) * sizeof(float), 0, channels * sizeof(float), 0,
            rows.data(), nullptr, &event);
    });
    wait(event, "writing the network's input");
}

size_t Network::planned_byte_size(int width, int height, size_t* unplanned) const {
    const Layout layout =
        lay_out(graph_, lower(graph_, true), infer_image_extents(graph_, width, height));
    if (unplanned != nullptr) *unplanned = layout.unplanned_byte_size;
    return layout.memory.byte_size;
}

}  // namespace pave::nn
