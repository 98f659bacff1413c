// Textures of the scene file: <texture> elements, nested ones and those referred to by id.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>

#include "host/scene/image.h"
#include "host/scene/xml.h"
#include "pave/hash.h"

namespace pave {

/// Reads textures into Scene::textures, each once.
class TextureReader {
   public:
    /// Every image file's bytes go into `hasher`, in the order of the textures.
    TextureReader(SceneFile& file, std::vector<Texture>& textures, Hasher& hasher)
        : file_(file), textures_(textures), hasher_(hasher) {}

    /// Makes a <texture> of the scene known by its id; it is read when something refers to it.
    void declare(pugi::xml_node node);
    /// Reads what nothing referred to, so that its errors show too.
    void read_declared();
    /// Index of a <texture>, or of the one that a <ref> names; -1 for an unsupported one that is
    /// ignored.
    int find(pugi::xml_node node);
    bool is_declared(pugi::xml_node ref) const;

    /// The image that `properties` names in "filename", relative to the scene file.
    Image read_image(Properties& properties);

   private:
    struct Declared {
        pugi::xml_node node;
        int index = -1;
        bool is_read = false;
    };
    int add(pugi::xml_node node);
    int resolve(Declared& declared);
    Texture read_bitmap(Properties& properties);
    Texture read_checkerboard(Properties& properties);

    SceneFile& file_;
    std::vector<Texture>& textures_;
    Hasher& hasher_;
    std::map<std::string, Declared> by_id_;
};

}  // namespace pave
