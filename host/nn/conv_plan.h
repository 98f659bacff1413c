// Which implementation each convolution takes: measured on the device and remembered.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <optional>
#include <string>

#include "host/nn/conv.h"

namespace pave::nn {

/// How ConvPlan decides. By default it follows what was measured on this device before; for a new
/// shape a GPU measures both, and a CPU takes the direct one: there CLBlast was 8 to 17 times
/// slower on every layer measured, and its first call compiles for 15 s, which would be the first
/// drawing's wait. PAVE_CONV=measure measures new shapes on every device; direct and clblast force
/// one.
enum class ConvPolicy : int { kRemember, kMeasure, kDirect, kGemm };
/// Of the environment. Throws UsageError for an unknown word.
ConvPolicy conv_policy();

/// Microseconds that an implementation took for one convolution (of all threads together on CPU
/// devices).
struct ConvTiming {
    double direct_us = 0.0, gemm_us = 0.0;
    ConvKind best() const { return gemm_us < direct_us ? ConvKind::kGemm : ConvKind::kDirect; }
};

/// Decisions by the shape of a convolution. They are kept in the kernel cache's folder, one file a
/// device and build of the kernels, so that only the first run of a machine measures. A file that
/// is not whole counts as not there.
class ConvPlan {
   public:
    ConvPlan(Runtime& runtime, WeightStore& store, ConvPolicy policy);

    /// The implementation for `site`, whose views lie in `arena`. Measuring overwrites the output
    /// view and blocks.
    ConvKind choose(const ConvSite& site, const cl::Buffer& arena);
    /// Writes what was measured since; failing to is no error.
    void save();
    const std::map<std::string, ConvTiming>& timings() const { return timings_; }

   private:
    ConvTiming measure(const ConvSite& site, const cl::Buffer& arena);

    Runtime& runtime_;
    WeightStore& store_;
    ConvPolicy policy_;
    std::string file_;  // empty: no folder
    std::map<std::string, ConvTiming> timings_;
    bool changed_ = false;
};

/// "conv2d 64>128 4x4 s2 p1 128x128>64x64".
std::string shape_text(const ConvSite& site);

/// The file's text for `timings`, and back; nothing if the text was damaged.
std::string timings_text(const std::map<std::string, ConvTiming>& timings);
std::optional<std::map<std::string, ConvTiming>> parse_timings(const std::string& text);

}  // namespace pave::nn
