// Which implementation each convolution takes.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/conv_plan.h"

#include <algorithm>
#include <cstdlib>
#include <ctime>
#include <limits>
#include <sstream>

#include "host/device/cache.h"
#include "pave/error.h"
#include "pave/hash.h"

namespace pave::nn {
namespace {

constexpr int kRepeats = 3;  // the least time counts: noise only adds
constexpr int64_t kSampleWork =
    1 << 25;  // multiply-adds timed on a CPU: milliseconds, even where they are slow
constexpr size_t kMaxRemembered = 4096;

/// A clock to compare implementations by. On a CPU other processes stretch wall time at random, and
/// not the processor time that this process gets; its threads share the work in either
/// implementation.
double now_us(bool serial) {
    timespec time{};
    clock_gettime(serial ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC, &time);
    return static_cast<double>(time.tv_sec) * 1e6 + static_cast<double>(time.tv_nsec) * 1e-3;
}

std::string cache_file(const Device& device) {
    const auto& folder = KernelCache::of_process().folder().path;
    if (folder.empty()) return {};
    const DeviceProfile& profile = device.profile();
    const std::string key =
        hash_hex(profile.platform + "/" + profile.name + "/" + profile.driver + "/" +
                 std::to_string(profile.lane_width) + "/" + std::to_string(profile.compute_units) +
                 "/" + Device::kernel_hash());
    return (folder / ("convolutions-" + key + ".txt")).string();
}

}  // namespace

ConvPolicy conv_policy() {
    const char* text = std::getenv("PAVE_CONV");
    const std::string word = text == nullptr ? "" : text;
    if (word.empty()) return ConvPolicy::kRemember;
    if (word == "measure") return ConvPolicy::kMeasure;
    if (word == "direct") return ConvPolicy::kDirect;
    if (word == "clblast") return ConvPolicy::kGemm;
    throw UsageError("PAVE_CONV=" + word.substr(0, 64) + ": known are measure, direct and clblast");
}

std::string shape_text(const ConvSite& site) {
    const Node& node = *site.node;
    std::ostringstream text;
    text << (node.op == Op::kConvTranspose2d ? "conv_transpose2d " : "conv2d ")
         << node.weight_in_channels << '>' << node.out_channels << ' ' << node.kernel_w << 'x'
         << node.kernel_h << " s" << node.stride << " p" << node.padding << ' ' << site.src.width
         << 'x' << site.src.height << '>' << site.dst.width << 'x' << site.dst.height;
    return text.str();
}

std::string timings_text(const std::map<std::string, ConvTiming>& timings) {
    std::ostringstream text;
    for (const auto& [shape, timing] : timings)
        text << timing.direct_us << '\t' << timing.gemm_us << '\t' << shape << '\n';
    return hash_hex(text.str()) + "\n" + text.str();
}

std::optional<std::map<std::string, ConvTiming>> parse_timings(const std::string& text) {
    constexpr size_t kHashLength = 32;
    if (text.size() <= kHashLength || text[kHashLength] != '\n') return std::nullopt;
    const std::string lines = text.substr(kHashLength + 1);
    if (hash_hex(lines) != text.substr(0, kHashLength)) return std::nullopt;
    std::map<std::string, ConvTiming> timings;
    std::istringstream stream(lines);
    ConvTiming timing;
    std::string shape;
    while (timings.size() < kMaxRemembered && stream >> timing.direct_us >> timing.gemm_us &&
           stream.get() == '\t' && std::getline(stream, shape))
        timings[shape] = timing;
    return timings;
}

ConvPlan::ConvPlan(Runtime& runtime, WeightStore& store, ConvPolicy policy)
    : runtime_(runtime), store_(store), policy_(policy), file_(cache_file(runtime.device())) {
    if (policy_ != ConvPolicy::kRemember || file_.empty()) return;
    if (const auto text = read_file_whole(file_))
        if (auto timings = parse_timings(*text)) timings_ = std::move(*timings);
}

ConvKind ConvPlan::choose(const ConvSite& site, const cl::Buffer& arena) {
    if (policy_ == ConvPolicy::kDirect || !supports(ConvKind::kGemm, runtime_, site))
        return ConvKind::kDirect;
    if (policy_ == ConvPolicy::kGemm || !supports(ConvKind::kDirect, runtime_, site))
        return ConvKind::kGemm;
    const std::string shape = shape_text(site);
    auto found = timings_.find(shape);
    if (found == timings_.end()) {
        if (policy_ == ConvPolicy::kRemember && runtime_.serial()) return ConvKind::kDirect;
        found = timings_.emplace(shape, measure(site, arena)).first;
        changed_ = true;
    }
    return found->second.best();
}

ConvTiming ConvPlan::measure(const ConvSite& site, const cl::Buffer& arena) {
    // A GPU needs all of the work to show its speed, and does it at once.
    const int64_t work = runtime_.serial() ? kSampleWork : std::numeric_limits<int64_t>::max();
    const auto time_us = [&](ConvKind kind) {
        const std::unique_ptr<Conv> conv = make_conv(kind, runtime_, store_, site);
        double best_us = std::numeric_limits<double>::max();
        for (int i = 0; i <= kRepeats; ++i) {
            const double start_us = now_us(runtime_.serial());
            const double part = conv->enqueue_sample(arena, work);
            finish(runtime_.device(), "a convolution being measured");
            const double us = now_us(runtime_.serial()) - start_us;
            if (i > 0) best_us = std::min(best_us, us / part);  // the first run compiles
        }
        return best_us;
    };
    const ConvTiming timing{time_us(ConvKind::kDirect), time_us(ConvKind::kGemm)};
    store_.forget(*site.node);  // only one of the two packings is needed from here on
    return timing;
}

void ConvPlan::save() {
    if (!changed_ || file_.empty()) return;
    changed_ = false;
    std::map<std::string, ConvTiming> all = timings_;
    // Another process may have measured other shapes meanwhile.
    if (const auto text = read_file_whole(file_))
        if (auto others = parse_timings(*text)) all.merge(*others);
    try_write_file(file_, timings_text(all));
}

}  // namespace pave::nn
