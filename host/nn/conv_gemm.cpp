// Convolution by matrix product: pixels to columns, CLBlast's SGEMM, bias and activation.
// SPDX-License-Identifier: BSD-3-Clause
#include <clblast.h>

#include <algorithm>
#include <mutex>
#include <set>

#include "host/device/cache.h"
#include "host/nn/conv.h"
#include "pave/hash.h"

namespace pave::nn {
namespace {

// Of columns, and of products, at a time: fits the last-level cache of a CPU.
constexpr size_t kChunkByteLimit = size_t{16} << 20;

size_t ceil_div(size_t a, size_t b) { return (a + b - 1) / b; }

std::string clblast_version() {
    return std::to_string(CLBLAST_VERSION_MAJOR) + "." + std::to_string(CLBLAST_VERSION_MINOR) +
           "." + std::to_string(CLBLAST_VERSION_PATCH);
}

clblast::StatusCode sgemm(Runtime& runtime, size_t rows, size_t outs, size_t depth,
                          const cl::Buffer& columns, const cl::Buffer& weights, size_t weight_first,
                          const cl::Buffer& product) {
    cl_command_queue queue = queue_of(runtime.device())();
    return clblast::Gemm<float>(clblast::Layout::kRowMajor, clblast::Transpose::kNo,
                                clblast::Transpose::kNo, rows, outs, depth, 1.0f, columns(), 0,
                                depth, weights(), weight_first, outs, 0.0f, product(), 0, outs,
                                &queue, nullptr);
}

/// product[rows][outs] = columns[rows][depth] x weights[depth][outs].
/// CLBlast compiles inside its calls and keeps programs for the process only, so the kernel cache
/// brackets every call until this shape has run once: what drivers that keep files write then is
/// there for the next process.
void multiply(Runtime& runtime, size_t rows, size_t outs, size_t depth, const cl::Buffer& columns,
              const cl::Buffer& weights, size_t weight_first, const cl::Buffer& product) {
    static std::mutex mutex;
    static std::set<std::string> seen;
    const DeviceProfile& profile = runtime.device().profile();
    const std::string key = hash_hex("clblast sgemm " + clblast_version() + "/" + profile.platform +
                                     "/" + profile.name + "/" + profile.driver);
    const std::lock_guard lock(mutex);
    clblast::StatusCode status{};
    const bool first = seen.insert(key + "/" + std::to_string(rows) + "/" + std::to_string(outs) +
                                   "/" + std::to_string(depth))
                           .second;
    if (first) {
        KernelCache::Compilation compilation(KernelCache::of_process(), key);
        status = sgemm(runtime, rows, outs, depth, columns, weights, weight_first, product);
        compilation.end();
    } else {
        status = sgemm(runtime, rows, outs, depth, columns, weights, weight_first, product);
    }
    if (status != clblast::StatusCode::kSuccess)
        throw ClError(
            "clblast::Gemm", static_cast<cl_int>(status),
            std::to_string(rows) + " x " + std::to_string(depth) + " x " + std::to_string(outs));
}

class GemmConv : public Conv {
   public:
    GemmConv(Runtime& runtime, WeightStore& store, const ConvSite& site)
        : runtime_(runtime),
          site_(site),
          geometry_(geometry_of(*site.node, site.dst.width, site.dst.height)),
          packed_(store.matrix(*site.node, geometry_)) {
        std::vector<cl_int2> taps;
        for (const Phase& phase : geometry_.phases) {
            tap_first_.push_back(static_cast<int>(taps.size()));
            for (const Tap& tap : phase.taps) taps.push_back({{tap.dx, tap.dy}});
        }
        taps_ = make_buffer_of(runtime.device(), taps, "taps of a convolution");
    }

    void enqueue(const cl::Buffer& arena) override {
        for (size_t i = 0; i < geometry_.phases.size(); ++i) {
            const Phase& phase = geometry_.phases[i];
            const int pixels = phase.grid_w * phase.grid_h;
            const int chunk = chunk_of(phase);
            for (int first = 0; first < pixels; first += chunk)
                enqueue_chunk(arena, i, first, std::min(chunk, pixels - first));
        }
    }

    double enqueue_sample(const cl::Buffer& arena, int64_t multiply_adds) override {
        int64_t all = 0;
        size_t largest = 0;
        for (size_t i = 0; i < geometry_.phases.size(); ++i) {
            all += pixels_of(i) * row_work(i);
            if (pixels_of(i) * row_work(i) > pixels_of(largest) * row_work(largest)) largest = i;
        }
        const int64_t row = std::max<int64_t>(1, row_work(largest));
        const int64_t limit =
            std::min<int64_t>(pixels_of(largest), chunk_of(geometry_.phases[largest]));
        const int64_t pixels = std::clamp<int64_t>(multiply_adds / row, 1, limit);
        enqueue_chunk(arena, largest, 0, static_cast<int>(pixels));
        return static_cast<double>(pixels * row) / static_cast<double>(std::max<int64_t>(1, all));
    }

   private:
    int64_t pixels_of(size_t phase) const {
        return static_cast<int64_t>(geometry_.phases[phase].grid_w) *
               geometry_.phases[phase].grid_h;
    }
    int64_t row_work(size_t phase) const {
        return static_cast<int64_t>(depth_of(geometry_.phases[phase])) * site_.node->out_channels;
    }
    size_t depth_of(const Phase& phase) const {
        return phase.taps.size() * static_cast<size_t>(site_.node->weight_in_channels);
    }

    /// Pixels whose columns and whose products stay within kChunkByteLimit each.
    int chunk_of(const Phase& phase) const {
        const size_t row = std::max(depth_of(phase), static_cast<size_t>(site_.node->out_channels));
        return static_cast<int>(
            std::clamp<size_t>(kChunkByteLimit / (row * sizeof(float)), 1, 1 << 20));
    }

    void enqueue_chunk(const cl::Buffer& arena, size_t phase_index, int first, int pixels) {
        const Phase& phase = geometry_.phases[phase_index];
        const size_t rows = static_cast<size_t>(pixels), depth = depth_of(phase);
        const size_t outs = static_cast<size_t>(site_.node->out_channels);
        const cl::Buffer& product =
            runtime_.scratch(Runtime::Scratch::kSecond, rows * outs * sizeof(float));
        if (depth == 0) {
            cl_guard("product", [&] {
                queue_of(runtime_.device())
                    .enqueueFillBuffer(product, 0.0f, 0, rows * outs * sizeof(float));
            });
        } else {
            const cl::Buffer& columns =
                runtime_.scratch(Runtime::Scratch::kFirst, rows * depth * sizeof(float));
            gather(arena, columns, phase_index, first, pixels);
            multiply(runtime_, rows, outs, depth, columns, packed_.weights,
                     static_cast<size_t>(packed_.phase_first[phase_index]), product);
        }
        scatter(arena, product, phase, first, pixels);
    }

    void gather(const cl::Buffer& arena, const cl::Buffer& columns, size_t phase_index, int first,
                int pixels) {
        const Phase& phase = geometry_.phases[phase_index];
        NnColumns s{};
        s.src_first = site_.src.first;
        s.src_step = site_.src.step;
        s.src_width = site_.src.width;
        s.src_height = site_.src.height;
        s.grid_width = phase.grid_w;
        s.in_step = geometry_.in_step;
        s.pixel_first = first;
        s.pixels = pixels;
        s.tap_first = tap_first_[phase_index];
        s.taps = static_cast<int>(phase.taps.size());
        s.in_channels = site_.node->weight_in_channels;
        s.channels_per_item = runtime_.channels_per_item(s.in_channels);
        const size_t groups =
            ceil_div(static_cast<size_t>(s.in_channels), static_cast<size_t>(s.channels_per_item));
        launch(runtime_.device(), runtime_.columns(),
               cl::NDRange(groups, phase.taps.size(), static_cast<size_t>(pixels)),
               runtime_.local(), s, arena, taps_, columns);
    }

    void scatter(const cl::Buffer& arena, const cl::Buffer& product, const Phase& phase, int first,
                 int pixels) {
        NnScatter s{};
        s.dst_first = site_.dst.first;
        s.dst_step = site_.dst.step;
        s.dst_width = site_.dst.width;
        s.grid_width = phase.grid_w;
        s.out_step = geometry_.out_step;
        s.out_x = phase.out_x;
        s.out_y = phase.out_y;
        s.pixel_first = first;
        s.pixels = pixels;
        s.out_channels = site_.node->out_channels;
        s.channels_per_item = runtime_.channels_per_item(s.out_channels);
        s.activation = site_.activation.kind;
        s.slope = site_.activation.slope;
        const size_t groups =
            ceil_div(static_cast<size_t>(s.out_channels), static_cast<size_t>(s.channels_per_item));
        launch(runtime_.device(), runtime_.scatter(),
               cl::NDRange(groups, static_cast<size_t>(pixels), 1), runtime_.local(), s, product,
               packed_.bias, arena);
    }

    Runtime& runtime_;
    ConvSite site_;
    Geometry geometry_;
    PackedWeights packed_;
    std::vector<int> tap_first_;
    cl::Buffer taps_;
};

}  // namespace

std::unique_ptr<Conv> make_gemm_conv(Runtime& runtime, WeightStore& store, const ConvSite& site) {
    return std::make_unique<GemmConv>(runtime, store, site);
}

}  // namespace pave::nn
