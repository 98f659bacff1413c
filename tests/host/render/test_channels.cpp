// Every channel against what geometry and statistics say it must be.
// SPDX-License-Identifier: BSD-3-Clause
#include <random>

#include "host/render/double3.h"
#include "host/render/scene_data.h"
#include "support.h"

namespace pave::test {
namespace {

constexpr int kWidth = 24, kHeight = 16;
const std::vector<std::string> kGeometry = {"albedo",   "normal",   "depth",
                                            "distance", "position", "object"};

/// Ray through film point (x, y) in pixels, by the camera's definition in Mitsuba: +x left, +y up,
/// +z ahead.
Double3 camera_ray(const View& view, double x, double y) {
    const Axes axes(view.world_from_camera);
    const double half = std::tan(static_cast<double>(view.fov_x_degrees) * M_PI / 360);
    const double u = half * (1 - 2 * x / kWidth),
                 v = half * kHeight / kWidth * (1 - 2 * y / kHeight);
    return normalized(axes.x * u + axes.y * v + axes.z);
}

TEST(Channels, PlaneIsWhereGeometryPutsIt) {
    Scene scene;
    const int grey = add_diffuse(scene, {0.2f, 0.4f, 0.6f});
    add_shape(scene, Shape::Type::kRectangle, translate(0, 0, -2) * rotate(1, 20) * scale(50),
              grey);
    scene.view = look_at({0.3f, 0.4f, 3}, {0.1f, 0.2f, 0}, {0.1f, 1, 0}, 60);
    const Frame frame = render(scene, kWidth, kHeight, kGeometry, {.spp = 64});
    const Axes plane(scene.shapes[0].world_from_object);
    const Double3 n = normalized(cross(plane.x, plane.y)),
                  eye = Axes(scene.view.world_from_camera).origin;
    const Double3 ahead = normalized(Axes(scene.view.world_from_camera).z);
    for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x) {
            const size_t i = static_cast<size_t>(y * kWidth + x), all = kWidth * kHeight;
            // The mean over the pixel lies between its corners, near its middle.
            double low = 1e30, high = 0;
            for (int corner = 0; corner < 4; ++corner) {
                const Double3 d = camera_ray(scene.view, x + (corner & 1), y + (corner >> 1));
                const double t = dot(plane.origin - eye, n) / dot(d, n);
                low = std::min(low, t * dot(d, ahead));
                high = std::max(high, t * dot(d, ahead));
            }
            const Double3 d = camera_ray(scene.view, x + 0.5, y + 0.5);
            const double t = dot(plane.origin - eye, n) / dot(d, n);
            ASSERT_GE(frame.channel("depth")[i], low - 1e-5);
            ASSERT_LE(frame.channel("depth")[i], high + 1e-5);
            ASSERT_NEAR(frame.channel("depth")[i], t * dot(d, ahead), 0.3 * (high - low) + 1e-4);
            ASSERT_NEAR(frame.channel("distance")[i], t, 0.05);
            const Double3 p{frame.channel("position")[i], frame.channel("position")[all + i],
                            frame.channel("position")[2 * all + i]};
            ASSERT_NEAR(dot(p - plane.origin, n), 0, 1e-5);
            ASSERT_NEAR(length(p - (eye + d * t)), 0, 0.15);
            for (size_t c = 0; c < 3; ++c) {
                ASSERT_NEAR(frame.channel("normal")[c * all + i], to_floats(n)[c], 1e-6);
                ASSERT_NEAR(frame.channel("albedo")[c * all + i], 0.2 * static_cast<double>(c + 1),
                            1e-6);
            }
            ASSERT_EQ(frame.channel("object")[i], 0.0f);
        }
}

TEST(Channels, PixelIsSampledEvenly) {
    // A light whose edges cut the only pixel: its share of the pixel is the mean, whatever the
    // edges' direction.
    for (const Sampler sampler : {Sampler::kSobol, Sampler::kIndependent})
        for (const float degrees : {0.0f, 45.0f, 90.0f, 135.0f}) {
            Scene scene;
            // An edge through (0.2, 0.1) of the square that the camera sees, [-1, 1]^2.
            make_emitter(add_shape(scene, Shape::Type::kRectangle,
                                   translate(0.2f, 0.1f, 0) * rotate(2, degrees) *
                                       translate(5, 0, 0) * scale(5),
                                   add_diffuse(scene, {0, 0, 0})),
                         {1, 1, 1});
            scene.view = look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0}, 90);
            const Frame frame =
                render(scene, 1, 1, {"color"}, {.spp = 1 << 16, .sampler = sampler});
            const double a = degrees * M_PI / 180, nx = std::cos(a), ny = std::sin(a);
            double inside = 0;  // midpoints of a grid
            constexpr int kFine = 512;
            for (int i = 0; i < kFine * kFine; ++i) {
                const double x = (2.0 * (i % kFine) + 1) / kFine - 1.2,
                             y = (2.0 * (i / kFine) + 1) / kFine - 1.1;
                inside += nx * x + ny * y > 0;
            }
            EXPECT_NEAR(mean(frame, "color"), inside / (kFine * kFine), 0.01) << degrees;
        }
}

TEST(Channels, OnePixelIsExact) {
    // So narrow a view that jitter does not matter: one float's worth of agreement with the closed
    // form.
    Scene scene;
    const int grey = add_diffuse(scene, {0.5f, 0.5f, 0.5f});
    add_shape(scene, Shape::Type::kRectangle, translate(7, 7, 7), grey);
    Shape& ball =
        add_shape(scene, Shape::Type::kSphere, translate(0.1f, 0.2f, 0.3f) * scale(0.5f), grey);
    ball.flip_normals = true;
    scene.view = look_at({1, 2, 3}, {0.2f, 0.3f, 0.5f}, {0, 1, 0}, 0.00005f);
    const Frame frame = render(scene, 1, 1, kGeometry, {.spp = 4});
    const Double3 eye{1, 2, 3}, center = to_double3({0.1f, 0.2f, 0.3f}),
                                d = normalized(Axes(scene.view.world_from_camera).z);
    const double b = dot(d, eye - center),
                 t = -b - std::sqrt(b * b - dot(eye - center, eye - center) + 0.25);
    const Double3 p = eye + d * t, n = (p - center) * -2.0;
    EXPECT_NEAR(frame.channel("distance")[0], t, 1e-5 * t);
    EXPECT_NEAR(frame.channel("depth")[0], t, 1e-5 * t);
    for (size_t c = 0; c < 3; ++c) {
        EXPECT_NEAR(frame.channel("position")[c], to_floats(p)[c], 1e-5 * t);
        EXPECT_NEAR(frame.channel("normal")[c], to_floats(n)[c], 1e-5);
    }
    EXPECT_EQ(frame.channel("object")[0], 1.0f);
}

TEST(Channels, MissIsZeroAndInfinitelyFar) {
    Scene scene;
    add_shape(scene, Shape::Type::kSphere, scale(0.1f), add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    scene.view = look_at({0, 0, 5}, {0, 0, 0}, {0, 1, 0}, 40);
    std::vector<std::string> channels = kGeometry;
    channels.insert(channels.end(), {"color", "direct", "variance"});
    const Frame frame = render(scene, 16, 16, channels, {.spp = 8});
    EXPECT_TRUE(std::isinf(frame.channel("depth")[0]) && frame.channel("depth")[0] > 0);
    EXPECT_TRUE(std::isinf(frame.channel("distance")[0]));
    EXPECT_EQ(frame.channel("object")[0], -1.0f);
    for (const char* channel : {"albedo", "normal", "position", "color", "direct", "variance"})
        for (size_t c = 0; c < 3; ++c) EXPECT_EQ(frame.channel(channel)[c * 256], 0.0f) << channel;
    // At the rim some samples miss: depth is the mean over those that hit, so never beyond the
    // sphere.
    for (float depth : frame.channel("depth"))
        EXPECT_TRUE(std::isinf(depth) || (depth > 4.89f && depth < 5.01f)) << depth;
    for (size_t i = 0; i < 256; ++i)
        if (std::isfinite(frame.channel("depth")[i])) {
            const Double3 n{frame.channel("normal")[i], frame.channel("normal")[256 + i],
                            frame.channel("normal")[512 + i]};
            EXPECT_NEAR(length(n), 1.0, 1e-5);
        }
}

TEST(Channels, AlbedoLooksThroughGlassAndMirrors) {
    Scene scene;
    const int red = add_diffuse(scene, {0.8f, 0.2f, 0.1f}, true);
    add_material(scene, Bsdf::Type::kDielectric);
    add_material(scene, Bsdf::Type::kConductor);
    Shape& room = add_shape(scene, Shape::Type::kCube, scale(5), red);
    room.flip_normals = true;
    add_shape(scene, Shape::Type::kSphere, translate(-1.1f, 0, 0), 1);
    add_shape(scene, Shape::Type::kSphere, translate(1.1f, 0, 0), 2);
    scene.view = look_at({0, 0, 4.5f}, {0, 0, 0}, {0, 1, 0}, 60);
    const Frame frame = render(scene, 32, 32, {"albedo", "object"}, {.spp = 64, .rr_depth = 50});
    for (size_t i = 0; i < 1024; ++i) {
        EXPECT_NEAR(frame.channel("albedo")[i], 0.8, 0.02)
            << "object " << frame.channel("object")[i];
        EXPECT_NEAR(frame.channel("albedo")[2048 + i], 0.1, 0.01);
    }
    // Roulette may end the chain, but must not darken what lies behind it.
    const Frame early = render(scene, 32, 32, {"albedo"}, {.spp = 256, .rr_depth = 1});
    EXPECT_NEAR(mean(early, "albedo"), mean(frame, "albedo"), 2e-3);
}

TEST(Channels, VarianceDoesNotDependOnTheLanes) {
    // Lanes end their paths in another order, but the samples are the same.
    Renderer renderer(device(), cornell());
    RenderOptions options{.spp = 8, .lane_width = 1};
    const Frame reference = render(renderer, 32, 32, {"color", "variance"}, options);
    for (int lanes : {4, 8, 16}) {
        options.lane_width = lanes;
        const Frame other = render(renderer, 32, 32, {"color", "variance"}, options);
        size_t far = 0;
        for (size_t i = 0; i < 3 * 1024; ++i) {
            const float a = reference.channel("variance")[i], b = other.channel("variance")[i];
            far += std::abs(a - b) > 1e-3f * std::max(a, b) + 1e-9f;
        }
        // Paths that a rounding sends another way.
        EXPECT_LE(far, 60u) << lanes << " lanes";
        EXPECT_NEAR(mean(other, "variance") / mean(reference, "variance"), 1.0, 0.02) << lanes;
    }
}

TEST(Channels, DirectIsTheImageOfTwoEdges) {
    for (const Scene& scene : {cornell(), menagerie()}) {
        const Frame full = render(scene, 32, 32, {"color", "direct"}, {.spp = 64});
        const Frame two = render(scene, 32, 32, {"color", "direct"}, {.spp = 64, .max_depth = 2});
        // The same samples, added as their paths end: longer paths change the order of additions.
        for (size_t i = 0; i < 3 * 1024; ++i)
            ASSERT_NEAR(full.channel("direct")[i], two.channel("direct")[i],
                        1e-6 * (1 + two.channel("direct")[i]))
                << scene.name << " value " << i;
        for (size_t i = 0; i < 3 * 1024; ++i) {
            ASSERT_NEAR(two.channel("color")[i], two.channel("direct")[i],
                        1e-6 * (1 + two.channel("color")[i]));
            ASSERT_GE(full.channel("color")[i] * 1.00001f + 1e-6f, full.channel("direct")[i]);
        }
    }
}

TEST(Channels, VarianceIsThatOfTheMean) {
    // 256 independent images of 16 samples: their scatter is what each predicts of itself, on
    // average.
    Renderer renderer(device(), cornell());
    constexpr int kImages = 256;
    constexpr size_t kPixels = 8 * 8;
    std::vector<double> sum(kPixels), squares(kPixels), predicted(kPixels);
    for (int k = 0; k < kImages; ++k) {
        const Frame frame =
            render(renderer, 8, 8, {"color", "variance"},
                   {.spp = 16, .sampler = Sampler::kIndependent, .seed = static_cast<uint64_t>(k)});
        for (size_t i = 0; i < kPixels; ++i) {
            const double x = frame.channel("color")[i];
            sum[i] += x;
            squares[i] += x * x;
            predicted[i] += frame.channel("variance")[i];
        }
    }
    double found = 0, said = 0;
    for (size_t i = 0; i < kPixels; ++i) {
        found += (squares[i] - sum[i] * sum[i] / kImages) / (kImages - 1);
        said += predicted[i] / kImages;
    }
    EXPECT_NEAR(said / found, 1.0, 0.1);
}

TEST(Channels, VarianceFallsAsOneOverSamples) {
    // Across passes too: 2^4 to 2^12 samples; a pass holds 2^8.
    Renderer renderer(device(), cornell());
    std::vector<double> log_variance;
    for (int log_spp = 4; log_spp <= 12; log_spp += 2)
        log_variance.push_back(std::log2(mean(
            render(renderer, 16, 16, {"color", "variance"}, {.spp = 1 << log_spp}), "variance")));
    const double slope = (log_variance.back() - log_variance.front()) / 8;
    EXPECT_NEAR(slope, -1.0, 0.05);
}

TEST(Channels, ConstantPixelsHaveNoVariance) {
    Scene scene;
    Shape& light =
        add_shape(scene, Shape::Type::kRectangle, scale(10), add_diffuse(scene, {0, 0, 0}));
    make_emitter(light, {17, 12, 4});
    scene.view = look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0}, 40);
    const Frame frame = render(scene, 4, 4, {"color", "variance"}, {.spp = 1000});
    for (size_t i = 0; i < 16; ++i) {
        EXPECT_FLOAT_EQ(frame.channel("color")[i], 17.0f);
        EXPECT_EQ(frame.channel("variance")[i], 0.0f);
    }
}

/// As kernels/vertex.h does it, in double.
Double3 unpack_normal(uint32_t word) {
    double x = (static_cast<int>(word & 0xffff) - 32768) / 32767.0,
           y = (static_cast<int>(word >> 16) - 32768) / 32767.0;
    const double z = 1 - std::abs(x) - std::abs(y), fold = std::max(-z, 0.0);
    x -= std::copysign(fold, x);
    y -= std::copysign(fold, y);
    return normalized({x, y, z});
}

TEST(Channels, VertexNormalsArePackedWithin7e5) {
    std::mt19937 rng(5);
    std::normal_distribution<float> normal;
    std::uniform_int_distribution<int> step(-1, 1);
    for (int i = 0; i < 100000; ++i) {
        const bool on_grid = i % 4 == 0;  // axes, edges and corners of the octahedron
        std::array<float, 3> n;
        for (float& x : n) x = on_grid ? static_cast<float>(step(rng)) : normal(rng);
        const uint32_t word = pack_normal(n);
        if (n == std::array<float, 3>{0, 0, 0}) {
            ASSERT_EQ(word, 0u);
            continue;
        }
        ASSERT_NE(word, 0u);
        ASSERT_LT(length(unpack_normal(word) - normalized(to_double3(n))), 7e-5)
            << n[0] << " " << n[1] << " " << n[2];
    }
    EXPECT_EQ(pack_normal({std::numeric_limits<float>::quiet_NaN(), 0, 1}), 0u);
}

TEST(Channels, VertexNormalsAreInterpolated) {
    Scene scene;
    add_mesh(scene, sphere_mesh(12, {0, 0, 0}, 1, true), add_diffuse(scene, {0.5f, 0.5f, 0.5f}));
    scene.view = look_at({0, 0.3f, 4}, {0, 0, 0}, {0, 1, 0}, 24);
    const Frame frame = render(scene, 32, 32, {"normal", "position", "depth"}, {.spp = 64});
    const auto n = frame.channel("normal"), p = frame.channel("position");
    size_t seen = 0;
    for (size_t i = 0; i < 32 * 32; ++i) {
        const Double3 at{p[i], p[1024 + i], p[2048 + i]};
        if (!(length(at) > 0.9)) continue;  // a silhouette
        const Double3 normal = normalized({n[i], n[1024 + i], n[2048 + i]});
        // Facets' own normals are up to a tenth off.
        EXPECT_LT(length(normal - normalized(at)), 0.03) << "pixel " << i;
        ++seen;
    }
    EXPECT_GT(seen, 400u);
}

TEST(Channels, LightHasOneSide) {
    Scene scene;
    Shape& light =
        add_shape(scene, Shape::Type::kRectangle, scale(10), add_diffuse(scene, {0, 0, 0}));
    make_emitter(light, {1, 1, 1});
    const auto seen = [&](float z, bool flip) {
        scene.shapes[0].flip_normals = flip;
        scene.view = look_at({0, 0, z}, {0, 0, 0}, {0, 1, 0}, 40);
        return mean(render(scene, 2, 2, {"color"}, {.spp = 4}), "color");
    };
    EXPECT_FLOAT_EQ(static_cast<float>(seen(1, false)), 1.0f);
    EXPECT_EQ(seen(-1, false), 0.0);
    EXPECT_EQ(seen(1, true), 0.0);
    EXPECT_FLOAT_EQ(static_cast<float>(seen(-1, true)), 1.0f);
}

}  // namespace
}  // namespace pave::test
