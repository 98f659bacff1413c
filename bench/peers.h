// Embree as the bench programs run it: single rays, on as many threads as the device has compute
// units.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <embree3/rtcore.h>

#include <span>

#include "pave/rays.h"
#include "pave/scene.h"

namespace pave::bench {

/// RTC_BUILD_QUALITY_MEDIUM (binned SAH) and no scene flag, which are Embree's defaults: so neither
/// robust nor compact. Embree builds with as many threads as it is given here.
/// Borrows the mesh, whose last vertex belongs to no triangle (bench/meshes.h makes such).
class EmbreeScene {
   public:
    EmbreeScene(const Mesh& mesh, int threads);
    ~EmbreeScene();
    EmbreeScene(const EmbreeScene&) = delete;
    EmbreeScene& operator=(const EmbreeScene&) = delete;

    /// rtcIntersect1 of every ray; hits as PAVE has them.
    void trace_closest(std::span<const Ray> rays, std::span<Hit> hits) const;
    /// rtcOccluded1 of every ray.
    void trace_any(std::span<const Ray> rays, std::span<uint8_t> occluded) const;

   private:
    int threads_;
    RTCDevice device_;
    RTCScene scene_;
};

}  // namespace pave::bench
