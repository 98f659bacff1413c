// Light transport against closed forms: furnaces, form factors, glass and mirrors that must vanish
// in them.
// SPDX-License-Identifier: BSD-3-Clause
#include <random>

#include "host/render/double3.h"
#include "support.h"

namespace pave::test {
namespace {

// ---- Furnaces: everything emits 1 and reflects rho, so each further edge adds rho times the one
// before ----

struct Furnace {
    Shape::Type type;
    float rho;
};
void PrintTo(const Furnace& f, std::ostream* out) {
    *out << (f.type == Shape::Type::kSphere ? "sphere" : "cube") << " albedo " << f.rho;
}

class FurnaceTest : public ::testing::TestWithParam<Furnace> {};
INSTANTIATE_TEST_SUITE_P(Albedos, FurnaceTest, ::testing::ValuesIn([] {
                             std::vector<Furnace> all;
                             for (auto type : {Shape::Type::kSphere, Shape::Type::kCube})
                                 for (float rho : {0.0f, 0.2f, 0.5f, 0.8f, 0.95f})
                                     all.push_back({type, rho});
                             return all;
                         }()));

TEST_P(FurnaceTest, HasTheRadianceOfTheTruncatedSeries) {
    const auto [type, rho] = GetParam();
    Scene scene;
    Shape& shape =
        add_shape(scene, type, rotate(0, 20) * scale(2.0f), add_diffuse(scene, {rho, rho, rho}));
    shape.flip_normals = true;
    make_emitter(shape, {1, 1, 1});
    scene.view = look_at({0.3f, 0.2f, 0.1f}, {1, 0.4f, -0.3f}, {0, 1, 0}, 90);
    constexpr int kEdges = 40;
    const Frame frame =
        render(scene, 64, 64, {"color", "variance"}, {.spp = 4096, .max_depth = kEdges, .seed = 1});
    const double expected =
        (1 - std::pow(static_cast<double>(rho), kEdges)) / (1 - static_cast<double>(rho));
    const double radiance = mean(frame, "color"), spread = standard_error(frame);
    EXPECT_NEAR(radiance, expected, 1e-3 * expected)
        << "rerun: test_render --gtest_filter=*Furnace*";
    EXPECT_NEAR(radiance, expected, 4 * spread + 2e-6 * expected)
        << (radiance - expected) / spread << " sigma";
    RecordProperty("radiance", std::to_string(radiance));
    RecordProperty("expected", std::to_string(expected));
}

TEST(Furnace, ShippedScenesSayWhatTheyPromise) {
    // Le (1 - albedo^n) / (1 - albedo), and without a limit of edges Le / (1 - albedo).
    for (const char* name : {"furnace-sphere", "furnace-cube"})
        for (int edges : {-1, 6}) {
            const Scene scene =
                load_scene(name, {.defines = {{"albedo", "0.8"},
                                              {"radiance", "0.2"},
                                              {"max_depth", std::to_string(edges)}}});
            const Frame frame = render(scene, 32, 32, {"color", "variance"},
                                       {.spp = 2048, .max_depth = scene.max_depth});
            const double expected = edges < 0 ? 1.0 : 1.0 - std::pow(0.8, edges);
            EXPECT_NEAR(mean(frame, "color"), expected, 4 * standard_error(frame) + 2e-6) << name;
            EXPECT_NEAR(mean(frame, "color"), expected, 1e-3) << name;
        }
}

TEST(Furnace, HoldsForEveryDepth) {
    Scene scene;
    Shape& shape =
        add_shape(scene, Shape::Type::kCube, scale(1.0f), add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    shape.flip_normals = true;
    make_emitter(shape, {1, 1, 1});
    for (int edges : {1, 2, 3, 5}) {
        const Frame frame = render(scene, 16, 16, {"color", "variance", "direct"},
                                   {.spp = 1024, .max_depth = edges});
        EXPECT_NEAR(mean(frame, "color"), 2 - std::pow(0.5, edges - 1),
                    4 * standard_error(frame) + 1e-6)
            << edges << " edges";
        EXPECT_NEAR(mean(frame, "direct"), edges == 1 ? 1.0 : 1.5, 0.01) << edges << " edges";
    }
}

TEST(Furnace, RouletteKeepsTheMean) {
    Scene scene;
    Shape& shape =
        add_shape(scene, Shape::Type::kSphere, scale(1.0f), add_diffuse(scene, {0.7f, 0.4f, 0.1f}));
    shape.flip_normals = true;
    make_emitter(shape, {1, 1, 1});
    for (int rr_depth : {0, 1, 3, 64}) {
        const Frame frame = render(scene, 16, 16, {"color", "variance"},
                                   {.spp = 2048, .max_depth = 64, .rr_depth = rr_depth});
        for (size_t c = 0; c < 3; ++c) {
            const double expected = 1 / (1 - static_cast<double>(std::array{0.7f, 0.4f, 0.1f}[c]));
            EXPECT_NEAR(mean(frame, "color", c), expected, 4.2 * standard_error(frame, c) + 1e-5)
                << "roulette from " << rr_depth;
        }
    }
}

/// In a furnace without absorption every lossless thing is invisible.
TEST(Furnace, HidesGlassMirrorsAndSmoothMeshes) {
    for (bool sky : {false, true}) {
        Scene scene;
        add_material(scene, Bsdf::Type::kDielectric);
        add_material(scene, Bsdf::Type::kConductor);
        const int black = add_diffuse(scene, {0, 0, 0});
        if (sky) {
            scene.has_environment = true;
            scene.environment = {1, 1, 1};
        } else {
            Shape& room = add_shape(scene, Shape::Type::kSphere, scale(5.0f), black);
            room.flip_normals = true;
            make_emitter(room, {1, 1, 1});
        }
        add_shape(scene, Shape::Type::kSphere, translate(-1.2f, 0, 0), 0);
        add_shape(scene, Shape::Type::kCube, translate(1.2f, 0, 0) * rotate(1, 30) * scale(0.6f),
                  0);
        add_shape(scene, Shape::Type::kSphere, translate(0, 1.5f, 0) * scale(0.5f), 1);
        add_mesh(scene, sphere_mesh(16, {0, -1.5f, 0}, 0.6f, true), 1);
        scene.view = look_at({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 60);
        const Frame frame = render(scene, 32, 32, {"color", "variance"},
                                   {.spp = 256, .max_depth = 1000, .rr_depth = 20});
        // Shading normals send a few mirror rays at the mesh's rim into its far side, where they
        // end; all else is exact.
        EXPECT_NEAR(mean(frame, "color"), 1.0, 0.004) << (sky ? "sky" : "room");
        size_t visible = 0;
        for (float x : frame.channel("color")) visible += std::abs(x - 1) > 0.02;
        EXPECT_LT(visible, 3 * 32 * 32 / 50) << (sky ? "sky" : "room");
    }
}

// ---- Direct light from polygons: Lambert's formula, clipped at the horizon, in double ----

std::vector<Double3> clipped(const std::vector<Double3>& polygon) {
    std::vector<Double3> above;
    for (size_t i = 0; i < polygon.size(); ++i) {
        const Double3 a = polygon[i], b = polygon[(i + 1) % polygon.size()];
        if (a.z > 0) above.push_back(a);
        if ((a.z > 0) != (b.z > 0)) above.push_back(a + (b - a) * (a.z / (a.z - b.z)));
    }
    return above;
}

/// Form factor of the polygon seen from the origin with normal +z: irradiance over pi and radiance.
double form_factor(const std::vector<Double3>& polygon) {
    const std::vector<Double3> p = clipped(polygon);
    double sum = 0;
    for (size_t i = 0; i < p.size(); ++i) {
        const Double3 a = normalized(p[i]), b = normalized(p[(i + 1) % p.size()]), n = cross(a, b);
        if (length(n) > 0) sum += std::atan2(length(n), dot(a, b)) * n.z / length(n);
    }
    return std::abs(sum) / (2 * M_PI);
}

/// Radiance of a white floor at the origin, lit by `light` alone, and its standard error.
std::pair<double, double> lit_floor(const Shape& light, int size, int spp, uint64_t seed,
                                    const Shape* blocker = nullptr) {
    Scene scene;
    add_shape(scene, Shape::Type::kRectangle, scale(1e-3f), add_diffuse(scene, {1, 1, 1}));
    scene.shapes.push_back(light);
    scene.shapes.back().bsdf = add_diffuse(scene, {0, 0, 0});
    make_emitter(scene.shapes.back(), {1, 1, 1});
    if (blocker != nullptr) {
        scene.shapes.push_back(*blocker);
        scene.shapes.back().bsdf = 1;
    }
    // So near to the floor that no light is in between, so narrow that all pixels see the origin.
    scene.view = look_at({0, 0, 1e-3f}, {0, 0, 0}, {0, 1, 0}, 0.01f);
    const Frame frame = render(scene, size, size, {"color", "variance"},
                               {.spp = spp, .max_depth = 2, .seed = seed});
    return {mean(frame, "color"), standard_error(frame)};
}

TEST(DirectLight, UnitSquareAtDistanceOne) {
    const std::vector<Double3> square{
        {-0.5, -0.5, 1}, {0.5, -0.5, 1}, {0.5, 0.5, 1}, {-0.5, 0.5, 1}};
    ASSERT_NEAR(form_factor(square), 0.2394564705, 1e-10);
    Shape light;
    light.world_from_object = translate(0, 0, 1) * rotate(0, 180) * scale(0.5f);
    const auto [radiance, spread] = lit_floor(light, 32, 4096, 1);
    EXPECT_NEAR(radiance, 0.2394564705, 4 * spread);
    EXPECT_NEAR(radiance, 0.2394564705, 0.0005 * 0.2394564705);
}

/// The measured Cornell box: its floor is lit by the light alone, for the box is empty and black.
TEST(DirectLight, FloorOfTheEmptyCornellBox) {
    struct Place {
        double x, z, factor;
    };
    for (const Place& at : {Place{278, 279.6, 0.0142069570}, Place{0, 0, 0.0062781834}}) {
        // The floor's y is our z, seen from the point.
        std::vector<Double3> corners;
        for (auto [x, z] : {std::pair(343.0, 227.0), std::pair(343.0, 332.0),
                            std::pair(213.0, 332.0), std::pair(213.0, 227.0)})
            corners.push_back({x - at.x, z - at.z, 548.8});
        ASSERT_NEAR(form_factor(corners), at.factor, 1e-10);
        Shape light;
        light.world_from_object =
            translate(static_cast<float>(278 - at.x), static_cast<float>(279.5 - at.z), 548.8f) *
            rotate(0, 180) * scale(65, 52.5f, 1);
        const auto [radiance, spread] = lit_floor(light, 32, 4096, 3);
        EXPECT_NEAR(radiance, at.factor, 4 * spread + 1e-7);
        EXPECT_NEAR(radiance, at.factor, 0.0005 * at.factor);
    }
}

TEST(DirectLight, RandomPolygonsFollowLambertsFormula) {
    std::mt19937 rng(61);
    std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
    constexpr int kPolygons = 200;
    double bias = 0;
    int used = 0;
    for (int i = 0; i < kPolygons; ++i) {
        Shape light;
        std::vector<Double3> polygon;
        if (i % 2 == 0) {
            const Matrix4 m = translate(1.5f * unit(rng), 1.5f * unit(rng), 0.3f + unit(rng)) *
                              rotate(0, 180 * unit(rng)) * rotate(1, 180 * unit(rng)) *
                              scale(0.3f + std::abs(unit(rng)), 0.3f + std::abs(unit(rng)), 1);
            light.world_from_object = m;
            const Axes axes(m);
            for (auto [x, y] :
                 {std::pair(-1, -1), std::pair(1, -1), std::pair(1, 1), std::pair(-1, 1)})
                polygon.push_back(axes.origin + axes.x * x + axes.y * y);
            light.flip_normals = dot(cross(axes.x, axes.y), axes.origin) > 0;
        } else {
            light.type = Shape::Type::kMesh;
            light.mesh = random_triangles(1, 1.0f, static_cast<uint32_t>(i));
            for (const auto& p : light.mesh.positions) polygon.push_back(to_double3(p));
            if (dot(cross(polygon[1] - polygon[0], polygon[2] - polygon[0]), polygon[0]) > 0)
                std::swap(light.mesh.triangles[0][1], light.mesh.triangles[0][2]);
        }
        const double expected = form_factor(polygon);
        if (expected < 1e-3) continue;  // all but below the horizon
        const auto [radiance, spread] = lit_floor(light, 16, 1024, static_cast<uint64_t>(i));
        EXPECT_NEAR(radiance, expected, 4.2 * spread) << "polygon " << i;
        bias += radiance / expected - 1;
        ++used;
    }
    ASSERT_GT(used, kPolygons / 2);
    // A thousand samples a pixel leave 0.1 to 1 % each, so their mean is known to about 0.03 %.
    EXPECT_NEAR(bias / used, 0.0, 1e-3);
}

TEST(DirectLight, BlockersHideWhatIsBehindThem) {
    // Of the unit square at distance 1 the half with x > 0, by one shape of each kind.
    const double expected =
        form_factor({{-0.5, -0.5, 1}, {0, -0.5, 1}, {0, 0.5, 1}, {-0.5, 0.5, 1}});
    std::vector<Shape> blockers(6);
    blockers[0].world_from_object = translate(2, 0, 0.5f) * scale(2);
    // Slanted: its edge is the line x = 0, z = 0.5 all the same, but no other one is along an axis.
    blockers[1].world_from_object =
        translate(0, 0, 0.5f) * rotate(1, 20) * translate(2, 0, 0) * scale(2);
    blockers[2].type = Shape::Type::kCube;
    blockers[2].world_from_object = translate(2, 0, 0.5f) * scale(2, 2, 0.1f);
    blockers[3].type = Shape::Type::kDisk;
    blockers[3].world_from_object = translate(400, 0, 0.5f) * scale(400);
    blockers[4].type = Shape::Type::kSphere;
    blockers[4].world_from_object = translate(400, 0, 0.5f) * scale(400);
    blockers[5].type = Shape::Type::kMesh;
    blockers[5].mesh.positions = {{0, -2, 0.5f}, {4, -2, 0.5f}, {4, 2, 0.5f}, {0, 2, 0.5f}};
    blockers[5].mesh.normals.resize(4, {0, 0, 1});  // so that it stays a mesh
    blockers[5].mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    Shape light;
    light.world_from_object = translate(0, 0, 1) * rotate(0, 180) * scale(0.5f);
    for (size_t i = 0; i < blockers.size(); ++i) {
        const auto [radiance, spread] = lit_floor(light, 16, 4096, 4, &blockers[i]);
        // The round ones leave slivers of a thousandth at the ends of the edge.
        EXPECT_NEAR(radiance, expected, 4 * spread + 1e-3 * expected) << "blocker " << i;
    }
}

TEST(DirectLight, SphereIsADiskOfTheSameSolidAngle) {
    // A sphere wholly above the horizon: sin^2 of its half angle times the cosine to its center.
    Shape light;
    light.type = Shape::Type::kSphere;
    light.world_from_object = translate(0.8f, 0, 1.5f) * scale(0.5f);
    const double d2 = 0.8 * 0.8 + 1.5 * 1.5, expected = 0.25 / d2 * 1.5 / std::sqrt(d2);
    const auto [radiance, spread] = lit_floor(light, 16, 1024, 2);
    EXPECT_NEAR(radiance, expected, 4 * spread + 1e-6);
}

TEST(DirectLight, PointLightAndSky) {
    Scene scene;
    add_shape(scene, Shape::Type::kRectangle, scale(1.0f), add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    scene.point_lights.push_back({{0, 1, 1}, {3, 3, 3}});
    scene.view = look_at({0, 0, 1e-3f}, {0, 0, 0}, {0, 1, 0}, 0.01f);
    const Frame point = render(scene, 4, 4, {"color"}, {.spp = 16});
    EXPECT_NEAR(mean(point, "color"), 0.5 / M_PI * 3 * std::sqrt(0.5) / 2, 1e-6);
    scene.point_lights.clear();
    scene.has_environment = true;
    scene.environment = {2, 2, 2};
    const Frame sky = render(scene, 16, 16, {"color", "variance"}, {.spp = 256});
    EXPECT_NEAR(mean(sky, "color"), 1.0, 4 * standard_error(sky) + 1e-6);
}

}  // namespace
}  // namespace pave::test
