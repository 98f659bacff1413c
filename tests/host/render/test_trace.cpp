// Intersections: the tree against brute force in double, closed meshes without a gap, no ray hits
// what it starts on.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <bit>
#include <random>

#include "selftest.h"

namespace pave::test {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct Rays {
    Planes planes;
    explicit Rays(size_t count) : planes(make_planes(9, count)) {
        std::fill(planes[6].begin(), planes[6].end(), kInfinity);
        for (size_t k : {7, 8})
            std::fill(planes[k].begin(), planes[k].end(), std::bit_cast<float>(-1));
    }
    void set(size_t i, Double3 o, Double3 d) {
        const auto of = to_floats(o), df = to_floats(d);
        for (size_t k = 0; k < 3; ++k) {
            planes[k][i] = of[k];
            planes[3 + k][i] = df[k];
        }
    }
    Double3 origin(size_t i) const { return {planes[0][i], planes[1][i], planes[2][i]}; }
    Double3 direction(size_t i) const { return {planes[3][i], planes[4][i], planes[5][i]}; }
};

Double3 random_direction(std::mt19937& rng) {
    std::normal_distribution<double> normal;
    return normalized({normal(rng), normal(rng), normal(rng)});
}

int32_t id_of(const Planes& hits, size_t i) { return std::bit_cast<int32_t>(hits[1][i]); }

/// Distance along the ray to triangle (a, b, c), or infinity. Moeller and Trumbore 1997, in double;
/// `edge` gets the least barycentric coordinate: how far inside the hit is.
double hit_triangle(Double3 o, Double3 d, Double3 a, Double3 b, Double3 c, double* edge) {
    const Double3 e1 = b - a, e2 = c - a, h = cross(d, e2);
    const double det = dot(e1, h);
    if (det == 0) return kInfinity;
    const Double3 s = o - a, q = cross(s, e1);
    const double u = dot(s, h) / det, v = dot(d, q) / det, t = dot(e2, q) / det;
    *edge = std::min({u, v, 1 - u - v});
    return *edge >= -1e-4 && t > 0 ? t : kInfinity;
}

struct MeshCase {
    const char* name;
    Mesh mesh;
};
std::vector<MeshCase> mesh_cases() {
    Mesh degenerate = random_triangles(500, 0.2f, 7);
    degenerate.positions.push_back({std::nanf(""), 0, 0});
    degenerate.positions.push_back({kInfinity, 0, 0});
    const auto n = static_cast<uint32_t>(degenerate.positions.size());
    for (uint32_t i = 0; i < 30; i += 3) {
        degenerate.triangles.push_back({i, i, i + 1});
        degenerate.triangles.push_back({i, i + 1, n - 1});
        degenerate.triangles.push_back({i, i + 1, n - 2});
    }
    Mesh needles = random_triangles(500, 0.5f, 8);
    for (size_t i = 0; i < needles.positions.size(); i += 3)
        for (size_t k = 0; k < 3; ++k)
            needles.positions[i + 1][k] = needles.positions[i][k] + 1e-4f * static_cast<float>(k);
    return {{"one", random_triangles(1, 1.0f, 1)},
            {"nine", random_triangles(9, 0.8f, 2)},
            {"sparse", random_triangles(300, 0.3f, 3)},
            {"dense", random_triangles(20000, 0.03f, 4)},
            {"crossing", random_triangles(400, 1.0f, 5)},
            {"sphere", sphere_mesh(40, {0.2f, 0, 0}, 0.7f, false)},
            {"degenerate", degenerate},
            {"needles", needles}};
}

Rays random_rays(size_t count, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    Rays rays(count);
    for (size_t i = 0; i < count; ++i) {
        Double3 d = random_direction(rng);
        if (i % 16 == 1) d = {i % 32 == 1 ? 1.0 : -1.0, 0, 0};  // along an axis
        if (i % 16 == 2) d = normalized({d.x, 0, d.z});
        rays.set(i, {2 * unit(rng), 2 * unit(rng), 2 * unit(rng)}, d);
    }
    return rays;
}

class Trace : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Lanes, Trace, ::testing::Values(1, 8));

TEST_P(Trace, TreeFindsWhatBruteForceFinds) {
    for (const MeshCase& c : mesh_cases()) {
        Scene scene;
        add_mesh(scene, c.mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
        SelfTest test(scene, GetParam());
        const auto& corners = test.data().corners;
        const size_t count = corners.size() > 5000 ? 512 : 8192;
        const Rays rays = random_rays(count, 31);
        const Planes hits = test.trace(rays.planes);
        for (size_t i = 0; i < count; ++i) {
            double nearest = kInfinity, nearest_edge = 1;
            for (const auto& k : corners) {
                double edge = 1;
                const double t = hit_triangle(rays.origin(i), rays.direction(i), to_double3(k[0]),
                                              to_double3(k[1]), to_double3(k[2]), &edge);
                if (t < nearest && edge >= 0) nearest = t, nearest_edge = edge;
            }
            const double t = hits[0][i];
            if (t < kInfinity) {  // the vertex comes from the triangle's weights
                const Double3 at = rays.origin(i) + rays.direction(i) * t,
                              p{hits[4][i], hits[5][i], hits[6][i]};
                ASSERT_LT(length(p - at), 1e-3 * (1 + length(at))) << c.name << " ray " << i;
            }
            if (t == nearest || std::abs(t - nearest) <= 2e-5 * std::max(1.0, nearest)) continue;
            // Where float and double disagree, the one or the other hit an edge within the rounding
            // of float32.
            const int32_t id = id_of(hits, i);
            double found_edge = 1;
            if (id >= 0) {
                const auto& k = corners[static_cast<size_t>(id)];
                hit_triangle(rays.origin(i), rays.direction(i), to_double3(k[0]), to_double3(k[1]),
                             to_double3(k[2]), &found_edge);
            }
            ASSERT_TRUE(nearest_edge < 1e-4 || std::abs(found_edge) < 1e-4)
                << c.name << " ray " << i << ": tree " << t << " (triangle " << id
                << "), brute force " << nearest;
        }
    }
}

TEST_P(Trace, AnyHitAgreesWithClosest) {
    for (const MeshCase& c : mesh_cases()) {
        Scene scene = menagerie();
        add_mesh(scene, c.mesh, 0);
        for (int broadcast : {0, 64}) {
            SelfTest test(
                scene, GetParam(),
                {.broadcast_shapes = broadcast, .cull_occluders = false, .specialise = false});
            Rays rays = random_rays(4096, 32);
            const Planes hits = test.trace(rays.planes);
            for (size_t i = 0; i < 4096; ++i) {
                ASSERT_EQ(hits[14][i] > 0, hits[0][i] < kInfinity) << c.name << " ray " << i;
                rays.planes[6][i] = hits[0][i] * (i % 2 == 0 ? 0.999f : 1.001f);
            }
            const Planes again = test.trace(rays.planes);
            for (size_t i = 0; i < 4096; ++i)
                if (hits[0][i] < kInfinity) {
                    ASSERT_EQ(again[14][i] > 0, i % 2 == 1) << c.name << " ray " << i;
                }
        }
    }
}

/// Rays whose closest hits, or whose occlusion, differ by more than rounding; and those that only
/// have another of two faces in one plane (the cuboids stand on the floor).
struct Differences {
    size_t hits = 0, faces = 0;
};
Differences differences(const Planes& a, const Planes& b) {
    Differences found;
    for (size_t i = 0; i < a[0].size(); ++i) {
        const double t = a[0][i], other = b[0][i];
        const bool same = t == other || std::abs(t - other) <= 1e-5 * std::max(1.0, t);
        found.hits += !same || (a[14][i] > 0) != (b[14][i] > 0);
        found.faces += same && t < kInfinity && id_of(a, i) != id_of(b, i);
    }
    return found;
}

TEST_P(Trace, ShapesAreTheSameInLoopAndTree) {
    Scene scene = menagerie();
    SelfTest loop(scene, GetParam()),
        tree(scene, GetParam(), {.broadcast_shapes = 0, .specialise = false});
    SelfTest special(scene, GetParam(), {});
    const Rays rays = random_rays(16384, 33);
    const Planes a = loop.trace(rays.planes), b = tree.trace(rays.planes),
                 c = special.trace(rays.planes);
    for (size_t i = 0; i < 16384; ++i) ASSERT_EQ(a[0][i], b[0][i]) << "ray " << i;
    // Shapes along the axes have a test of their own, which rounds another way.
    const Differences found = differences(a, c);
    EXPECT_LE(found.hits, 4u);
    EXPECT_LE(found.faces, 50u);
}

TEST_P(Trace, ShapesAlongTheAxesHaveATestOfTheirOwn) {
    // The scene is turned by 90 degrees about each axis, so that every axis has its shapes.
    constexpr size_t kCount = 16384;
    for (int axis = 0; axis < 3; ++axis) {
        Scene scene = cornell();
        for (Shape& shape : scene.shapes)
            shape.world_from_object = rotate(axis, 90) * shape.world_from_object;
        const RendererPaths all{.cull_occluders = false};
        SelfTest general(scene, GetParam(), {.cull_occluders = false, .specialise = false}),
            special(scene, GetParam(), all);
        ASSERT_GE(special.data().axis_rects.size(), 6u);
        ASSERT_EQ(special.data().axis_cubes.size(), 3u);
        Rays rays = random_rays(kCount, 34);
        for (size_t i = 0; i < 512; ++i)  // along a face: no slope in two directions
            for (size_t k = 0; k < 3; ++k)
                rays.planes[3 + k][i] = k == i % 3 ? (i % 2 == 0 ? 1.0f : -1.0f) : 0.0f;
        const Differences found =
            differences(general.trace(rays.planes), special.trace(rays.planes));
        EXPECT_LE(found.hits, 4u) << "axis " << axis;
        EXPECT_LE(found.faces, 100u) << "axis " << axis;
    }
}

TEST(TraceMesh, DropsAndCountsDegenerateTriangles) {
    Scene scene;
    add_mesh(scene, mesh_cases()[6].mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    EXPECT_EQ(Renderer(device(), scene).dropped_triangles(), 30);
}

/// Rays from within a closed mesh, the half of them aimed at vertices and edges; returns how many
/// get out.
size_t leaks(const Mesh& mesh, Double3 center, Double3 radii, size_t count, uint32_t seed) {
    Scene scene;
    add_mesh(scene, mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    SelfTest test(scene);
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> unit(-0.5, 0.5);
    std::uniform_int_distribution<size_t> pick(0, mesh.triangles.size() - 1);
    Rays rays(count);
    for (size_t i = 0; i < count; ++i) {
        const Double3 o =
            center + Double3{radii.x * unit(rng), radii.y * unit(rng), radii.z * unit(rng)};
        const Double3 o_rounded = to_double3(to_floats(o));
        const auto& t = mesh.triangles[pick(rng)];
        const Double3 a = to_double3(mesh.positions[t[0]]), b = to_double3(mesh.positions[t[1]]);
        const Double3 aim = i % 4 == 0 ? a : a + (b - a) * (unit(rng) + 0.5);
        // Stretched as the mesh is: rays across needles end within the rounding of their length.
        const Double3 d = random_direction(rng);
        rays.set(i, o,
                 normalized(i % 2 == 0 ? aim - o_rounded
                                       : Double3{radii.x * d.x, radii.y * d.y, radii.z * d.z}));
    }
    const Planes hits = test.trace(rays.planes);
    return static_cast<size_t>(std::count(hits[0].begin(), hits[0].end(), kInfinity));
}

TEST(TraceWatertight, NoRayLeavesAClosedMesh) {
    constexpr size_t kCount = 1 << 19;
    for (double scale : {1e-3, 1.0, 1e5})
        EXPECT_EQ(leaks(sphere_mesh(100, {0, 0, 0}, static_cast<float>(scale), false), {0, 0, 0},
                        Double3{scale, scale, scale}, kCount, 41),
                  0u)
            << scale;
    // Embree's place for this test: coordinates whose rounding is a hundredth of a triangle.
    EXPECT_EQ(leaks(sphere_mesh(100, {148376, 1234, -223423}, 200, false), {148376, 1234, -223423},
                    {200, 200, 200}, kCount, 42),
              0u);
    // Needles: a million times as long as wide.
    Mesh needles = sphere_mesh(100, {0, 0, 0}, 1, false);
    for (auto& p : needles.positions) p[0] *= 1e6f;
    EXPECT_EQ(leaks(needles, {0, 0, 0}, {1e6, 1, 1}, kCount, 43), 0u);
}

TEST(TraceSmall, TinyTrianglesAreHitWhereTheyAre) {
    constexpr size_t kTriangles = 8192, kRaysEach = 128, kCount = kTriangles * kRaysEach;
    const Mesh mesh = random_triangles(static_cast<int>(kTriangles), 1e-4f, 44);
    Scene scene;
    add_mesh(scene, mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    SelfTest test(scene);
    std::mt19937 rng(45);
    Rays rays(kCount);
    std::vector<double> distance(kCount);
    for (size_t i = 0; i < kCount; ++i) {
        const auto& t = mesh.triangles[i % kTriangles];
        const Double3 a = to_double3(mesh.positions[t[0]]), b = to_double3(mesh.positions[t[1]]),
                      c = to_double3(mesh.positions[t[2]]);
        // Not edge-on: the tiny angle that float32 leaves of a direction would decide.
        const Double3 n = normalized(cross(b - a, c - a)), middle = (a + b + c) / 3;
        Double3 d = random_direction(rng);
        d = normalized(d + n * (dot(d, n) < 0 ? -0.5 : 0.5));
        rays.set(i, middle - d * 2.0, d);
        distance[i] = dot(middle - rays.origin(i), d);
    }
    const Planes hits = test.trace(rays.planes);
    size_t wrong = 0;
    for (size_t i = 0; i < kCount; ++i)  // another one may lie before it
        wrong += id_of(hits, i) != static_cast<int32_t>(i % kTriangles) &&
                 !(hits[0][i] < distance[i] - 1e-4);
    EXPECT_EQ(wrong, 0u);
}

TEST(TraceSelfHit, NoRayHitsWhatItStartsOn) {
    // Triangles over eight decades of size and place, each hit and left again in random directions,
    // without skip.
    std::mt19937 rng(51);
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    constexpr size_t kTriangles = 1024, kDirections = 2048, kCount = kTriangles * kDirections;
    Scene scene;
    Mesh mesh;
    Rays rays(kTriangles);
    for (uint32_t i = 0; i < kTriangles; ++i) {
        const double size = std::pow(10.0, 4 * unit(rng)),
                     place = size * std::pow(10.0, 2 * unit(rng));
        const Double3 center = Double3{unit(rng), unit(rng), unit(rng)} * place;
        Double3 p[3];
        for (Double3& corner : p) {
            corner =
                to_double3(to_floats(center + Double3{unit(rng), unit(rng), unit(rng)} * size));
            mesh.positions.push_back(to_floats(corner));
        }
        mesh.triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
        const Double3 target = p[0] * 0.3 + p[1] * 0.4 + p[2] * 0.3;
        const Double3 o = target + random_direction(rng) * size;
        rays.set(i, o, normalized(target - to_double3(to_floats(o))));
    }
    add_mesh(scene, mesh, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    SelfTest test(scene);
    const Planes hits = test.trace(rays.planes);
    Rays away(kCount);
    for (size_t i = 0; i < kCount; ++i) {
        const size_t from = i / kDirections;
        const Double3 p{hits[4][from], hits[5][from], hits[6][from]},
            n{hits[7][from], hits[8][from], hits[9][from]};
        Double3 d = random_direction(rng);
        if (i % 4 == 0) d = normalized(d - n * (dot(d, n) * 0.999));  // grazing
        away.set(i, p + n * (dot(n, d) < 0 ? -hits[13][from] : hits[13][from]), d);
    }
    const Planes again = test.trace(away.planes);
    size_t self = 0;
    for (size_t i = 0; i < kCount; ++i)
        self += hits[0][i / kDirections] < kInfinity && again[0][i] < kInfinity &&
                id_of(again, i) == id_of(hits, i / kDirections);
    EXPECT_EQ(self, 0u);
}

TEST(TraceSelfHit, NoRayHitsTheShapeItLeaves) {
    std::mt19937 rng(52);
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    constexpr size_t kRays = 4096;
    for (int round = 0; round < 24; ++round) {
        const auto type = std::array{Shape::Type::kRectangle, Shape::Type::kDisk,
                                     Shape::Type::kCube, Shape::Type::kSphere}[round % 4];
        const double size = std::pow(10.0, 3 * unit(rng)),
                     place = size * std::pow(10.0, 2 * unit(rng));
        const Double3 center = Double3{unit(rng), unit(rng), unit(rng)} * place;
        const Matrix4 turn = rotate(0, static_cast<float>(180 * unit(rng))) *
                             rotate(1, static_cast<float>(180 * unit(rng)));
        Scene scene;
        const auto at = to_floats(center);
        add_shape(scene, type,
                  translate(at[0], at[1], at[2]) * turn * scale(static_cast<float>(size)),
                  add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
        SelfTest test(scene);
        Rays rays(kRays);
        for (size_t i = 0; i < kRays; ++i) {
            const Double3 o = center + random_direction(rng) * (3 * size);
            rays.set(i, o,
                     normalized(center + Double3{unit(rng), unit(rng), unit(rng)} * (0.5 * size) -
                                to_double3(to_floats(o))));
        }
        const Planes hits = test.trace(rays.planes);
        Rays away(kRays);
        for (size_t i = 0; i < kRays; ++i) {
            const Double3 p{hits[4][i], hits[5][i], hits[6][i]},
                n{hits[7][i], hits[8][i], hits[9][i]};
            Double3 d = random_direction(rng);
            if (dot(d, n) < 0) d = -d;
            if (i % 2 == 0) d = normalized(d - n * (dot(d, n) * 0.999));
            if (hits[0][i] < kInfinity)
                away.set(i, p + n * static_cast<double>(hits[13][i]), d);
            else
                away.set(i, center + Double3{9 * size, 0, 0}, {1, 0, 0});
        }
        const Planes again = test.trace(away.planes);
        EXPECT_EQ(std::count(again[0].begin(), again[0].end(), kInfinity),
                  static_cast<std::ptrdiff_t>(kRays))
            << "shape type " << round % 4 << " size " << size << " place " << place;
    }
}

}  // namespace
}  // namespace pave::test
