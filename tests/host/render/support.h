// Scenes built by hand, renders and statistics for the tests of the path tracer.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "host/device/cl.h"
#include "pave/render.h"

namespace pave::test {

/// The device of PAVE_DEVICE or the first one; made once.
inline const Device& device() {
    // Never destroyed: some drivers are gone when static objects are.
    static const Device* instance = new Device(Device::select());
    return *instance;
}

// ---- Matrices: world_from_object, composed right to left ----

inline Matrix4 operator*(const Matrix4& a, const Matrix4& b) {
    Matrix4 r{};
    for (size_t i = 0; i < 4; ++i)
        for (size_t j = 0; j < 4; ++j)
            for (size_t k = 0; k < 4; ++k) r[4 * i + j] += a[4 * i + k] * b[4 * k + j];
    return r;
}
inline Matrix4 translate(float x, float y, float z) {
    return {1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1};
}
inline Matrix4 scale(float x, float y, float z) {
    return {x, 0, 0, 0, 0, y, 0, 0, 0, 0, z, 0, 0, 0, 0, 1};
}
inline Matrix4 scale(float s) { return scale(s, s, s); }
/// Rotation by `degrees` about axis 0, 1 or 2, right-handed.
inline Matrix4 rotate(int axis, float degrees) {
    const float c = std::cos(degrees * 0.017453292519943295f),
                s = std::sin(degrees * 0.017453292519943295f);
    if (axis == 0) return {1, 0, 0, 0, 0, c, -s, 0, 0, s, c, 0, 0, 0, 0, 1};
    if (axis == 1) return {c, 0, s, 0, 0, 1, 0, 0, -s, 0, c, 0, 0, 0, 0, 1};
    return {c, -s, 0, 0, s, c, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
}

// ---- Scenes ----

inline int add_diffuse(Scene& scene, Rgb reflectance, bool two_sided = false) {
    Bsdf bsdf;
    bsdf.reflectance = reflectance;
    bsdf.two_sided = two_sided;
    scene.bsdfs.push_back(bsdf);
    return static_cast<int>(scene.bsdfs.size()) - 1;
}
inline int add_material(Scene& scene, Bsdf::Type type) {
    scene.bsdfs.emplace_back().type = type;
    return static_cast<int>(scene.bsdfs.size()) - 1;
}
inline Shape& add_shape(Scene& scene, Shape::Type type, const Matrix4& world_from_object,
                        int bsdf) {
    Shape shape;
    shape.type = type;
    shape.world_from_object = world_from_object;
    shape.bsdf = bsdf;
    scene.shapes.push_back(shape);
    return scene.shapes.back();
}
inline void make_emitter(Shape& shape, Rgb radiance) {
    shape.is_emitter = true;
    shape.radiance = radiance;
}

/// Box [-1,1]^3 open towards +z, light under the ceiling, three cuboids; the camera looks in along
/// -z.
Scene cornell();
/// A unit sphere mesh of rows x 2*rows quads (two triangles each) around `center`.
Mesh sphere_mesh(int rows, std::array<float, 3> center, float radius, bool smooth);
/// `count` random triangles in [-1,1]^3.
Mesh random_triangles(int count, float size, uint32_t seed);
inline Shape& add_mesh(Scene& scene, Mesh mesh, int bsdf) {
    Shape& shape = add_shape(scene, Shape::Type::kMesh, scale(1.0f), bsdf);
    shape.mesh = std::move(mesh);
    return shape;
}
inline int add_group(Scene& scene, std::vector<Shape> shapes, std::string id = "group") {
    scene.groups.push_back({std::move(id), std::move(shapes)});
    return static_cast<int>(scene.groups.size()) - 1;
}
inline Shape mesh_shape(Mesh mesh, int bsdf) {
    Shape shape;
    shape.type = Shape::Type::kMesh;
    shape.bsdf = bsdf;
    shape.mesh = std::move(mesh);
    return shape;
}
inline Shape& add_instance(Scene& scene, int group, const Matrix4& world_from_group) {
    Shape& shape = add_shape(scene, Shape::Type::kInstance, world_from_group, 0);
    shape.group = group;
    return shape;
}
/// Two groups of several materials, each placed a few times in a lit box: turned, stretched,
/// sheared and mirrored.
Scene grove();
/// One shape or material of every kind in a lit box.
Scene menagerie();
/// A few things under an image of a sky.
Scene outdoors();

// ---- Renders ----

Frame render(Renderer& renderer, int width, int height, const std::vector<std::string>& channels,
             const RenderOptions& options);
Frame render(const Scene& scene, int width, int height, const std::vector<std::string>& channels,
             const RenderOptions& options, const RendererPaths& paths = {});
/// Mean over the pixels of plane `plane` of a channel.
double mean(const Frame& frame, const std::string& channel, size_t plane = 0);
/// Standard error of that mean, from channel "variance".
double standard_error(const Frame& frame, size_t plane = 0);
/// Whether all bytes of the channel are equal.
::testing::AssertionResult same_bits(const Frame& a, const Frame& b, const std::string& channel);
/// Compares two independent renders with "color" and "variance": few pixels may differ by much,
/// none of the means.
::testing::AssertionResult same_image(const Frame& a, const Frame& b);

}  // namespace pave::test
