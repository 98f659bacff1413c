// A model as a scene: its materials as PAVE's, emission as light, and a camera that sees it all.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/import_scene.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "host/scene/bounds.h"
#include "host/scene/image.h"
#include "host/scene/import_file.h"
#include "host/scene/mesh.h"
#include "host/scene/shape.h"
#include "host/scene/text.h"
#include "pave/error.h"

namespace pave {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMaxModelByteSize = size_t{1} << 30, kMaxImageByteSize = size_t{256} << 20;
constexpr float kMetal = 0.5f;    // glTF: metallic from here on is metal
constexpr float kGlossy = 0.3f;   // glTF: roughness up to here is plastic's clear coat
constexpr float kShiny = 100.0f;  // MTL: Ns from here on is a clear coat
constexpr float kFovDegrees = 40.0f;
constexpr int kSpp = 64, kMaxDepth = 16;

class ModelReader {
   public:
    ModelReader(const fs::path& path, Hasher& hasher) : path_(path), hasher_(hasher) {}

    Scene read() {
        hasher_.update(read_file(path_, kMaxModelByteSize));
        ImportedFile file = import_file(path_);
        for (size_t i = 0; i < file.images.size(); ++i) add_image(file, i);
        for (const ImportedMaterial& material : file.materials) add_material(material);
        if (file.materials.empty()) scene_.bsdfs.emplace_back();
        const std::vector<std::vector<Affine>> places = places_of(file);
        for (size_t i = 0; i < file.meshes.size(); ++i) add_mesh(file, i, places[i]);
        if (scene_.shapes.empty()) fail("has no triangle with an area");
        if (file.light_count > 0) warn("lights that are no surface are left out");
        const bool is_lit = std::any_of(scene_.shapes.begin(), scene_.shapes.end(),
                                        [](const Shape& shape) { return shape.is_emitter; });
        scene_.has_environment = !is_lit;
        if (!is_lit) scene_.environment = {1, 1, 1};
        if (!bounds_.in_range()) fail("reaches beyond 1e12");
        set_bounds(scene_, bounds_);
        set_view();
        scene_.spp = kSpp;
        scene_.max_depth = kMaxDepth;
        scene_.name = path_.stem().string();
        return std::move(scene_);
    }

   private:
    [[noreturn]] void fail(const std::string& reason) const {
        throw InputError(path_.string() + ": " + reason);
    }
    void warn(const std::string& reason) {
        const std::string text = path_.string() + ": " + reason;
        if (std::find(scene_.warnings.begin(), scene_.warnings.end(), text) ==
            scene_.warnings.end())
            scene_.warnings.push_back(text);
    }

    /// Bytes of an image beside the file; names that lead elsewhere are refused.
    std::string read_beside(const std::string& name) const {
        const fs::path relative = fs::path(name).lexically_normal();
        if (name.empty() || relative.is_absolute() || *relative.begin() == ".." ||
            name.find('\\') != std::string::npos)
            fail("image " + quote(name) + " is not in the model's folder");
        return read_file(path_.parent_path() / relative, kMaxImageByteSize);
    }

    void add_image(const ImportedFile& file, size_t i) {
        const std::string& name = file.image_paths.at(i);
        const std::string bytes = file.images[i].empty() ? read_beside(name) : file.images[i];
        hasher_.update(bytes);
        try {
            images_.push_back(decode_image(bytes));
        } catch (const ImageError& error) {
            fail("image " + (name.empty() ? std::to_string(i) : quote(name)) + ": " + error.what());
        }
    }

    int add_texture(const ImportedMaterial& material) {
        if (material.image < 0) return -1;
        if (static_cast<size_t>(material.image) >= images_.size()) fail("an image is missing");
        Texture texture;
        texture.image = images_[static_cast<size_t>(material.image)];
        if (!texture.image.floats.empty()) fail("an image of colours is OpenEXR");
        texture.wrap = static_cast<Texture::Wrap>(std::clamp(material.wrap, 0, 2));
        scene_.textures.push_back(std::move(texture));
        return static_cast<int>(scene_.textures.size()) - 1;
    }

    Rgb colour(Rgb rgb) const {
        for (float& x : rgb) x = std::isfinite(x) ? std::clamp(x, 0.0f, 1.0f) : 0.0f;
        return rgb;
    }

    void add_material(const ImportedMaterial& from) {
        Bsdf to;
        to.two_sided = true;  // models are often seen from behind
        const Rgb specular = colour(from.specular), base = colour(from.base);
        const bool is_metal =
            from.has_roughness != 0
                ? from.metallic >= kMetal
                : *std::max_element(base.begin(), base.end()) == 0 && specular != Rgb{0, 0, 0};
        const bool is_coated = from.has_roughness != 0
                                   ? from.roughness <= kGlossy
                                   : specular != Rgb{0, 0, 0} && from.shininess >= kShiny;
        const int texture = add_texture(from);
        if (is_metal) {
            // A perfect mirror's facets, tinted.
            to.type = Bsdf::Type::kRoughConductor;
            to.specular_reflectance = from.has_roughness != 0 ? base : specular;
            to.specular_reflectance_texture = texture;
            const float alpha = from.has_roughness != 0
                                    ? from.roughness * from.roughness
                                    : std::sqrt(2 / (std::max(from.shininess, 0.0f) + 2));
            to.alpha_u = to.alpha_v = std::isfinite(alpha) ? std::clamp(alpha, 1e-3f, 1.0f) : 1.0f;
        } else {
            to.type = is_coated ? Bsdf::Type::kPlastic : Bsdf::Type::kDiffuse;
            to.reflectance = base;
            to.reflectance_texture = texture;
            to.int_ior = 1.5f;
            to.ext_ior = 1.0f;
        }
        if (from.is_transparent != 0) warn("transparency is left out");
        if (from.has_emission_image != 0) warn("images of emission are left out");
        scene_.bsdfs.push_back(to);
    }

    /// The mesh where its nodes put it. One that several nodes share becomes a group, unless it
    /// emits.
    void add_mesh(ImportedFile& file, size_t i, const std::vector<Affine>& places) {
        Shape shape;
        shape.type = Shape::Type::kMesh;
        shape.mesh = std::move(file.meshes[i]);
        check(shape.mesh);
        hash(shape.mesh);  // buffers may lie in other files
        if (places.empty()) return;
        const int32_t material = file.mesh_materials[i];
        if (material < 0 ||
            static_cast<size_t>(material) >= std::max<size_t>(file.materials.size(), 1))
            fail("a material is missing");
        shape.bsdf = material;
        if (!file.materials.empty()) {
            Rgb radiance = file.materials[static_cast<size_t>(material)].emission;
            for (float& x : radiance) x = std::isfinite(x) ? std::clamp(x, 0.0f, 1e6f) : 0.0f;
            shape.radiance = radiance;
            shape.is_emitter = radiance != Rgb{0, 0, 0};
        }
        try {
            if (places.size() == 1 || shape.is_emitter) {
                for (const Affine& place : places) {
                    Shape copy = shape;
                    place_facing(copy.mesh, place);
                    add_shape(std::move(copy));
                }
                return;
            }
            place_mesh(shape.mesh, {});
        } catch (const MeshError& error) {
            warn("mesh " + std::to_string(i) + " is left out: " + error.what());
            return;
        }
        Bounds bounds;
        bounds.include(shape.mesh);
        use_material_of(shape);
        const int group = static_cast<int>(scene_.groups.size());
        scene_.groups.push_back({"mesh " + std::to_string(i), {}});
        scene_.groups.back().shapes.push_back(std::move(shape));
        for (const Affine& place : places) {
            Shape instance;
            instance.type = Shape::Type::kInstance;
            instance.group = group;
            instance.world_from_object = place.matrix();
            bounds_.include_image(place, bounds);
            scene_.shapes.push_back(std::move(instance));
        }
    }

    /// Front stays front: glTF turns the winding where a node mirrors.
    static void place_facing(Mesh& mesh, const Affine& place) {
        if (place.determinant() < 0)
            for (auto& triangle : mesh.triangles) std::swap(triangle[1], triangle[2]);
        place_mesh(mesh, {.world_from_object = place});
    }

    void add_shape(Shape shape) {
        use_material_of(shape);
        bounds_.include(shape.mesh);
        scene_.shapes.push_back(std::move(shape));
    }

    /// Without its image where the mesh has no texture coordinates.
    void use_material_of(Shape& shape) {
        const Bsdf& bsdf = scene_.bsdfs[static_cast<size_t>(shape.bsdf)];
        if (!has_texture(bsdf) || !shape.mesh.texcoords.empty()) return;
        warn("an image is left out, its mesh has no texture coordinates");
        Bsdf plain = bsdf;
        plain.reflectance_texture = plain.specular_reflectance_texture = -1;
        scene_.bsdfs.push_back(plain);
        shape.bsdf = static_cast<int>(scene_.bsdfs.size()) - 1;
    }

    /// By mesh, where its nodes put it; nodes that flatten it or are out of range are left out.
    std::vector<std::vector<Affine>> places_of(const ImportedFile& file) {
        std::vector<std::vector<Affine>> places(file.meshes.size());
        for (const ImportedPlacement& placement : file.placements) {
            if (placement.mesh < 0 || static_cast<size_t>(placement.mesh) >= places.size())
                fail("a mesh is missing");
            Affine map;
            for (size_t row = 0; row < 3; ++row) {
                const double* m = placement.world_from_mesh.data() + 4 * row;
                map.linear[row] = {m[0], m[1], m[2]};
                map.offset[row] = m[3];
            }
            if (can_place(map))
                places[static_cast<size_t>(placement.mesh)].push_back(map);
            else
                warn("a node is left out: its transform is singular or out of range");
            hasher_.update({reinterpret_cast<const char*>(placement.world_from_mesh.data()),
                            sizeof placement.world_from_mesh});
        }
        return places;
    }

    void check(const Mesh& mesh) const {
        const size_t count = mesh.positions.size();
        for (const auto& triangle : mesh.triangles)
            for (const uint32_t vertex : triangle)
                if (vertex >= count) fail("a vertex is missing");
        if ((!mesh.normals.empty() && mesh.normals.size() != count) ||
            (!mesh.texcoords.empty() && mesh.texcoords.size() != count))
            fail("vertices have not as many normals or texture coordinates");
        for (const auto& uv : mesh.texcoords)
            if (!std::isfinite(uv[0]) || !std::isfinite(uv[1]))
                fail("a texture coordinate is not finite");
    }

    void hash(const Mesh& mesh) {
        const auto add = [&](const auto& values) {
            hasher_.update(
                {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(values[0])});
        };
        add(mesh.positions);
        add(mesh.normals);
        add(mesh.texcoords);
        add(mesh.triangles);
    }

    /// From the front, a little from the right and above (+y is up): the sphere around the bounds
    /// just fits.
    void set_view() {
        const Double3 direction = normalized({0.5, 0.4, 1.0});
        Double3 center{}, half{};
        for (size_t a = 0; a < 3; ++a) {
            center[a] = (static_cast<double>(scene_.bounds_min[a]) + scene_.bounds_max[a]) / 2;
            half[a] = (static_cast<double>(scene_.bounds_max[a]) - scene_.bounds_min[a]) / 2;
        }
        const double distance = length(half) / std::sin(kFovDegrees / 2 * std::numbers::pi / 180);
        const Double3 eye = center + distance * direction;
        const auto narrow = [](const Double3& v) {
            return std::array{static_cast<float>(v[0]), static_cast<float>(v[1]),
                              static_cast<float>(v[2])};
        };
        scene_.view = look_at(narrow(eye), narrow(center), {0, 1, 0}, kFovDegrees);
    }

    const fs::path& path_;
    Hasher& hasher_;
    Scene scene_;
    std::vector<Image> images_;
    Bounds bounds_;
};

}  // namespace

bool is_model(const fs::path& path) {
    std::string extension = path.extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return std::tolower(c); });
    return extension == ".glb" || extension == ".gltf" || extension == ".obj";
}

Scene import_scene(const fs::path& path, Hasher& hasher) {
    return ModelReader(path, hasher).read();
}

}  // namespace pave
