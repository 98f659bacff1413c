// Colours of the scene file as linear BT.709, the way Mitsuba's RGB variants read them.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/colour.h"

#include "host/scene/text.h"

namespace pave {
namespace {

// Equal-energy white (CIE illuminant E) in linear BT.709, luminance about 1: what Mitsuba 3.9.1
// makes of <spectrum name="radiance" value="1"/> in its RGB variants (read back from the loaded
// scene).
constexpr Rgb kEqualEnergyWhite{0x1.346d6p+0f, 0x1.e58666p-1f, 0x1.d15d72p-1f};

std::array<double, 3> read_values(SceneFile& file, pugi::xml_node node) {
    file.check_attributes(node, {"name", "value"});
    file.check_no_children(node);
    const std::string text = file.attribute(node, "value");
    const std::vector<std::string_view> words = split_words(text);
    if (!words.empty() && words[0].starts_with('#'))
        file.fail(
            node,
            "hex colours are sRGB, which Mitsuba 3 does not take either: give three linear values");
    if (words.size() != 1 && words.size() != 3)
        file.fail(node, quote(text) + " is not one or three numbers");
    std::array<double, 3> values{};
    for (size_t i = 0; i < 3; ++i) {
        const std::optional<double> number = parse_number(words[words.size() == 1 ? 0 : i]);
        if (!number) file.fail(node, quote(text) + " has a part that is not a finite number");
        values[i] = *number;
    }
    return values;
}

// True (after an error or a warning) if `node` is a kind of colour that PAVE lacks.
bool is_unsupported(Properties& properties, const std::string& name, pugi::xml_node node) {
    SceneFile& file = properties.file();
    for (const char* tag : {"texture", "spectrum", "ref"})
        for (const pugi::xml_node object : properties.take_objects(tag, name)) {
            file.unsupported(
                object, "a texture is not supported here: " + quote(name) + " must be one colour");
        }
    if (std::string_view(node.name()) != "spectrum") return false;
    const std::string text = file.attribute(node, "value");
    if (!node.attribute("filename") && text.find(':') == std::string::npos &&
        split_words(text).size() == 1)
        return false;
    file.unsupported(node, "spectra over wavelengths are not supported: give an <rgb>");
    return true;
}

}  // namespace

Rgb read_colour(Properties& properties, const std::string& name, ColourUse use,
                const Rgb& fallback) {
    SceneFile& file = properties.file();
    const pugi::xml_node node = properties.value(name);
    if (is_unsupported(properties, name, node) || !node) return fallback;
    const std::string_view tag = node.name();
    if (tag != "rgb" && tag != "spectrum" && tag != "float")
        file.fail(node, "must be an <rgb>, a constant <spectrum> or a <float>");
    const std::array<double, 3> values = read_values(file, node);
    if (tag == "float" && split_words(file.attribute(node, "value")).size() != 1)
        file.fail(node, "a <float> is one number");
    const bool is_white = tag == "spectrum" && use == ColourUse::kRadiance;
    Rgb colour{};
    for (size_t i = 0; i < 3; ++i) {
        if (values[i] < 0) file.fail(node, "must not be negative");
        if (use == ColourUse::kReflectance && values[i] > 1)
            file.fail(node, "a reflectance must be in [0, 1]");
        if (values[i] > 1e30) file.fail(node, "is beyond 1e30");
        colour[i] = static_cast<float>(values[i]) * (is_white ? kEqualEnergyWhite[i] : 1.0f);
    }
    return colour;
}

}  // namespace pave
