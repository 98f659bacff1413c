// Bounds of the shapes, and which of them can stand between a surface and a light.
// SPDX-License-Identifier: BSD-3-Clause
// All of it reads the kernels' own floats, so that it holds for what they will intersect.
#include <algorithm>
#include <bit>
#include <cmath>

#include "host/render/scene_data.h"

namespace pave {
namespace {

constexpr double kFloatStep = 0x1p-23;

/// Box of the points, wider by more than the rounding of the floats that they were computed from.
template <size_t N>
Aabb box_around(const std::array<Double3, N>& points) {
    double largest = 0;
    for (const Double3& p : points) largest = std::max(largest, max_abs(p));
    const double slack = 8 * kFloatStep * largest;
    Aabb box;
    for (const Double3& p : points) {
        box.grow_to(to_floats(p - Double3{slack, slack, slack}));
        box.grow_to(to_floats(p + Double3{slack, slack, slack}));
    }
    return box;
}

}  // namespace

/// Corners of the parallelogram around a flat shape, from its dual axes.
static std::array<Double3, 4> corners_of(const kernel::FlatShape& flat) {
    const Double3 u{flat.u[0], flat.u[1], flat.u[2]}, v{flat.v[0], flat.v[1], flat.v[2]},
        n{flat.n[0], flat.n[1], flat.n[2]};
    // Rows u, v, n of the world-to-object map; columns of its inverse are the axes.
    const double det = dot(u, cross(v, n));
    const Double3 x = cross(v, n) / det, y = cross(n, u) / det, z = cross(u, v) / det;
    const Double3 center = x * -flat.u[3] + y * -flat.v[3] + z * flat.n[3];
    if (flat.kind == FLAT_TRIANGLE) return {center, center + x, center + y, center};
    return {center - x - y, center + x - y, center - x + y, center + x + y};
}

/// Edges of the cube from its center, from its dual axes.
static std::array<Double3, 3> axes_of(const kernel::CubeShape& cube) {
    Double3 row[3];
    for (int a = 0; a < 3; ++a) row[a] = {cube.row[a][0], cube.row[a][1], cube.row[a][2]};
    const double det = dot(row[0], cross(row[1], row[2]));
    return {cross(row[1], row[2]) / det, cross(row[2], row[0]) / det, cross(row[0], row[1]) / det};
}

Aabb bounds_of(const kernel::FlatShape& flat) { return box_around(corners_of(flat)); }

Aabb bounds_of(const kernel::CubeShape& cube) {
    const std::array<Double3, 3> axis = axes_of(cube);
    std::array<Double3, 8> corners;
    for (size_t corner = 0; corner < 8; ++corner)
        for (size_t a = 0; a < 3; ++a)
            corners[corner] =
                corners[corner] + axis[a] * ((corner >> a & 1 ? 1.0 : -1.0) - cube.row[a][3]);
    return box_around(corners);
}

Aabb bounds_of(const kernel::SphereShape& sphere) {
    const Double3 center{sphere.center[0], sphere.center[1], sphere.center[2]};
    const Double3 reach{sphere.radius, sphere.radius, sphere.radius};
    return box_around(std::array{center - reach, center + reach});
}

namespace {

/// Least and greatest signed distance of the box's corners from the plane of `flat`.
std::array<double, 2> distances(const kernel::FlatShape& flat, const Aabb& box) {
    double low = -flat.n[3], high = -flat.n[3];
    for (size_t a = 0; a < 3; ++a) {
        const double p = static_cast<double>(flat.n[a]) * box.lower[a],
                     q = static_cast<double>(flat.n[a]) * box.upper[a];
        low += std::min(p, q);
        high += std::max(p, q);
    }
    return {low, high};
}

/// Extent of a rotated cube seen along n, which its box would overstate.
std::array<double, 2> distances(const kernel::FlatShape& flat, const kernel::CubeShape& cube) {
    const std::array<Double3, 3> axis = axes_of(cube);
    const Double3 n{flat.n[0], flat.n[1], flat.n[2]};
    double low = -flat.n[3], high = -flat.n[3];
    for (size_t a = 0; a < 3; ++a) {
        const double middle = -dot(n, axis[a]) * cube.row[a][3], half = std::abs(dot(n, axis[a]));
        low += middle - half;
        high += middle + half;
    }
    return {low, high};
}

}  // namespace

/// Whether all that a shadow ray can start from or end at lies on one side of the plane: then the
/// shape never blocks one.
static bool is_hull(const SceneData& data, const Scene& scene, const kernel::FlatShape& flat) {
    const double tolerance = 1e-5 * max_abs({data.bounds.upper[0] - data.bounds.lower[0],
                                             data.bounds.upper[1] - data.bounds.lower[1],
                                             data.bounds.upper[2] - data.bounds.lower[2]});
    double low = 0, high = 0;
    const auto take = [&](std::array<double, 2> d) {
        low = std::min(low, d[0]);
        high = std::max(high, d[1]);
    };
    for (const kernel::FlatShape& other : data.flats)
        for (const Double3& p : corners_of(other)) {
            const double d = dot(p, {flat.n[0], flat.n[1], flat.n[2]}) - flat.n[3];
            take({d, d});
        }
    for (const kernel::CubeShape& cube : data.cubes) take(distances(flat, cube));
    for (const kernel::SphereShape& sphere : data.spheres) {
        const double d = dot({sphere.center[0], sphere.center[1], sphere.center[2]},
                             {flat.n[0], flat.n[1], flat.n[2]}) -
                         flat.n[3];
        take({d - sphere.radius, d + sphere.radius});
    }
    for (size_t i = 0; i < data.own_triangles; ++i) {
        Aabb box;
        for (const auto& corner : data.corners[i]) box.grow_to(corner);
        take(distances(flat, box));
    }
    for (const InstanceData& instance : data.instances) take(distances(flat, instance.bounds));
    for (const Scene::PointLight& light : scene.point_lights) {
        Aabb point;
        point.grow_to(light.position);
        take(distances(flat, point));
    }
    return low >= -tolerance || high <= tolerance;
}

void sort_occluders(const Scene& scene, SceneData& data, const RendererPaths& paths) {
    const bool one_light = data.lights.size() == LIGHT_ROWS;
    const auto can_block = [&](const kernel::FlatShape& flat) {
        if (!paths.cull_occluders || scene.has_environment) return true;
        const bool is_light =
            bits_emits(std::bit_cast<uint32_t>(data.surfaces[flat.surface * SURFACE_ROWS][3]));
        // A ray that ends on the emitting side of the only light does not pass through it.
        if (is_light && one_light) return false;
        return !is_hull(data, scene, flat);
    };
    const std::vector<bool> blocks = [&] {
        std::vector<bool> result;
        for (const kernel::FlatShape& flat : data.flats) result.push_back(can_block(flat));
        return result;
    }();
    const auto is_blocking = [&](const kernel::FlatShape& flat) {
        return blocks[static_cast<size_t>(&flat - data.flats.data())];
    };
    std::vector<kernel::FlatShape> sorted;
    auto from = data.flats.begin();
    for (size_t kind = 0; kind < FLAT_KINDS; ++kind) {
        const auto to = from + data.flat_count[kind];
        for (bool blocking : {true, false})
            for (auto it = from; it != to; ++it)
                if (is_blocking(*it) == blocking) {
                    sorted.push_back(*it);
                    data.flat_shadow[kind] += blocking;
                }
        from = to;
    }
    data.flats = std::move(sorted);
}

}  // namespace pave
