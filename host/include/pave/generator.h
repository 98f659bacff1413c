// The trained generator inside the renderer: reads an exported run, draws a frame on the OpenCL
// device.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "pave/device.h"

namespace pave {

/// A network exported by `pave train` (generator.json, generator.safetensors and their manifest),
/// on one device. One draw at a time.
class Generator {
   public:
    /// `run_folder` holds these files. Verifies checksums before parsing. Throws InputError naming
    /// file and reason.
    Generator(const Device& device, const std::string& run_folder);
    ~Generator();
    Generator(Generator&&) noexcept;
    Generator& operator=(Generator&&) noexcept;

    /// Input channels by name, in the network's order.
    const std::vector<std::string>& inputs() const;
    /// Identity of the weights: XXH3-128 hex of generator.safetensors.
    const std::string& weights_version() const;

    /// Reads the input channels of `frame` (linear, as rendered) and writes linear radiance to its
    /// channel "drawn", or to "color" if it has no "drawn". Blocking. Throws UsageError "missing
    /// input: NAME" if the frame lacks an input, and for slots of 2^31 floats and more.
    void draw(Frame& frame);

    /// Runs the graph on encoded input planes (C, H, W) and returns the encoded output planes: for
    /// parity tests. If `layers` is given it receives every node's output by node name.
    std::vector<float> run(std::span<const float> input, int width, int height,
                           std::map<std::string, std::vector<float>>* layers = nullptr);

    /// Bytes of activations that the liveness plan needs for this size; without reuse it would be
    /// `unplanned`.
    size_t planned_byte_size(int width, int height, size_t* unplanned = nullptr) const;

   private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace pave
