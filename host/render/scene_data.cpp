// Puts a scene's parts together for the device: bounds, and the features its programs need.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/scene_data.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "pave/error.h"

namespace pave {
namespace {

bool has_bsdf(const Scene& scene, Bsdf::Type type) {
    return std::any_of(scene.bsdfs.begin(), scene.bsdfs.end(),
                       [&](const Bsdf& b) { return b.type == type; });
}

bool has_light(const SceneData& data, int kind) {
    for (size_t row = 0; row < data.lights.size(); row += LIGHT_ROWS)
        if (std::bit_cast<int32_t>(data.lights[row][3]) == kind) return true;
    return false;
}

/// Bounds of all shapes (those of the triangles are in already), and how far rays start off them at
/// least: a thousandth of what the largest coordinate would ask for.
void set_bounds(SceneData& data) {
    for (const auto& shape : data.flats) data.bounds.grow(bounds_of(shape));
    for (const auto& shape : data.cubes) data.bounds.grow(bounds_of(shape));
    for (const auto& shape : data.spheres) data.bounds.grow(bounds_of(shape));
    for (const auto& instance : data.instances) data.bounds.grow(instance.bounds);
    if (data.bounds.empty()) return;
    double extent = 0;
    for (size_t a = 0; a < 3; ++a)
        extent = std::max(extent, static_cast<double>(data.bounds.upper[a]) - data.bounds.lower[a]);
    data.offset_floor = static_cast<float>(extent * 0x1p-30);
}

}  // namespace

float as_float_bits(uint32_t bits) { return std::bit_cast<float>(bits); }

bool emits(const Shape& shape) { return shape.is_emitter && luminance(shape.radiance) > 0; }

uint32_t object_of(const Scene& scene, const Shape& shape) {
    if (shape.object >= 0) return static_cast<uint32_t>(shape.object);
    return static_cast<uint32_t>(&shape - scene.shapes.data());
}

std::string name_of(const Scene& scene, const Shape& shape) {
    for (const ShapeGroup& group : scene.groups)
        for (const Shape& part : group.shapes)
            if (&part == &shape)
                return "scene '" + scene.name + "': group '" + group.id + "': shape " +
                       std::to_string(&part - group.shapes.data()) +
                       (shape.id.empty() ? "" : " '" + shape.id + "'");
    return "scene '" + scene.name + "': shape " + std::to_string(object_of(scene, shape)) +
           (shape.id.empty() ? "" : " '" + shape.id + "'");
}

void add_features(const Scene& scene, SceneData& data, const RendererPaths& paths) {
    const auto set = [&](const char* name, int value) {
        data.features.insert_or_assign(name, value);
    };
    // In coarse steps, so that most scenes share one program.
    set("PAVE_STACK", std::max((data.stack + 63) / 64 * 64, 64));
    const bool shapes = !data.flats.empty() || !data.cubes.empty() || !data.spheres.empty();
    set("PAVE_TREE_SHAPES", !data.broadcast && shapes);
    set("PAVE_ONE_LIGHT", paths.specialise && data.lights.size() == LIGHT_ROWS);
    if (!paths.specialise) {
        set("PAVE_TREE_SHAPES", 1);
        return;
    }
    set("PAVE_HAS_AXIS_RECTS", !data.axis_rects.empty());
    set("PAVE_FEW_SURFACES", data.surfaces.size() <= 32 * SURFACE_ROWS);
    set("PAVE_HAS_AXIS_CUBES", !data.axis_cubes.empty());
    set("PAVE_HAS_RECTS", data.broadcast && data.flat_count[FLAT_RECT] > 0);
    set("PAVE_HAS_DISKS", data.broadcast && data.flat_count[FLAT_DISK] > 0);
    set("PAVE_HAS_FLAT_TRIANGLES", data.broadcast && data.flat_count[FLAT_TRIANGLE] > 0);
    set("PAVE_HAS_CUBES", data.broadcast && !data.cubes.empty());
    set("PAVE_HAS_SPHERES", data.broadcast && !data.spheres.empty());
    set("PAVE_HAS_TRIANGLES", !data.corners.empty());
    set("PAVE_HAS_INSTANCES", !data.instances.empty());
    set("PAVE_HAS_SMOOTH", data.smooth);
    set("PAVE_HAS_CONDUCTOR", has_bsdf(scene, Bsdf::Type::kConductor));
    set("PAVE_HAS_ROUGH", has_bsdf(scene, Bsdf::Type::kRoughConductor));
    set("PAVE_HAS_DIELECTRIC", has_bsdf(scene, Bsdf::Type::kDielectric));
    set("PAVE_HAS_PLASTIC", has_bsdf(scene, Bsdf::Type::kPlastic));
    set("PAVE_HAS_ROUGH_DIELECTRIC", has_bsdf(scene, Bsdf::Type::kRoughDielectric));
    const auto any_bsdf = [&](auto test) {
        return std::any_of(scene.bsdfs.begin(), scene.bsdfs.end(), test);
    };
    set("PAVE_HAS_ANISOTROPIC", any_bsdf([](const Bsdf& b) { return b.alpha_u != b.alpha_v; }));
    set("PAVE_HAS_TEXTURES", any_bsdf([](const Bsdf& b) { return has_texture(b); }));
    set("PAVE_HAS_TWO_SIDED", any_bsdf([](const Bsdf& b) { return b.two_sided; }));
    set("PAVE_HAS_QUAD_LIGHT", has_light(data, LIGHT_QUAD));
    set("PAVE_HAS_TRIANGLE_LIGHT", has_light(data, LIGHT_TRIANGLE));
    set("PAVE_HAS_DISK_LIGHT", has_light(data, LIGHT_DISK));
    set("PAVE_HAS_SPHERE_LIGHT", has_light(data, LIGHT_SPHERE));
    set("PAVE_HAS_ENVIRONMENT", has_light(data, LIGHT_ENVIRONMENT));
    set("PAVE_HAS_ENVMAP", data.environment.size() > ENVIRONMENT_ROWS);
    set("PAVE_HAS_POINT_LIGHT", has_light(data, LIGHT_POINT));
}

SceneData build_scene_data(const Scene& scene, const RendererPaths& paths, bool tables) {
    const auto most_shapes = static_cast<size_t>(std::max(paths.broadcast_shapes, 0));
    SceneData data;
    Workers workers;
    std::vector<LightSource> lights;
    add_textures(scene, data);
    add_materials(scene, data);
    place_instances(scene, data, paths, tables);
    data.parts.resize(data.shapes.size());
    if (paths.recognise_shapes) recognise_shapes(scene, data, most_shapes);
    add_shapes(scene, data, lights);
    add_triangles(scene, data, lights, tables, workers);
    build_groups(data, workers);
    set_bounds(data);
    add_lights(scene, data, std::move(lights));
    add_environment(scene, data);
    const size_t shapes = data.flats.size() + data.cubes.size() + data.spheres.size();
    data.broadcast = shapes <= most_shapes;
    if (data.broadcast) sort_occluders(scene, data, paths);
    data.repeat_shapes = data.broadcast && paths.specialise;
    if (data.repeat_shapes) split_axis_shapes(data);
    add_tree(data, workers);
    add_features(scene, data, paths);
    data.shapes = std::vector<const Shape*>();
    data.copies = std::vector<Shape>();
    data.groups = std::vector<GroupData>();
    data.surface_count = static_cast<int>(data.surfaces.size() / SURFACE_ROWS);
    data.light_count = static_cast<int>(data.lights.size() / LIGHT_ROWS);
    // Lanes without a hit read entry 0 of every table.
    if (data.surfaces.empty()) data.surfaces.resize(SURFACE_ROWS);
    if (data.triangles.empty()) data.triangles.resize(TRIANGLE_ROWS);
    if (data.bsdfs.empty()) data.bsdfs.resize(BSDF_ROWS);
    if (data.lights.empty()) data.lights.resize(LIGHT_ROWS);
    if (data.uvs.empty()) data.uvs.resize(UV_ROWS);
    if (data.textures.empty()) data.textures.resize(TEXTURE_ROWS);
    return data;
}

}  // namespace pave
