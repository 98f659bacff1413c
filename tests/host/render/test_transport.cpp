// Light in closed rooms: both directions of a path, and where all of the light goes.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/double3.h"
#include "support.h"

namespace pave::test {
namespace {

using Type = Shape::Type;

// ---- Both directions: the irradiance that a point light gives to a patch, and the fluence that
// the patch gives to that point when it emits ----

constexpr float kPatch = 0.12f;  // half its side
const Matrix4 kPatchToWorld =
    translate(0.45f, -0.62f, 0.35f) * rotate(1, 25) * rotate(0, -60) * scale(kPatch);
constexpr std::array<float, 3> kPoint{-0.55f, 0.35f, 0.45f};
constexpr float kPatchRho = 0.4f;

/// A box with things that scatter in every way but by mirrors, which no point light is seen in; the
/// patch is the last shape.
Scene reciprocal_room() {
    Scene scene;
    const int white = add_diffuse(scene, {0.7f, 0.6f, 0.5f}, true);
    const int metal = add_material(scene, Bsdf::Type::kRoughConductor);
    scene.bsdfs.back().eta = {0.14f, 0.37f, 1.44f};
    scene.bsdfs.back().k = {3.98f, 2.39f, 1.6f};
    scene.bsdfs.back().alpha_u = 0.3f;
    scene.bsdfs.back().alpha_v = 0.6f;
    scene.bsdfs.back().two_sided = true;
    const int frosted = add_material(scene, Bsdf::Type::kRoughDielectric);
    scene.bsdfs.back().alpha_u = scene.bsdfs.back().alpha_v = 0.5f;
    Shape& room = add_shape(scene, Type::kCube, scale(1.0f), white);
    room.flip_normals = true;
    add_shape(scene, Type::kSphere, translate(-0.1f, -0.1f, 0.3f) * scale(0.3f), frosted);
    add_shape(scene, Type::kCube, translate(-0.4f, -0.6f, -0.3f) * rotate(1, 30) * scale(0.3f),
              metal);
    add_mesh(scene, sphere_mesh(8, {0.5f, 0.4f, -0.4f}, 0.35f, false), white);
    add_shape(scene, Type::kRectangle, kPatchToWorld,
              add_diffuse(scene, {kPatchRho, kPatchRho, kPatchRho}));
    return scene;
}

/// Irradiance of the patch, averaged over it, from a point light of intensity 1; and its error.
std::array<double, 2> irradiance_of_patch() {
    Scene scene = reciprocal_room();
    scene.point_lights.push_back({kPoint, {1, 1, 1}});
    const Axes axes(kPatchToWorld);
    const Double3 up = normalized(axes.z), eye = axes.origin + up * 0.01;
    scene.view = look_at(to_floats(eye), to_floats(axes.origin), to_floats(normalized(axes.y)),
                         static_cast<float>(2 * std::atan(kPatch / 0.01) * 180 / M_PI));
    const Frame frame = render(scene, 64, 64, {"color", "variance"},
                               {.spp = 2048, .max_depth = 60, .sampler = Sampler::kIndependent});
    const double scale = M_PI / kPatchRho;
    return {scale * mean(frame, "color", 1), scale * standard_error(frame, 1)};
}

/// Fluence at the point while the patch emits radiance 1: radiance over all directions, by the six
/// faces of a cube around it.
std::array<double, 2> fluence_at_point() {
    Scene scene = reciprocal_room();
    make_emitter(scene.shapes.back(), {1, 1, 1});
    Renderer renderer(device(), scene);
    constexpr int kSize = 64;
    double sum = 0, variance = 0;
    for (size_t face = 0; face < 6; ++face) {
        std::array<float, 3> ahead{}, up{}, target = kPoint;
        ahead[face / 2] = face % 2 == 0 ? 1.0f : -1.0f;
        up[(face / 2 + 1) % 3] = 1;
        for (size_t k = 0; k < 3; ++k) target[k] += ahead[k];
        Frame frame = make_frame(FrameSchema::of_known(kSize, kSize, {"color", "variance"}),
                                 const_cast<Device&>(device()));
        renderer.render(
            look_at(kPoint, target, up, 90),
            {.spp = 1024, .max_depth = 60, .sampler = Sampler::kIndependent, .seed = face}, frame);
        for (size_t i = 0; i < kSize * kSize; ++i) {
            const double x = (2 * (static_cast<double>(i % kSize) + 0.5)) / kSize - 1,
                         y = (2 * (static_cast<double>(i / kSize) + 0.5)) / kSize - 1;
            const double angle = 4.0 / (kSize * kSize) * std::pow(1 + x * x + y * y, -1.5);
            sum += angle * frame.channel("color")[kSize * kSize + i];
            variance += angle * angle * frame.channel("variance")[kSize * kSize + i];
        }
    }
    return {sum, std::sqrt(variance)};
}

TEST(Transport, IsTheSameInBothDirections) {
    const auto [irradiance, irradiance_error] = irradiance_of_patch();
    const auto [fluence, fluence_error] = fluence_at_point();
    const double area = 4 * kPatch * kPatch;
    EXPECT_GT(fluence, 0.01);
    EXPECT_NEAR(irradiance * area / fluence, 1.0,
                4 * std::hypot(irradiance_error / irradiance, fluence_error / fluence));
    EXPECT_LT(irradiance_error / irradiance + fluence_error / fluence, 0.004) << "too much noise";
}

// ---- All light of a closed box is absorbed: its walls fill the six views of 90 degrees from its
// middle, evenly by area ----

TEST(Transport, WhatIsEmittedIsAbsorbed) {
    Scene scene;
    // Of each wall another reflectance in each channel; the last but one, nearly black, is where a
    // window would let the light out.
    const Rgb rho[6] = {{0.8f, 0.3f, 0.5f}, {0.2f, 0.7f, 0.6f},    {0.5f, 0.5f, 0.9f},
                        {0.6f, 0.9f, 0.4f}, {0.02f, 0.02f, 0.02f}, {0.7f, 0.4f, 0.3f}};
    const Matrix4 walls[6] = {
        translate(1, 0, 0) * rotate(1, -90), translate(-1, 0, 0) * rotate(1, 90),
        translate(0, 1, 0) * rotate(0, 90),  translate(0, -1, 0) * rotate(0, -90),
        translate(0, 0, 1) * rotate(0, 180), translate(0, 0, -1)};
    for (size_t i = 0; i < 6; ++i) {
        const int bsdf = add_diffuse(scene, rho[i]);
        if (i == 2) {  // one half of the ceiling emits
            add_shape(scene, Type::kRectangle,
                      walls[i] * translate(-0.5f, 0, 0) * scale(0.5f, 1, 1), bsdf);
            make_emitter(add_shape(scene, Type::kRectangle,
                                   walls[i] * translate(0.5f, 0, 0) * scale(0.5f, 1, 1), bsdf),
                         {3, 2, 1});
        } else {
            add_shape(scene, Type::kRectangle, walls[i], bsdf);
        }
    }
    Renderer renderer(device(), scene);
    double absorbed[3] = {}, variance[3] = {};
    const double emitted[3] = {3 * M_PI * 2, 2 * M_PI * 2, 1 * M_PI * 2};
    for (size_t face = 0; face < 6; ++face) {
        std::array<float, 3> ahead{}, up{};
        ahead[face / 2] = face % 2 == 0 ? 1.0f : -1.0f;
        up[(face / 2 + 1) % 3] = 1;
        Frame frame = make_frame(FrameSchema::of_known(64, 64, {"color", "variance"}),
                                 const_cast<Device&>(device()));
        renderer.render(
            look_at({0, 0, 0}, ahead, up, 90),
            {.spp = 2048, .max_depth = 200, .sampler = Sampler::kIndependent, .seed = face}, frame);
        for (size_t c = 0; c < 3; ++c) {
            const double own = face == 2 ? emitted[c] / (2 * M_PI) / 2 : 0;
            const double power = M_PI * 4 * (1 - rho[face][c]) / rho[face][c];
            absorbed[c] += power * (mean(frame, "color", c) - own);
            variance[c] += std::pow(power * standard_error(frame, c), 2);
        }
    }
    for (size_t c = 0; c < 3; ++c) {
        EXPECT_NEAR(absorbed[c], emitted[c], 4 * std::sqrt(variance[c])) << "channel " << c;
        EXPECT_NEAR(absorbed[c] / emitted[c], 1.0, 1e-3) << "channel " << c;
    }
}

}  // namespace
}  // namespace pave::test
