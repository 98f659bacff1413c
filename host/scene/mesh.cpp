// What is done to a mesh before rendering: place, normals, side, and the checks that keep broken
// data from the device.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/mesh.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace pave {
namespace {

using Float3 = std::array<float, 3>;

Double3 widen(const Float3& v) { return {v[0], v[1], v[2]}; }

Float3 narrow(const Double3& v) {
    return {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
}

bool is_finite(const Double3& v) {
    return std::all_of(v.begin(), v.end(), [](double x) { return std::abs(x) <= kMaxCoordinate; });
}

// Twice the area times the normal, from the float positions that the device will see.
Double3 face_cross(const Mesh& mesh, const std::array<uint32_t, 3>& triangle) {
    const Double3 a = widen(mesh.positions[triangle[0]]);
    return cross(widen(mesh.positions[triangle[1]]) - a, widen(mesh.positions[triangle[2]]) - a);
}

void place_positions(Mesh& mesh, const Affine& world_from_object) {
    for (size_t i = 0; i < mesh.positions.size(); ++i) {
        const Double3 position = world_from_object.point(widen(mesh.positions[i]));
        if (!is_finite(position))
            throw MeshError("vertex " + std::to_string(i + 1) + " is not finite or beyond 1e12");
        mesh.positions[i] = narrow(position);
    }
}

void place_normals(Mesh& mesh, const Affine& world_from_object) {
    const double side =
        world_from_object.determinant() < 0 ? -1 : 1;  // cofactors carry the determinant's sign
    for (size_t i = 0; i < mesh.normals.size(); ++i) {
        const Double3 normal =
            normalized(side * world_from_object.normal(normalized(widen(mesh.normals[i]))));
        if (!(std::abs(length(normal) - 1) < 1e-6))
            throw MeshError("the normal of vertex " + std::to_string(i + 1) +
                            " is zero or not finite");
        mesh.normals[i] = narrow(normal);
    }
}

void drop_flat_triangles(Mesh& mesh) {
    std::erase_if(mesh.triangles, [&](const std::array<uint32_t, 3>& triangle) {
        // In float, as the device computes it: what underflows there can never be hit.
        const Float3 normal = narrow(face_cross(mesh, triangle));
        return normal == Float3{0, 0, 0};
    });
    if (mesh.triangles.empty()) throw MeshError("no triangle has an area");
}

void compute_normals(Mesh& mesh) {
    std::vector<Double3> sums(mesh.positions.size(), Double3{0, 0, 0});
    for (const std::array<uint32_t, 3>& triangle : mesh.triangles) {
        const Double3 normal = normalized(face_cross(mesh, triangle));
        for (size_t i = 0; i < 3; ++i) {
            const Double3 corner = widen(mesh.positions[triangle[i]]);
            const Double3 a = normalized(widen(mesh.positions[triangle[(i + 1) % 3]]) - corner);
            const Double3 b = normalized(widen(mesh.positions[triangle[(i + 2) % 3]]) - corner);
            sums[triangle[i]] =
                sums[triangle[i]] + std::atan2(length(cross(a, b)), dot(a, b)) * normal;
        }
    }
    mesh.normals.clear();
    for (const Double3& sum :
         sums)  // vertices of no triangle get some unit vector; nothing reads it
        mesh.normals.push_back(narrow(length(sum) > 0 ? normalized(sum) : Double3{1, 0, 0}));
}

}  // namespace

void place_mesh(Mesh& mesh, const MeshPlacement& placement) {
    if (mesh.positions.empty() || mesh.triangles.empty()) throw MeshError("the mesh is empty");
    place_positions(mesh, placement.world_from_object);
    drop_flat_triangles(mesh);
    if (placement.face_normals) {
        mesh.normals.clear();
    } else if (mesh.normals.empty()) {
        compute_normals(mesh);
    } else {
        place_normals(mesh, placement.world_from_object);
    }
    if (placement.flip_texcoords)
        for (std::array<float, 2>& uv : mesh.texcoords) uv[1] = 1 - uv[1];
    if (!placement.flip_normals) return;
    for (std::array<uint32_t, 3>& triangle : mesh.triangles) std::swap(triangle[1], triangle[2]);
    for (Float3& normal : mesh.normals) normal = {-normal[0], -normal[1], -normal[2]};
}

double mesh_area(const Mesh& mesh) {
    double area = 0;
    for (const std::array<uint32_t, 3>& triangle : mesh.triangles)
        area += 0.5 * length(face_cross(mesh, triangle));
    return area;
}

}  // namespace pave
