// Batch normalisation folded into the convolution before it; weights in the kernels' order.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/nn/graph.h"

namespace pave::nn {

/// A batch_norm whose input is a convolution that nobody else reads becomes part of it: the
/// convolution's node goes, and the folded one stands under the batch_norm's name. All weights of
/// convolutions are brought to [tap][in][out] and get a bias. Folds in double precision. A
/// batch_norm elsewhere stays: running statistics are applied channel by channel.
Graph fold(Graph graph);

}  // namespace pave::nn
