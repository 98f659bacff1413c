// Triangles of all meshes: corners, shading data, emitting triangles; the degenerate ones are
// dropped.
// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <numbers>

#include "host/render/scene_data.h"
#include "pave/error.h"

namespace pave {
namespace {

using Point = std::array<float, 3>;

// Squared length of a face normal that float32 kernels can still normalise.
constexpr double kLeastSquaredArea = 1e-36;

bool has_area(const Point& a, const Point& b, const Point& c) {
    const Double3 normal = cross(to_double3(b) - to_double3(a), to_double3(c) - to_double3(a));
    return is_finite(normal) && dot(normal, normal) > kLeastSquaredArea &&
           dot(normal, normal) < 1e36;
}

Row row_of(const Point& a, float a3, const Point& b, float b3) {
    return {a[0], a[1], a[2], a3, b[0], b[1], b[2], b3};
}

LightSource light_of(const std::array<Point, 3>& corners, const Rgb& radiance, int normals) {
    const Double3 p = to_double3(corners[0]);
    LightSource light{.kind = LIGHT_TRIANGLE,
                      .p = p,
                      .e1 = to_double3(corners[1]) - p,
                      .e2 = to_double3(corners[2]) - p};
    const Double3 area = cross(light.e1, light.e2);
    light.normal = normalized(area);
    light.area = length(area) / 2;
    light.radiance = radiance;
    light.power = std::numbers::pi * light.area * luminance(radiance);
    light.normals = normals;
    return light;
}

}  // namespace

void add_triangles(const Scene& scene, SceneData& data, std::vector<LightSource>& lights) {
    for (const Shape& shape : scene.shapes) {
        if (shape.type != Shape::Type::kMesh) continue;
        const Mesh& mesh = shape.mesh;
        const auto object = static_cast<uint32_t>(&shape - scene.shapes.data());
        const bool smooth = !mesh.normals.empty();
        const bool textured = has_texture(scene.bsdfs[static_cast<size_t>(shape.bsdf)]);
        if (textured && mesh.texcoords.size() != mesh.positions.size())
            throw InputError(name_of(scene, shape) +
                             ": its material has a texture, but there are " +
                             std::to_string(mesh.texcoords.size()) + " texture coordinates for " +
                             std::to_string(mesh.positions.size()) + " vertices");
        if (smooth && mesh.normals.size() != mesh.positions.size())
            throw InputError(name_of(scene, shape) + ": " + std::to_string(mesh.normals.size()) +
                             " normals for " + std::to_string(mesh.positions.size()) + " vertices");
        for (std::array<uint32_t, 3> vertex : mesh.triangles) {
            for (uint32_t index : vertex)
                if (index >= mesh.positions.size())
                    throw InputError(name_of(scene, shape) + ": vertex " + std::to_string(index) +
                                     " of " + std::to_string(mesh.positions.size()));
            if (shape.flip_normals) std::swap(vertex[1], vertex[2]);
            const std::array<Point, 3> corners{mesh.positions[vertex[0]], mesh.positions[vertex[1]],
                                               mesh.positions[vertex[2]]};
            if (!has_area(corners[0], corners[1], corners[2])) {
                ++data.dropped_triangles;
                continue;
            }
            int normals = -1;
            if (smooth) {
                normals = static_cast<int>(data.normals.size() / NORMALS_ROWS);
                std::array<Point, 3> n{mesh.normals[vertex[0]], mesh.normals[vertex[1]],
                                       mesh.normals[vertex[2]]};
                if (shape.flip_normals)
                    for (Point& v : n)
                        for (float& x : v) x = -x;
                data.normals.push_back(row_of(n[0], 0, n[1], 0));
                data.normals.push_back(row_of(n[2], 0, {0, 0, 0}, 0));
            }
            const int uvs = textured ? static_cast<int>(data.uvs.size()) : -1;
            if (textured) {
                const auto &a = mesh.texcoords[vertex[0]], &b = mesh.texcoords[vertex[1]],
                           &c = mesh.texcoords[vertex[2]];
                data.uvs.push_back({a[0], a[1], b[0], b[1], c[0], c[1], 0, 0});
            }
            const uint32_t bits = surface_bits(scene, shape, SURFACE_FLAT, false);
            data.triangles.push_back(row_of(corners[0], as_float_bits(bits), corners[1],
                                            as_float_bits(static_cast<uint32_t>(lights.size()))));
            data.triangles.push_back(row_of(corners[2], as_float_bits(object),
                                            {as_float_bits(static_cast<uint32_t>(normals)),
                                             as_float_bits(static_cast<uint32_t>(uvs)), 0},
                                            0));
            data.corners.push_back(corners);
            if (emits(shape)) lights.push_back(light_of(corners, shape.radiance, normals));
        }
    }
}

}  // namespace pave
