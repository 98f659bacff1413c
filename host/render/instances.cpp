// Groups and their instances: which are copied, where the others lie, and what the kernels map
// rays by.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>

#include "host/render/scene_data.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr double kFarthest = 1e12;         // coordinate, and scale either way
constexpr double kBoxSlack = 0x1p-20;      // of a box's coordinates: what the transforms round
constexpr size_t kInstanceChunk = 1 << 8;  // instances that a thread takes

[[noreturn]] void refuse(const Scene& scene, const Shape& shape, const std::string& reason) {
    throw InputError(name_of(scene, shape) + ": " + reason);
}

Double3 times(const Axes& map, Double3 v) { return map.x * v.x + map.y * v.y + map.z * v.z; }
/// Rows of the linear part's inverse.
std::array<Double3, 3> inverse_rows(const Axes& map) {
    const double volume = dot(cross(map.x, map.y), map.z);
    return {cross(map.y, map.z) / volume, cross(map.z, map.x) / volume,
            cross(map.x, map.y) / volume};
}
/// The map's own rows.
std::array<Double3, 3> rows_of(const Axes& map) {
    return {Double3{map.x.x, map.y.x, map.z.x}, Double3{map.x.y, map.y.y, map.z.y},
            Double3{map.x.z, map.y.z, map.z.z}};
}
double dot_of_magnitudes(Double3 a, Double3 b) {
    return std::abs(a.x * b.x) + std::abs(a.y * b.y) + std::abs(a.z * b.z);
}

Matrix4 matrix_of(const Axes& map) {
    const auto f = [](double v) { return static_cast<float>(v); };
    return {f(map.x.x), f(map.y.x), f(map.z.x), f(map.origin.x),
            f(map.x.y), f(map.y.y), f(map.z.y), f(map.origin.y),
            f(map.x.z), f(map.y.z), f(map.z.z), f(map.origin.z),
            0,          0,          0,          1};
}

void check_instance(const Scene& scene, const Shape& shape) {
    if (shape.group < 0 || static_cast<size_t>(shape.group) >= scene.groups.size())
        refuse(
            scene, shape,
            "group " + std::to_string(shape.group) + " of " + std::to_string(scene.groups.size()));
    const Axes map(shape.world_from_object);
    const double volume = std::abs(dot(cross(map.x, map.y), map.z));
    double most = max_abs(map.origin);
    for (const Double3& axis : {map.x, map.y, map.z}) most = std::max(most, max_abs(axis));
    if (volume > 1e-12 * length(map.x) * length(map.y) * length(map.z))
        for (const Double3& row : inverse_rows(map)) most = std::max(most, max_abs(row));
    else
        most = kFarthest;
    if (!(most < kFarthest))
        refuse(scene, shape,
               "its transform is singular or beyond 1e12; check scale and matrix in to_world");
}

void check_group(const Scene& scene, const ShapeGroup& group) {
    for (const Shape& shape : group.shapes) {
        if (shape.type == Shape::Type::kInstance) refuse(scene, shape, "a group has no instances");
        if (shape.is_emitter) refuse(scene, shape, "a group has no emitters");
    }
}

/// `part` of a group where an instance has it.
Shape copy_of(const Shape& part, const Axes& map, int object, int number, bool turn) {
    Shape copy = part;
    copy.object = object;
    copy.part = number;
    if (part.type != Shape::Type::kMesh) {
        const Axes inner(part.world_from_object);
        Axes whole = inner;
        whole.x = times(map, inner.x);
        whole.y = times(map, inner.y);
        whole.z = times(map, inner.z);
        whole.origin = times(map, inner.origin) + map.origin;
        copy.world_from_object = matrix_of(whole);
        return copy;
    }
    for (auto& p : copy.mesh.positions) p = to_floats(times(map, to_double3(p)) + map.origin);
    const std::array<Double3, 3> inverse = inverse_rows(map);
    double most = 0;
    for (const Double3& row : inverse) most = std::max(most, max_abs(row));
    for (auto& n : copy.mesh.normals)
        n = to_floats((inverse[0] * n[0] + inverse[1] * n[1] + inverse[2] * n[2]) / most);
    // The winding's normal is to go by the inverse transpose too.
    if (turn && dot(cross(map.x, map.y), map.z) < 0)
        for (auto& triangle : copy.mesh.triangles) std::swap(triangle[1], triangle[2]);
    return copy;
}

/// Box around a box as the map leaves it.
Aabb mapped(const Axes& map, const Aabb& box) {
    const Double3 low = to_double3(box.lower), high = to_double3(box.upper);
    const Double3 center = times(map, (low + high) / 2) + map.origin, half = (high - low) / 2;
    const std::array<Double3, 3> rows = rows_of(map);
    const Double3 reach{dot_of_magnitudes(rows[0], half), dot_of_magnitudes(rows[1], half),
                        dot_of_magnitudes(rows[2], half)};
    Aabb result;
    result.grow_to(to_floats(center - reach));
    result.grow_to(to_floats(center + reach));
    return result;
}

/// The boxes two levels below the root: turned, they are tighter than the root's own.
std::vector<Aabb> upper_boxes(const Bvh8& tree) {
    std::vector<Aabb> boxes;
    const Bvh8Node& root = tree.nodes[0];
    for (size_t i = 0; i < 8; ++i) {
        if (root.kinds[i] == Bvh8Node::Kind::kLeaf) boxes.push_back(root.bounds[i]);
        if (root.kinds[i] != Bvh8Node::Kind::kInner) continue;
        const Bvh8Node& node = tree.nodes[root.children[i]];
        for (size_t k = 0; k < 8; ++k)
            if (node.kinds[k] != Bvh8Node::Kind::kNone) boxes.push_back(node.bounds[k]);
    }
    return boxes;
}

Aabb placed_bounds(const Axes& map, const Aabb& whole, const std::vector<Aabb>& boxes) {
    Aabb result;
    for (const Aabb& box : boxes) result.grow(mapped(map, box));
    // What the kernels add up on the way there and back.
    Double3 far;
    far.x = std::max(std::abs(whole.lower[0]), std::abs(whole.upper[0]));
    far.y = std::max(std::abs(whole.lower[1]), std::abs(whole.upper[1]));
    far.z = std::max(std::abs(whole.lower[2]), std::abs(whole.upper[2]));
    double reach = 0;
    for (const Double3& row : rows_of(map)) reach = std::max(reach, dot_of_magnitudes(row, far));
    const auto slack = static_cast<float>(kBoxSlack * (reach + max_abs(map.origin)));
    for (size_t a = 0; a < 3; ++a) {
        result.lower[a] -= slack;
        result.upper[a] += slack;
    }
    return result;
}

}  // namespace

namespace {

constexpr size_t kCopied = ~size_t{0};

/// Whether the map keeps angles, to float32's precision.
bool is_even(const Axes& map) {
    const double x = dot(map.x, map.x), y = dot(map.y, map.y), z = dot(map.z, map.z);
    return std::max({std::abs(x - y), std::abs(x - z), std::abs(dot(map.x, map.y)),
                     std::abs(dot(map.x, map.z)), std::abs(dot(map.y, map.z))}) <= 1e-5 * x;
}

struct Placements {
    size_t count = 0;
    bool stretched = false;  // some map does not keep angles
};
/// By group; throws for an instance that is not sound.
std::vector<Placements> placements_of(const Scene& scene) {
    std::vector<Placements> placements(scene.groups.size());
    for (const Shape& shape : scene.shapes) {
        if (shape.type != Shape::Type::kInstance) continue;
        check_instance(scene, shape);
        Placements& of_group = placements[static_cast<size_t>(shape.group)];
        ++of_group.count;
        of_group.stretched |= !is_even(Axes(shape.world_from_object));
    }
    return placements;
}

bool has_normals(const ShapeGroup& group) {
    return std::any_of(group.shapes.begin(), group.shapes.end(),
                       [](const Shape& part) { return !part.mesh.normals.empty(); });
}

/// By group its place in data.groups, which get those that are not copied; else kCopied. Vertex
/// normals are interpolated in the group's space before they are stretched, and a copy's are of
/// unit length each: groups with both are never copied.
std::vector<size_t> share_groups(const Scene& scene, SceneData& data, int copied_triangles) {
    const std::vector<Placements> placements = placements_of(scene);
    std::vector<size_t> shared(scene.groups.size(), kCopied), order, triangles;
    const auto share = [&](size_t group) {
        shared[group] = data.groups.size();
        data.groups.emplace_back().group = &scene.groups[group];
    };
    for (size_t i = 0; i < scene.groups.size(); ++i) {
        check_group(scene, scene.groups[i]);
        size_t& sum = triangles.emplace_back(0);
        for (const Shape& part : scene.groups[i].shapes) sum += part.mesh.triangles.size();
        if (sum > 0 && placements[i].stretched && has_normals(scene.groups[i]))
            share(i);
        else if (sum > 0 && placements[i].count > (copied_triangles < 0 ? 0u : 1u))
            order.push_back(i);
    }
    std::stable_sort(order.begin(), order.end(),
                     [&](size_t a, size_t b) { return triangles[a] < triangles[b]; });
    size_t copied = 0;
    for (const size_t i : order) {
        copied += triangles[i] * placements[i].count;
        if (copied <= static_cast<size_t>(std::max(copied_triangles, 0))) continue;
        share(i);
    }
    return shared;
}

}  // namespace

void place_instances(const Scene& scene, SceneData& data, const RendererPaths& paths, bool turn) {
    const std::vector<size_t> shared = share_groups(scene, data, paths.copied_triangles);
    for (const Shape& shape : scene.shapes) {
        if (shape.type != Shape::Type::kInstance) {
            data.shapes.push_back(&shape);
            continue;
        }
        const size_t group = shared[static_cast<size_t>(shape.group)];
        const std::vector<Shape>& parts = scene.groups[static_cast<size_t>(shape.group)].shapes;
        const Axes map(shape.world_from_object);
        const uint32_t object = object_of(scene, shape);
        for (size_t i = 0; i < parts.size(); ++i)
            if (parts[i].type != Shape::Type::kMesh || group == kCopied)
                data.copies.push_back(
                    copy_of(parts[i], map, static_cast<int>(object), static_cast<int>(i), turn));
        if (group != kCopied) data.instances.push_back({group, object, map, {}});
    }
    for (const Shape& shape : data.copies) data.shapes.push_back(&shape);
}

void build_groups(SceneData& data, Workers& workers) {
    std::vector<std::vector<Aabb>> boxes;
    for (GroupData& group : data.groups) {
        group.tree =
            build_bvh8(triangle_boxes(data, group.first, group.count, 0, workers), workers);
        boxes.push_back(upper_boxes(group.tree));
    }
    // Of a group whose triangles were all dropped nothing is seen.
    std::erase_if(data.instances,
                  [&](const InstanceData& i) { return data.groups[i.group].count == 0; });
    run_chunks(workers, data.instances.size(), kInstanceChunk,
               [&](size_t, size_t first, size_t last) {
                   for (size_t i = first; i < last; ++i) {
                       InstanceData& instance = data.instances[i];
                       instance.bounds =
                           placed_bounds(instance.world_from_group,
                                         data.groups[instance.group].bounds, boxes[instance.group]);
                   }
               });
}

void write_instance(const InstanceData& instance, const GroupData& group, uint32_t root,
                    Row* rows) {
    const auto set = [](Row& row, size_t at, Double3 v, double w) {
        const std::array<float, 3> f = to_floats(v);
        std::copy(f.begin(), f.end(), row.begin() + static_cast<std::ptrdiff_t>(at));
        row[at + 3] = static_cast<float>(w);
    };
    const Axes& map = instance.world_from_group;
    const std::array<Double3, 3> in = inverse_rows(map), out = rows_of(map);
    std::array<double, 3> bound;
    for (size_t a = 0; a < 3; ++a)
        bound[a] = std::max(std::abs(group.bounds.lower[a]), std::abs(group.bounds.upper[a]));
    std::fill_n(rows, INSTANCE_ROWS, Row{});
    set(rows[0], 0, in[0], map.origin.x);
    set(rows[0], 4, in[1], map.origin.y);
    set(rows[1], 0, in[2], map.origin.z);
    rows[1][4] = as_float_bits(root);
    rows[1][5] = as_float_bits(instance.object);
    rows[1][6] = static_cast<float>(bound[0]);
    rows[1][7] = static_cast<float>(bound[1]);
    set(rows[2], 0, out[0], bound[2]);
    set(rows[2], 4, out[1], 0);
    set(rows[3], 0, out[2], 0);
}

}  // namespace pave
