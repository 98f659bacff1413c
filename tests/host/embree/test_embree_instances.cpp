// Hits in instances against Embree's: distance, instance, part, triangle and place on it.
// SPDX-License-Identifier: BSD-3-Clause
#include <embree3/rtcore.h>

#include <algorithm>
#include <limits>
#include <random>

#include "pave/rays.h"
#include "tests/host/render/support.h"

namespace pave::test {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

/// The scene's groups and instances in Embree, with its robust flag; of meshes alone.
class EmbreeInstances {
   public:
    explicit EmbreeInstances(const Scene& scene)
        : device_(rtcNewDevice("threads=1")), scene_(rtcNewScene(device_)) {
        rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
        for (const ShapeGroup& group : scene.groups) {
            groups_.push_back(rtcNewScene(device_));
            rtcSetSceneFlags(groups_.back(), RTC_SCENE_FLAG_ROBUST);
            for (const Shape& part : group.shapes) add_mesh(groups_.back(), part.mesh);
            rtcCommitScene(groups_.back());
        }
        for (const Shape& shape : scene.shapes) {
            RTCGeometry instance = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_INSTANCE);
            rtcSetGeometryInstancedScene(instance, groups_[static_cast<size_t>(shape.group)]);
            rtcSetGeometryTransform(instance, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR,
                                    shape.world_from_object.data());
            rtcCommitGeometry(instance);
            rtcAttachGeometry(scene_, instance);
            rtcReleaseGeometry(instance);
        }
        rtcCommitScene(scene_);
    }
    ~EmbreeInstances() {
        rtcReleaseScene(scene_);
        for (RTCScene group : groups_) rtcReleaseScene(group);
        rtcReleaseDevice(device_);
    }
    EmbreeInstances(const EmbreeInstances&) = delete;
    EmbreeInstances& operator=(const EmbreeInstances&) = delete;

    Hit closest(const Ray& ray) const {
        RTCRayHit r{};
        r.ray.org_x = ray.origin[0], r.ray.org_y = ray.origin[1], r.ray.org_z = ray.origin[2];
        r.ray.dir_x = ray.direction[0], r.ray.dir_y = ray.direction[1];
        r.ray.dir_z = ray.direction[2];
        r.ray.tfar = ray.t_max;
        r.ray.mask = ~0u;
        r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        rtcIntersect1(scene_, &context, &r);
        if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return {};
        return {.t = r.ray.tfar,
                .shape = static_cast<int32_t>(r.hit.instID[0]),
                .part = static_cast<int32_t>(r.hit.geomID),
                .primitive = static_cast<int32_t>(r.hit.primID),
                .b1 = r.hit.u,
                .b2 = r.hit.v};
    }

   private:
    void add_mesh(RTCScene to, const Mesh& mesh) {
        RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
        auto* positions = static_cast<std::array<float, 3>*>(rtcSetNewGeometryBuffer(
            geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, mesh.positions.size()));
        std::copy(mesh.positions.begin(), mesh.positions.end(), positions);
        auto* triangles = static_cast<std::array<uint32_t, 3>*>(rtcSetNewGeometryBuffer(
            geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, mesh.triangles.size()));
        std::copy(mesh.triangles.begin(), mesh.triangles.end(), triangles);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(to, geometry);
        rtcReleaseGeometry(geometry);
    }

    RTCDevice device_;
    RTCScene scene_;
    std::vector<RTCScene> groups_;
};

/// Meshes of several kinds, placed at random: turned, stretched, sheared, mirrored, and into each
/// other.
Scene crowd(int instances, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<float> unit(-1, 1);
    Scene scene;
    const int grey = add_diffuse(scene, {0.5f, 0.5f, 0.5f});
    add_group(scene, {mesh_shape(sphere_mesh(20, {0.1f, 0, 0}, 0.7f, false), grey),
                      mesh_shape(random_triangles(300, 0.3f, 4), grey)});
    add_group(scene, {mesh_shape(random_triangles(5, 0.9f, 2), grey)});
    add_group(scene, {mesh_shape(sphere_mesh(60, {0, 0, 0}, 1, false), grey),
                      mesh_shape(sphere_mesh(50, {0, 0, 0}, 0.99f, false), grey)});
    for (int i = 0; i < instances; ++i) {
        Matrix4 m = translate(unit(rng), unit(rng), unit(rng)) * rotate(0, 180 * unit(rng)) *
                    rotate(1, 180 * unit(rng)) * scale(0.1f + 0.1f * unit(rng));
        if (i % 3 > 0) m = m * scale(1, 2 + unit(rng), 0.2f) * rotate(2, 180 * unit(rng));
        if (i % 4 > 1) m = m * scale(-1, 1.5f, 1);
        add_instance(scene, i % 3, m);
    }
    return scene;
}

TEST(EmbreeAgrees, OnInstances) {
    for (int instances : {1, 8, 9, 400}) {
        const Scene scene = crowd(instances, 91);
        const EmbreeInstances embree(scene);
        std::mt19937 rng(92);
        std::normal_distribution<float> normal;
        std::uniform_real_distribution<float> unit(-1.2f, 1.2f);
        std::vector<Ray> rays(20000);
        for (size_t i = 0; i < rays.size(); ++i)
            for (size_t k = 0; k < 3; ++k) {
                rays[i].origin[k] = unit(rng);
                rays[i].direction[k] = i % 8 == 1 && k != i / 8 % 3 ? 0 : normal(rng);
                if (i % 2 == 0)  // towards an instance
                    rays[i].direction[k] =
                        scene.shapes[i % scene.shapes.size()].world_from_object[4 * k + 3] +
                        0.1f * normal(rng) - rays[i].origin[k];
            }
        std::vector<Hit> hits(rays.size());
        std::vector<uint8_t> occluded(rays.size());
        RayTracer tracer(device(), scene, {.copied_triangles = -1});
        tracer.trace_closest(rays, hits);
        tracer.trace_any(rays, occluded);
        size_t found = 0, other_t = 0, other_triangle = 0;
        for (size_t i = 0; i < rays.size(); ++i) {
            const Hit expected = embree.closest(rays[i]);
            found += expected.shape >= 0;
            ASSERT_EQ(occluded[i], hits[i].shape >= 0 ? 1 : 0) << "ray " << i;
            if (std::abs(hits[i].t - expected.t) > 1e-4f * (1 + expected.t) ||
                (hits[i].shape >= 0) != (expected.shape >= 0)) {
                ++other_t;
                continue;
            }
            if (expected.shape < 0) continue;
            if (hits[i].shape != expected.shape || hits[i].part != expected.part ||
                hits[i].primitive != expected.primitive) {
                ++other_triangle;
                continue;
            }
            EXPECT_NEAR(hits[i].b1, expected.b1, 2e-3f) << "ray " << i;
            EXPECT_NEAR(hits[i].b2, expected.b2, 2e-3f) << "ray " << i;
        }
        EXPECT_GT(found, 500u) << instances;
        // An edge that a rounding decides, here or there; the neighbour across an edge.
        EXPECT_LE(other_t, 4u) << instances << " instances";
        EXPECT_LE(other_triangle, rays.size() / 1000) << instances << " instances";
    }
}

}  // namespace
}  // namespace pave::test
