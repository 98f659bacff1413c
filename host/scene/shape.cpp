// Shapes of the scene file, their area emitters and the meshes they name.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/shape.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <numbers>

#include "host/scene/colour.h"
#include "host/scene/mesh.h"
#include "host/scene/text.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr size_t kMaxMeshByteSize = size_t{1} << 30;
constexpr double kUniformTolerance =
    1e-4;  // relative; digits that files write are coarser than float32's

constexpr const char *kGroup = "shapegroup", *kInstance = "instance";
const std::map<std::string, Shape::Type> kTypes{{"rectangle", Shape::Type::kRectangle},
                                                {"cube", Shape::Type::kCube},
                                                {"sphere", Shape::Type::kSphere},
                                                {"disk", Shape::Type::kDisk},
                                                {"obj", Shape::Type::kMesh},
                                                {"ply", Shape::Type::kMesh}};

// Columns orthogonal to each other and, if `is_uniform`, equally long.
bool is_orthogonal(const Affine& map, size_t columns, bool is_uniform) {
    for (size_t i = 0; i < columns; ++i)
        for (size_t j = i + 1; j < columns; ++j) {
            const double a = length(map.column(i)), b = length(map.column(j));
            if (std::abs(dot(map.column(i), map.column(j))) > kUniformTolerance * a * b)
                return false;
            if (is_uniform && std::abs(a - b) > kUniformTolerance * a) return false;
        }
    return true;
}

double surface_area(const Shape& shape, const Affine& map) {
    const double xy = length(cross(map.column(0), map.column(1)));
    const double yz = length(cross(map.column(1), map.column(2)));
    const double zx = length(cross(map.column(2), map.column(0)));
    switch (shape.type) {
        case Shape::Type::kRectangle:
            return 4 * xy;
        case Shape::Type::kCube:
            return 8 * (xy + yz + zx);
        case Shape::Type::kSphere:
            return 4 * std::numbers::pi * xy;
        case Shape::Type::kDisk:
            return std::numbers::pi * xy;
        case Shape::Type::kMesh:
            return mesh_area(shape.mesh);
        case Shape::Type::kInstance:
            break;
    }
    return 0;
}

void include(Bounds& bounds, const Shape& shape, const Affine& to_world) {
    if (shape.type == Shape::Type::kMesh) return bounds.include(shape.mesh);
    const bool is_flat = shape.type == Shape::Type::kRectangle || shape.type == Shape::Type::kDisk;
    const bool is_round = shape.type == Shape::Type::kSphere || shape.type == Shape::Type::kDisk;
    bounds.include_image(to_world, {0, 0, 0}, {1, 1, is_flat ? 0.0 : 1.0}, is_round);
}

}  // namespace

std::string read_file(const std::filesystem::path& path, size_t max_byte_size) {
    std::error_code error;
    const std::filesystem::file_status status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) throw InputError(path.string() + ": no such file");
    if (!std::filesystem::is_regular_file(status))
        throw InputError(path.string() + ": not a regular file");
    const uintmax_t byte_size = std::filesystem::file_size(path, error);
    if (error) throw InputError(path.string() + ": " + error.message());
    if (byte_size > max_byte_size)
        throw InputError(path.string() + ": " + std::to_string(byte_size) +
                         " bytes, more than the " + std::to_string(max_byte_size >> 20) +
                         " MiB that are allowed");
    std::string bytes(static_cast<size_t>(byte_size), '\0');
    std::ifstream stream(path, std::ios::binary);
    if (!stream.read(bytes.data(), static_cast<std::streamsize>(bytes.size())))
        throw InputError(path.string() + ": cannot be read");
    return bytes;
}

void ShapeReader::declare_group(pugi::xml_node node) {
    const std::string id = file_.attribute(node, "id");
    if (id.empty()) file_.fail(node, "needs an id, by which instances refer to it");
    const int index = static_cast<int>(groups_.size());
    if (!groups_.emplace(id, Group{node, index, {}}).second)
        file_.fail(node, "id " + quote(id) + " is given twice");
}

void ShapeReader::read_groups() {
    scene_.groups.resize(groups_.size());
    std::vector<Group*> in_order(groups_.size());
    for (auto& [id, group] : groups_) in_order[static_cast<size_t>(group.index)] = &group;
    for (Group* group : in_order) {
        Properties properties(file_, group->node);
        scene_.groups[static_cast<size_t>(group->index)].id = properties.id();
        const std::vector<pugi::xml_node> parts = properties.take_objects("shape");
        properties.finish();
        if (parts.empty()) file_.fail(group->node, "a shapegroup needs shapes inside");
        for (const pugi::xml_node part : parts) read_part(part, *group);
    }
}

void ShapeReader::read_part(pugi::xml_node node, Group& group) {
    const std::string type = file_.attribute(node, "type");
    if (type == kGroup || type == kInstance)
        file_.fail(node, "a shapegroup cannot hold another one, nor instances");
    if (const pugi::xml_node emitter = node.child("emitter"))
        file_.fail(emitter, "a shape of a shapegroup cannot be an emitter");
    Shape shape;
    if (!read(node, shape, group.bounds)) return;
    scene_.groups[static_cast<size_t>(group.index)].shapes.push_back(std::move(shape));
}

const ShapeReader::Group& ShapeReader::group_of(Properties& instance) {
    if (const auto inside = instance.take_objects("shape"); !inside.empty())
        file_.fail(inside[0], "stands in an instance: give the shapegroup an id and a <ref> to it");
    const std::vector<pugi::xml_node> refs = instance.take_objects("ref");
    if (refs.size() != 1)
        file_.fail(refs.empty() ? instance.node() : refs[1],
                   "an instance needs one <ref id=\"...\"> to a shapegroup");
    file_.check_attributes(refs[0], {"id"}, {"name"});
    const std::string id = file_.attribute(refs[0], "id");
    const auto group = groups_.find(id);
    if (group != groups_.end()) return group->second;
    std::vector<std::string> ids;
    for (const auto& entry : groups_) ids.push_back(entry.first);
    file_.fail(refs[0],
               "no shapegroup of the scene has the id " + quote(id) + did_you_mean(id, ids));
}

void ShapeReader::add_instance(pugi::xml_node node) {
    Properties properties(file_, node);
    Shape shape;
    shape.type = Shape::Type::kInstance;
    shape.id = properties.id();
    const Group& group = group_of(properties);
    const Affine to_world = read_to_world(properties);
    properties.finish();
    shape.group = group.index;
    shape.world_from_object = to_world.matrix();
    for (const Shape& part : scene_.groups[static_cast<size_t>(group.index)].shapes)
        if (part.type == Shape::Type::kSphere && !is_orthogonal(to_world, 3, true))
            file_.fail(node,
                       "its shapegroup has a sphere, which can only be scaled by the same "
                       "factor in x, y and z");
    if (!group.bounds.empty()) {
        bounds_.include_image(to_world, group.bounds);
        set_bounds(scene_, bounds_);
    }
    if (!can_place(to_world) || !(group.bounds.empty() || bounds_.in_range()))
        file_.fail(node, "its transform scales by less than 1e-10 or leads beyond 1e12");
    scene_.shapes.push_back(std::move(shape));
}

void ShapeReader::add(pugi::xml_node node) {
    const std::string type = file_.attribute(node, "type");
    if (type == kGroup) return;
    if (type == kInstance) return add_instance(node);
    Shape shape;
    if (!read(node, shape, bounds_)) return;
    set_bounds(scene_, bounds_);
    scene_.shapes.push_back(std::move(shape));
}

bool ShapeReader::read(pugi::xml_node node, Shape& shape, Bounds& bounds) {
    Properties properties(file_, node);
    const auto type = kTypes.find(properties.type());
    if (type == kTypes.end()) {
        std::vector<std::string> names{kGroup, kInstance};
        for (const auto& entry : kTypes) names.push_back(entry.first);
        std::sort(names.begin(), names.end());
        file_.unsupported(node, "this shape is not supported" +
                                    did_you_mean(properties.type(), names) + "; there are " +
                                    join(names));
        return false;
    }
    shape.type = type->second;
    shape.id = properties.id();
    shape.flip_normals = properties.boolean("flip_normals", false);
    properties.accept({"silhouette_sampling_weight"});  // for Mitsuba's differentiation
    Affine to_world = read_to_world(properties);
    const bool has_emitter = [&] {
        for (const pugi::xml_node child : node.children("emitter"))
            if (file_.attribute(child, "type") == "area") return true;
        return false;
    }();
    read_emitter(properties, shape);
    shape.bsdf = bsdfs_.of_shape(properties, has_emitter);
    if (shape.type == Shape::Type::kCube)
        properties.accept({"face_normals"});  // its normals are that anyway
    if (shape.type == Shape::Type::kSphere) read_sphere(properties, shape, to_world);
    if (shape.type == Shape::Type::kDisk && !is_orthogonal(to_world, 2, false))
        file_.fail(node, "a disk cannot be sheared");
    if (shape.type == Shape::Type::kMesh)
        read_mesh(properties, shape, to_world);
    else
        shape.world_from_object = to_world.matrix();
    properties.finish();
    check_material(properties, shape);
    check_area(properties, shape, to_world);
    include(bounds, shape, to_world);
    return true;
}

void ShapeReader::read_emitter(Properties& properties, Shape& shape) {
    const std::vector<pugi::xml_node> nodes = properties.take_objects("emitter");
    if (nodes.size() > 1) file_.fail(nodes[1], "a shape has one emitter");
    if (nodes.empty()) return;
    Properties emitter(file_, nodes[0]);
    if (emitter.type() != "area")
        return file_.unsupported(nodes[0], "only an \"area\" emitter can be inside a shape");
    shape.radiance = read_colour(emitter, "radiance", ColourUse::kRadiance, {1, 1, 1});
    emitter.finish();
    // A dark light would be a light that the CDF over power cannot hold.
    shape.is_emitter = shape.radiance[0] + shape.radiance[1] + shape.radiance[2] > 0;
}

void ShapeReader::read_sphere(Properties& properties, Shape& shape, Affine& to_world) {
    const Double3 center = properties.point("center", {0, 0, 0});
    const double radius = properties.number("radius", 1);
    if (radius == 0) file_.fail(properties.node(), "the radius is 0");
    to_world = compose(to_world, compose(translation(center), scaling({radius, radius, radius})));
    if (!is_orthogonal(to_world, 3, true))
        file_.fail(properties.node(),
                   "a sphere can only be scaled by the same factor in x, y and z");
    // A mirrored sphere is the same sphere with its normals turned, as in Mitsuba; the point
    // reflection is taken out.
    if (to_world.determinant() > 0) return;
    for (Double3& row : to_world.linear) row = -1.0 * row;
    shape.flip_normals = !shape.flip_normals;
}

void ShapeReader::read_mesh(Properties& properties, Shape& shape, const Affine& to_world) {
    MeshPlacement placement{to_world, properties.boolean("face_normals", false),
                            shape.flip_normals};
    const bool is_obj = properties.type() == "obj";
    placement.flip_texcoords = properties.boolean("flip_tex_coords", is_obj);
    const pugi::xml_node name_node = properties.peek("filename");
    if (!name_node) file_.fail(properties.node(), "needs a <string name=\"filename\">");
    const std::filesystem::path name = properties.string("filename", "");
    const std::filesystem::path path = file_.path().parent_path() / name;
    try {
        const std::string bytes = read_file(path, kMaxMeshByteSize);
        hasher_.update(bytes);
        shape.mesh = is_obj ? parse_obj(bytes) : parse_ply(bytes);
        place_mesh(shape.mesh, placement);
    } catch (const MeshError& error) {
        file_.fail(name_node,
                   path.string() + ":" +
                       (std::isdigit(static_cast<unsigned char>(error.what()[0])) ? "" : " ") +
                       error.what());
    } catch (const InputError& error) {
        file_.fail(name_node, error.what());
    }
    shape.flip_normals = false;  // done
}

void ShapeReader::check_material(const Properties& properties, const Shape& shape) const {
    const Bsdf& bsdf = scene_.bsdfs[static_cast<size_t>(shape.bsdf)];
    if (shape.type == Shape::Type::kMesh && bsdf.alpha_u != bsdf.alpha_v)
        file_.fail(properties.node(),
                   "alpha_u and alpha_v need a direction, which meshes have not in PAVE: "
                   "give one alpha");
    if (shape.type == Shape::Type::kMesh && has_texture(bsdf) && shape.mesh.texcoords.empty())
        file_.fail(properties.node(),
                   "its material has a texture, but the mesh has no texture coordinates");
}

void ShapeReader::check_area(const Properties& properties, const Shape& shape,
                             const Affine& to_world) const {
    const double area = surface_area(shape, to_world);
    if (shape.is_emitter && !(area >= static_cast<double>(std::numeric_limits<float>::min())))
        file_.fail(properties.node(), "the emitter has no area");
}

}  // namespace pave
