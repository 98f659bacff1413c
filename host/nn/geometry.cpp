// Phases and taps of convolutions.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/geometry.h"

namespace pave::nn {
namespace {

Geometry plain(const Node& node, int out_width, int out_height) {
    Phase phase{0, 0, out_width, out_height, {}};
    for (int y = 0; y < node.kernel_h; ++y)
        for (int x = 0; x < node.kernel_w; ++x)
            phase.taps.push_back({x - node.padding, y - node.padding, y * node.kernel_w + x});
    return {node.stride, 1, {phase}};
}

/// torch: out[i * stride - padding + k] += in[i] * weight[k]. So output o = g * stride + p reads
/// in[g + (p + padding - k) / stride] for those k that leave no remainder.
Geometry transposed(const Node& node, int out_width, int out_height) {
    Geometry geometry{1, node.stride, {}};
    for (int py = 0; py < node.stride; ++py)
        for (int px = 0; px < node.stride; ++px) {
            Phase phase{px,
                        py,
                        (out_width - px + node.stride - 1) / node.stride,
                        (out_height - py + node.stride - 1) / node.stride,
                        {}};
            for (int y = 0; y < node.kernel_h; ++y)
                for (int x = 0; x < node.kernel_w; ++x) {
                    const int dx = px + node.padding - x, dy = py + node.padding - y;
                    if (dx % node.stride != 0 || dy % node.stride != 0) continue;
                    phase.taps.push_back(
                        {dx / node.stride, dy / node.stride, y * node.kernel_w + x});
                }
            geometry.phases.push_back(std::move(phase));
        }
    return geometry;
}

}  // namespace

Geometry geometry_of(const Node& node, int out_width, int out_height) {
    return node.op == Op::kConvTranspose2d ? transposed(node, out_width, out_height)
                                           : plain(node, out_width, out_height);
}

}  // namespace pave::nn
