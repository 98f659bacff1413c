// Lights: samples follow the density that a ray which hits the light computes, and carry its
// radiance.
// SPDX-License-Identifier: BSD-3-Clause
#include <numeric>
#include <random>

#include "selftest.h"

namespace pave::test {
namespace {

using Type = Shape::Type;

Scene one_light(Type type, const Matrix4& m, bool flip = false) {
    Scene scene;
    Shape& shape = add_shape(scene, type, m, add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    shape.flip_normals = flip;
    make_emitter(shape, {1, 2, 3});
    return scene;
}

struct LightCase {
    const char* name;
    Scene scene;
    float reach = 2.0f;  // points are chosen up to this far from the origin
};

std::vector<LightCase> cases() {
    Scene triangles;
    make_emitter(add_mesh(triangles, random_triangles(1, 1.0f, 4),
                          add_diffuse(triangles, {0.5f, 0.5f, 0.5f})),
                 {1, 2, 3});
    Scene ball;
    make_emitter(add_mesh(ball, sphere_mesh(8, {0, 0, 0}, 0.8f, false),
                          add_diffuse(ball, {0.5f, 0.5f, 0.5f})),
                 {1, 2, 3});
    Scene sky;
    sky.has_environment = true;
    sky.environment = {1, 2, 3};
    // A small bright sun in a varied, turned sky, with black pixels.
    Scene map;
    map.has_environment = true;
    map.environment_map = {.width = 16, .height = 9};
    for (int i = 0; i < 16 * 9; ++i)
        for (int c = 0; c < 3; ++c)
            map.environment_map.floats.push_back(i == 60 ? 50.0f
                                                         : static_cast<float>((i * (c + 3)) % 5));
    map.environment = {2, 2, 2};
    map.map_from_world = {0.36f, 0.48f, -0.8f, -0.8f, 0.6f, 0, 0.48f, 0.64f, 0.6f};
    // Lights of very different power, none in front of another as seen from near the origin.
    Scene many;
    const int grey = add_diffuse(many, {0.5f, 0.5f, 0.5f});
    make_emitter(add_shape(many, Type::kRectangle, translate(0, 0, 4) * rotate(0, 180), grey),
                 {9, 9, 9});
    make_emitter(add_shape(many, Type::kDisk, translate(0, 0, -4), grey), {3, 2, 1});
    make_emitter(add_shape(many, Type::kSphere, translate(4, 0, 0) * scale(1.5f), grey), {1, 1, 1});
    make_emitter(add_shape(many, Type::kCube, translate(-4, 0, 0) * rotate(2, 30), grey),
                 {0.1f, 0.1f, 0.1f});
    make_emitter(add_mesh(many, sphere_mesh(6, {0, 4, 0}, 1.2f, false), grey), {5, 1, 1});
    return {
        {"rectangle", one_light(Type::kRectangle, rotate(0, 40) * scale(1, 0.4f, 1))},
        {"parallelogram",
         one_light(Type::kRectangle, {1, 0.5f, 0, 0, 0, 0.7f, 0, 0, 0.2f, 0, 1, 0, 0, 0, 0, 1})},
        {"ellipse", one_light(Type::kDisk, rotate(1, 25) * scale(1, 0.5f, 1))},
        {"cube", one_light(Type::kCube, rotate(1, 25) * scale(0.5f, 0.7f, 0.4f))},
        {"sphere", one_light(Type::kSphere, scale(0.7f))},
        {"sphere from inside", one_light(Type::kSphere, scale(3.0f), true), 2.9f},
        {"triangle", triangles},
        {"mesh", ball},
        {"sky", sky},
        {"map", map},
        {"many", many, 0.5f},
    };
}

/// Points around the origin, off the x-y plane that flat lights are near to: seen edge-on, a light
/// is thinner than the points that the density is integrated over.
std::vector<std::array<float, 3>> points(float reach, int count, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
    std::vector<std::array<float, 3>> result;
    for (int i = 0; i < count; ++i) {
        const float x = 0.5f * unit(rng), y = 0.5f * unit(rng);
        result.push_back({reach * x, reach * y, (i % 2 ? -0.7f : 0.7f) * reach});
    }
    return result;
}

TEST(LightChi2, SamplesFollowTheirDensity) {
    constexpr int kPoints = 4;
    const std::vector<LightCase> all = cases();
    const double least_p = sidak(kPoints * static_cast<int>(all.size()));
    double smallest = 1;
    for (const LightCase& c : all) {
        SelfTest test(c.scene);
        for (const auto& at : points(c.reach, kPoints, 21)) {
            const Planes s = test.sample_light(at, 5, 1 << 15);
            const double p = DirectionTest{}.p_value(
                s, [&](size_t i) { return s[3][i] > 0; },
                [&](const Planes& d) { return test.light_pdf(at, d); });
            smallest = std::min(smallest, p);
            EXPECT_GT(p, least_p) << c.name << " from " << at[0] << " " << at[1] << " " << at[2];
        }
    }
    RecordProperty("smallest_p", std::to_string(smallest));
}

TEST(LightChi2, NoticesADensityThatIsATenthOff) {
    for (const LightCase& c : cases()) {
        SelfTest test(c.scene);
        double least = 1;  // of some points a one-sided light is not seen at all
        for (const auto& at : points(c.reach, 4, 21)) {
            const Planes s = test.sample_light(at, 5, 1 << 15);
            const double p = DirectionTest{}.p_value(
                s, [&](size_t i) { return s[3][i] > 0; },
                [&](const Planes& d) {
                    std::vector<float> pdf = test.light_pdf(at, d);
                    for (float& x : pdf) x *= 1.1f;
                    return pdf;
                });
            least = std::min(least, p);
        }
        EXPECT_LT(least, 1e-4) << c.name;
    }
}

TEST(Light, BothWaysToTheDensityAgree) {
    for (const LightCase& c : cases()) {
        SelfTest test(c.scene);
        for (const auto& at : points(c.reach, 4, 22)) {
            const Planes s = test.sample_light(at, 6, 4096);
            const std::vector<float> pdf = test.light_pdf(at, {s[0], s[1], s[2]});
            size_t usable = 0, far = 0;
            for (size_t i = 0; i < pdf.size(); ++i)
                if (s[3][i] > 0) {
                    ++usable;
                    far += std::abs(pdf[i] / s[3][i] - 1) > 2e-3;
                }
            // A direction to a point on an edge may miss the light by a rounding.
            EXPECT_LE(static_cast<double>(far), 2e-3 * static_cast<double>(usable) + 1) << c.name;
        }
    }
}

TEST(Light, SampleCarriesTheRadiance) {
    for (const LightCase& c : cases()) {
        if (std::string(c.name) == "many" || std::string(c.name) == "map") continue;
        const Planes s = SelfTest(c.scene).sample_light({1.4f, 1.2f, 0.9f}, 7, 256);
        for (size_t i = 0; i < 256; ++i)
            for (size_t k = 0; k < 3; ++k)
                ASSERT_FLOAT_EQ(s[4 + k][i], static_cast<float>(k + 1)) << c.name;
    }
}

TEST(Light, PointLightFallsWithTheSquare) {
    Scene scene;
    scene.point_lights.push_back({{0, 0, 2}, {4, 8, 12}});
    const Planes s = SelfTest(scene).sample_light({0, 0, -2}, 8, 16);
    EXPECT_FLOAT_EQ(s[3][0], 1.0f);
    EXPECT_FLOAT_EQ(s[4][0], 4.0f / 16);
    EXPECT_FLOAT_EQ(s[6][0], 12.0f / 16);
    EXPECT_FLOAT_EQ(s[2][0], 1.0f);
}

TEST(Light, AreChosenByPower) {
    Scene scene;
    const int grey = add_diffuse(scene, {0.5f, 0.5f, 0.5f});
    std::vector<double> power;
    for (int i = 0; i < 37; ++i) {
        const float strength = static_cast<float>((i * i) % 11 + 1);
        make_emitter(
            add_shape(scene, Type::kRectangle, translate(static_cast<float>(3 * i), 0, 0), grey),
            {strength, strength, strength});
        power.push_back(strength);
    }
    const double total = std::accumulate(power.begin(), power.end(), 0.0);
    constexpr size_t kCount = 1 << 17;
    SelfTest test(scene);
    const Planes s = test.sample_light({50, 1, 5}, 9, kCount);
    std::vector<double> seen(power.size(), 0.0);
    for (size_t i = 0; i < kCount; ++i) seen[static_cast<size_t>(std::lround(s[7][i] / 3))] += 1;
    double statistic = 0;
    for (size_t i = 0; i < power.size(); ++i) {
        const double expected = kCount * power[i] / total;
        statistic += (seen[i] - expected) * (seen[i] - expected) / expected;
    }
    EXPECT_GT(chi2_tail(statistic, static_cast<double>(power.size() - 1)), 0.01);
    uint32_t last = 0;
    for (size_t i = 0; i + 1 < power.size(); ++i) {
        const uint32_t end = test.data().light_cdf[i];
        const float pmf = test.data().lights[i * LIGHT_ROWS][7];
        EXPECT_NEAR(pmf, (end - last) / 4294967296.0, 1e-7)
            << "density and choice must be one number";
        last = end;
    }
}

}  // namespace
}  // namespace pave::test
