// Instances: the hits and images of copies, no leaks, no self-hits; misuse is refused.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <bit>
#include <random>

#include "pave/rays.h"
#include "selftest.h"

namespace pave::test {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr RendererPaths kNoCopies{.copied_triangles = -1}, kAllCopies{.copied_triangles = 1 << 20};
// Of queries nothing may be left out; one program serves all of them.
constexpr RendererPaths kGeneral{
    .cull_occluders = false, .copied_triangles = -1, .specialise = false};
const std::vector<std::string> kAll = {"color",    "albedo",   "direct",   "normal", "depth",
                                       "distance", "variance", "position", "object"};

/// A map in double, of the float matrix that the renderer gets.
struct Map {
    Axes axes;
    explicit Map(const Matrix4& m) : axes(m) {}
    Double3 vector(Double3 v) const { return axes.x * v.x + axes.y * v.y + axes.z * v.z; }
    Double3 point(Double3 p) const { return vector(p) + axes.origin; }
    double volume() const { return dot(cross(axes.x, axes.y), axes.z); }
};

/// From twelve decades of size and place: even, stretched, sheared and mirrored ones.
Matrix4 random_map(std::mt19937& rng, double decades) {
    std::uniform_real_distribution<float> unit(-1, 1);
    const auto power = [&](double range) {
        return static_cast<float>(std::pow(10.0, range * static_cast<double>(unit(rng))));
    };
    const float size = power(decades), place = size * power(1);
    Matrix4 m = translate(place * unit(rng), place * unit(rng), place * unit(rng)) *
                rotate(0, 180 * unit(rng)) * rotate(1, 180 * unit(rng)) * scale(size);
    const int kind = static_cast<int>(rng() % 4);
    if (kind >= 1) m = m * scale(power(1), power(1), power(1));
    if (kind >= 2) m = m * rotate(2, 180 * unit(rng)) * scale(power(0.5), 1, power(0.5));
    if (kind == 3) m = m * scale(-1, 1, 1);
    return m;
}

struct Rays {
    Planes planes;
    explicit Rays(size_t count) : planes(make_planes(9, count)) {
        std::fill(planes[6].begin(), planes[6].end(), kInfinity);
        for (size_t k : {7, 8})
            std::fill(planes[k].begin(), planes[k].end(), std::bit_cast<float>(-1));
    }
    void set(size_t i, Double3 o, Double3 d) {
        const auto of = to_floats(o), df = to_floats(d);
        for (size_t k = 0; k < 3; ++k) planes[k][i] = of[k], planes[3 + k][i] = df[k];
    }
    Double3 origin(size_t i) const { return {planes[0][i], planes[1][i], planes[2][i]}; }
    Double3 direction(size_t i) const { return {planes[3][i], planes[4][i], planes[5][i]}; }
};
int32_t bits(float x) { return std::bit_cast<int32_t>(x); }
Double3 three(const Planes& planes, size_t first, size_t i) {
    return {planes[first][i], planes[first + 1][i], planes[first + 2][i]};
}
Double3 random_direction(std::mt19937& rng) {
    std::normal_distribution<double> normal;
    return normalized({normal(rng), normal(rng), normal(rng)});
}
/// Within the box [-1, 1]^3, half of them towards an instance.
Rays random_rays(const Scene& scene, size_t count, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> unit(-1, 1);
    Rays rays(count);
    for (size_t i = 0; i < count; ++i) {
        const Double3 o = Double3{unit(rng), unit(rng), unit(rng)} * 1.2;
        const Shape& shape = scene.shapes[scene.shapes.size() - 1 - i / 2 % 6];
        const Double3 aim =
            Map(shape.world_from_object).point(Double3{unit(rng), unit(rng), unit(rng)} * 0.5);
        rays.set(i, o, i % 2 == 0 ? normalized(aim - o) : random_direction(rng));
    }
    return rays;
}

/// Corners of all triangles in the world, in double.
std::vector<std::array<Double3, 3>> triangles_of(const Scene& scene) {
    std::vector<std::array<Double3, 3>> result;
    for (const Shape& shape : scene.shapes) {
        if (shape.type != Shape::Type::kInstance) continue;
        const Map map(shape.world_from_object);
        for (const Shape& part : scene.groups[static_cast<size_t>(shape.group)].shapes)
            for (const auto& t : part.mesh.triangles) {
                auto& corners = result.emplace_back();
                for (size_t k = 0; k < 3; ++k)
                    corners[k] = map.point(to_double3(part.mesh.positions[t[k]]));
            }
    }
    return result;
}

/// Instances alone, of meshes alone.
Scene meshes_only() {
    Scene scene = grove();
    scene.shapes.erase(scene.shapes.begin(), scene.shapes.begin() + 6);
    scene.groups[1].shapes.erase(scene.groups[1].shapes.begin());
    return scene;
}

class InstanceLanes : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Lanes, InstanceLanes, ::testing::Values(1, 4, 8, 16));

TEST_P(InstanceLanes, HitsAreThoseOfBruteForce) {
    const Scene scene = meshes_only();
    const auto triangles = triangles_of(scene);
    const Rays rays = random_rays(scene, 4096, 71);
    SelfTest test(scene, GetParam(), kGeneral);
    ASSERT_EQ(test.data().instances.size(), 6u);
    const Planes hits = test.trace(rays.planes);
    size_t found = 0;
    for (size_t i = 0; i < 4096; ++i) {
        double nearest = kInfinity, edge = 1;
        const Double3 o = rays.origin(i), d = rays.direction(i);
        for (const auto& [a, b, c] : triangles) {  // Moeller and Trumbore 1997
            const Double3 e1 = b - a, e2 = c - a, h = cross(d, e2), s = o - a, q = cross(s, e1);
            const double det = dot(e1, h), u = dot(s, h) / det, v = dot(d, q) / det,
                         t = dot(e2, q) / det, least = std::min({u, v, 1 - u - v});
            if (!(t > 0) || t > nearest) continue;
            if (least > -1e-3) edge = std::min(edge, std::abs(least));
            if (least >= 0) nearest = t;
        }
        const double t = hits[0][i];
        found += t < kInfinity;
        ASSERT_EQ(hits[14][i] > 0, t < kInfinity) << "ray " << i;
        if (t == nearest || std::abs(t - nearest) <= 2e-5 * std::max(1.0, nearest)) continue;
        ASSERT_LT(edge, 1e-3) << "ray " << i << ": " << t << ", brute force " << nearest;
    }
    EXPECT_GT(found, 1000u);
}

/// Groves whose groups may be copied: without vertex normals, and with maps that keep angles.
std::vector<Scene> copyable_groves() {
    Scene faceted = grove(), even = grove();
    for (ShapeGroup& group : faceted.groups)
        for (Shape& part : group.shapes) part.mesh.normals.clear();
    even.shapes[7].world_from_object = translate(0, -0.6f, -0.4f) * rotate(1, 130) * scale(0.2f);
    even.shapes[9].world_from_object = translate(0.1f, 0.3f, 0) * rotate(2, 170) * scale(0.2f);
    return {faceted, even};
}

void expect_vertices_of_copies(const Scene& scene, int lanes) {
    const Rays rays = random_rays(scene, 8192, 72);
    RendererPaths all_copies = kGeneral;
    all_copies.copied_triangles = 1 << 20;
    SelfTest test(scene, lanes, kGeneral), copies(scene, lanes, all_copies);
    ASSERT_TRUE(copies.data().instances.empty());
    const Planes a = test.trace(rays.planes), b = copies.trace(rays.planes);
    size_t different = 0, placed = 0;
    for (size_t i = 0; i < 8192; ++i) {
        ASSERT_EQ(a[14][i] > 0, a[0][i] < kInfinity);
        if (!(a[0][i] < kInfinity) || std::abs(a[0][i] - b[0][i]) > 2e-5 * (1 + b[0][i])) {
            different += a[0][i] != b[0][i];
            continue;
        }
        placed += bits(a[15][i]) >= 0;
        constexpr double kNormalSlack = 3e-4;  // they are packed to 7e-5
        different += max_abs(three(a, 4, i) - three(b, 4, i)) > 1e-5 ||
                     max_abs(three(a, 7, i) - three(b, 7, i)) > 1e-4 ||
                     max_abs(three(a, 10, i) - three(b, 10, i)) > kNormalSlack;
    }
    EXPECT_GT(placed, 1000u);
    EXPECT_LE(different, 8u) << "rays that a rounding sends past an edge";
}
TEST_P(InstanceLanes, VerticesAreThoseOfCopies) {
    for (const Scene& scene : copyable_groves()) expect_vertices_of_copies(scene, GetParam());
}

TEST_P(InstanceLanes, ImageIsThatOfCopies) {
    const Scene scene = copyable_groves()[GetParam() % 8 == 0];
    RenderOptions options{.spp = 128, .sampler = Sampler::kIndependent, .lane_width = GetParam()};
    options.seed = 1;
    const Frame copies = render(scene, 32, 32, kAll, options, kAllCopies);
    options.seed = 2;
    std::vector<RendererPaths> ways{kNoCopies};
    if (GetParam() == 8) {
        ways.push_back({.broadcast_shapes = 0, .copied_triangles = -1});
        ways.push_back({.copied_triangles = -1, .specialise = false});
    }
    for (const RendererPaths& paths : ways) {
        Renderer renderer(device(), scene, paths);
        const Frame instances = render(renderer, 32, 32, kAll, options);
        EXPECT_EQ(renderer.dropped_samples(), 0u);
        EXPECT_TRUE(same_image(copies, instances));
        size_t objects = 0;
        for (size_t i = 0; i < 32 * 32; ++i)
            objects += instances.channel("object")[i] >= 6;  // the instances' places
        EXPECT_GT(objects, 50u);
    }
    options.seed = 1;
    const Frame again = render(scene, 32, 32, kAll, options, kNoCopies);
    for (const char* channel : {"normal", "depth", "albedo", "object", "position"}) {
        const auto x = copies.channel(channel), y = again.channel(channel);
        size_t far = 0;
        for (size_t i = 0; i < x.size(); ++i)
            far += x[i] != y[i] && !(std::abs(x[i] - y[i]) <= 1e-3f * (1 + std::abs(x[i])));
        EXPECT_LE(far, x.size() / 100) << channel;
    }
}

TEST(Instances, BitsDoNotDependOnTheSchedule) {
    Renderer renderer(device(), grove(), kNoCopies);
    const RenderOptions options{.spp = 64, .seed = 9};
    const Frame reference = render(renderer, 33, 7, kAll, options);
    for (int tile_rows : {1, 3, 7})
        for (int group : {0, 1, 2}) {
            RenderOptions other = options;
            other.tile_rows = tile_rows;
            other.work_group_size = group;
            const Frame frame = render(renderer, 33, 7, kAll, other);
            for (const std::string& channel : kAll)
                EXPECT_TRUE(same_bits(frame, reference, channel)) << tile_rows << " rows";
        }
}

TEST(Instances, NormalsAreAcrossTheMappedTriangles) {
    std::mt19937 rng(73);
    for (int round = 0; round < 16; ++round) {
        const Matrix4 matrix = random_map(rng, 3);
        const Map map(matrix);
        Scene scene;
        const Mesh mesh = sphere_mesh(10, {0.3f, 0, 0}, 1, false);
        const int group =
            add_group(scene, {mesh_shape(mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}))});
        add_instance(scene, group, matrix);
        SelfTest test(scene, 8, kGeneral);
        Rays rays(1024);
        for (size_t i = 0; i < 1024; ++i) {
            const Double3 o = map.point(Double3{0.3, 0, 0} + random_direction(rng) * 3);
            const Double3 from = to_double3(to_floats(o));
            rays.set(i, from, map.point(Double3{0.3, 0, 0} + random_direction(rng) * 0.5) - from);
        }
        const Planes hits = test.trace(rays.planes);
        for (size_t i = 0; i < 1024; ++i) {
            ASSERT_LT(hits[0][i], kInfinity) << "round " << round << " ray " << i;
            const auto& t = mesh.triangles[static_cast<size_t>(bits(hits[1][i]))];
            Double3 p[3];
            for (size_t k = 0; k < 3; ++k) p[k] = map.point(to_double3(mesh.positions[t[k]]));
            const Double3 across = cross(p[1] - p[0], p[2] - p[0]) * (map.volume() < 0 ? -1 : 1);
            EXPECT_LT(max_abs(three(hits, 7, i) - normalized(across)), 2e-4)
                << "round " << round << " ray " << i;
            const Double3 on = p[0] + (p[1] - p[0]) * hits[2][i] + (p[2] - p[0]) * hits[3][i];
            EXPECT_LT(max_abs(three(hits, 4, i) - on),
                      2e-6 * (max_abs(p[0]) + max_abs(p[1]) + max_abs(map.axes.origin)));
        }
    }
}

TEST(Instances, NoRayLeavesAClosedMesh) {
    std::mt19937 rng(74);
    std::uniform_real_distribution<double> unit(-0.5, 0.5);
    const Mesh mesh = sphere_mesh(60, {0, 0, 0}, 1, false);
    std::uniform_int_distribution<size_t> pick(0, mesh.triangles.size() - 1);
    constexpr size_t kCount = 1 << 16;
    for (int round = 0; round < 16; ++round) {
        const Matrix4 matrix = random_map(rng, 4);
        const Map map(matrix);
        Scene scene;
        add_instance(scene,
                     add_group(scene, {mesh_shape(mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}))}),
                     matrix);
        SelfTest test(scene, 8, kGeneral);
        Rays rays(kCount);
        for (size_t i = 0; i < kCount; ++i) {
            const Double3 o =
                to_double3(to_floats(map.point(Double3{unit(rng), unit(rng), unit(rng)})));
            const auto& t = mesh.triangles[pick(rng)];
            const Double3 a = to_double3(mesh.positions[t[0]]),
                          b = to_double3(mesh.positions[t[1]]),
                          aim = map.point(i % 4 == 0 ? a : a + (b - a) * (unit(rng) + 0.5));
            rays.set(i, o, i % 2 == 0 ? aim - o : random_direction(rng));
        }
        const Planes hits = test.trace(rays.planes);
        EXPECT_EQ(std::count(hits[0].begin(), hits[0].end(), kInfinity), 0) << "round " << round;
    }
}

TEST(Instances, NoRayHitsWhatItStartsOn) {
    // Without skip, from triangles in instances over eight decades of size, as
    // TraceSelfHit.NoRayHitsWhatItStartsOn.
    std::mt19937 rng(75);
    std::uniform_real_distribution<double> unit(-1, 1);
    constexpr size_t kInstances = 256, kDirections = 1024, kCount = kInstances * kDirections;
    Scene scene;
    Rays rays(kInstances);
    Mesh triangle;
    triangle.positions = {{0.3f, -0.9f, 0.4f}, {0.9f, 0.8f, -0.6f}, {-0.8f, 0.2f, 0.7f}};
    triangle.triangles = {{0, 1, 2}};
    const int group =
        add_group(scene, {mesh_shape(triangle, add_diffuse(scene, {0.5f, 0.5f, 0.5f}))});
    for (size_t i = 0; i < kInstances; ++i) {
        const Matrix4 matrix = random_map(rng, 4);
        add_instance(scene, group, matrix);
        const Map map(matrix);
        const Double3 target = map.point({0.15, 0.05, 0.15});
        const Double3 o = to_double3(to_floats(target + map.vector(random_direction(rng))));
        rays.set(i, o, target - o);
    }
    SelfTest test(scene, 8, kGeneral);
    const Planes hits = test.trace(rays.planes);
    Rays away(kCount);
    for (size_t i = 0; i < kCount; ++i) {
        const size_t from = i / kDirections;
        const Double3 p = three(hits, 4, from), n = three(hits, 7, from);
        Double3 d = random_direction(rng);
        if (i % 4 == 0) d = normalized(d - n * (dot(d, n) * 0.999));  // grazing
        away.set(i, p + n * (dot(n, d) < 0 ? -hits[13][from] : hits[13][from]), d);
    }
    const Planes again = test.trace(away.planes);
    size_t self = 0, found = 0;
    for (size_t i = 0; i < kCount; ++i) {
        found += hits[0][i / kDirections] < kInfinity;
        self += hits[0][i / kDirections] < kInfinity && again[0][i] < kInfinity &&
                bits(again[15][i]) == bits(hits[15][i / kDirections]);
    }
    EXPECT_EQ(self, 0u);
    EXPECT_GT(found, kCount / 2);
}

/// A triangle of two instances, one behind the other, in front of a mesh of the scene's own.
Scene row_of_triangles() {
    Scene scene;
    const int grey = add_diffuse(scene, {0.5f, 0.5f, 0.5f});
    Mesh mesh;
    mesh.positions = {{-1, -1, 0}, {1, -1, 0}, {0, 1, 0}, {-1, -1, -9}, {1, -1, -9}, {0, 1, -9}};
    mesh.triangles = {{3, 4, 5}, {0, 1, 2}};
    Shape ball;
    ball.type = Shape::Type::kSphere;
    ball.bsdf = grey;
    ball.world_from_object = translate(10, 0, 0);
    const int group = add_group(scene, {ball, mesh_shape(mesh, grey)});
    Mesh own;
    own.positions = {{-1, -1, 0}, {1, -1, 0}, {0, 1, 0}};
    own.triangles = {{0, 1, 2}};
    for (auto& p : own.positions) p[2] = 7;
    add_mesh(scene, own, grey);
    add_instance(scene, group, translate(0, 0, 2));
    add_instance(scene, group, translate(0, 0, 4) * scale(-2, 2, 2));
    return scene;
}

TEST(Instances, OnlyTheTriangleOfItsInstanceIsSkipped) {
    for (int lanes : {1, 8}) {
        SelfTest test(row_of_triangles(), lanes, kGeneral);
        Rays rays(16);
        for (size_t i = 0; i < 16; ++i) rays.set(i, {0, -0.5, 1}, {0, 0, 1});
        const Planes first = test.trace(rays.planes);
        ASSERT_EQ(first[0][0], 1.0f);
        EXPECT_EQ(bits(first[15][0]), 0);
        rays.planes[7][0] = rays.planes[7][1] = first[1][0];
        rays.planes[8][0] = std::bit_cast<float>(0);
        rays.planes[8][1] = std::bit_cast<float>(1);
        const Planes hits = test.trace(rays.planes);
        EXPECT_EQ(hits[0][0], 3.0f) << "the same triangle of the next instance";
        EXPECT_EQ(bits(hits[15][0]), 1);
        EXPECT_EQ(hits[1][0], first[1][0]);
        EXPECT_EQ(hits[0][1], 1.0f) << "the triangle of the other one is skipped";
    }
}

TEST(Instances, HitsNameInstancePartAndTriangle) {
    for (int lanes : {1, 16})
        for (int copied : {-1, 100}) {
            RayTracer tracer(device(), row_of_triangles(),
                             {.lane_width = lanes,
                              .broadcast_shapes = copied < 0 ? 0 : 64,
                              .copied_triangles = copied});
            std::vector<Ray> rays(5);
            std::vector<Hit> hits(5);
            std::vector<uint8_t> any(5);
            rays[0] = {{0, -0.5f, 1}, kInfinity, {0, 0, 2}, 0};
            rays[1] = {{0, -0.5f, 3}, kInfinity, {0, 0, 1}, 0};
            rays[2] = {{-0.4f, -0.5f, 5}, kInfinity, {0, 0, 1}, 0};
            rays[3] = {{-20, 0, 0}, kInfinity, {0, 0, 1}, 0};
            rays[4] = {{-20, 0, 0}, 3.0f, {0, 0, 1}, 0};
            for (size_t i = 0; i < 3; ++i) rays[i].origin[0] += 0.1f;
            tracer.trace_closest(rays, hits);
            tracer.trace_any(rays, any);
            EXPECT_EQ(hits[0].t, 0.5f);
            EXPECT_EQ(hits[0].shape, 1);
            EXPECT_EQ(hits[0].part, 1);
            EXPECT_EQ(hits[0].primitive, 1);
            EXPECT_NEAR(hits[0].b2, 0.25f, 1e-6f);
            EXPECT_NEAR(hits[0].b1, 0.425f, 1e-6f);
            EXPECT_EQ(hits[1].shape, 2);
            EXPECT_EQ(hits[1].part, 1);
            EXPECT_NEAR(hits[1].b2, 0.375f, 1e-6f);
            EXPECT_NEAR(hits[1].b1, 0.2875f, 1e-6f) << "mirrored: x is -0.05 in the group";
            EXPECT_EQ(hits[2].shape, 0);
            EXPECT_EQ(hits[2].part, -1);
            EXPECT_EQ(hits[3].shape, 2);
            EXPECT_EQ(hits[3].part, 0) << "the sphere";
            EXPECT_EQ(hits[3].t, 2.0f);
            EXPECT_EQ(hits[4].shape, 2);
            EXPECT_EQ(any, (std::vector<uint8_t>{1, 1, 1, 1, 1}));
            rays[3].t_max = 1.9f;
            tracer.trace_any(rays, any);
            EXPECT_EQ(any[3], 0);
        }
}

TEST(Instances, SmallGroupsAndThosePlacedOnceAreCopied) {
    EXPECT_EQ(build_scene_data(grove(), {}).instances.size(), 4u)
        << "normals of stretched groups are not those of copies";
    Scene scene = copyable_groves()[0];
    const auto instances = [&](int copied_triangles) {
        return build_scene_data(scene, {.copied_triangles = copied_triangles}).instances.size();
    };
    EXPECT_EQ(build_scene_data(scene, {}).instances.size(), 0u);
    EXPECT_EQ(instances(-1), 6u);
    EXPECT_EQ(instances(239), 6u);
    EXPECT_EQ(instances(240), 4u) << "120 triangles of the second group, twice";
    EXPECT_EQ(instances(240 + 4 * 284 - 1), 4u);
    EXPECT_EQ(instances(240 + 4 * 284), 0u);
    scene.shapes.resize(7);
    const SceneData once = build_scene_data(scene, {});
    EXPECT_EQ(once.instances.size(), 0u);
    EXPECT_EQ(once.corners.size(), 284u);
    scene.shapes.resize(6);
    EXPECT_EQ(build_scene_data(scene, {}).corners.size(), 0u) << "nothing places the groups";
    // Sharing: the triangles are there once.
    Scene many;
    const int group = add_group(many, {mesh_shape(sphere_mesh(20, {0, 0, 0}, 1, true),
                                                  add_diffuse(many, {0.5f, 0.5f, 0.5f}))});
    for (int i = 0; i < 1000; ++i)
        add_instance(many, group, translate(3.0f * static_cast<float>(i), 0, 0));
    const SceneData data = build_scene_data(many, {.copied_triangles = 1000000});
    EXPECT_EQ(data.corners.size(), 1520u);
    EXPECT_EQ(data.triangles.size(), 1520u * TRIANGLE_ROWS);
    EXPECT_EQ(data.instances.size(), 1000u);
    EXPECT_FLOAT_EQ(data.tree_bound[0], 2998.003f);
}

TEST(Instances, WhatCannotBePlacedIsNamed) {
    const auto expect = [](const Scene& scene, const std::string& part) {
        try {
            (void)build_scene_data(scene, kNoCopies);
            ADD_FAILURE() << "no error with " << part;
        } catch (const InputError& error) {
            EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
        }
    };
    Scene scene = grove();
    scene.shapes[6].world_from_object = scale(1, 0, 1);
    expect(scene, "scene 'grove': shape 6: its transform is singular");
    scene.shapes[6].world_from_object = scale(kInfinity);
    expect(scene, "shape 6: its transform is singular or beyond 1e12");
    scene.shapes[6].world_from_object = scale(1e-13f);
    expect(scene, "shape 6: its transform is singular or beyond 1e12");
    scene = grove();
    scene.shapes[7].group = 2;
    expect(scene, "shape 7: group 2 of 2");
    scene = grove();
    scene.shapes[10].world_from_object = scale(1, 2, 1);
    expect(scene, "shape 10: a sphere can only be scaled evenly");
    scene = grove();
    make_emitter(scene.groups[0].shapes[1], {1, 1, 1});
    expect(scene, "group 'tree': shape 1: a group has no emitters");
    scene = grove();
    scene.groups[0].shapes[0].type = Shape::Type::kInstance;
    expect(scene, "group 'tree': shape 0: a group has no instances");
    scene = grove();
    scene.groups[0].shapes[1].bsdf = 99;
    expect(scene, "group 'tree': shape 1: material 99 of ");
    scene = grove();
    scene.groups[0].shapes[1].mesh.triangles[3][1] = 5000;
    expect(scene, "group 'tree': shape 1: vertex 5000 of 180");
}

}  // namespace
}  // namespace pave::test
