// Shapes of the scene file, their area emitters and the meshes they name.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/scene/bounds.h"
#include "host/scene/bsdf.h"
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

    /// Makes a <shape type="shapegroup"> of the scene known by its id.
    void declare_group(pugi::xml_node node);
    /// Reads those declared, before the shapes that refer to them.
    void read_groups();
    /// Appends the shape to the scene and widens the scene's bounds. Groups were read before.
    void add(pugi::xml_node node);

   private:
    struct Group {
        pugi::xml_node node;
        int index;
        Bounds bounds;
    };
    /// Whether there is a shape: an unsupported one may be ignored. `bounds` grow around it.
    bool read(pugi::xml_node node, Shape& shape, Bounds& bounds);
    void read_part(pugi::xml_node node, Group& group);
    void add_instance(pugi::xml_node node);
    const Group& group_of(Properties& instance);
    void read_emitter(Properties& properties, Shape& shape);
    void read_sphere(Properties& properties, Shape& shape, Affine& to_world);
    void read_mesh(Properties& properties, Shape& shape, const Affine& to_world);
    void check_material(const Properties& properties, const Shape& shape) const;
    void check_area(const Properties& properties, const Shape& shape, const Affine& to_world) const;

    SceneFile& file_;
    BsdfReader& bsdfs_;
    Scene& scene_;
    Hasher& hasher_;
    std::map<std::string, Group> groups_;  // by id
    Bounds bounds_;
};

}  // namespace pave
