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
    }
    return 0;
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

void ShapeReader::add(pugi::xml_node node) {
    Properties properties(file_, node);
    const auto type = kTypes.find(properties.type());
    if (type == kTypes.end()) {
        std::vector<std::string> names;
        for (const auto& entry : kTypes) names.push_back(entry.first);
        file_.unsupported(node, "this shape is not supported" +
                                    did_you_mean(properties.type(), names) + "; there are " +
                                    join(names));
        return;
    }
    Shape shape;
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
    grow_bounds(shape, to_world);
    scene_.shapes.push_back(std::move(shape));
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

void ShapeReader::include(const Double3& low, const Double3& high) {
    for (size_t i = 0; i < 3; ++i) {
        scene_.bounds_min[i] = std::min(scene_.bounds_min[i], static_cast<float>(low[i]));
        scene_.bounds_max[i] = std::max(scene_.bounds_max[i], static_cast<float>(high[i]));
    }
}

void ShapeReader::grow_bounds(const Shape& shape, const Affine& to_world) {
    if (scene_.shapes.empty()) {
        scene_.bounds_min.fill(std::numeric_limits<float>::infinity());
        scene_.bounds_max.fill(-std::numeric_limits<float>::infinity());
    }
    if (shape.type == Shape::Type::kMesh) {
        for (const std::array<uint32_t, 3>& triangle : shape.mesh.triangles)
            for (const uint32_t vertex : triangle) {
                const std::array<float, 3>& p = shape.mesh.positions[vertex];
                include({p[0], p[1], p[2]}, {p[0], p[1], p[2]});
            }
        return;
    }
    // Half-extent along each axis of the image of a box (sum of the columns' parts) or of a ball
    // (their root of squares).
    const bool is_flat = shape.type == Shape::Type::kRectangle || shape.type == Shape::Type::kDisk;
    const bool is_round = shape.type == Shape::Type::kSphere || shape.type == Shape::Type::kDisk;
    Double3 half{};
    for (size_t axis = 0; axis < 3; ++axis) {
        const Double3& row = to_world.linear[axis];
        const double z = is_flat ? 0 : row[2];
        half[axis] = is_round ? length({row[0], row[1], z})
                              : std::abs(row[0]) + std::abs(row[1]) + std::abs(z);
    }
    include(to_world.offset - half, to_world.offset + half);
}

}  // namespace pave
