// glTF, GLB and OBJ through assimp, in a process of its own whose findings come back as bytes.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/import_file.h"

#include <assimp/config.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include <assimp/Importer.hpp>
#include <cstring>
#include <map>
#include <stdexcept>

#include "host/scene/isolate.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr size_t kMaxTriangles = size_t{1} << 27, kMaxPlacements = size_t{1} << 22;

// ---- Bytes between the two processes; lengths are checked, for the other side may have gone wrong
// ----

class Packer {
   public:
    template <typename T>
    void put(const std::vector<T>& values) {
        static_assert(std::is_trivially_copyable_v<T>);
        put_bytes(values.data(), values.size() * sizeof(T));
    }
    void put(const std::vector<std::string>& texts) {
        put(std::vector<uint64_t>{texts.size()});
        for (const std::string& text : texts) put_bytes(text.data(), text.size());
    }
    std::string take() { return std::move(bytes_); }

   private:
    void put_bytes(const void* data, uint64_t byte_size) {
        bytes_.append(reinterpret_cast<const char*>(&byte_size), sizeof byte_size);
        if (byte_size > 0) bytes_.append(static_cast<const char*>(data), byte_size);
    }
    std::string bytes_;
};

class Unpacker {
   public:
    explicit Unpacker(std::string_view bytes) : rest_(bytes) {}

    template <typename T>
    std::vector<T> values() {
        const std::string_view bytes = next();
        if (bytes.size() % sizeof(T) != 0) throw std::runtime_error("gives no sound answer");
        std::vector<T> result(bytes.size() / sizeof(T));
        if (!bytes.empty()) std::memcpy(result.data(), bytes.data(), bytes.size());
        return result;
    }
    std::vector<std::string> texts() {
        const std::vector<uint64_t> count = values<uint64_t>();
        std::vector<std::string> result;
        for (uint64_t i = 0; !count.empty() && i < count[0]; ++i) result.emplace_back(next());
        return result;
    }

   private:
    std::string_view next() {
        uint64_t byte_size = 0;
        if (rest_.size() < sizeof byte_size) throw std::runtime_error("gives no sound answer");
        std::memcpy(&byte_size, rest_.data(), sizeof byte_size);
        rest_.remove_prefix(sizeof byte_size);
        if (byte_size > rest_.size()) throw std::runtime_error("gives no sound answer");
        const std::string_view bytes = rest_.substr(0, byte_size);
        rest_.remove_prefix(byte_size);
        return bytes;
    }
    std::string_view rest_;
};

std::string pack(const ImportedFile& file) {
    Packer packer;
    packer.put(file.materials);
    packer.put(file.mesh_materials);
    packer.put(file.placements);
    for (const Mesh& mesh : file.meshes) {
        packer.put(mesh.positions);
        packer.put(mesh.normals);
        packer.put(mesh.texcoords);
        packer.put(mesh.triangles);
    }
    packer.put(file.images);
    packer.put(file.image_paths);
    packer.put(std::vector<int32_t>{file.light_count});
    return packer.take();
}

ImportedFile unpack(std::string_view bytes) {
    Unpacker unpacker(bytes);
    ImportedFile file;
    file.materials = unpacker.values<ImportedMaterial>();
    file.mesh_materials = unpacker.values<int32_t>();
    file.placements = unpacker.values<ImportedPlacement>();
    for (size_t i = 0; i < file.mesh_materials.size(); ++i) {
        Mesh mesh;
        mesh.positions = unpacker.values<std::array<float, 3>>();
        mesh.normals = unpacker.values<std::array<float, 3>>();
        mesh.texcoords = unpacker.values<std::array<float, 2>>();
        mesh.triangles = unpacker.values<std::array<uint32_t, 3>>();
        file.meshes.push_back(std::move(mesh));
    }
    file.images = unpacker.texts();
    file.image_paths = unpacker.texts();
    const std::vector<int32_t> lights = unpacker.values<int32_t>();
    file.light_count = lights.empty() ? 0 : lights[0];
    return file;
}

// ---- In the other process ----

class AssimpReader {
   public:
    AssimpReader(const aiScene& scene, bool is_gltf) : scene_(scene), is_gltf_(is_gltf) {}

    ImportedFile read() {
        for (unsigned i = 0; i < scene_.mNumMaterials; ++i) add_material(*scene_.mMaterials[i]);
        size_t triangles = 0;
        for (unsigned i = 0; i < scene_.mNumMeshes; ++i) {
            triangles += scene_.mMeshes[i]->mNumFaces;
            if (triangles > kMaxTriangles) throw std::runtime_error("has too many triangles");
            add_mesh(*scene_.mMeshes[i]);
        }
        if (scene_.mRootNode != nullptr) add_node(*scene_.mRootNode, aiMatrix4x4t<double>());
        file_.light_count = static_cast<int32_t>(scene_.mNumLights);
        return std::move(file_);
    }

   private:
    static Rgb rgb_of(const aiColor3D& c) { return {c.r, c.g, c.b}; }

    void add_material(const aiMaterial& from) {
        ImportedMaterial to;
        aiColor3D colour;
        aiColor4D base;
        if (is_gltf_ && from.Get(AI_MATKEY_BASE_COLOR, base) == AI_SUCCESS)
            to.base = {base.r, base.g, base.b};
        else if (from.Get(AI_MATKEY_COLOR_DIFFUSE, colour) == AI_SUCCESS)
            to.base = rgb_of(colour);
        if (from.Get(AI_MATKEY_COLOR_SPECULAR, colour) == AI_SUCCESS) to.specular = rgb_of(colour);
        if (from.Get(AI_MATKEY_COLOR_EMISSIVE, colour) == AI_SUCCESS) to.emission = rgb_of(colour);
        (void)from.Get(AI_MATKEY_SHININESS, to.shininess);
        (void)from.Get(AI_MATKEY_METALLIC_FACTOR, to.metallic);
        (void)from.Get(AI_MATKEY_ROUGHNESS_FACTOR, to.roughness);
        to.has_roughness = is_gltf_;
        float opacity = 1;
        (void)from.Get(AI_MATKEY_OPACITY, opacity);
        to.is_transparent = opacity < 1;
        to.has_emission_image = from.GetTextureCount(aiTextureType_EMISSIVE) > 0;
        for (const aiTextureType type : {aiTextureType_BASE_COLOR, aiTextureType_DIFFUSE})
            if (to.image < 0 && from.GetTextureCount(type) > 0) add_image(from, type, to);
        file_.materials.push_back(to);
    }

    void add_image(const aiMaterial& from, aiTextureType type, ImportedMaterial& to) {
        aiString name;
        aiTextureMapMode modes[3] = {aiTextureMapMode_Wrap, aiTextureMapMode_Wrap,
                                     aiTextureMapMode_Wrap};
        if (from.GetTexture(type, 0, &name, nullptr, nullptr, nullptr, nullptr, modes) !=
            AI_SUCCESS)
            return;
        if (modes[0] == aiTextureMapMode_Mirror) to.wrap = static_cast<int>(Texture::Wrap::kMirror);
        if (modes[0] == aiTextureMapMode_Clamp) to.wrap = static_cast<int>(Texture::Wrap::kClamp);
        const auto [entry, is_new] =
            images_.emplace(name.C_Str(), static_cast<int>(file_.images.size()));
        to.image = entry->second;
        if (!is_new) return;
        const aiTexture* embedded = scene_.GetEmbeddedTexture(name.C_Str());
        if (embedded != nullptr && embedded->mHeight != 0)
            throw std::runtime_error("has an image that is neither PNG nor JPEG");
        file_.images.emplace_back(
            embedded == nullptr
                ? std::string()
                : std::string(reinterpret_cast<const char*>(embedded->pcData), embedded->mWidth));
        file_.image_paths.emplace_back(embedded == nullptr ? name.C_Str() : "");
    }

    void add_mesh(const aiMesh& from) {
        Mesh to;
        for (unsigned i = 0; i < from.mNumVertices; ++i) {
            const aiVector3D& p = from.mVertices[i];
            to.positions.push_back({p.x, p.y, p.z});
            if (from.HasNormals()) {
                const aiVector3D& n = from.mNormals[i];
                to.normals.push_back({n.x, n.y, n.z});
            }
            // assimp counts v from an image's bottom.
            if (from.HasTextureCoords(0))
                to.texcoords.push_back(
                    {from.mTextureCoords[0][i].x, 1 - from.mTextureCoords[0][i].y});
        }
        for (unsigned i = 0; i < from.mNumFaces; ++i) {
            const aiFace& face = from.mFaces[i];
            if (face.mNumIndices == 3)
                to.triangles.push_back({face.mIndices[0], face.mIndices[1], face.mIndices[2]});
        }
        meshes_.push_back(to.triangles.empty() ? -1 : static_cast<int32_t>(file_.meshes.size()));
        if (to.triangles.empty()) return;  // points and lines
        file_.meshes.push_back(std::move(to));
        file_.mesh_materials.push_back(static_cast<int32_t>(from.mMaterialIndex));
    }

    void add_node(const aiNode& node, const aiMatrix4x4t<double>& world_from_parent) {
        const aiMatrix4x4t<double> m =
            world_from_parent * aiMatrix4x4t<double>(node.mTransformation);
        for (unsigned i = 0; i < node.mNumMeshes; ++i) {
            const int32_t mesh = meshes_.at(node.mMeshes[i]);
            if (mesh < 0) continue;
            if (file_.placements.size() == kMaxPlacements)
                throw std::runtime_error("has too many nodes with meshes");
            file_.placements.push_back(
                {{m.a1, m.a2, m.a3, m.a4, m.b1, m.b2, m.b3, m.b4, m.c1, m.c2, m.c3, m.c4},
                 mesh,
                 0});
        }
        for (unsigned i = 0; i < node.mNumChildren; ++i) add_node(*node.mChildren[i], m);
    }

    const aiScene& scene_;
    bool is_gltf_;
    ImportedFile file_;
    std::map<std::string, int> images_;
    std::vector<int32_t> meshes_;  // into the file's; -1: left out
};

std::string read_and_pack(const std::filesystem::path& path) {
    Assimp::Importer importer;
    importer.SetPropertyInteger(AI_CONFIG_PP_SBP_REMOVE,
                                aiPrimitiveType_POINT | aiPrimitiveType_LINE);
    const aiScene* scene =
        importer.ReadFile(path.string(), aiProcess_Triangulate | aiProcess_JoinIdenticalVertices |
                                             aiProcess_GenSmoothNormals | aiProcess_SortByPType |
                                             aiProcess_ValidateDataStructure);
    if (scene == nullptr) {
        std::string reason = importer.GetErrorString();
        for (char& c : reason)
            if (static_cast<unsigned char>(c) < ' ') c = ' ';
        throw std::runtime_error(reason);
    }
    std::string extension = path.extension().string();
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    const bool is_obj = extension == ".obj";
    return pack(AssimpReader(*scene, !is_obj).read());
}

}  // namespace

ImportedFile import_file(const std::filesystem::path& path) {
    try {
        return unpack(run_isolated([&] { return read_and_pack(path); }));
    } catch (const std::runtime_error& error) {
        throw InputError(path.string() + ": cannot be imported: " + error.what());
    }
}

}  // namespace pave
