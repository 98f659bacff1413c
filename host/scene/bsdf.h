// Materials of the scene file: <bsdf> elements, nested ones and those referred to by id.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>

#include "host/scene/colour.h"
#include "host/scene/texture.h"
#include "host/scene/xml.h"

namespace pave {

/// Reads materials into Scene::bsdfs, each once.
class BsdfReader {
   public:
    BsdfReader(SceneFile& file, TextureReader& textures, std::vector<Bsdf>& bsdfs)
        : file_(file), textures_(textures), bsdfs_(bsdfs) {}

    /// Makes a <bsdf> of the scene known by its id; it is read when something refers to it.
    void declare(pugi::xml_node node);
    /// Reads what nothing referred to, so that its errors show too.
    void read_declared();
    /// Reads a <bsdf>; returns its index.
    int add(pugi::xml_node node);
    /// Index of the material of `owner` (a shape): its nested <bsdf> or <ref>, else Mitsuba's
    /// default, which is a diffuse grey of 0.5 and for emitters black.
    int of_shape(Properties& owner, bool is_emitter);

   private:
    struct Declared {
        pugi::xml_node node;
        int index = -1;
        bool is_open = false;  // being read: a reference to it now is a cycle
    };
    int resolve(Declared& declared);
    Bsdf read(pugi::xml_node node);
    Bsdf read_type(pugi::xml_node node);
    Bsdf read_two_sided(Properties& properties);
    Bsdf read_conductor(Properties& properties);
    void read_roughness(Properties& properties, Bsdf& bsdf);
    Bsdf read_dielectric(Properties& properties);
    Bsdf read_plastic(Properties& properties);
    void read_indices(Properties& properties, Bsdf& bsdf);
    void read_reflectance(Properties& properties, const std::string& name, Rgb& colour,
                          int& texture);
    float read_ior(Properties& properties, const std::string& name, float fallback);
    int find(pugi::xml_node ref);

    SceneFile& file_;
    TextureReader& textures_;
    std::vector<Bsdf>& bsdfs_;
    std::map<std::string, Declared> by_id_;
    std::map<float, int> defaults_;  // by grey
    int depth_ = 0;
};

}  // namespace pave
