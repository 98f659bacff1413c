// Batch normalisation folded into the convolution before it.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/fold.h"

#include <cmath>
#include <utility>

namespace pave::nn {
namespace {

bool is_convolution(const Node& node) {
    return node.op == Op::kConv2d || node.op == Op::kConvTranspose2d;
}

std::vector<int> count_readers(const Graph& graph) {
    std::vector<int> readers(graph.nodes.size(), 0);
    for (const Node& node : graph.nodes)
        for (int input : node.inputs) ++readers[static_cast<size_t>(input)];
    ++readers[static_cast<size_t>(graph.result)];
    return readers;
}

/// (out, in, h, w) or, transposed, (in, out, h, w) to [h * w][in][out].
void arrange_weights(Node& node) {
    const size_t taps = static_cast<size_t>(node.kernel_w) * static_cast<size_t>(node.kernel_h);
    const size_t outs = static_cast<size_t>(node.out_channels);
    const size_t ins = static_cast<size_t>(node.weight_in_channels);
    const bool transposed = node.op == Op::kConvTranspose2d;
    std::vector<float> arranged(node.weight.size());
    for (size_t out = 0; out < outs; ++out)
        for (size_t in = 0; in < ins; ++in) {
            const float* from =
                node.weight.data() + (transposed ? in * outs + out : out * ins + in) * taps;
            for (size_t tap = 0; tap < taps; ++tap)
                arranged[(tap * ins + in) * outs + out] = from[tap];
        }
    node.weight = std::move(arranged);
    node.bias.resize(outs, 0.0f);
}

/// y = (conv - mean) / sqrt(var + eps) * weight + bias, as one convolution.
void fold_into(Node& convolution, const Node& norm) {
    const size_t outs = convolution.bias.size();
    std::vector<double> gain(outs);
    for (size_t c = 0; c < outs; ++c) {
        gain[c] = (norm.weight.empty() ? 1.0 : static_cast<double>(norm.weight[c])) /
                  std::sqrt(static_cast<double>(norm.var[c]) + static_cast<double>(norm.eps));
        const double shift = norm.bias.empty() ? 0.0 : static_cast<double>(norm.bias[c]);
        convolution.bias[c] = static_cast<float>(
            (static_cast<double>(convolution.bias[c]) - static_cast<double>(norm.mean[c])) *
                gain[c] +
            shift);
    }
    for (size_t i = 0; i < convolution.weight.size(); ++i)
        convolution.weight[i] =
            static_cast<float>(static_cast<double>(convolution.weight[i]) * gain[i % outs]);
    convolution.name = norm.name;
}

}  // namespace

Graph fold(Graph graph) {
    const std::vector<int> readers = count_readers(graph);
    std::vector<int> index_of(graph.nodes.size(),
                              -1);  // old index to new; of a folded pair, both to the one node
    std::vector<Node> nodes;
    for (size_t i = 0; i < graph.nodes.size(); ++i) {
        Node& node = graph.nodes[i];
        const int source = node.inputs.empty() ? -1 : node.inputs[0];
        for (int& input : node.inputs) input = index_of[static_cast<size_t>(input)];
        if (is_convolution(node)) arrange_weights(node);
        const bool folds = node.op == Op::kBatchNorm && readers[static_cast<size_t>(source)] == 1 &&
                           is_convolution(nodes[static_cast<size_t>(node.inputs[0])]);
        if (folds) {
            index_of[i] = node.inputs[0];
            fold_into(nodes[static_cast<size_t>(node.inputs[0])], node);
            continue;
        }
        index_of[i] = static_cast<int>(nodes.size());
        nodes.push_back(std::move(node));
    }
    graph.nodes = std::move(nodes);
    graph.result = index_of[static_cast<size_t>(graph.result)];
    return graph;
}

}  // namespace pave::nn
