// Textures: lookups against a reference in double, coordinates of every shape through the albedo.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <random>

#include "pave/error.h"
#include "selftest.h"

namespace pave::test {
namespace {

using Wrap = Texture::Wrap;

Texture random_bitmap(int width, int height, bool is_bytes, uint32_t seed) {
    std::mt19937 rng(seed);
    Texture texture;
    texture.image = {.width = width, .height = height};
    const auto pixels = static_cast<size_t>(width * height);
    if (is_bytes) {
        texture.image.bytes.resize(4 * pixels);
        for (uint8_t& x : texture.image.bytes) x = static_cast<uint8_t>(rng() % 256);
    } else {
        texture.image.floats.resize(3 * pixels);
        for (float& x : texture.image.floats) x = static_cast<float>(rng() % 1000) / 1000.0f;
    }
    return texture;
}

double decoded(const Texture& t, int x, int y, size_t c) {
    const auto at = static_cast<size_t>(y * t.image.width + x);
    if (t.image.bytes.empty()) return t.image.floats[3 * at + c];
    const double value = t.image.bytes[4 * at + c] / 255.0;
    if (t.is_raw) return value;
    return value <= 0.04045 ? value / 12.92 : std::pow((value + 0.055) / 1.055, 2.4);
}

/// Texel that index `i` of a row or column of `size` stands for.
int wrapped(int i, int size, Wrap wrap) {
    if (wrap == Wrap::kClamp) return std::clamp(i, 0, size - 1);
    const int period = wrap == Wrap::kRepeat ? size : 2 * size;
    const int inside = ((i % period) + period) % period;
    return inside < size ? inside : 2 * size - 1 - inside;
}

double looked_up(const Texture& t, double u, double v, size_t c) {
    const auto& m = t.uv_map;
    const double x = (m[0] * u + m[1] * v + m[2]) * t.image.width,
                 y = (m[3] * u + m[4] * v + m[5]) * t.image.height;
    const auto at = [&](double i, double j) {
        return decoded(t, wrapped(static_cast<int>(i), t.image.width, t.wrap),
                       wrapped(static_cast<int>(j), t.image.height, t.wrap), c);
    };
    if (t.is_nearest) return at(std::floor(x), std::floor(y));
    const double i = std::floor(x - 0.5), j = std::floor(y - 0.5), a = x - 0.5 - i, b = y - 0.5 - j;
    return (1 - b) * ((1 - a) * at(i, j) + a * at(i + 1, j)) +
           b * ((1 - a) * at(i, j + 1) + a * at(i + 1, j + 1));
}

/// A scene whose materials use the textures, on one rectangle each.
Scene scene_with(const std::vector<Texture>& textures) {
    Scene scene;
    scene.textures = textures;
    for (size_t i = 0; i < textures.size(); ++i) {
        const int bsdf = add_diffuse(scene, {1, 1, 1});
        scene.bsdfs.back().reflectance_texture = static_cast<int>(i);
        add_shape(scene, Shape::Type::kRectangle, scale(1.0f), bsdf);
    }
    return scene;
}

TEST(Textures, AreLookedUpAsTheFormulaSays) {
    std::vector<Texture> textures;
    for (const Wrap wrap : {Wrap::kRepeat, Wrap::kMirror, Wrap::kClamp})
        for (const bool nearest : {false, true})
            for (const bool is_bytes : {false, true}) {
                // Also a single texel, and sizes that are no power of two.
                Texture texture = random_bitmap(textures.size() % 4 == 0 ? 1 : 13, 7, is_bytes,
                                                static_cast<uint32_t>(textures.size()));
                texture.wrap = wrap;
                texture.is_nearest = nearest;
                texture.is_raw = textures.size() % 3 == 0;
                if (textures.size() % 2 == 0) texture.uv_map = {1.5f, 0.25f, 0.1f, -0.5f, 2, -0.3f};
                textures.push_back(texture);
            }
    constexpr size_t kCount = 4096;
    std::mt19937 rng(3);
    std::uniform_real_distribution<float> wide(-3.0f, 3.0f);
    Planes uv = make_planes(2, kCount);
    for (auto& plane : uv)
        for (float& x : plane) x = wide(rng);
    for (const int lanes : {1, 4, 8, 16}) {
        SelfTest test(scene_with(textures), lanes);
        for (size_t t = 0; t < textures.size(); ++t) {
            const Planes colours = test.texture(static_cast<int>(t), uv);
            size_t far = 0;
            for (size_t i = 0; i < kCount; ++i)
                for (size_t c = 0; c < 3; ++c) {
                    const double expected = looked_up(textures[t], uv[0][i], uv[1][i], c);
                    far += std::abs(colours[c][i] - expected) > 2e-4;
                }
            // At the edge of a texel, nearest may round to the other one.
            EXPECT_LE(far, textures[t].is_nearest ? 12u : 0u) << "texture " << t;
        }
    }
}

TEST(Textures, CheckersAlternateAtTheHalf) {
    Texture checkers;
    checkers.type = Texture::Type::kCheckerboard;
    checkers.color0 = {0.1f, 0.2f, 0.3f};
    checkers.color1 = {0.6f, 0.7f, 0.8f};
    checkers.uv_map = {2, 0, 0, 0, 1, 0};
    SelfTest test(scene_with({checkers}));
    Planes uv = make_planes(2, 16);
    uv[0] = {0.1f, 0.3f, 0.1f, 0.3f, -0.1f, 0.6f, 0.6f, 1.1f, 0, 0, 0, 0, 0, 0, 0, 0};
    uv[1] = {0.1f, 0.1f, 0.6f, 0.6f, 0.1f, 0.1f, -0.1f, 5.6f, 0, 0, 0, 0, 0, 0, 0, 0};
    const std::vector<int> second{0, 1, 1, 0, 1, 0, 1, 1};
    const Planes colours = test.texture(0, uv);
    for (size_t i = 0; i < second.size(); ++i)
        EXPECT_FLOAT_EQ(colours[0][i], second[i] ? 0.6f : 0.1f) << i;
}

TEST(Textures, ThatAreBrokenAreRefused) {
    Scene scene = scene_with({random_bitmap(4, 4, true, 1)});
    scene.textures[0].image.bytes.pop_back();
    EXPECT_THROW(build_scene_data(scene, {}), InputError);
    scene = scene_with({random_bitmap(4, 4, true, 1)});
    scene.bsdfs[0].reflectance_texture = 1;
    EXPECT_THROW(build_scene_data(scene, {}), InputError);
    scene = scene_with({random_bitmap(4, 4, true, 1)});
    add_mesh(scene, sphere_mesh(4, {0, 0, 0}, 1, true), 0);
    EXPECT_THROW(build_scene_data(scene, {}), InputError) << "a mesh without coordinates";
}

/// Albedo (u, v, 0): what a texture of two texels a side gives between their centres, widened so
/// that all of [0, 1] lies there.
Texture coordinates_as_colours() {
    Texture texture;
    texture.wrap = Wrap::kClamp;
    texture.image = {.width = 2, .height = 2};
    texture.image.floats = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0};
    texture.uv_map = {0.5f, 0, 0.25f, 0, 0.5f, 0.25f};
    return texture;
}

/// Renders one textured shape and compares albedo with (u, v) of the position in object space.
void expect_coordinates(Shape::Type type, const Matrix4& m, const Matrix4& inverse,
                        const std::function<std::array<double, 2>(std::array<double, 3>)>& uv,
                        const RendererPaths& paths) {
    Scene scene;
    scene.textures.push_back(coordinates_as_colours());
    const int bsdf = add_diffuse(scene, {1, 1, 1});
    scene.bsdfs.back().reflectance_texture = 0;
    add_shape(scene, type, m, bsdf);
    scene.view = look_at({1.5f, 2.5f, 6}, {0, 0, 0}, {0, 1, 0}, 30);
    const Frame frame = render(scene, 32, 32, {"albedo", "position", "depth"}, {.spp = 1}, paths);
    size_t seen = 0;
    for (size_t i = 0; i < 1024; ++i) {
        if (std::isinf(frame.channel("depth")[i])) continue;
        std::array<double, 3> p{};
        for (size_t row = 0; row < 3; ++row)
            p[row] = inverse[4 * row] * frame.channel("position")[i] +
                     inverse[4 * row + 1] * frame.channel("position")[1024 + i] +
                     inverse[4 * row + 2] * frame.channel("position")[2048 + i] +
                     inverse[4 * row + 3];
        const std::array<double, 2> expected = uv(p);
        ++seen;
        for (size_t k = 0; k < 2; ++k)
            ASSERT_NEAR(frame.channel("albedo")[1024 * k + i], expected[k], 1e-4)
                << static_cast<int>(type) << " at " << p[0] << " " << p[1] << " " << p[2];
    }
    EXPECT_GT(seen, 50u);
}

double turn(double x, double y) {
    const double t = std::atan2(y, x) / (2 * M_PI);
    return t < 0 ? t + 1 : t;
}

TEST(Textures, CoordinatesFollowTheShape) {
    using Type = Shape::Type;
    using Point = std::array<double, 3>;
    const Matrix4 m = translate(0.1f, 0.2f, 0) * rotate(1, 20) * scale(1.25f),
                  inverse = scale(0.8f) * rotate(1, -20) * translate(-0.1f, -0.2f, 0);
    const auto square = [](Point p) { return std::array{(p[0] + 1) / 2, (p[1] + 1) / 2}; };
    const auto disk = [](Point p) { return std::array{std::hypot(p[0], p[1]), turn(p[0], p[1])}; };
    const auto sphere = [](Point p) {
        return std::array{turn(p[0], p[1]), std::acos(std::clamp(p[2], -1.0, 1.0)) / M_PI};
    };
    // The faces that the camera sees: Mitsuba's cube, read back from its mesh.
    const auto cube = [](Point p) {
        const double x = (p[0] + 1) / 2, y = (p[1] + 1) / 2, z = (p[2] + 1) / 2;
        if (std::abs(p[2] - 1) < 1e-4) return std::array{y, x};
        if (std::abs(p[1] - 1) < 1e-4) return std::array{1 - x, 1 - z};
        if (std::abs(p[0] - 1) < 1e-4) return std::array{y, 1 - z};
        return std::array{y, z};  // x = -1
    };
    for (const RendererPaths& paths : {RendererPaths{}, RendererPaths{.broadcast_shapes = 0},
                                       RendererPaths{.specialise = false}}) {
        expect_coordinates(Type::kRectangle, m, inverse, square, paths);
        expect_coordinates(Type::kDisk, m, inverse, disk, paths);
        expect_coordinates(Type::kSphere, m, inverse, sphere, paths);
        expect_coordinates(Type::kCube, m, inverse, cube, paths);
    }
}

TEST(Textures, CoordinatesAreInterpolatedOnTriangles) {
    Scene scene;
    scene.textures.push_back(coordinates_as_colours());
    const int bsdf = add_diffuse(scene, {1, 1, 1});
    scene.bsdfs.back().reflectance_texture = 0;
    Mesh mesh;
    mesh.positions = {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}};
    mesh.texcoords = {{0, 0.25f}, {1, 0.25f}, {1, 0.75f}, {0, 0.75f}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    add_mesh(scene, mesh, bsdf);
    scene.view = look_at({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 25);
    const Frame frame = render(scene, 16, 16, {"albedo", "position"}, {.spp = 1});
    for (size_t i = 0; i < 256; ++i) {
        EXPECT_NEAR(frame.channel("albedo")[i], (frame.channel("position")[i] + 1) / 2, 1e-4);
        EXPECT_NEAR(frame.channel("albedo")[256 + i], 0.5 + frame.channel("position")[256 + i] / 4,
                    1e-4);
    }
}

}  // namespace
}  // namespace pave::test
