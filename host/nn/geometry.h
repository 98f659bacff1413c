// Convolution and transposed convolution as one: phases of pixels that read the same taps.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include "host/nn/graph.h"

namespace pave::nn {

/// Grid pixel (x, y) of a phase reads input pixel (x * in_step + dx, y * in_step + dy) under weight
/// `index` = ky * kernel_w + kx.
struct Tap {
    int dx = 0, dy = 0;
    int index = 0;
};

/// Output pixels (x * out_step + out_x, y * out_step + out_y) for x, y in the grid.
struct Phase {
    int out_x = 0, out_y = 0;
    int grid_w = 0, grid_h = 0;
    std::vector<Tap> taps;  // may be empty: then the output is the bias
};

struct Geometry {
    int in_step = 1, out_step = 1;
    std::vector<Phase>
        phases;  // every output pixel is in exactly one; small images leave some grids empty
};

/// One phase for a convolution, stride^2 for a transposed one. Their taps do not depend on the
/// size.
Geometry geometry_of(const Node& node, int out_width, int out_height);

}  // namespace pave::nn
