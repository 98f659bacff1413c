// Rectangles, disks, cubes and spheres: from object transforms to what the kernels intersect,
// shade and sample.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <bit>
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
        const Double3 across_u = cross(axes.y, up), across_v = cross(up, axes.x);
        const Double3 u = across_u / dot(axes.x, across_u), v = across_v / dot(axes.y, across_v);
        const double reach = max_abs(axes.origin) + max_abs(axes.x) + max_abs(axes.y);
        const double slack = 4 * kFloatStep * (1 + reach * std::max(max_abs(u), max_abs(v)));

        kernel::FlatShape flat{};
        set3(flat.u, u);
        set3(flat.v, v);
        set3(flat.n, normal);
        flat.u[3] = static_cast<float>(-dot(u, axes.origin));
        flat.v[3] = static_cast<float>(-dot(v, axes.origin));
        flat.n[3] = static_cast<float>(dot(normal, axes.origin));
        flat.limit = static_cast<float>(is_disk ? 1 + 2 * slack : 1 + slack);
        flat.surface = surface_count();
        flat.kind = is_disk ? FLAT_DISK : FLAT_RECT;
        push_flat(flat);

        // A rectangle's (u, v) are its object coordinates from 0 to 1, a disk's are polar.
        if (is_disk)
            add_uv_map(axes.origin, u, v, {0, 0, 0}, 1, 0);
        else
            add_uv_map(axes.origin, u, v, {0, 0, 0}, 0.5, 0.5);
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
        add_surface(shape, is_disk ? SURFACE_DISK : SURFACE_FLAT, normal, flat.n[3],
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

    void push_flat(const kernel::FlatShape& flat) {
        data_.flats.push_back(flat);
        ++data_.flat_count[flat.kind];
    }

    void add_facet(const Shape& shape, const Corners& corners) {
        const Double3 p = to_double3(corners[0]), x = to_double3(corners[1]) - p,
                      y = to_double3(corners[2]) - p;
        const Double3 normal = normalized(cross(x, y));
        const Double3 across_u = cross(y, normal), across_v = cross(normal, x);
        const Double3 u = across_u / dot(x, across_u), v = across_v / dot(y, across_v);
        const double reach = max_abs(p) + max_abs(x) + max_abs(y);
        kernel::FlatShape flat{};
        set3(flat.u, u);
        set3(flat.v, v);
        set3(flat.n, normal);
        flat.u[3] = static_cast<float>(-dot(u, p));
        flat.v[3] = static_cast<float>(-dot(v, p));
        flat.n[3] = static_cast<float>(dot(normal, p));
        flat.limit =
            static_cast<float>(8 * kFloatStep * (1 + reach * std::max(max_abs(u), max_abs(v))));
        flat.surface = surface_count();
        flat.kind = FLAT_TRIANGLE;
        push_flat(flat);
        add_uv_map({}, {}, {}, {}, 1, 0);  // its material has no texture
        add_surface(shape, SURFACE_FLAT, normal, flat.n[3], x,
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
    for (size_t i = 0; i < scene.shapes.size(); ++i) {
        if (data.parts[i].empty()) shapes.push_back(&scene.shapes[i]);
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

// What follows reads the kernels' own floats, so that it holds for what they will intersect.

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
    for (const auto& triangle : data.corners) {
        Aabb box;
        for (const auto& corner : triangle) box.grow_to(corner);
        take(distances(flat, box));
    }
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
