// Finds the boxes, rectangles and triangles that small meshes are made of: the kernels' fastest
// tests are for these.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <optional>

#include "host/render/scene_data.h"

namespace pave {
namespace {

constexpr size_t kMostTriangles = 256;  // of a mesh that is looked at; pairs are compared
// How far corners may lie from where a parallelogram has them, in units of the mesh's extent: what
// float32 files round, and far less than a ray's offset from its surface.
constexpr double kTolerance = 1.6e-6;

/// u, a, c, b around; its normal is that of the triangle u, a, b.
struct Parallelogram {
    Double3 u, a, b;

    Double3 center() const { return (a + b) / 2; }
    Double3 normal() const { return normalized(cross(a - u, b - u)); }
};

bool is_near(Double3 p, Double3 q, double tolerance) { return max_abs(p - q) <= tolerance; }

Matrix4 matrix_of(Double3 x, Double3 y, Double3 z, Double3 origin) {
    const auto f = [](double v) { return static_cast<float>(v); };
    return {f(x.x), f(y.x), f(z.x), f(origin.x), f(x.y), f(y.y), f(z.y), f(origin.y),
            f(x.z), f(y.z), f(z.z), f(origin.z), 0,      0,      0,      1};
}

/// The two triangles as one parallelogram: they share an edge, turn the same way, and their other
/// corners face each other.
std::optional<Parallelogram> join(const Mesh& mesh, const std::array<uint32_t, 3>& s,
                                  const std::array<uint32_t, 3>& t, double tolerance) {
    for (size_t i = 0; i < 3; ++i)
        for (size_t j = 0; j < 3; ++j) {
            const auto &a = mesh.positions[s[(i + 1) % 3]], &b = mesh.positions[s[(i + 2) % 3]];
            if (a != mesh.positions[t[(j + 2) % 3]] || b != mesh.positions[t[(j + 1) % 3]])
                continue;
            const Parallelogram p{to_double3(mesh.positions[s[i]]), to_double3(a), to_double3(b)};
            if (is_near(p.u + to_double3(mesh.positions[t[j]]), p.a + p.b, tolerance)) return p;
        }
    return std::nullopt;
}

/// Pairs of the mesh's triangles, and those that are left over.
std::vector<Parallelogram> pair_up(const Mesh& mesh, double tolerance,
                                   std::vector<std::array<uint32_t, 3>>& left) {
    std::vector<Parallelogram> found;
    std::vector<bool> taken(mesh.triangles.size());
    for (size_t i = 0; i < mesh.triangles.size(); ++i) {
        if (taken[i]) continue;
        bool paired = false;
        for (size_t j = i + 1; j < mesh.triangles.size() && !paired; ++j) {
            if (taken[j]) continue;
            if (const auto p = join(mesh, mesh.triangles[i], mesh.triangles[j], tolerance)) {
                found.push_back(*p);
                paired = taken[j] = true;
            }
        }
        if (!paired) left.push_back(mesh.triangles[i]);
    }
    return found;
}

/// Whether the six are the faces of one box, and then where a cube must go to be it.
bool is_box(const std::vector<Parallelogram>& sides, double tolerance, Matrix4& box,
            bool& inverted) {
    if (sides.size() != 6) return false;
    Double3 center;
    for (const Parallelogram& side : sides) center = center + side.center() / 6;
    const Double3 x = (sides[0].a - sides[0].u) / 2, y = (sides[0].b - sides[0].u) / 2;
    const Double3 z = sides[0].center() - center;
    // Every side lies across an axis, one to each end of it.
    std::array<int, 6> ends{};
    int outwards = 0;
    for (const Parallelogram& side : sides) {
        const Double3 at = side.center() - center;
        const std::array<Double3, 3> axes{x, y, z};
        int end = -1;
        for (int k = 0; k < 6; ++k)
            if (is_near(at, axes[static_cast<size_t>(k) / 2] * (k % 2 == 0 ? 1.0 : -1.0),
                        tolerance))
                end = k;
        if (end < 0) return false;
        ++ends[static_cast<size_t>(end)];
        const Double3 e = axes[static_cast<size_t>(end / 2 + 1) % 3],
                      f = axes[static_cast<size_t>(end / 2 + 2) % 3];
        for (const Double3& corner : {side.u, side.a, side.b}) {
            bool there = false;
            for (double s : {-1.0, 1.0})
                for (double t : {-1.0, 1.0})
                    there |= is_near(corner, side.center() + e * s + f * t, tolerance);
            if (!there) return false;
        }
        outwards += dot(side.normal(), at) > 0;
    }
    if (ends != std::array<int, 6>{1, 1, 1, 1, 1, 1} || (outwards != 0 && outwards != 6))
        return false;
    box = matrix_of(x, y, z, center);
    inverted = outwards == 0;
    return std::abs(dot(cross(x, y), z)) > 0;
}

Shape like(const Shape& mesh, Shape::Type type, const Matrix4& world_from_object) {
    Shape shape;
    shape.type = type;
    shape.id = mesh.id;
    shape.world_from_object = world_from_object;
    shape.bsdf = mesh.bsdf;
    shape.is_emitter = mesh.is_emitter;
    shape.radiance = mesh.radiance;
    return shape;
}

/// What the mesh is made of: a box, or rectangles and a mesh of what is left over. Nothing if its
/// shading needs the mesh.
std::vector<Shape> parts_of(const Shape& shape, const Bsdf& bsdf) {
    const Mesh& mesh = shape.mesh;
    if (!mesh.normals.empty() || mesh.triangles.empty() || mesh.triangles.size() > kMostTriangles ||
        shape.flip_normals)
        return {};
    // Tangents and texture coordinates of meshes run otherwise than those of shapes.
    if (has_texture(bsdf)) return {};
    if (bsdf.type == Bsdf::Type::kRoughConductor && bsdf.alpha_u != bsdf.alpha_v) return {};
    double extent = 0;
    for (const auto& triangle : mesh.triangles) {
        for (uint32_t index : triangle) {
            if (index >= mesh.positions.size()) return {};  // add_triangles says what is wrong
            extent = std::max(extent, max_abs(to_double3(mesh.positions[index])));
        }
        // Counted and dropped there.
        if (!has_area({mesh.positions[triangle[0]], mesh.positions[triangle[1]],
                       mesh.positions[triangle[2]]}))
            return {};
    }
    const double tolerance = kTolerance * extent;
    std::vector<std::array<uint32_t, 3>> left;
    const std::vector<Parallelogram> sides = pair_up(mesh, tolerance, left);
    Matrix4 box{};
    bool inverted = false;
    if (left.empty() && is_box(sides, tolerance, box, inverted)) {
        Shape cube = like(shape, Shape::Type::kCube, box);
        cube.flip_normals = inverted;
        return {cube};
    }
    std::vector<Shape> parts;
    for (const Parallelogram& p : sides) {
        const Matrix4 matrix = matrix_of((p.a - p.u) / 2, (p.b - p.u) / 2, p.normal(), p.center());
        parts.push_back(like(shape, Shape::Type::kRectangle, matrix));
    }
    if (!left.empty()) {
        Shape& rest = parts.emplace_back(like(shape, Shape::Type::kMesh, shape.world_from_object));
        rest.mesh.positions = mesh.positions;
        rest.mesh.triangles = left;
    }
    return parts;
}

}  // namespace

void recognise_shapes(const Scene& scene, SceneData& data, size_t most_shapes) {
    std::vector<std::vector<Shape>> parts(data.shapes.size());
    size_t count = 0;
    for (size_t i = 0; i < parts.size(); ++i) {
        const Shape& shape = *data.shapes[i];
        if (shape.type != Shape::Type::kMesh) {
            ++count;
            continue;
        }
        parts[i] = parts_of(shape, scene.bsdfs[static_cast<size_t>(shape.bsdf)]);
        for (Shape& part : parts[i]) {
            part.object = static_cast<int>(object_of(scene, shape));
            count += part.type == Shape::Type::kMesh ? part.mesh.triangles.size() : 1;
        }
    }
    if (count <= most_shapes) data.parts = std::move(parts);
}

}  // namespace pave
