// One convolution of a program, bound to its place in the arena, in several implementations.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <memory>
#include <string>

#include "host/nn/geometry.h"
#include "host/nn/runtime.h"

namespace pave::nn {

enum class ConvKind : int { kDirect, kGemm };
const char* name_of(ConvKind kind);

/// What is to be computed: a folded node (weights [tap][in][out], bias) from one view to another.
struct ConvSite {
    const Node* node = nullptr;  // borrowed
    View src, dst;
    Activation activation;
};

/// A convolution's weights on the device, in the order of one implementation.
struct PackedWeights {
    cl::Buffer weights, bias;
    std::vector<int> phase_first;  // floats at which each phase begins
    int zeros_first = 0;
};

/// Packs weights at first need and keeps them: programs of several sizes share them. Borrows the
/// nodes.
class WeightStore {
   public:
    explicit WeightStore(const Device& device) : device_(device) {}
    /// [phase][block of tile_channels][tap][in][tile_channels] with zeros as padding, then
    /// in_channels zeros.
    const PackedWeights& tiled(const Node& node, const Geometry& geometry, int tile_channels);
    /// [phase][tap][in][out].
    const PackedWeights& matrix(const Node& node, const Geometry& geometry);
    /// Drops what was packed for `node`; convolutions that are bound keep theirs.
    void forget(const Node& node);

   private:
    Device device_;
    std::map<std::pair<const Node*, int>, PackedWeights>
        packed_;  // by node and tile_channels, 0 for matrix
};

/// A convolution ready to run. Non-blocking, on the device's queue.
class Conv {
   public:
    virtual ~Conv() = default;
    virtual void enqueue(const cl::Buffer& arena) = 0;
    /// Enqueues about so many multiply-adds of it, at least one launch's worth, for measuring;
    /// returns which part of the whole that is, in (0, 1].
    virtual double enqueue_sample(const cl::Buffer& arena, int64_t multiply_adds) = 0;
};

/// Register tiles of pixels x channels (kernels/nn_conv.cl).
std::unique_ptr<Conv> make_direct_conv(Runtime& runtime, WeightStore& store, const ConvSite& site);
/// im2col and CLBlast's SGEMM, in chunks of bounded memory.
std::unique_ptr<Conv> make_gemm_conv(Runtime& runtime, WeightStore& store, const ConvSite& site);
std::unique_ptr<Conv> make_conv(ConvKind kind, Runtime& runtime, WeightStore& store,
                                const ConvSite& site);

/// False where an implementation's index arithmetic would overflow.
bool supports(ConvKind kind, const Runtime& runtime, const ConvSite& site);

}  // namespace pave::nn
