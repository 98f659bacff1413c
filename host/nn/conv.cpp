// Packing of weights, and which implementations there are.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/conv.h"

#include <algorithm>
#include <limits>

namespace pave::nn {
namespace {

size_t taps_of(const Node& node) {
    return static_cast<size_t>(node.kernel_w) * static_cast<size_t>(node.kernel_h);
}

size_t padded(size_t count, size_t multiple) {
    return (count + multiple - 1) / multiple * multiple;
}

}  // namespace

const char* name_of(ConvKind kind) { return kind == ConvKind::kDirect ? "direct" : "clblast"; }

const PackedWeights& WeightStore::tiled(const Node& node, const Geometry& geometry,
                                        int tile_channels) {
    const auto key = std::pair(&node, tile_channels);
    if (const auto found = packed_.find(key); found != packed_.end()) return found->second;
    const size_t ins = static_cast<size_t>(node.weight_in_channels);
    const size_t outs = static_cast<size_t>(node.out_channels);
    const size_t tile = static_cast<size_t>(tile_channels), all = padded(outs, tile);
    PackedWeights packed;
    std::vector<float> weights(all * ins * taps_of(node) + ins, 0.0f);
    size_t at = 0;
    for (const Phase& phase : geometry.phases) {
        packed.phase_first.push_back(static_cast<int>(at));
        for (size_t block = 0; block < all; block += tile)
            for (const Tap& tap : phase.taps)
                for (size_t in = 0; in < ins; ++in, at += tile)
                    std::copy_n(node.weight.data() +
                                    (static_cast<size_t>(tap.index) * ins + in) * outs + block,
                                std::min(tile, outs - block), weights.data() + at);
    }
    packed.zeros_first = static_cast<int>(at);
    std::vector<float> bias = node.bias;
    bias.resize(all, 0.0f);
    packed.weights = make_buffer_of(device_, weights, "weights of " + node.name);
    packed.bias = make_buffer_of(device_, bias, "bias of " + node.name);
    return packed_.emplace(key, std::move(packed)).first->second;
}

const PackedWeights& WeightStore::matrix(const Node& node, const Geometry& geometry) {
    const auto key = std::pair(&node, 0);
    if (const auto found = packed_.find(key); found != packed_.end()) return found->second;
    const size_t rows =
        static_cast<size_t>(node.weight_in_channels) * static_cast<size_t>(node.out_channels);
    PackedWeights packed;
    std::vector<float> weights;
    weights.reserve(node.weight.size());
    for (const Phase& phase : geometry.phases) {
        packed.phase_first.push_back(static_cast<int>(weights.size()));
        for (const Tap& tap : phase.taps) {
            const auto from = node.weight.begin() +
                              static_cast<std::ptrdiff_t>(static_cast<size_t>(tap.index) * rows);
            weights.insert(weights.end(), from, from + static_cast<std::ptrdiff_t>(rows));
        }
    }
    packed.weights = make_buffer_of(device_, weights, "weights of " + node.name);
    packed.bias = make_buffer_of(device_, node.bias, "bias of " + node.name);
    return packed_.emplace(key, std::move(packed)).first->second;
}

void WeightStore::forget(const Node& node) {
    std::erase_if(packed_, [&](const auto& item) { return item.first.first == &node; });
}

bool supports(ConvKind kind, const Runtime& runtime, const ConvSite& site) {
    constexpr size_t kLargestIndex = static_cast<size_t>(std::numeric_limits<int>::max());
    const Node& node = *site.node;
    // The smallest tile: make_direct_conv takes a larger one only where that pads no more.
    const size_t outs = kind == ConvKind::kDirect
                            ? padded(static_cast<size_t>(node.out_channels),
                                     static_cast<size_t>(runtime.conv_lanes()))
                            : static_cast<size_t>(node.out_channels);
    return (outs * taps_of(node) + 1) * static_cast<size_t>(node.weight_in_channels) <
           kLargestIndex;
}

std::unique_ptr<Conv> make_conv(ConvKind kind, Runtime& runtime, WeightStore& store,
                                const ConvSite& site) {
    return kind == ConvKind::kDirect ? make_direct_conv(runtime, store, site)
                                     : make_gemm_conv(runtime, store, site);
}

}  // namespace pave::nn
