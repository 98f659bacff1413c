// Rectangles, disks, cubes and spheres: from object transforms to what the kernels intersect,
// shade and sample.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <numbers>

#include "host/render/scene_data.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr double kFloatStep = 0x1p-23;
// How unevenly a sphere may be scaled before it is refused: more than files round, less than one
// sees.
constexpr double kSphereTolerance = 1e-3;

[[noreturn]] void refuse(const Scene& scene, const Shape& shape, const std::string& reason) {
    throw InputError(name_of(scene, shape) + ": " + reason);
}

void set3(float* to, Double3 v) {
    to[0] = static_cast<float>(v.x);
    to[1] = static_cast<float>(v.y);
    to[2] = static_cast<float>(v.z);
}

/// u and v in the plane across `normal`: dot(u, a x + b y) is a, dot(v, a x + b y) is b.
struct DualAxes {
    Double3 u, v;

    DualAxes(Double3 x, Double3 y, Double3 normal) : u(cross(y, normal)), v(cross(normal, x)) {
        u = u / dot(x, u);
        v = v / dot(y, v);
    }
};

class ShapeAdder {
   public:
    ShapeAdder(const Scene& scene, SceneData& data, std::vector<LightSource>& lights)
        : scene_(scene), data_(data), lights_(lights) {}

    void add_flat(const Shape& shape) {
        const bool is_disk = shape.type == Shape::Type::kDisk;
        const Axes axes(shape.world_from_object);
        const Double3 area = cross(axes.x, axes.y);
        if (!(length(area) > 0) || !is_finite(area) || !is_finite(axes.origin))
            refuse(scene_, shape, "its transform has no area; check scale and matrix in to_world");
        const Double3 up = normalized(area);
        // By the inverse transpose: towards the object's +z, also if the transform mirrors.
        const Double3 normal = (dot(area, axes.z) < 0) != shape.flip_normals ? -up : up;
        const DualAxes dual(axes.x, axes.y, normal);
        const float plane =
            push_flat(is_disk ? FLAT_DISK : FLAT_RECT, axes.origin, axes.x, axes.y, dual, normal);

        // A rectangle's (u, v) are its object coordinates from 0 to 1, a disk's are polar.
        if (is_disk)
            add_uv_map(axes.origin, dual.u, dual.v, {0, 0, 0}, 1, 0);
        else
            add_uv_map(axes.origin, dual.u, dual.v, {0, 0, 0}, 0.5, 0.5);
        LightSource light{.kind = is_disk ? LIGHT_DISK : LIGHT_QUAD,
                          .p = axes.origin,
                          .e1 = axes.x,
                          .e2 = axes.y,
                          .normal = normal,
                          .area = length(area) * (is_disk ? std::numbers::pi : 4.0)};
        if (!is_disk) {
            light.p = axes.origin - axes.x - axes.y;
            light.e1 = axes.x * 2;
            light.e2 = axes.y * 2;
        }
        add_surface(shape, is_disk ? SURFACE_DISK : SURFACE_FLAT, normal, plane,
                    is_disk ? axes.origin : axes.x, light);
    }

    /// All triangles of a small faceted mesh, each as a shape of its own.
    void add_facets(const Shape& shape) {
        for (const auto& vertices : shape.mesh.triangles) {
            Corners corners;
            for (size_t k = 0; k < 3; ++k) corners[k] = shape.mesh.positions[vertices[k]];
            add_facet(shape, corners);
        }
    }

    void add_cube(const Shape& shape) {
        const Axes axes(shape.world_from_object);
        const Double3 axis[3] = {axes.x, axes.y, axes.z};
        const double volume = dot(cross(axes.x, axes.y), axes.z);
        const double extent = length(axes.x) * length(axes.y) * length(axes.z);
        if (!(std::abs(volume) > 1e-12 * extent) || !std::isfinite(volume) ||
            !is_finite(axes.origin))
            refuse(scene_, shape,
                   "its transform has no volume; check scale and matrix in to_world");
        kernel::CubeShape cube{};
        cube.surface = surface_count();
        Double3 row[3];
        for (int a = 0; a < 3; ++a) {
            row[a] = cross(axis[(a + 1) % 3], axis[(a + 2) % 3]) / volume;
            set3(cube.row[a], row[a]);
            cube.row[a][3] = static_cast<float>(-dot(row[a], axes.origin));
        }
        for (int a = 0; a < 3; ++a)
            for (int side = -1; side <= 1; side += 2)
                add_face(shape, axes.origin, axis, row, a, side);
        data_.cubes.push_back(cube);
    }

    void add_sphere(const Shape& shape) {
        const Axes axes(shape.world_from_object);
        const double radius = length(axes.x);
        const double uneven = std::max(
            {std::abs(length(axes.y) - radius), std::abs(length(axes.z) - radius),
             std::abs(dot(axes.x, axes.y)) / radius, std::abs(dot(axes.y, axes.z)) / radius,
             std::abs(dot(axes.z, axes.x)) / radius});
        if (!(radius > 0) || !std::isfinite(radius) || !is_finite(axes.origin))
            refuse(scene_, shape,
                   "its transform leaves no radius; check scale and matrix in to_world");
        if (!(uneven <= kSphereTolerance * radius))
            refuse(scene_, shape,
                   "a sphere can only be scaled evenly; use a mesh for an ellipsoid");
        kernel::SphereShape sphere{};
        set3(sphere.center, axes.origin);
        sphere.radius = static_cast<float>(radius);
        sphere.surface = surface_count();
        data_.spheres.push_back(sphere);
        const double squared = radius * radius;
        add_uv_map(axes.origin, axes.x / squared, axes.y / squared, axes.z / squared, 1, 0);
        const LightSource light{.kind = LIGHT_SPHERE,
                                .p = axes.origin,
                                .normal = {shape.flip_normals ? -1.0 : 1.0, 0, 0},
                                .radius = radius,
                                .area = 4 * std::numbers::pi * radius * radius};
        add_surface(shape, SURFACE_SPHERE, axes.origin, sphere.radius, axes.z, light);
    }

   private:
    uint32_t surface_count() const {
        return static_cast<uint32_t>(data_.surfaces.size() / SURFACE_ROWS);
    }

    /// Appends the shape of the next surface; returns its plane's distance from the origin.
    float push_flat(uint32_t kind, Double3 origin, Double3 x, Double3 y, const DualAxes& dual,
                    Double3 normal) {
        const double reach = max_abs(origin) + max_abs(x) + max_abs(y);
        const double slack =
            4 * kFloatStep * (1 + reach * std::max(max_abs(dual.u), max_abs(dual.v)));
        kernel::FlatShape flat{};
        set3(flat.u, dual.u);
        set3(flat.v, dual.v);
        set3(flat.n, normal);
        flat.u[3] = static_cast<float>(-dot(dual.u, origin));
        flat.v[3] = static_cast<float>(-dot(dual.v, origin));
        flat.n[3] = static_cast<float>(dot(normal, origin));
        flat.limit = static_cast<float>(kind == FLAT_RECT   ? 1 + slack
                                        : kind == FLAT_DISK ? 1 + 2 * slack
                                                            : 2 * slack);
        flat.surface = surface_count();
        flat.kind = kind;
        data_.flats.push_back(flat);
        ++data_.flat_count[kind];
        return flat.n[3];
    }

    void add_facet(const Shape& shape, const Corners& corners) {
        const Double3 p = to_double3(corners[0]), x = to_double3(corners[1]) - p,
                      y = to_double3(corners[2]) - p;
        const Double3 normal = normalized(cross(x, y));
        const float plane = push_flat(FLAT_TRIANGLE, p, x, y, DualAxes(x, y, normal), normal);
        add_uv_map({}, {}, {}, {}, 1, 0);  // its material has no texture
        add_surface(shape, SURFACE_FLAT, normal, plane, x,
                    light_of_triangle(corners, shape.radiance, -1));
    }

    /// How surfaces get texture coordinates from world points; nothing without textures. `x`, `y`
    /// and `z` are dual axes: object coordinates are their dot products with p - origin.
    void add_uv_map(Double3 origin, Double3 x, Double3 y, Double3 z, double scale, double offset) {
        if (scene_.textures.empty()) return;
        Row first{}, second{};
        const auto put = [&](float* to, Double3 axis) {
            set3(to, axis * scale);
            to[3] = static_cast<float>(offset - scale * dot(axis, origin));
        };
        put(&first[0], x);
        put(&first[4], y);
        put(&second[0], z);
        data_.uvs.push_back(first);
        data_.uvs.push_back(second);
    }

    void add_face(const Shape& shape, Double3 center, const Double3* axis, const Double3* row,
                  int a, int side) {
        // Mitsuba's cube is a mesh whose texture coordinates u and v run along these axes.
        struct Along {
            int u, u_sign, v, v_sign;
        };
        constexpr Along kAlong[3][2] = {{{1, 1, 2, 1}, {1, 1, 2, -1}},
                                        {{2, 1, 0, 1}, {0, -1, 2, -1}},
                                        {{1, -1, 0, 1}, {1, 1, 0, 1}}};
        const Along& along = kAlong[a][side > 0];
        add_uv_map(center, row[along.u] * along.u_sign, row[along.v] * along.v_sign, {0, 0, 0}, 0.5,
                   0.5);
        const int b = (a + 1) % 3, c = (a + 2) % 3;
        const Double3 outward = normalized(row[a]) * side;
        const Double3 normal = shape.flip_normals ? -outward : outward;
        const Double3 middle = center + axis[a] * side;
        const LightSource light{.kind = LIGHT_QUAD,
                                .p = middle - axis[b] - axis[c],
                                .e1 = axis[b] * 2,
                                .e2 = axis[c] * 2,
                                .normal = normal,
                                .area = 4 * length(cross(axis[b], axis[c]))};
        add_surface(shape, SURFACE_FLAT, normal, static_cast<float>(dot(normal, middle)),
                    axis[along.u], light);
    }

    void add_surface(const Shape& shape, int kind, Double3 q, float q3, Double3 tangent,
                     LightSource light) {
        const auto object = object_of(scene_, shape);
        const auto bsdf = static_cast<size_t>(shape.bsdf);
        const Row& material = data_.bsdfs[bsdf * BSDF_ROWS];
        const bool inverted = kind == SURFACE_SPHERE && shape.flip_normals;
        Row hot{}, cold{};
        set3(&hot[0], q);
        hot[3] = as_float_bits(surface_bits(scene_, shape, kind, inverted));
        for (size_t c = 0; c < 3; ++c) hot[4 + c] = material[c];
        hot[7] = q3;
        if (kind == SURFACE_FLAT) tangent = normalized(tangent);
        set3(&cold[0], tangent);
        cold[3] = as_float_bits(static_cast<uint32_t>(lights_.size()));
        cold[4] = as_float_bits(object);
        cold[5] = as_float_bits(static_cast<uint32_t>(shape.part));
        data_.surfaces.push_back(hot);
        data_.surfaces.push_back(cold);
        if (!emits(shape)) return;
        light.radiance = shape.radiance;
        light.power = std::numbers::pi * light.area * luminance(shape.radiance);
        lights_.push_back(light);
    }

    const Scene& scene_;
    SceneData& data_;
    std::vector<LightSource>& lights_;
};

}  // namespace

void add_shapes(const Scene& scene, SceneData& data, std::vector<LightSource>& lights) {
    ShapeAdder adder(scene, data, lights);
    std::vector<const Shape*> shapes;
    for (size_t i = 0; i < data.shapes.size(); ++i) {
        if (data.parts[i].empty()) shapes.push_back(data.shapes[i]);
        for (const Shape& part : data.parts[i])
            if (part.type != Shape::Type::kMesh) shapes.push_back(&part);
    }
    for (const Shape* shape : shapes)
        if (shape->type == Shape::Type::kRectangle) adder.add_flat(*shape);
    for (const Shape* shape : shapes) {
        if (shape->type == Shape::Type::kDisk) adder.add_flat(*shape);
        if (shape->type == Shape::Type::kCube) adder.add_cube(*shape);
        if (shape->type == Shape::Type::kSphere) adder.add_sphere(*shape);
    }
    for (const auto& parts : data.parts)
        for (const Shape& part : parts)
            if (part.type == Shape::Type::kMesh) adder.add_facets(part);
}

}  // namespace pave
