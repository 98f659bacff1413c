// Embree scenes and loops of single rays over threads.
// SPDX-License-Identifier: BSD-3-Clause
#include "bench/peers.h"

#include <algorithm>
#include <atomic>
#include <functional>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include "bench/report.h"

namespace pave::bench {
namespace {

constexpr size_t kChunk = 4096;  // rays that a thread takes at once

/// Calls work(first, last) for parts of [0, count) on `threads` threads.
void in_parallel(int threads, size_t count, const std::function<void(size_t, size_t)>& work) {
    std::atomic<size_t> next{0};
    std::vector<std::thread> others;
    const auto take = [&] {
        for (size_t first; (first = next.fetch_add(kChunk)) < count;)
            work(first, std::min(first + kChunk, count));
    };
    for (int i = 1; i < threads; ++i) others.emplace_back(take);
    take();
    for (std::thread& thread : others) thread.join();
}

RTCRay ray_of(const Ray& ray) {
    RTCRay r;
    r.org_x = ray.origin[0], r.org_y = ray.origin[1], r.org_z = ray.origin[2];
    r.dir_x = ray.direction[0], r.dir_y = ray.direction[1], r.dir_z = ray.direction[2];
    r.tnear = 0;
    r.tfar = ray.t_max;
    r.time = 0;
    r.mask = ~0u;
    r.id = r.flags = 0;
    return r;
}

}  // namespace

EmbreeScene::EmbreeScene(const Mesh& mesh, int threads) : threads_(threads) {
    device_ = rtcNewDevice(("threads=" + std::to_string(threads)).c_str());
    if (device_ == nullptr) fail("Embree does not start");
    scene_ = rtcNewScene(device_);
    rtcSetSceneBuildQuality(scene_, RTC_BUILD_QUALITY_MEDIUM);
    RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    // The caller's own memory, not a copy. Embree reads a little past the last vertex that it is
    // told of: the mesh's spare one.
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                               mesh.positions.data(), 0, sizeof mesh.positions[0],
                               mesh.positions.size() - 1);
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                               mesh.triangles.data(), 0, sizeof mesh.triangles[0],
                               mesh.triangles.size());
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene_, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene_);
}

EmbreeScene::~EmbreeScene() {
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
}

void EmbreeScene::trace_closest(std::span<const Ray> rays, std::span<Hit> hits) const {
    in_parallel(threads_, rays.size(), [&](size_t first, size_t last) {
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        for (size_t i = first; i < last; ++i) {
            RTCRayHit r;
            r.ray = ray_of(rays[i]);
            r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
            rtcIntersect1(scene_, &context, &r);
            Hit& hit = hits[i];
            hit = {};
            if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) continue;
            hit.t = r.ray.tfar;
            hit.shape = static_cast<int32_t>(r.hit.geomID);
            hit.primitive = static_cast<int32_t>(r.hit.primID);
            hit.b1 = r.hit.u;
            hit.b2 = r.hit.v;
        }
    });
}

void EmbreeScene::trace_any(std::span<const Ray> rays, std::span<uint8_t> occluded) const {
    in_parallel(threads_, rays.size(), [&](size_t first, size_t last) {
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        for (size_t i = first; i < last; ++i) {
            RTCRay r = ray_of(rays[i]);
            rtcOccluded1(scene_, &context, &r);
            occluded[i] = r.tfar < 0;
        }
    });
}

}  // namespace pave::bench
