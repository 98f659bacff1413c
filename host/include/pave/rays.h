// Ray queries against a scene on one device: closest hits and occlusion of many rays at once.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>

#include "pave/device.h"
#include "pave/render.h"
#include "pave/scene.h"

namespace pave {

/// origin + t * direction for 0 < t < t_max; the direction need not be of unit length, and t counts
/// in its lengths. A ray with a number that is not finite (t_max may be infinite), without a
/// direction or with t_max <= 0 meets nothing.
struct Ray {
    float origin[3] = {0, 0, 0};
    float t_max = std::numeric_limits<float>::infinity();
    float direction[3] = {0, 0, 1};
    float spare = 0;  // not read
};

/// What a ray meets first. Triangles are two-sided here, whatever their material.
struct Hit {
    float t = std::numeric_limits<float>::infinity();  // infinite: nothing
    int32_t shape = -1;                                // into Scene::shapes; -1: nothing
    int32_t part = -1;       // of an instance: into its group's shapes; else -1
    int32_t primitive = -1;  // triangle of a mesh as the scene has them, face of a cube (low x,
                             // high x, low y, high y, low z, high z), else 0
    float b1 = 0, b2 = 0;    // weights of a triangle's second and third vertex
};

struct RayTracerOptions {
    int lane_width = 0;              // 1, 4, 8, 16: forces kernels of that width; 0 chooses
    int broadcast_shapes = 64;       // as RendererPaths::broadcast_shapes
    int copied_triangles = 1 << 18;  // as RendererPaths::copied_triangles
    TreeTurns tree_turns = TreeTurns::kAuto;
    bool specialise = true;  // as RendererPaths::specialise
    int segment = 0;         // rays a work-item, a multiple of the lanes; 0 chooses. Changes no
                             // result.
};

/// A scene on a device, for ray queries. Keeps no reference to the scene. One call at a time per
/// object; distinct objects are independent. Results do not depend on segments or threads,
/// and on lanes by a rounding at most, but for ties: of several hits at exactly the same t any one
/// may be named.
class RayTracer {
   public:
    /// Blocks until the scene is on the device. Throws InputError, naming the shape, for a scene
    /// that cannot be traced, UsageError for options out of range, DeviceError from OpenCL.
    RayTracer(const Device& device, const Scene& scene, const RayTracerOptions& options = {});
    ~RayTracer();
    RayTracer(RayTracer&&) noexcept;
    RayTracer& operator=(RayTracer&&) noexcept;

    const Device& device() const;
    /// Triangles without an area or with coordinates that are not finite: no ray meets them.
    int dropped_triangles() const;

    /// hits[i] is the first thing that rays[i] meets. Blocks. On devices that share the host's
    /// memory the kernels read and write the spans themselves; on others they get a copy. Throws
    /// UsageError if the spans differ in length, DeviceError from OpenCL.
    void trace_closest(std::span<const Ray> rays, std::span<Hit> hits);
    /// occluded[i] is 1 if rays[i] meets anything, else 0. As trace_closest otherwise.
    void trace_any(std::span<const Ray> rays, std::span<uint8_t> occluded);

    /// The same over OpenCL buffers (cl_mem of the device's context, borrowed until the work is
    /// done), records as Ray, Hit and uint8_t. Enqueues on the device's queue and returns: wait by
    /// the queue. Throws UsageError for a null or too small buffer or one of another context.
    void enqueue_closest(void* rays, void* hits, size_t count);
    void enqueue_any(void* rays, void* occluded, size_t count);

   private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace pave
