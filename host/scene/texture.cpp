// Textures of the scene file: bitmaps and checkerboards, under Mitsuba's names and defaults.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/texture.h"

#include <algorithm>

#include "host/scene/colour.h"
#include "host/scene/shape.h"
#include "host/scene/text.h"
#include "host/scene/transform.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr size_t kMaxImageByteSize = size_t{1} << 30;

std::array<float, 6> read_uv_map(Properties& properties) {
    const Affine map = read_affine(properties, "to_uv");
    std::array<float, 6> rows{};
    for (size_t i = 0; i < 2; ++i) {
        rows[3 * i] = static_cast<float>(map.linear[i][0]);
        rows[3 * i + 1] = static_cast<float>(map.linear[i][1]);
        rows[3 * i + 2] = static_cast<float>(map.offset[i]);
    }
    return rows;
}

}  // namespace

void TextureReader::declare(pugi::xml_node node) {
    const std::string id = file_.attribute(node, "id");
    if (!by_id_.emplace(id, Declared{node}).second)
        file_.fail(node, "id " + quote(id) + " is given twice");
}

void TextureReader::read_declared() {
    for (auto& entry : by_id_) resolve(entry.second);
}

int TextureReader::resolve(Declared& declared) {
    if (!declared.is_read) declared.index = add(declared.node);
    declared.is_read = true;
    return declared.index;
}

bool TextureReader::is_declared(pugi::xml_node ref) const {
    return by_id_.contains(file_.attribute(ref, "id"));
}

int TextureReader::find(pugi::xml_node node) {
    if (std::string_view(node.name()) != "ref") return add(node);
    file_.check_attributes(node, {"id"}, {"name"});
    const std::string id = file_.attribute(node, "id");
    const auto found = by_id_.find(id);
    if (found == by_id_.end()) {
        std::vector<std::string> ids;
        for (const auto& entry : by_id_) ids.push_back(entry.first);
        file_.fail(node, "no texture of the scene has the id " + quote(id) + did_you_mean(id, ids));
    }
    return resolve(found->second);
}

int TextureReader::add(pugi::xml_node node) {
    Properties properties(file_, node);
    Texture texture;
    if (properties.type() == "bitmap") {
        texture = read_bitmap(properties);
    } else if (properties.type() == "checkerboard") {
        texture = read_checkerboard(properties);
    } else {
        const std::vector<std::string> types{"bitmap", "checkerboard"};
        file_.unsupported(node, "this texture is not supported" +
                                    did_you_mean(properties.type(), types) + "; there are " +
                                    join(types));
        return -1;
    }
    texture.uv_map = read_uv_map(properties);
    texture.id = properties.id();
    properties.finish();
    textures_.push_back(std::move(texture));
    return static_cast<int>(textures_.size()) - 1;
}

Image TextureReader::read_image(Properties& properties) {
    const pugi::xml_node node = properties.peek("filename");
    if (!node) file_.fail(properties.node(), "needs a <string name=\"filename\">");
    const std::filesystem::path path =
        file_.path().parent_path() / properties.string("filename", "");
    try {
        const std::string bytes = read_file(path, kMaxImageByteSize);
        hasher_.update(bytes);
        return decode_image(bytes);
    } catch (const ImageError& error) {
        file_.fail(node, path.string() + ": " + error.what());
    } catch (const InputError& error) {
        file_.fail(node, error.what());
    }
}

Texture TextureReader::read_bitmap(Properties& properties) {
    const auto choice = [&](const std::string& name, const std::vector<std::string>& words) {
        const pugi::xml_node node = properties.peek(name);
        const std::string word = properties.string(name, words[0]);
        const auto found = std::find(words.begin(), words.end(), word);
        if (found == words.end())
            file_.fail(node, quote(word) + " is not known" + did_you_mean(word, words) +
                                 "; there are " + join(words));
        return static_cast<int>(found - words.begin());
    };
    Texture texture;
    texture.is_nearest = choice("filter_type", {"bilinear", "nearest"}) == 1;
    texture.wrap = static_cast<Texture::Wrap>(choice("wrap_mode", {"repeat", "mirror", "clamp"}));
    texture.is_raw = properties.boolean("raw", false);
    properties.accept({"format", "accel"});  // how Mitsuba stores texels
    const pugi::xml_node node = properties.peek("filename");
    texture.image = read_image(properties);
    const auto in_range = [](float x) { return x >= 0 && x <= 1; };
    if (!std::all_of(texture.image.floats.begin(), texture.image.floats.end(), in_range))
        file_.fail(node, "a reflectance must be in [0, 1], but the image has other values");
    return texture;
}

Texture TextureReader::read_checkerboard(Properties& properties) {
    Texture texture;
    texture.type = Texture::Type::kCheckerboard;
    texture.color0 = read_colour(properties, "color0", ColourUse::kReflectance, texture.color0);
    texture.color1 = read_colour(properties, "color1", ColourUse::kReflectance, texture.color1);
    return texture;
}

}  // namespace pave
