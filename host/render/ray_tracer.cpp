// RayTracer: uploads a scene once and launches the kernels of rays.cl over spans or buffers.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <bit>
#include <cstddef>
#include <string>
#include <vector>

#include "host/device/impl.h"
#include "host/render/options.h"
#include "kernels/ray_types.h"
#include "pave/rays.h"

namespace pave {
namespace {

static_assert(sizeof(Ray) == sizeof(kernel::RayRecord));
static_assert(offsetof(Ray, t_max) == offsetof(kernel::RayRecord, t_max));
static_assert(offsetof(Ray, direction) == offsetof(kernel::RayRecord, direction));
static_assert(sizeof(Hit) == sizeof(kernel::HitRecord));
static_assert(offsetof(Hit, part) == offsetof(kernel::HitRecord, part));
static_assert(offsetof(Hit, b1) == offsetof(kernel::HitRecord, b1));

constexpr size_t kRaysALaunch = size_t{1} << 22;  // about a second: the queue is not blocked longer
constexpr int kSegment = 128;  // rays a work-item with vectors: 10 to 50 us on a CPU core
constexpr int kMaxSegment = 1 << 16;
constexpr size_t kPointerAlignment = 4;  // kernels read and write single numbers

RendererPaths paths_of(const RayTracerOptions& options) {
    // Queries are no shadow rays: nothing can be left out.
    return {.broadcast_shapes = options.broadcast_shapes,
            .cull_occluders = false,
            .recognise_shapes = false,  // hits name the mesh's own triangles
            .copied_triangles = options.copied_triangles,
            .specialise = options.specialise};
}

int lanes_of(const Device& device, const RayTracerOptions& options) {
    const int lanes = options.lane_width;
    if (lanes != 0 && lanes != 1 && lanes != 4 && lanes != 8 && lanes != 16)
        throw UsageError("lane_width " + std::to_string(lanes) + " is outside 0, 1, 4, 8, 16");
    return lanes != 0 ? lanes : device.profile().lane_width;
}

int segment_for(const RayTracerOptions& options, int lanes) {
    if (options.segment == 0) return lanes == 1 ? 1 : kSegment;
    if (options.segment < 1 || options.segment > kMaxSegment || options.segment % lanes != 0)
        throw UsageError("segment " + std::to_string(options.segment) + " is outside " +
                         std::to_string(lanes) + ".." + std::to_string(kMaxSegment) +
                         " or no multiple of the lanes");
    return options.segment;
}

/// Where ids change their shape, or skip a dropped triangle.
std::vector<kernel::IdRun> id_runs(const SceneData& data) {
    std::vector<kernel::IdRun> runs;
    for (int id = 0; id < data.surface_count; ++id) {
        const auto row = static_cast<size_t>(id) * SURFACE_ROWS + 1;
        const int shape = std::bit_cast<int32_t>(data.surfaces[row][4]),
                  part = std::bit_cast<int32_t>(data.surfaces[row][5]);
        if (runs.empty() || runs.back().shape != shape || runs.back().part != part)
            runs.push_back({id, shape, part, 0});
    }
    for (const TriangleRun& run : data.triangle_runs)
        runs.push_back({data.surface_count + static_cast<int>(run.first), run.shape, run.part,
                        static_cast<int>(run.primitive)});
    if (runs.empty()) runs.push_back({});  // OpenCL knows no empty buffers
    return runs;
}

}  // namespace

class RayTracer::Impl {
   public:
    Impl(const Device& device, const Scene& scene, const RayTracerOptions& options)
        : device_(device),
          lanes_(lanes_of(device, options)),
          segment_(segment_for(options, lanes_)) {
        SceneData data = build_scene_data(scene, paths_of(options), false);
        dropped_triangles_ = data.dropped_triangles;
        tree_rows_ = std::move(data.tree);
        const size_t tree_byte_size = tree_rows_.size() * sizeof(Row);
        tree_ = make_tree_buffer(device_, tree_rows_);
        shapes_ = make_buffer_of(device_, pack_shapes(data, lanes_), "shapes");
        const std::vector<kernel::IdRun> runs = id_runs(data);
        run_count_ = static_cast<cl_int>(runs.size());
        runs_ = make_buffer_of(device_, runs, "shape ids");
        kernel::PathParams p{};
        set_scene_params(p, data, lanes_);
        params_ = make_buffer_of(device_, std::array{p}, "parameters");
        const cl::Program program = build_program(
            device_, "rays.cl",
            scene_defines(data, device_.profile(), tree_byte_size, options.tree_turns, lanes_));
        closest_ = make_kernel(program, "trace_closest_rays");
        any_ = make_kernel(program, "trace_any_rays");
    }

    const Device& device() const { return device_; }
    int dropped_triangles() const { return dropped_triangles_; }

    void enqueue_closest(const cl::Buffer& rays, const cl::Buffer& hits, size_t count) {
        for_parts(count, [&](cl_ulong first, cl_int part, const cl::NDRange& items) {
            last_ = launch(device_, closest_, items, local(), params_, shapes_, tree_, runs_,
                           run_count_, rays, hits, first, part, segment_);
        });
    }
    void enqueue_any(const cl::Buffer& rays, const cl::Buffer& occluded, size_t count) {
        for_parts(count, [&](cl_ulong first, cl_int part, const cl::NDRange& items) {
            last_ = launch(device_, any_, items, local(), params_, shapes_, tree_, rays, occluded,
                           first, part, segment_);
        });
    }

    template <class Result, class Enqueue>
    void trace(std::span<const Ray> rays, std::span<Result> results, Enqueue enqueue) {
        if (rays.size() != results.size())
            throw UsageError(std::to_string(rays.size()) + " rays and room for " +
                             std::to_string(results.size()) + " results");
        if (rays.empty()) return;
        if (is_shared(rays.data()) && is_shared(results.data())) {
            // The kernels only read the rays; OpenCL has no pointer to const for that.
            const cl::Buffer in = over(const_cast<Ray*>(rays.data()), rays.size_bytes(), "rays");
            const cl::Buffer out = over(results.data(), results.size_bytes(), "results of rays");
            // The spans are the caller's again when this returns, by an error too.
            try {
                enqueue(in, out, rays.size());
            } catch (...) {
                finish(device_, "rays");
                throw;
            }
            wait(last_, "rays");
            return;
        }
        const cl::Buffer in = make_buffer_of(device_, rays, "rays");
        const cl::Buffer out = make_buffer(device_, results.size_bytes(), "results of rays");
        enqueue(in, out, rays.size());
        read_buffer(device_, out, results, "results of rays");
    }

    /// The caller's buffer, if it belongs to the device's context and holds `byte_size`.
    cl::Buffer checked(void* handle, size_t byte_size, const char* what) const {
        if (handle == nullptr) throw UsageError(std::string(what) + ": the buffer is null");
        cl::Buffer buffer(static_cast<cl_mem>(handle), true);
        const auto [context, held] = cl_guard(what, [&] {
            return std::pair(buffer.getInfo<CL_MEM_CONTEXT>(), buffer.getInfo<CL_MEM_SIZE>());
        });
        if (context() != context_of(device_)())
            throw UsageError(std::string(what) + ": the buffer is of another context");
        if (held < byte_size)
            throw UsageError(std::string(what) + ": the buffer holds " + std::to_string(held) +
                             " bytes, " + std::to_string(byte_size) + " are needed");
        return buffer;
    }

   private:
    cl::NDRange local() const { return lanes_ == 1 ? cl::NullRange : cl::NDRange(1); }

    template <class Launch>
    void for_parts(size_t count, Launch launch_part) {
        const auto segment = static_cast<size_t>(segment_);
        for (size_t first = 0; first < count; first += kRaysALaunch) {
            const size_t part = std::min(kRaysALaunch, count - first);
            size_t items = (part + segment - 1) / segment;
            if (lanes_ == 1) items = (items + 63) / 64 * 64;  // a size that drivers can divide
            launch_part(static_cast<cl_ulong>(first), static_cast<cl_int>(part),
                        cl::NDRange(items));
        }
        cl_guard("rays", [&] { queue_of(device_).flush(); });
    }

    bool is_shared(const void* data) const {
        return device_.impl().slot_access() == SlotAccess::kShared &&
               reinterpret_cast<uintptr_t>(data) % kPointerAlignment == 0;
    }
    cl::Buffer over(void* data, size_t byte_size, const char* what) const {
        return cl_guard(what, [&] {
            return cl::Buffer(context_of(device_), CL_MEM_READ_WRITE | CL_MEM_USE_HOST_PTR,
                              byte_size, data);
        });
    }

    Device device_;
    cl_int lanes_, segment_, run_count_ = 0;
    int dropped_triangles_ = 0;
    Block<Row> tree_rows_;  // under tree_, or empty
    cl::Buffer tree_, shapes_, runs_, params_;
    cl::Kernel closest_, any_;
    cl::Event last_;
};

RayTracer::RayTracer(const Device& device, const Scene& scene, const RayTracerOptions& options)
    : impl_(std::make_unique<Impl>(device, scene, options)) {}
RayTracer::~RayTracer() = default;
RayTracer::RayTracer(RayTracer&&) noexcept = default;
RayTracer& RayTracer::operator=(RayTracer&&) noexcept = default;

const Device& RayTracer::device() const { return impl_->device(); }
int RayTracer::dropped_triangles() const { return impl_->dropped_triangles(); }

void RayTracer::trace_closest(std::span<const Ray> rays, std::span<Hit> hits) {
    impl_->trace(rays, hits,
                 [&](const auto&... arguments) { impl_->enqueue_closest(arguments...); });
}
void RayTracer::trace_any(std::span<const Ray> rays, std::span<uint8_t> occluded) {
    impl_->trace(rays, occluded,
                 [&](const auto&... arguments) { impl_->enqueue_any(arguments...); });
}
void RayTracer::enqueue_closest(void* rays, void* hits, size_t count) {
    if (count == 0) return;
    impl_->enqueue_closest(impl_->checked(rays, count * sizeof(Ray), "rays"),
                           impl_->checked(hits, count * sizeof(Hit), "hits"), count);
}
void RayTracer::enqueue_any(void* rays, void* occluded, size_t count) {
    if (count == 0) return;
    impl_->enqueue_any(impl_->checked(rays, count * sizeof(Ray), "rays"),
                       impl_->checked(occluded, count, "occluded"), count);
}

}  // namespace pave
