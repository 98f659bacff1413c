// Ray queries: all lane widths and paths agree, ids are the scene's own, misuse is refused.
// SPDX-License-Identifier: BSD-3-Clause
#include <chrono>
#include <limits>
#include <random>

#include "pave/rays.h"
#include "support.h"

namespace pave::test {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

Ray ray_of(std::array<float, 3> o, std::array<float, 3> d, float t_max = kInfinity) {
    return {{o[0], o[1], o[2]}, t_max, {d[0], d[1], d[2]}, 0};
}

std::vector<Ray> random_rays(size_t count, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
    std::vector<Ray> rays;
    for (size_t i = 0; i < count; ++i)
        rays.push_back(ray_of({1.5f * unit(rng), 1.5f * unit(rng), 1.5f * unit(rng)},
                              {unit(rng), unit(rng), unit(rng)},
                              i % 3 == 0 ? 1.0f + unit(rng) : kInfinity));
    return rays;
}

std::vector<Hit> closest(RayTracer& tracer, const std::vector<Ray>& rays) {
    std::vector<Hit> hits(rays.size());
    tracer.trace_closest(rays, hits);
    return hits;
}
std::vector<uint8_t> any(RayTracer& tracer, const std::vector<Ray>& rays) {
    std::vector<uint8_t> occluded(rays.size(), 7);
    tracer.trace_any(rays, occluded);
    return occluded;
}

/// A rectangle, a cube and a mesh whose third triangle has no area, along the z axis.
Scene row_of_shapes() {
    Scene scene;
    const int grey = add_diffuse(scene, {0.5f, 0.5f, 0.5f});
    using Type = Shape::Type;
    add_shape(scene, Type::kRectangle, translate(0, 0, 1) * scale(1.0f), grey);
    add_shape(scene, Type::kCube, translate(4, 0, 2) * scale(1.0f), grey);
    Mesh mesh;
    mesh.positions = {{-1, -1, 5}, {1, -1, 5}, {0, 1, 5}, {-1, -1, 6}, {1, -1, 6}, {0, 1, 6}};
    mesh.triangles = {{3, 4, 5}, {0, 0, 1}, {0, 1, 2}};
    add_mesh(scene, mesh, grey);
    return scene;
}

TEST(Rays, HitsNameTheScenesOwnShapesAndTriangles) {
    for (int broadcast : {0, 64}) {
        RayTracer tracer(device(), row_of_shapes(), {.broadcast_shapes = broadcast});
        EXPECT_EQ(tracer.dropped_triangles(), 1);
        const std::vector<Hit> hits = closest(tracer, {
                                                          ray_of({0, 0, 0}, {0, 0, 2}),
                                                          ray_of({0, 0, 0}, {0, 0, 1}, 0.9f),
                                                          ray_of({4, 0, 0}, {0, 0, 1}),
                                                          ray_of({4, 0, 9}, {0, 0, -1}),
                                                          ray_of({0, -0.5f, 2}, {0, 0, 1}),
                                                          ray_of({0, -0.5f, 9}, {0, 0, -1}),
                                                      });
        EXPECT_EQ(hits[0].t, 0.5f);
        EXPECT_EQ(hits[0].shape, 0);
        EXPECT_EQ(hits[0].primitive, 0);
        EXPECT_EQ(hits[1].shape, -1);
        EXPECT_EQ(hits[1].t, kInfinity);
        EXPECT_EQ(hits[2].shape, 1);
        EXPECT_EQ(hits[2].primitive, 4);  // low z
        EXPECT_EQ(hits[3].primitive, 5);
        EXPECT_EQ(hits[4].shape, 2);
        EXPECT_EQ(hits[4].primitive, 2);
        EXPECT_NEAR(hits[4].t, 3.0f, 1e-6f);
        EXPECT_NEAR(hits[4].b2, 0.25f, 1e-6f);
        EXPECT_NEAR(hits[4].b1, 0.375f, 1e-6f);
        EXPECT_EQ(hits[5].primitive, 0);
    }
}

class RayPaths : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Lanes, RayPaths, ::testing::Values(1, 4, 8, 16));

TEST_P(RayPaths, AgreeOnEveryRay) {
    const Scene scene = menagerie();
    const std::vector<Ray> rays = random_rays(4099, 1);  // no multiple of anything
    RayTracer reference(device(), scene, {.lane_width = 1, .specialise = false});
    const std::vector<Hit> expected = closest(reference, rays);
    for (int broadcast : {0, 64})
        for (int segment : {0, 16, 4096}) {
            const TreeTurns turns = segment == 16 ? TreeTurns::kAlways : TreeTurns::kNever;
            RayTracer tracer(device(), scene,
                             {.lane_width = GetParam(),
                              .broadcast_shapes = broadcast,
                              .tree_turns = turns,
                              .segment = segment});
            const std::vector<Hit> hits = closest(tracer, rays);
            const std::vector<uint8_t> occluded = any(tracer, rays);
            size_t ties = 0;   // the cubes stand on the floor: two faces at the same t
            size_t edges = 0;  // a rounding decides
            for (size_t i = 0; i < rays.size(); ++i) {
                // Shapes along the axes, and wide lanes' reciprocals, round another way.
                const float t = expected[i].t;
                const bool same = hits[i].t == t || std::abs(hits[i].t - t) <= 1e-5f * (1 + t);
                edges += !same;
                ASSERT_EQ(occluded[i], hits[i].shape >= 0 ? 1 : 0) << "ray " << i;
                if (!same || hits[i].shape != expected[i].shape) {
                    ++ties;
                    continue;
                }
                ASSERT_EQ(hits[i].primitive, expected[i].primitive) << "ray " << i;
                ASSERT_EQ(hits[i].b1, expected[i].b1) << "ray " << i;
            }
            EXPECT_LE(edges, 2u);
            EXPECT_LE(ties, rays.size() / 100);
        }
}

/// Rays of a camera, which wide kernels trace together: whole rows, some of them with a ray among
/// them that goes elsewhere, ends early or has no direction.
std::vector<Ray> camera_rays(int width, int height) {
    std::vector<Ray> rays;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const float u = 2.0f * static_cast<float>(x) / static_cast<float>(width) - 1;
            const float v = 2.0f * static_cast<float>(y) / static_cast<float>(height) - 1;
            rays.push_back(ray_of({0.1f, 0.05f, 3}, {0.5f * u, 0.5f * v, -1}));
            if ((7 * x + 13 * y) % 91 == 0) rays.back().t_max = 2.3f;
            if ((5 * x + 3 * y) % 97 == 0) rays.back().direction[2] = x % 2 == 0 ? 0.0f : 1.0f;
            if ((3 * x + 5 * y) % 499 == 0) rays.back() = ray_of({0, 0, 0}, {0, 0, 0});
        }
    return rays;
}

TEST_P(RayPaths, RaysTogetherOrInTurnsGetWhatTheyGetAlone) {
    std::vector<Ray> rays = camera_rays(333, 200);
    for (const Ray& ray : random_rays(20000, 3)) rays.push_back(ray);
    for (const Mesh& mesh :
         {random_triangles(2000, 0.2f, 9), sphere_mesh(50, {0, 0, 0}, 0.8f, false)}) {
        Scene scene;
        add_mesh(scene, mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
        RayTracer one(device(), scene, {.lane_width = 1});
        const std::vector<Hit> expected = closest(one, rays);
        for (int segment : {0, 16, 4096}) {
            const TreeTurns turns = segment == 16 ? TreeTurns::kNever : TreeTurns::kAlways;
            RayTracer tracer(device(), scene,
                             {.lane_width = GetParam(), .tree_turns = turns, .segment = segment});
            const std::vector<Hit> hits = closest(tracer, rays);
            const std::vector<uint8_t> occluded = any(tracer, rays);
            size_t found = 0;
            for (size_t i = 0; i < rays.size(); ++i) {
                ASSERT_EQ(hits[i].t, expected[i].t) << "ray " << i;
                ASSERT_EQ(occluded[i], expected[i].shape >= 0 ? 1 : 0) << "ray " << i;
                ASSERT_EQ(hits[i].shape, expected[i].shape) << "ray " << i;
                found += hits[i].shape >= 0;
                if (hits[i].primitive != expected[i].primitive) continue;  // on a shared edge
                ASSERT_EQ(hits[i].b1, expected[i].b1) << "ray " << i;
                ASSERT_EQ(hits[i].b2, expected[i].b2) << "ray " << i;
            }
            EXPECT_GT(found, rays.size() / 8);
        }
    }
}

TEST_P(RayPaths, SenselessRaysMeetNothing) {
    const std::array<float, 3> o{0, 0, 0}, d{0, 0, -1};
    const std::vector<Ray> rays{ray_of({kNaN, 0, 0}, d),
                                ray_of({0, kInfinity, 0}, d),
                                ray_of(o, {0, 0, kNaN}),
                                ray_of(o, {0, -kInfinity, 1}),
                                ray_of(o, {0, 0, 0}),
                                ray_of(o, d, kNaN),
                                ray_of(o, d, 0.0f),
                                ray_of(o, d, -1.0f),
                                ray_of(o, d)};
    for (int broadcast : {0, 64}) {
        RayTracer tracer(device(), menagerie(),
                         {.lane_width = GetParam(), .broadcast_shapes = broadcast});
        const std::vector<Hit> hits = closest(tracer, rays);
        const std::vector<uint8_t> occluded = any(tracer, rays);
        for (size_t i = 0; i + 1 < rays.size(); ++i) {
            EXPECT_EQ(hits[i].shape, -1) << "ray " << i;
            EXPECT_EQ(occluded[i], 0) << "ray " << i;
        }
        EXPECT_GE(hits.back().shape, 0);
        EXPECT_EQ(occluded.back(), 1);
    }
}

/// Seconds of the fastest of seven queries.
double fastest(RayTracer& tracer, const std::vector<Ray>& rays) {
    double least = 1e30;
    for (int i = 0; i < 7; ++i) {
        const auto begin = std::chrono::steady_clock::now();
        closest(tracer, rays);
        const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - begin;
        least = std::min(least, spent.count());
    }
    return least;
}

TEST(Rays, SenselessOnesTakeNoLonger) {
    Scene scene;
    add_mesh(scene, random_triangles(20000, 0.1f, 8), add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    RayTracer tracer(device(), scene);
    const std::vector<Ray> sane = random_rays(1 << 16, 9);
    const double seconds = fastest(tracer, sane);
    for (const float bad : {kNaN, kInfinity, -kInfinity})
        for (const bool origin : {false, true}) {
            std::vector<Ray> rays = sane;
            for (size_t i = 0; i < rays.size(); i += 2)
                (origin ? rays[i].origin : rays[i].direction)[i / 2 % 3] = bad;
            EXPECT_LT(fastest(tracer, rays), 2 * seconds + 1e-3) << bad << " " << origin;
        }
}

TEST(Rays, EmptyScenesAndNoRays) {
    Scene scene;
    RayTracer tracer(device(), scene);
    EXPECT_EQ(closest(tracer, random_rays(3, 2))[2].shape, -1);
    EXPECT_EQ(any(tracer, random_rays(3, 2))[2], 0);
    EXPECT_TRUE(closest(tracer, {}).empty());
}

TEST(Rays, BuffersGiveWhatSpansGive) {
    const std::vector<Ray> rays = random_rays(1000, 3);
    RayTracer tracer(device(), menagerie());
    const std::vector<Hit> expected = closest(tracer, rays);
    const cl::Buffer in = make_buffer_of(device(), rays, "rays");
    const cl::Buffer out = make_buffer(device(), rays.size() * sizeof(Hit), "hits");
    tracer.enqueue_closest(in(), out(), rays.size());
    std::vector<Hit> hits(rays.size());
    read_buffer(device(), out, hits, "hits");
    for (size_t i = 0; i < rays.size(); ++i) ASSERT_EQ(hits[i].t, expected[i].t) << "ray " << i;
    tracer.enqueue_any(in(), out(), rays.size());
    std::vector<uint8_t> occluded(rays.size());
    read_buffer(device(), out, occluded, "occluded");
    for (size_t i = 0; i < rays.size(); ++i)
        ASSERT_EQ(occluded[i], expected[i].shape >= 0 ? 1 : 0) << "ray " << i;
}

TEST(Rays, RefusesWhatDoesNotFit) {
    RayTracer tracer(device(), menagerie());
    std::vector<Ray> rays(4);
    std::vector<Hit> hits(3);
    EXPECT_THROW(tracer.trace_closest(rays, hits), UsageError);
    const cl::Buffer small = make_buffer(device(), 64, "small");
    EXPECT_THROW(tracer.enqueue_closest(small(), small(), 4), UsageError);
    EXPECT_THROW(tracer.enqueue_any(nullptr, small(), 1), UsageError);
    const cl::Context other(device_of(device()));
    const cl::Buffer foreign(other, CL_MEM_READ_WRITE, 64);
    EXPECT_THROW(tracer.enqueue_any(foreign(), small(), 1), UsageError);
    EXPECT_THROW(RayTracer(device(), menagerie(), {.lane_width = 5}), UsageError);
    EXPECT_THROW(RayTracer(device(), menagerie(), {.lane_width = 8, .segment = 12}), UsageError);
}

}  // namespace
}  // namespace pave::test
