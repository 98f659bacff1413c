// The network's kernels on one device: built once, launched from views and steps.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <memory>

#include "host/device/cl.h"
#include "host/nn/program.h"
#include "kernels/nn_types.h"

namespace pave::nn {

/// Kernels, scratch memory and the device's shape. Everything is enqueued on the device's queue and
/// returns at once. One thread at a time.
class Runtime {
   public:
    explicit Runtime(const Device& device);

    const Device& device() const { return device_; }
    /// Lanes of the kernels along channels; 1 where a work-item an element is right.
    int lanes() const { return lanes_; }
    /// Lanes of nn_conv_direct: its tile wants vectors on every device.
    int conv_lanes() const { return serial_ ? lanes_ : 4; }
    /// Pixels of its tile.
    static constexpr int kTilePixels = 6;
    /// Largest NN_BLOCK whose tile stays in registers.
    int largest_block() const { return lanes_ >= 16 ? 4 : 2; }
    /// True where one work-item does the work of many (CPU devices).
    bool serial() const { return serial_; }
    int compute_units() const { return device_.profile().compute_units; }
    cl::NDRange local() const { return serial_ ? cl::NDRange(1, 1, 1) : cl::NullRange; }

    /// Channels that a work-item takes of `channels`: all on CPUs, where they are side by side; one
    /// on GPUs.
    int channels_per_item(int channels) const { return serial_ ? channels : lanes_; }

    cl::Kernel& direct_convolution(int block);
    cl::Kernel& columns() { return columns_; }
    cl::Kernel& scatter() { return scatter_; }
    cl::Kernel& encode() { return encode_; }
    cl::Kernel& decode() { return decode_; }

    /// dst = activation(op(src, other)). `parameters` is read by NN_ROWS_AFFINE alone.
    void rows(int op, const cl::Buffer& arena, const View& src, const View* other, const View& dst,
              const Activation& activation, const cl::Buffer* parameters = nullptr, int scale = 1);
    /// dst = activation(instance norm of src); `gains` is [2][channels], weight and bias.
    void instance_norm(const cl::Buffer& arena, const View& src, const View& dst,
                       const Activation& activation, const cl::Buffer& gains, float eps);

    /// Memory that a single step uses and nothing outlives; two kinds, so that a step may have
    /// both. Grows as asked.
    enum class Scratch : int { kFirst, kSecond };
    const cl::Buffer& scratch(Scratch which, size_t byte_size);

   private:
    Device device_;
    int lanes_;
    bool serial_;
    cl::Kernel rows_, narrow_rows_;  // the latter takes channel by channel
    cl::Kernel moments_, normalise_, columns_, scatter_, encode_, decode_;
    std::map<int, cl::Kernel> direct_;  // by block
    std::map<Scratch, std::pair<size_t, cl::Buffer>> scratch_;
    cl::Buffer nothing_;  // stands in for arguments that are not read
};

}  // namespace pave::nn
