// The network's kernels on one device.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/runtime.h"

#include <algorithm>

namespace pave::nn {
namespace {

int ceil_div(int a, int b) { return (a + b - 1) / b; }

}  // namespace

Runtime::Runtime(const Device& device)
    : device_(device),
      lanes_(device.profile().lane_width),
      serial_(device.profile().lane_width > 1),
      nothing_(make_buffer(device, 0, "unused argument")) {
    const Defines defines{{"NN_LANES", lanes_}, {"NN_SERIAL", serial_ ? 1 : 0}};
    const cl::Program ops = build_program(device, "nn_ops.cl", defines);
    rows_ = make_kernel(ops, "nn_rows");
    narrow_rows_ = make_kernel(
        build_program(device, "nn_ops.cl", {{"NN_LANES", 1}, {"NN_SERIAL", serial_ ? 1 : 0}}),
        "nn_rows");
    moments_ = make_kernel(ops, "nn_moments");
    normalise_ = make_kernel(ops, "nn_normalise");
    const cl::Program gemm = build_program(device, "nn_gemm.cl", defines);
    columns_ = make_kernel(gemm, "nn_columns");
    scatter_ = make_kernel(gemm, "nn_scatter");
    const cl::Program frame = build_program(device, "nn_frame.cl", defines);
    encode_ = make_kernel(frame, "nn_encode");
    decode_ = make_kernel(frame, "nn_decode");
}

cl::Kernel& Runtime::direct_convolution(int block) {
    const auto found = direct_.find(block);
    if (found != direct_.end()) return found->second;
    const cl::Program program = build_program(device_, "nn_conv.cl",
                                              {{"NN_LANES", conv_lanes()},
                                               {"NN_SERIAL", serial_ ? 1 : 0},
                                               {"NN_BLOCK", block},
                                               {"NN_PIXELS", kTilePixels}});
    return direct_.emplace(block, make_kernel(program, "nn_conv_direct")).first->second;
}

void Runtime::rows(int op, const cl::Buffer& arena, const View& src, const View* other,
                   const View& dst, const Activation& activation, const cl::Buffer* parameters,
                   int scale) {
    NnRows s{};
    s.op = op;
    s.src_first = src.first;
    s.src_step = src.step;
    s.other_first = other != nullptr ? other->first : 0;
    s.other_step = other != nullptr ? other->step : 0;
    s.dst_first = dst.first;
    s.dst_step = dst.step;
    s.pixels = dst.width * dst.height;
    s.channels = dst.channels;
    s.channels_per_item = channels_per_item(dst.channels);
    // About 16 items a thread: enough to balance, large enough not to pay for their launch.
    s.pixels_per_item = serial_ ? std::max(1, ceil_div(s.pixels, 16 * compute_units())) : 1;
    s.activation = activation.kind;
    s.slope = activation.slope;
    s.scale = scale;
    s.width = dst.width;
    // A vector for three channels of an image would be mostly the taking apart of it. But exp and
    // tanh of vectors round as those of the convolutions do, which may have them fused.
    const bool rounds_alike = activation.kind != NN_ACT_SIGMOID && activation.kind != NN_ACT_TANH;
    launch(device_, s.channels < lanes_ && rounds_alike ? narrow_rows_ : rows_,
           cl::NDRange(static_cast<size_t>(ceil_div(s.channels, s.channels_per_item)),
                       static_cast<size_t>(ceil_div(s.pixels, s.pixels_per_item)), 1),
           local(), s, parameters != nullptr ? *parameters : nothing_, arena);
}

void Runtime::instance_norm(const cl::Buffer& arena, const View& src, const View& dst,
                            const Activation& activation, const cl::Buffer& gains, float eps) {
    constexpr int kPixelsPerChunk = 1024;  // sums of so many floats keep 1e-6 of relative error
    NnMoments s{};
    s.src_first = src.first;
    s.src_step = src.step;
    s.pixels = src.width * src.height;
    s.channels = src.channels;
    s.pixels_per_chunk = std::min(s.pixels, kPixelsPerChunk);
    s.chunks = ceil_div(s.pixels, s.pixels_per_chunk);
    s.eps = eps;
    const size_t channels = static_cast<size_t>(s.channels);
    const cl::Buffer& partial =
        scratch(Scratch::kFirst, 2 * channels * static_cast<size_t>(s.chunks) * sizeof(float));
    const cl::Buffer& parameters = scratch(Scratch::kSecond, 3 * channels * sizeof(float));
    const size_t groups = static_cast<size_t>(ceil_div(s.channels, lanes_));
    launch(device_, moments_, cl::NDRange(groups, static_cast<size_t>(s.chunks), 1), local(), s,
           arena, partial);
    launch(device_, normalise_, cl::NDRange(groups, 1, 1), local(), s, partial, gains, parameters);
    rows(NN_ROWS_AFFINE, arena, src, nullptr, dst, activation, &parameters);
}

const cl::Buffer& Runtime::scratch(Scratch which, size_t byte_size) {
    auto& [size, buffer] = scratch_[which];
    if (size < byte_size) {
        // Kernels that still use the old one keep it alive until they are done.
        buffer = make_buffer(device_, byte_size, "scratch of the network");
        size = byte_size;
    }
    return buffer;
}

}  // namespace pave::nn
