// Shapes of the scene file, their area emitters and the meshes they name.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/scene/bsdf.h"
#include "host/scene/transform.h"
#include "pave/hash.h"

namespace pave {

/// Whole content of a regular file of at most `max_byte_size`. Throws InputError naming the file
/// and the reason.
std::string read_file(const std::filesystem::path& path, size_t max_byte_size);

class ShapeReader {
   public:
    /// Every mesh file's bytes go into `hasher`, in the order of the shapes.
    ShapeReader(SceneFile& file, BsdfReader& bsdfs, Scene& scene, Hasher& hasher)
        : file_(file), bsdfs_(bsdfs), scene_(scene), hasher_(hasher) {}

    /// Appends the shape to the scene and widens the scene's bounds.
    void add(pugi::xml_node node);

   private:
    void read_emitter(Properties& properties, Shape& shape);
    void read_sphere(Properties& properties, Shape& shape, Affine& to_world);
    void read_mesh(Properties& properties, Shape& shape, const Affine& to_world);
    void check_material(const Properties& properties, const Shape& shape) const;
    void check_area(const Properties& properties, const Shape& shape, const Affine& to_world) const;
    void grow_bounds(const Shape& shape, const Affine& to_world);
    void include(const Double3& low, const Double3& high);

    SceneFile& file_;
    BsdfReader& bsdfs_;
    Scene& scene_;
    Hasher& hasher_;
};

}  // namespace pave
