// Meshes and rays of the bench programs.
// SPDX-License-Identifier: BSD-3-Clause
#include "bench/meshes.h"

#include <array>
#include <cmath>
#include <random>

namespace pave::bench {
namespace {

using Point = std::array<float, 3>;

constexpr size_t kBoxTriangles = 12;  // the last ones of the mesh
constexpr double kPi = 3.14159265358979323846;

/// Distance of the bumpy surface from the centre, in the direction of (theta, phi).
double radius_at(double theta, double phi) {
    return 0.6 + 0.06 * std::sin(7 * theta) * std::cos(5 * phi) +
           0.03 * std::sin(19 * theta + 1) * std::sin(23 * phi) +
           0.01 * std::cos(61 * theta) * std::cos(67 * phi);
}

void add_sphere(Mesh& mesh, uint32_t rows) {
    const uint32_t columns = 2 * rows;
    const auto add = [&](double theta, double phi) {
        const double r = radius_at(theta, phi);
        mesh.positions.push_back({static_cast<float>(r * std::sin(theta) * std::cos(phi)),
                                  static_cast<float>(r * std::cos(theta)),
                                  static_cast<float>(r * std::sin(theta) * std::sin(phi))});
    };
    add(0, 0);
    add(kPi, 0);
    for (uint32_t row = 1; row < rows; ++row)
        for (uint32_t column = 0; column < columns; ++column)
            add(kPi * row / rows, 2 * kPi * column / columns);
    const auto index = [&](uint32_t row, uint32_t column) -> uint32_t {
        if (row == 0) return 0;
        if (row == rows) return 1;
        return 2 + (row - 1) * columns + column % columns;
    };
    for (uint32_t row = 0; row < rows; ++row)
        for (uint32_t column = 0; column < columns; ++column) {
            const uint32_t a = index(row, column), b = index(row + 1, column),
                           c = index(row + 1, column + 1), d = index(row, column + 1);
            if (row + 1 < rows) mesh.triangles.push_back({a, c, b});
            if (row > 0) mesh.triangles.push_back({a, d, c});
        }
}

void add_box(Mesh& mesh) {
    const auto first = static_cast<uint32_t>(mesh.positions.size());
    for (int i = 0; i < 8; ++i)
        mesh.positions.push_back(
            {i & 1 ? 1.0f : -1.0f, i & 2 ? 1.0f : -1.0f, i & 4 ? 1.0f : -1.0f});
    for (const auto& q : std::array<std::array<uint32_t, 4>, 6>{{{0, 2, 6, 4},
                                                                 {1, 5, 7, 3},
                                                                 {0, 4, 5, 1},
                                                                 {2, 3, 7, 6},
                                                                 {0, 1, 3, 2},
                                                                 {4, 6, 7, 5}}}) {
        mesh.triangles.push_back({first + q[0], first + q[1], first + q[2]});
        mesh.triangles.push_back({first + q[0], first + q[2], first + q[3]});
    }
}

Point minus(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Point cross(const Point& a, const Point& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Point normalized(const Point& a) {
    const float scale = 1.0f / std::sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
    return {a[0] * scale, a[1] * scale, a[2] * scale};
}

/// A point a little above a random triangle of the sphere, and that triangle's normal.
struct Start {
    Point p, n;
};
Start random_start(const Mesh& mesh, std::mt19937& rng) {
    std::uniform_int_distribution<size_t> pick(0, mesh.triangles.size() - kBoxTriangles - 1);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    const auto& t = mesh.triangles[pick(rng)];
    const Point &a = mesh.positions[t[0]], &b = mesh.positions[t[1]], &c = mesh.positions[t[2]];
    float u = unit(rng), v = unit(rng);
    if (u + v > 1) u = 1 - u, v = 1 - v;
    Start start{{}, normalized(cross(minus(b, a), minus(c, a)))};
    const float outwards = start.n[0] * a[0] + start.n[1] * a[1] + start.n[2] * a[2] < 0 ? -1 : 1;
    for (size_t k = 0; k < 3; ++k) {
        start.n[k] *= outwards;
        start.p[k] = a[k] + u * (b[k] - a[k]) + v * (c[k] - a[k]) + 1e-4f * start.n[k];
    }
    return start;
}

}  // namespace

Mesh bumpy_sphere_in_box(size_t triangles) {
    Mesh mesh;
    uint32_t rows = 8;
    while (4 * static_cast<size_t>(rows) * (rows - 1) + kBoxTriangles < triangles) ++rows;
    add_sphere(mesh, rows);
    add_box(mesh);
    mesh.positions.push_back({0, 0, 0});
    return mesh;
}

Scene scene_of(Mesh mesh) {
    Scene scene;
    scene.name = "bench";
    scene.bsdfs.emplace_back();
    Shape& shape = scene.shapes.emplace_back();
    shape.type = Shape::Type::kMesh;
    shape.mesh = std::move(mesh);
    return scene;
}

std::vector<Ray> diffuse_rays(const Mesh& mesh, size_t count, uint32_t seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<float> normal;
    std::vector<Ray> rays(count);
    for (Ray& ray : rays) {
        const Start start = random_start(mesh, rng);
        Point w = normalized({normal(rng), normal(rng), normal(rng)});
        for (size_t k = 0; k < 3; ++k) w[k] += start.n[k];  // Lambert: a point of the unit sphere
        w = normalized(w);                                  // that touches the surface
        for (size_t k = 0; k < 3; ++k) ray.origin[k] = start.p[k], ray.direction[k] = w[k];
    }
    return rays;
}

std::vector<Ray> shadow_rays(const Mesh& mesh, size_t count, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<float> unit(-0.5f, 0.5f);
    std::vector<Ray> rays(count);
    for (Ray& ray : rays) {
        const Start start = random_start(mesh, rng);
        const Point lamp{unit(rng), 0.99f, unit(rng)};
        for (size_t k = 0; k < 3; ++k) {
            ray.origin[k] = start.p[k];
            ray.direction[k] = lamp[k] - start.p[k];
        }
        ray.t_max = 1.0f;
    }
    return rays;
}

std::vector<Ray> primary_rays(size_t side) {
    std::vector<Ray> rays(side * side);
    for (size_t y = 0; y < side; ++y)
        for (size_t x = 0; x < side; ++x) {
            const auto at = [&](size_t i) {
                return 0.85f *
                       (2.0f * (static_cast<float>(i) + 0.5f) / static_cast<float>(side) - 1);
            };
            Ray& ray = rays[y * side + x];
            ray.origin[0] = 0.3f, ray.origin[1] = 0.2f, ray.origin[2] = 0.98f;
            const Point d = normalized({at(x) - 0.2f, -at(y) - 0.15f, -0.7f});
            for (size_t k = 0; k < 3; ++k) ray.direction[k] = d[k];
        }
    return rays;
}

}  // namespace pave::bench
