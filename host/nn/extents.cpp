// Output sizes of every node of a graph, and the errors of those that do not fit together.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/graph.h"
#include "pave/error.h"

namespace pave::nn {
namespace {

[[noreturn]] void fail(const Graph& graph, const Node& node, const std::string& reason) {
    throw InputError(graph.file + ": node '" + node.name + "': " + reason);
}

std::string text_of(const Extent& extent) {
    return std::to_string(extent.channels) + " x " + std::to_string(extent.height) + " x " +
           std::to_string(extent.width);
}

int convolved(const Node& node, int size, int kernel) {
    if (node.op == Op::kConvTranspose2d)
        return (size - 1) * node.stride - 2 * node.padding + kernel;
    const int span = size + 2 * node.padding - kernel;
    return span < 0 ? 0 : span / node.stride + 1;
}

void require_channels(const Graph& graph, const Node& node, int channels) {
    if (node.weight_in_channels != 0 && node.weight_in_channels != channels)
        fail(graph, node,
             "its weights are for " + std::to_string(node.weight_in_channels) +
                 " channels, its input has " + std::to_string(channels));
}

Extent join(const Graph& graph, const Node& node, const std::vector<Extent>& extents) {
    Extent joined = extents[static_cast<size_t>(node.inputs[0])];
    for (size_t i = 1; i < node.inputs.size(); ++i) {
        const Extent& other = extents[static_cast<size_t>(node.inputs[i])];
        const bool same_size = other.width == joined.width && other.height == joined.height;
        if (!same_size || (node.op != Op::kConcat && other.channels != joined.channels))
            fail(graph, node,
                 "inputs of " + text_of(joined) + " and " + text_of(other) + " do not fit");
        if (node.op == Op::kConcat) joined.channels += other.channels;
        if (joined.channels > kMaxChannels) fail(graph, node, "too many channels");
    }
    return joined;
}

Extent extent_of(const Graph& graph, const Node& node, const std::vector<Extent>& extents) {
    if (node.op == Op::kConcat || node.op == Op::kAdd || node.op == Op::kMul)
        return join(graph, node, extents);
    Extent extent = extents[static_cast<size_t>(node.inputs[0])];
    switch (node.op) {
        case Op::kConv2d:
        case Op::kConvTranspose2d:
            require_channels(graph, node, extent.channels);
            extent = {node.out_channels, convolved(node, extent.height, node.kernel_h),
                      convolved(node, extent.width, node.kernel_w)};
            break;
        case Op::kBatchNorm:
        case Op::kInstanceNorm:
            require_channels(graph, node, extent.channels);
            break;
        case Op::kSliceChannels:
            if (node.first + node.count > extent.channels)
                fail(graph, node,
                     "the slice ends beyond the input's " + std::to_string(extent.channels) +
                         " channels");
            extent.channels = node.count;
            break;
        case Op::kUpsampleNearest:
            extent.height *= node.scale;
            extent.width *= node.scale;
            break;
        default:
            break;
    }
    return extent;
}

}  // namespace

std::vector<Extent> infer_extents(const Graph& graph, int width, int height) {
    constexpr int kMaxExtent =
        1 << 18;  // keeps every product of two below 2^36 and a 64-fold upsampling in an int
    std::vector<Extent> extents{{graph.input_channels, height, width}};
    for (size_t i = 1; i < graph.nodes.size(); ++i) {
        const Node& node = graph.nodes[i];
        const Extent extent = extent_of(graph, node, extents);
        if (extent.width < 1 || extent.height < 1)
            fail(graph, node,
                 "an input of " + std::to_string(width) + " x " + std::to_string(height) +
                     " is too small for it");
        if (extent.width > kMaxExtent || extent.height > kMaxExtent)
            fail(graph, node, "its output would be " + text_of(extent));
        extents.push_back(extent);
    }
    return extents;
}

std::vector<Extent> infer_image_extents(const Graph& graph, int width, int height) {
    std::vector<Extent> extents = infer_extents(graph, width, height);
    const Extent& result = extents[static_cast<size_t>(graph.result)];
    if (result != Extent{graph.output_channels, height, width})
        fail(graph, graph.nodes[static_cast<size_t>(graph.result)],
             "the result is " + text_of(result) + " for an input of " + std::to_string(width) +
                 " x " + std::to_string(height) + ", not the output's planes at the input's size");
    return extents;
}

}  // namespace pave::nn
