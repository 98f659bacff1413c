// load_scene(): the scene file from its outermost element down, in the order that references and
// parameters need.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/bsdf.h"
#include "host/scene/colour.h"
#include "host/scene/environment.h"
#include "host/scene/find_scene.h"
#include "host/scene/import_scene.h"
#include "host/scene/sensor.h"
#include "host/scene/shape.h"
#include "host/scene/text.h"
#include "host/scene/xml.h"
#include "pave/error.h"
#include "pave/hash.h"
#include "pave/scene.h"

namespace pave {
namespace {

constexpr size_t kMaxXmlByteSize = size_t{64} << 20;

class SceneReader {
   public:
    SceneReader(SceneFile& file, Hasher& hasher)
        : file_(file),
          textures_(file, scene_.textures, hasher),
          bsdfs_(file, textures_, scene_.bsdfs),
          shapes_(file, bsdfs_, scene_, hasher) {}

    Scene read() {
        for (const pugi::xml_node node : file_.root().children())
            if (std::string_view(node.name()) == "default") file_.define_default(node);
        for (const pugi::xml_node node : file_.root().children("bsdf"))
            if (node.attribute("id")) bsdfs_.declare(node);
        for (const pugi::xml_node node : file_.root().children("texture"))
            if (node.attribute("id")) textures_.declare(node);
        for (const pugi::xml_node node : file_.root().children("shape"))
            if (file_.attribute(node, "type") == "shapegroup") shapes_.declare_group(node);
        shapes_.read_groups();
        for (const pugi::xml_node node : file_.root().children()) read_child(node);
        bsdfs_.read_declared();
        textures_.read_declared();
        if (!has_sensor_) file_.fail(file_.root(), "has no <sensor type=\"perspective\">");
        if (scene_.shapes.empty()) file_.fail(file_.root(), "has no shape");
        if (!has_integrator_) scene_.max_depth = kEndlessDepth;  // as Mitsuba's default integrator
        file_.check_defines_used();
        scene_.name = file_.path().stem().string();
        scene_.warnings = file_.take_warnings();
        return std::move(scene_);
    }

   private:
    void read_child(pugi::xml_node node) {
        const std::string tag = node.name();
        if (node.type() == pugi::node_comment || node.type() == pugi::node_pi || tag == "default")
            return;
        if (node.type() != pugi::node_element)
            file_.fail(node, "stray text " + quote(trim(node.value())));
        if (tag == "shape") return shapes_.add(node);
        if (tag == "emitter") return read_emitter(node);
        if (tag == "sensor") return read_only(node, has_sensor_, "sensor", read_sensor);
        if (tag == "integrator")
            return read_only(node, has_integrator_, "integrator", read_integrator);
        if (tag == "texture") {
            if (!node.attribute("id")) (void)textures_.find(node);
            return;
        }
        if (tag == "bsdf") {
            if (!node.attribute("id")) bsdfs_.add(node);  // of no use, but its errors should show
            return;
        }
        file_.unsupported(node, "<" + tag + "> is not supported in a scene" +
                                    did_you_mean(tag, {"shape", "emitter", "sensor", "integrator",
                                                       "bsdf", "texture", "default"}));
    }

    template <typename Read>
    void read_only(pugi::xml_node node, bool& has_one, const std::string& what, Read read) {
        if (has_one) return file_.unsupported(node, "a second " + what + " is not supported");
        has_one = true;
        read(file_, node, scene_);
    }

    void read_emitter(pugi::xml_node node) {
        Properties emitter(file_, node);
        if (emitter.type() == "constant") {
            take_environment(node);
            scene_.environment = read_colour(emitter, "radiance", ColourUse::kRadiance, {1, 1, 1});
            scene_.has_environment = scene_.environment != Rgb{0, 0, 0};
        } else if (emitter.type() == "envmap") {
            take_environment(node);
            read_environment_map(emitter, textures_, scene_);
        } else if (emitter.type() == "point") {
            read_point_light(emitter);
        } else if (emitter.type() == "area") {
            file_.fail(node, "an area emitter must stand inside a shape");
        } else {
            return file_.unsupported(
                node, "this emitter is not supported" +
                          did_you_mean(emitter.type(), {"area", "constant", "envmap", "point"}) +
                          "; there are area (in a shape), constant, envmap, point");
        }
        emitter.finish();
    }

    void take_environment(pugi::xml_node node) {
        if (has_environment_) file_.fail(node, "a scene has one constant or envmap emitter");
        has_environment_ = true;
    }

    void read_point_light(Properties& emitter) {
        if (emitter.has("position") && emitter.has("to_world"))
            file_.fail(emitter.node(), "give either position or to_world");
        const Double3 offset = read_to_world(emitter).offset;
        const Double3 position = emitter.point("position", offset);
        Scene::PointLight light;
        for (size_t i = 0; i < 3; ++i) light.position[i] = static_cast<float>(position[i]);
        light.intensity = read_colour(emitter, "intensity", ColourUse::kRadiance, {1, 1, 1});
        if (light.intensity != Rgb{0, 0, 0}) scene_.point_lights.push_back(light);
    }

    SceneFile& file_;
    Scene scene_;
    TextureReader textures_;
    BsdfReader bsdfs_;
    ShapeReader shapes_;
    bool has_sensor_ = false, has_integrator_ = false, has_environment_ = false;
};

}  // namespace

Scene load_scene(const std::string& path_or_name, const LoadOptions& options) {
    const std::filesystem::path path = find_scene(path_or_name);
    Hasher hasher;
    if (is_model(path)) {
        if (!options.defines.empty())
            throw UsageError("a model has no parameters to set: " + quote(path.string()));
        Scene scene = import_scene(path, hasher);
        scene.hash = hasher.hex();
        return scene;
    }
    SceneFile file(path, read_file(path, kMaxXmlByteSize), options);
    hasher.update(file.text());
    // Defines change what the same bytes mean.
    for (const auto& [name, value] : options.defines) hasher.update("\n$" + name + "=" + value);
    Scene scene = SceneReader(file, hasher).read();
    scene.hash = hasher.hex();
    return scene;
}

}  // namespace pave
