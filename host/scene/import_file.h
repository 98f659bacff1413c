// What a glTF, GLB or OBJ file holds, before it becomes a scene.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>

#include "pave/scene.h"

namespace pave {

struct ImportedMaterial {
    Rgb base{1, 1, 1}, specular{0, 0, 0}, emission{0, 0, 0};
    float metallic = 0, roughness = 1, shininess = 0;
    int32_t has_roughness = 0;  // glTF's model; else that of an MTL file
    int32_t is_transparent = 0, has_emission_image = 0;
    int32_t image = -1;  // of the base colour
    int32_t wrap = 0;    // Texture::Wrap
};

/// A mesh where a node puts it.
struct ImportedPlacement {
    std::array<double, 12> world_from_mesh;  // three rows of four
    int32_t mesh, spare;
};

struct ImportedFile {
    std::vector<ImportedMaterial> materials;
    std::vector<Mesh> meshes;             // each in its own space
    std::vector<int32_t> mesh_materials;  // one a mesh
    std::vector<ImportedPlacement> placements;
    std::vector<std::string> images;       // a PNG or JPEG file's bytes
    std::vector<std::string> image_paths;  // or, where those are empty, its place beside the file
    int32_t light_count = 0;               // lights that are no surface
};

/// Reads the file in a process of its own: importers have open faults, and models come from
/// anywhere. Throws InputError naming the file.
ImportedFile import_file(const std::filesystem::path& path);

}  // namespace pave
