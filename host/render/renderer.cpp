// Renderer: uploads a scene once, keeps its programs, renders frames in launches of some rows.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <chrono>
#include <deque>
#include <map>
#include <tuple>

#include "host/render/options.h"
#include "pave/error.h"
#include "pave/render.h"
#include "pave/version.h"

namespace pave {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kPassSpp =
    256;  // samples of a pixel that are summed before passes are added (kernels/film.h)
constexpr double kLaunchSeconds =
    0.1;  // aimed at: short enough to cancel, long against what a launch costs
constexpr double kFirstGuess =
    1e6;  // paths a second and compute unit, until a launch has been measured
constexpr int kKeptFloats =
    32;  // a pixel's sums between passes; SUM_KEPT of kernels/film.h is less
constexpr size_t kLaunchesAhead = 2;  // in the queue, so that the device never waits for the host

double seconds_since(Clock::time_point begin) {
    return std::chrono::duration<double>(Clock::now() - begin).count();
}

/// Local size along a row. Where work-items are vectors one is a group of its own; else the driver
/// knows best.
cl::NDRange local_size(int wanted, int lanes, int global) {
    if (wanted == 0) return lanes == 1 ? cl::NullRange : cl::NDRange(1, 1);
    int size = std::clamp(wanted, 1, global);
    while (global % size != 0) --size;  // it must divide the global size
    return cl::NDRange(static_cast<size_t>(size), 1);
}

}  // namespace

class Renderer::Impl {
   public:
    Impl(const Device& device, const Scene& scene, const RendererPaths& paths)
        : device_(device),
          scene_(scene),
          turns_(paths.tree_turns),
          data_(build_scene_data(scene, paths)),
          tree_byte_size_(data_.tree.size() * sizeof(Row)) {
        tree_ = make_tree_buffer(device_, data_.tree);
        tables_ = make_buffer_of(device_, pack_tables(data_), "tables");
        light_cdf_ = make_buffer_of(device_, data_.light_cdf, "lights");
        dropped_ = make_buffer_of(device_, std::array<uint32_t, 1>{0}, "count of dropped samples");
        params_ = make_buffer(device_, sizeof(kernel::PathParams), "parameters", CL_MEM_READ_ONLY);
    }

    void render(const View& view, const RenderOptions& options, Frame& frame) {
        const Clock::time_point begin = Clock::now();
        if (!frame) throw UsageError("render needs a frame; acquire one of a stage or make one");
        check_options(view, options, device_.profile().max_work_group_size);
        Frame target = frame;
        if (slot_buffer_of(device_, frame)() == nullptr)
            target = make_frame(frame.schema(), device_);
        slot_to_device(device_, target);
        try {
            trace(view, options, target);
        } catch (...) {  // the caller keeps the frame and may look at it
            wait(slot_to_host(device_, target), "frame");
            throw;
        }
        wait(slot_to_host(device_, target), "frame");
        if (target.slot() != frame.slot()) copy_channels(target, frame);
        fill_metadata(view, options, frame.metadata());
        frame.metadata().seconds_spent = seconds_since(begin);
    }

    const Device& device() const { return device_; }
    const Scene& scene() const { return scene_; }
    const SceneData& data() const { return data_; }
    uint64_t dropped_samples() const { return dropped_samples_; }

   private:
    /// Program for these channels and lanes; built when first asked for.
    cl::Kernel& kernel_for(uint32_t channels, int lanes, Sampler sampler) {
        const auto key = std::tuple(channels, lanes, sampler);
        auto it = kernels_.find(key);
        if (it == kernels_.end()) {
            Defines defines =
                scene_defines(data_, device_.profile(), tree_byte_size_, turns_, lanes);
            defines.insert_or_assign("PAVE_CHANNELS", channels);
            defines.insert_or_assign("PAVE_SOBOL", sampler == Sampler::kSobol ? 1 : 0);
            defines.insert_or_assign("PAVE_SEGMENT", segment_of(1, lanes));
            const cl::Program program = build_program(device_, "path.cl", defines);
            it = kernels_.emplace(key, make_kernel(program, "render_paths")).first;
        }
        return it->second;
    }

    const cl::Buffer& shapes_for(int lanes) {
        auto it = shapes_.find(lanes);
        if (it == shapes_.end())
            it =
                shapes_.emplace(lanes, make_buffer_of(device_, pack_shapes(data_, lanes), "shapes"))
                    .first;
        return it->second;
    }

    void trace(const View& view, const RenderOptions& options, Frame& target) {
        const FrameSchema& schema = target.schema();
        const int lanes =
            options.lane_width != 0 ? options.lane_width : device_.profile().lane_width;
        cl::Kernel& kernel = kernel_for(channels_of(schema), lanes, options.sampler);
        const kernel::PathParams p = make_params(data_, scene_, view, options, schema, lanes);
        write_buffer(device_, params_, std::array{p}, "parameters");
        const cl::Buffer slot = slot_buffer_of(device_, target);
        const cl::Buffer& shapes = shapes_for(lanes);
        const int segments = (p.width + p.segment - 1) / p.segment;
        const cl::NDRange local = local_size(options.work_group_size, lanes, segments);
        Rows rows(*this, options, p);
        for (int row = 0, count = 0; row < p.height; row += count) {
            count = rows.next(p.height - row);
            const cl::Buffer& kept = kept_for(
                options.spp > kPassSpp ? static_cast<size_t>(count) * static_cast<size_t>(p.width)
                                       : 0);
            for (int sample = 0; sample < options.spp; sample += kPassSpp) {
                const int samples = std::min(kPassSpp, options.spp - sample);
                rows.launched(
                    launch(device_, kernel,
                           cl::NDRange(static_cast<size_t>(segments), static_cast<size_t>(count)),
                           local, params_, shapes, tree_, tables_, light_cdf_, slot, kept, dropped_,
                           row, sample, samples),
                    static_cast<double>(count) * p.width * samples);
            }
        }
        rows.finish();
        std::array<uint32_t, 1> dropped{};
        read_buffer(device_, dropped_, dropped, "count of dropped samples");
        dropped_samples_ += static_cast<uint32_t>(dropped[0] - last_dropped_);
        last_dropped_ = dropped[0];
    }

    /// Keeps a few launches ahead of the device, measures them and chooses how many rows the next
    /// one gets.
    class Rows {
       public:
        Rows(Impl& impl, const RenderOptions& options, const kernel::PathParams& p)
            : impl_(impl),
              options_(options),
              width_(p.width),
              all_(static_cast<double>(p.plane) * options.spp) {}
        ~Rows() {
            // Commands still in the queue use the frame: they must end before the caller gets it
            // back.
            try {
                for (const Launch& l : pending_) wait(l.event, "render");
            } catch (...) {
                // The error that unwinds is the one to report.
            }
        }
        Rows(const Rows&) = delete;
        Rows& operator=(const Rows&) = delete;

        int next(int left) const {
            if (options_.tile_rows > 0) return std::min(options_.tile_rows, left);
            const double paths_a_row =
                static_cast<double>(width_) * std::min(options_.spp, kPassSpp);
            const double rows = impl_.paths_a_second_ * kLaunchSeconds / paths_a_row;
            return std::clamp(static_cast<int>(std::min(rows, 16384.0)), 1, left);
        }
        void launched(cl::Event event, double paths) {
            cl_guard("render", [&] { queue_of(impl_.device_).flush(); });
            pending_.push_back({std::move(event), paths});
            while (pending_.size() > kLaunchesAhead) take_first();
        }
        void finish() {
            while (!pending_.empty()) take_first();
        }

       private:
        struct Launch {
            cl::Event event;
            double paths;
        };
        void take_first() {
            const Launch first = pending_.front();
            wait(first.event, "render");
            pending_.pop_front();
            const double spent = seconds_since(last_);
            last_ = Clock::now();
            done_ += first.paths;
            // The very first launch also compiles.
            if (measured_++ > 0 && spent > 0)
                impl_.paths_a_second_ = 0.5 * (impl_.paths_a_second_ + first.paths / spent);
            if (options_.progress && !options_.progress(done_ / all_))
                throw RunError("render cancelled");
        }

        Impl& impl_;
        const RenderOptions& options_;
        int width_;
        double all_, done_ = 0;
        int measured_ = 0;
        Clock::time_point last_ = Clock::now();
        std::deque<Launch> pending_;
    };

    const cl::Buffer& kept_for(size_t pixels) {
        if (kept_() == nullptr || kept_pixels_ < pixels) {
            kept_ =
                make_buffer(device_, pixels * kKeptFloats * sizeof(float), "sums between passes");
            kept_pixels_ = pixels;
        }
        return kept_;
    }

    void copy_channels(const Frame& from, Frame& to) const {
        for (const Channel& channel : from.schema().channels())
            if (is_rendered(channel.name)) {
                const std::span<const float> pixels = from.channel(channel.name);
                std::copy(pixels.begin(), pixels.end(), to.channel(channel.name).begin());
            }
    }

    void fill_metadata(const View& view, const RenderOptions& options, FrameMetadata& m) const {
        m.index = options.frame_index;
        m.view = view;
        m.spp = options.spp;
        m.max_depth = options.max_depth;
        m.rr_depth = options.rr_depth;
        m.seed = options.seed;
        m.scene = scene_.name;
        m.scene_hash = scene_.hash;
        m.device = device_.profile().name;
        m.driver = device_.profile().driver;
        m.kernel_hash = Device::kernel_hash();
        m.program_version = program_version();
        m.program_commit = program_commit();
        m.weights_version.clear();
    }

    Device device_;
    Scene scene_;
    TreeTurns turns_;
    SceneData data_;
    size_t tree_byte_size_;
    std::map<int, cl::Buffer> shapes_;  // by lanes
    cl::Buffer tree_, tables_, light_cdf_, dropped_, params_, kept_;
    size_t kept_pixels_ = 0;
    std::map<std::tuple<uint32_t, int, Sampler>, cl::Kernel> kernels_;
    double paths_a_second_ = kFirstGuess * std::max(device_.profile().compute_units, 1);
    uint64_t dropped_samples_ = 0;
    uint32_t last_dropped_ = 0;
};

Renderer::Renderer(const Device& device, const Scene& scene, const RendererPaths& paths)
    : impl_(std::make_unique<Impl>(device, scene, paths)) {}
Renderer::~Renderer() = default;
Renderer::Renderer(Renderer&&) noexcept = default;
Renderer& Renderer::operator=(Renderer&&) noexcept = default;

const Scene& Renderer::scene() const { return impl_->scene(); }
const Device& Renderer::device() const { return impl_->device(); }
void Renderer::render(const View& view, const RenderOptions& options, Frame& frame) {
    impl_->render(view, options, frame);
}
uint64_t Renderer::dropped_samples() const { return impl_->dropped_samples(); }
int Renderer::dropped_triangles() const { return impl_->data().dropped_triangles; }

}  // namespace pave
