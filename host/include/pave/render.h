// The path tracer on one device: renders every channel of a view in one pass, straight into a
// frame's slot.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <functional>
#include <memory>

#include "pave/device.h"
#include "pave/scene.h"

namespace pave {

/// Where a path's numbers come from.
enum class Sampler {
    kSobol,  // stratified over a pixel's samples at the first two vertices, independent beyond
    kIndependent,  // all independent: more noise, but `variance` is then exactly its measure
};

struct RenderOptions {
    int spp = 16;        // samples a pixel, 1..2^24
    int max_depth = 50;  // edges of the longest path, as Mitsuba: 1 = emission seen, 2 = one
                         // scattering event, ...
    int rr_depth = 5;    // Russian roulette from this depth on; >= max_depth switches it off
    Sampler sampler = Sampler::kSobol;
    uint64_t seed = 0;
    int64_t frame_index = 0;  // part of the random numbers' key, 0..2^32-1
    // Schedule: none of these changes a single bit of the result.
    int tile_rows = 0;        // rows a launch; 0 chooses
    int work_group_size = 0;  // local size, along a row; 0 chooses
    // Forced paths, for tests: 0 chooses.
    int lane_width = 0;  // 1, 4, 8, 16
    std::function<bool(double done)>
        progress{};  // called between launches with the fraction done; false cancels (RunError)
};

/// Whether rays that pass the tree one by one take turns, so that the memory of one is read while
/// others are tested: on CPUs, kAuto does where the tree is larger than the device's cache.
enum class TreeTurns { kAuto, kNever, kAlways };

/// Which way a scene takes through the kernels. The defaults are the fast ones; tests force the
/// others.
struct RendererPaths {
    int broadcast_shapes = 64;   // up to this many analytic shapes are tested one after the other;
                                 // more go into the tree
    bool cull_occluders = true;  // shapes on the scene's hull are left out of shadow tests
    bool recognise_shapes = true;  // meshes made of rectangles and boxes are traced as such
    TreeTurns tree_turns = TreeTurns::kAuto;
    // Groups are copied to the places of their instances, the smallest first, as long as the copies
    // have no more triangles than this in all, and always where they are placed once: such a scene
    // is traced 1.3 to 2.5 times as fast. -1: none is.
    int copied_triangles = 1 << 18;
    bool specialise = true;  // programs for this scene's features only, not for any scene
};

/// Scene data on one device and the programs specialised for it. One render at a time per renderer;
/// distinct renderers are independent. render() blocks until the frame is complete.
class Renderer {
   public:
    /// Throws InputError, naming the shape, for a scene that can not be rendered.
    Renderer(const Device& device, const Scene& scene, const RendererPaths& paths = {});
    ~Renderer();
    Renderer(Renderer&&) noexcept;
    Renderer& operator=(Renderer&&) noexcept;

    const Scene& scene() const;
    const Device& device() const;

    /// Fills every channel of `frame` that the path tracer knows (color, albedo, direct, normal,
    /// depth, distance, variance, position, object; others are left alone) and its metadata. Frames
    /// of this device are written in place; other frames get a copy. Throws UsageError for options
    /// out of range, DeviceError from OpenCL.
    void render(const View& view, const RenderOptions& options, Frame& frame);

    /// Samples of all renders so far that met radiance that is not finite: it was left out and the
    /// path ended there. 0 unless
    /// the scene holds absurd numbers or PAVE has a bug.
    uint64_t dropped_samples() const;
    /// Triangles without an area or with coordinates that are not finite, which were left out.
    int dropped_triangles() const;

   private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace pave
