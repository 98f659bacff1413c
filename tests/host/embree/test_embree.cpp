// Hits against Embree and brute force in double; ten million rays in a closed mesh far away.
// SPDX-License-Identifier: BSD-3-Clause
#include <embree3/rtcore.h>

#include <algorithm>
#include <limits>
#include <random>

#include "host/render/double3.h"
#include "pave/rays.h"
#include "tests/host/render/support.h"

namespace pave::test {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct MeshCase {
    const char* name;
    Mesh mesh;
};

Mesh moved(Mesh mesh, float scale, std::array<float, 3> by) {
    for (auto& p : mesh.positions)
        for (size_t k = 0; k < 3; ++k) p[k] = p[k] * scale + by[k];
    return mesh;
}

/// A height field of side x side quads with long, thin triangles.
Mesh terrain(uint32_t side, float stretch) {
    Mesh mesh;
    for (uint32_t y = 0; y <= side; ++y)
        for (uint32_t x = 0; x <= side; ++x) {
            const float u = 2.0f * static_cast<float>(x) / static_cast<float>(side) - 1;
            const float v = 2.0f * static_cast<float>(y) / static_cast<float>(side) - 1;
            mesh.positions.push_back({u * stretch, 0.2f * std::sin(9 * u) * std::cos(7 * v), v});
        }
    for (uint32_t y = 0; y < side; ++y)
        for (uint32_t x = 0; x < side; ++x) {
            const uint32_t a = y * (side + 1) + x, b = a + 1, c = a + side + 1, d = c + 1;
            mesh.triangles.push_back({a, b, c});
            mesh.triangles.push_back({b, d, c});
        }
    return mesh;
}

Mesh joined(Mesh a, const Mesh& b) {
    const auto first = static_cast<uint32_t>(a.positions.size());
    a.positions.insert(a.positions.end(), b.positions.begin(), b.positions.end());
    for (const auto& t : b.triangles)
        a.triangles.push_back({first + t[0], first + t[1], first + t[2]});
    return a;
}

/// Triangles without an area, with NaN and infinite corners, among sound ones.
Mesh degenerate() {
    Mesh mesh = random_triangles(500, 0.2f, 7);
    mesh.positions.push_back({std::nanf(""), 0, 0});
    mesh.positions.push_back({static_cast<float>(kInfinity), 0, 0});
    const auto n = static_cast<uint32_t>(mesh.positions.size());
    for (uint32_t i = 0; i < 30; i += 3) {
        mesh.triangles.push_back({i, i, i + 1});
        mesh.triangles.push_back({i, i + 1, n - 1});
        mesh.triangles.push_back({i, i + 1, n - 2});
    }
    return mesh;
}

std::vector<MeshCase> mesh_cases() {
    const Mesh sphere = sphere_mesh(40, {0.1f, 0, 0}, 0.7f, false);
    return {{"one", random_triangles(1, 1.0f, 1)},
            {"eight", random_triangles(8, 0.9f, 2)},
            {"nine", random_triangles(9, 0.8f, 3)},
            {"sparse", random_triangles(300, 0.3f, 4)},
            {"crossing", random_triangles(700, 1.0f, 5)},
            {"dense", random_triangles(3000, 0.05f, 6)},
            {"degenerate", degenerate()},
            {"sphere", sphere},
            {"shells", joined(sphere, sphere_mesh(30, {0.1f, 0, 0}, 0.69f, false))},
            {"twice", joined(sphere, sphere)},
            {"terrain", terrain(40, 1.0f)},
            {"needles", terrain(40, 50.0f)},
            {"tiny", moved(sphere, 1e-3f, {0, 0, 0})},
            {"far", moved(sphere, 1.0f, {300, -200, 100})}};
}

/// The mesh in Embree with its robust flag; triangles that PAVE drops are of no consequence there.
class Embree {
   public:
    explicit Embree(const Mesh& mesh)
        : device_(rtcNewDevice("threads=1")), scene_(rtcNewScene(device_)) {
        rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
        RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
        auto* positions = static_cast<std::array<float, 3>*>(rtcSetNewGeometryBuffer(
            geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, mesh.positions.size()));
        std::copy(mesh.positions.begin(), mesh.positions.end(), positions);
        auto* triangles = static_cast<std::array<uint32_t, 3>*>(rtcSetNewGeometryBuffer(
            geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, mesh.triangles.size()));
        std::copy(mesh.triangles.begin(), mesh.triangles.end(), triangles);
        rtcCommitGeometry(geometry);
        rtcAttachGeometry(scene_, geometry);
        rtcReleaseGeometry(geometry);
        rtcCommitScene(scene_);
    }
    ~Embree() {
        rtcReleaseScene(scene_);
        rtcReleaseDevice(device_);
    }
    Embree(const Embree&) = delete;
    Embree& operator=(const Embree&) = delete;

    double closest(const Ray& ray) const {
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
        return r.hit.geomID == RTC_INVALID_GEOMETRY_ID ? kInfinity : r.ray.tfar;
    }

   private:
    RTCDevice device_;
    RTCScene scene_;
};

Double3 point_of(const float* p) { return {p[0], p[1], p[2]}; }

/// Distance to the closest triangle in double, and how near an edge it is hit: what is nearer than
/// float32 can tell may be missed or hit. Moeller and Trumbore 1997.
struct BruteHit {
    double t = kInfinity;
    double edge = 1;  // least barycentric coordinate, also of near misses
};
BruteHit brute_force(const Mesh& mesh, const Ray& ray) {
    BruteHit hit;
    const Double3 o = point_of(ray.origin), d = point_of(ray.direction);
    for (const auto& triangle : mesh.triangles) {
        const Double3 a = to_double3(mesh.positions[triangle[0]]),
                      e1 = to_double3(mesh.positions[triangle[1]]) - a,
                      e2 = to_double3(mesh.positions[triangle[2]]) - a;
        const Double3 h = cross(d, e2), s = o - a, q = cross(s, e1);
        const double det = dot(e1, h);
        if (det == 0 || !std::isfinite(det)) continue;
        const double u = dot(s, h) / det, v = dot(d, q) / det, t = dot(e2, q) / det;
        const double edge = std::min({u, v, 1 - u - v});
        if (!(t > 0) || t > hit.t) continue;
        if (edge > -1e-3) hit.edge = std::min(hit.edge, std::abs(edge));
        if (edge >= 0) hit.t = t;
    }
    return hit;
}

std::vector<Ray> rays_at(const Mesh& mesh, size_t count, uint32_t seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<float> normal;
    std::uniform_real_distribution<float> unit(0, 1);
    std::uniform_int_distribution<size_t> pick(0, mesh.triangles.size() - 1);
    std::array<float, 3> low, high;
    low.fill(1e30f), high.fill(-1e30f);
    for (const auto& p : mesh.positions)
        for (size_t k = 0; k < 3 && std::isfinite(p[0]); ++k)
            low[k] = std::min(low[k], p[k]), high[k] = std::max(high[k], p[k]);
    std::vector<Ray> rays(count);
    for (size_t i = 0; i < count; ++i) {
        Ray& ray = rays[i];
        const auto& t = mesh.triangles[pick(rng)];
        for (size_t k = 0; k < 3; ++k) {
            ray.origin[k] = low[k] + (high[k] - low[k]) * (1.6f * unit(rng) - 0.3f);
            ray.direction[k] = normal(rng);
            if (i % 2 == 0) ray.direction[k] = mesh.positions[t[0]][k] - ray.origin[k];
        }
        for (size_t k = 0; k < 3; ++k)  // along axes and planes too
            if (i % 8 == 1 && k != i / 8 % 3) ray.direction[k] = 0;
        if (!std::isfinite(ray.direction[0])) ray.direction[0] = 1;
    }
    return rays;
}

TEST(EmbreeAgrees, OnMeshesOfAllKinds) {
    TreeTurns turns = TreeTurns::kAuto;
    for (const MeshCase& c : mesh_cases()) {
        Scene scene;
        add_mesh(scene, c.mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
        turns = turns == TreeTurns::kAlways ? TreeTurns::kNever : TreeTurns::kAlways;
        RayTracer tracer(device(), scene, {.tree_turns = turns});
        const Embree embree(c.mesh);
        const std::vector<Ray> rays = rays_at(c.mesh, 72000, 61);
        std::vector<Hit> hits(rays.size());
        std::vector<uint8_t> occluded(rays.size());
        tracer.trace_closest(rays, hits);
        tracer.trace_any(rays, occluded);
        size_t by_edge = 0, found = 0;
        for (size_t i = 0; i < rays.size(); ++i) {
            const double t = hits[i].t, expected = embree.closest(rays[i]);
            ASSERT_EQ(occluded[i], t < kInfinity ? 1 : 0) << c.name << " ray " << i;
            found += expected < kInfinity;
            const auto close = [&](double x) {
                return t == x || std::abs(t - x) <= 1e-4 * std::max(1.0, x);
            };
            if (close(expected) && i % 64 != 0) continue;
            const BruteHit exact = brute_force(c.mesh, rays[i]);
            if (close(exact.t)) continue;
            by_edge += i % 2;  // of rays that are not aimed at a vertex
            ASSERT_LT(exact.edge, 1e-3) << c.name << " ray " << i << ": PAVE " << t << ", Embree "
                                        << expected << ", double " << exact.t;
        }
        EXPECT_GT(found, 100u) << c.name;
        EXPECT_LE(by_edge, rays.size() / 500) << c.name;
    }
}

TEST(Watertight, TenMillionRaysStayInAMeshFarAway) {
    constexpr size_t kBatch = 1 << 20, kBatches = 10;
    const std::array<float, 3> center{148376, 1234, -223423};
    const Mesh mesh = sphere_mesh(100, center, 200, false);
    Scene scene;
    add_mesh(scene, mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    RayTracer tracer(device(), scene, {.tree_turns = TreeTurns::kNever});
    RayTracer in_turns(device(), scene, {.tree_turns = TreeTurns::kAlways});
    std::mt19937 rng(62);
    std::normal_distribution<float> normal;
    std::uniform_real_distribution<float> unit(0, 1);
    std::uniform_int_distribution<size_t> pick(0, mesh.triangles.size() - 1);
    std::vector<Ray> rays(kBatch);
    std::vector<Hit> hits(kBatch);
    size_t misses = 0;
    for (size_t batch = 0; batch < kBatches; ++batch) {
        size_t first = 0;
        for (size_t i = 0; i < kBatch; ++i) {
            // In every other batch sixteen rays go together, from one point to one strip.
            const bool together = batch % 2 == 1, leads = i % 16 == 0;
            if (!together || leads) first = pick(rng);
            const auto& t =
                mesh.triangles[(first + (together ? i % 16 : 0)) % mesh.triangles.size()];
            const auto &a = mesh.positions[t[0]], &b = mesh.positions[t[1]];
            const float along = i % 4 == 0 ? 0.0f : unit(rng);
            for (size_t k = 0; k < 3; ++k) {
                rays[i].origin[k] = together && !leads ? rays[i - 1].origin[k]
                                                       : center[k] + 100 * (2 * unit(rng) - 1);
                rays[i].direction[k] = together || i % 2 == 0
                                           ? a[k] + along * (b[k] - a[k]) - rays[i].origin[k]
                                           : normal(rng);
            }
        }
        (batch / 2 % 2 == 0 ? tracer : in_turns).trace_closest(rays, hits);
        for (const Hit& hit : hits) misses += hit.shape < 0;
    }
    EXPECT_EQ(misses, 0u) << "of " << kBatch * kBatches;
}

}  // namespace
}  // namespace pave::test
