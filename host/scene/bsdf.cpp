// Materials of the scene file: <bsdf> elements, nested ones and those referred to by id.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/bsdf.h"

#include <algorithm>
#include <cctype>

#include "host/scene/text.h"

namespace pave {
namespace {

// Indices of refraction near 589 nm under Mitsuba's names and with its digits (Hecht, Optics, 4th
// edition).
const std::map<std::string, float> kIndices{
    {"vacuum", 1.0f},      {"helium", 1.000036f},        {"hydrogen", 1.000132f},
    {"air", 1.000277f},    {"carbon dioxide", 1.00045f}, {"water", 1.3330f},
    {"acetone", 1.36f},    {"ethanol", 1.361f},          {"carbon tetrachloride", 1.461f},
    {"glycerol", 1.4729f}, {"benzene", 1.501f},          {"silicone oil", 1.52045f},
    {"bromine", 1.661f},   {"water ice", 1.31f},         {"fused quartz", 1.458f},
    {"pyrex", 1.470f},     {"acrylic glass", 1.49f},     {"polypropylene", 1.49f},
    {"bk7", 1.5046f},      {"sodium chloride", 1.544f},  {"amber", 1.55f},
    {"pet", 1.5750f},      {"diamond", 2.419f}};
const std::vector<std::string> kTypes{"diffuse",        "twosided",   "conductor",
                                      "roughconductor", "dielectric", "roughdielectric",
                                      "plastic"};
constexpr int kMaxDepth = 16;
constexpr double kMinAlpha = 1e-4;  // below it Mitsuba clamps too

Bsdf grey(float reflectance) {
    Bsdf bsdf;
    bsdf.reflectance = {reflectance, reflectance, reflectance};
    return bsdf;
}

}  // namespace

void BsdfReader::declare(pugi::xml_node node) {
    const std::string id = file_.attribute(node, "id");
    if (!by_id_.emplace(id, Declared{node}).second)
        file_.fail(node, "id " + quote(id) + " is given twice");
}

void BsdfReader::read_declared() {
    for (auto& entry : by_id_) resolve(entry.second);
}

int BsdfReader::add(pugi::xml_node node) {
    Bsdf bsdf = read(node);  // may add the material that a twosided refers to
    bsdfs_.push_back(std::move(bsdf));
    return static_cast<int>(bsdfs_.size()) - 1;
}

int BsdfReader::resolve(Declared& declared) {
    if (declared.index < 0) {
        if (declared.is_open) file_.fail(declared.node, "refers to itself");
        declared.is_open = true;
        declared.index = add(declared.node);
    }
    return declared.index;
}

int BsdfReader::find(pugi::xml_node ref) {
    file_.check_attributes(ref, {"id"}, {"name"});
    const std::string id = file_.attribute(ref, "id");
    const auto found = by_id_.find(id);
    if (found == by_id_.end()) {
        std::vector<std::string> ids;
        for (const auto& entry : by_id_) ids.push_back(entry.first);
        file_.fail(ref, "no bsdf of the scene has the id " + quote(id) + did_you_mean(id, ids));
    }
    return resolve(found->second);
}

int BsdfReader::of_shape(Properties& owner, bool is_emitter) {
    const std::vector<pugi::xml_node> nested = owner.take_objects("bsdf"),
                                      refs = owner.take_objects("ref");
    if (nested.size() + refs.size() > 1)
        file_.fail(nested.size() > 1 ? nested[1] : refs.back(), "a shape has one bsdf");
    if (!refs.empty()) return find(refs[0]);
    if (!nested.empty()) return add(nested[0]);
    const float reflectance = is_emitter ? 0.0f : 0.5f;
    const auto [entry, is_new] = defaults_.emplace(reflectance, static_cast<int>(bsdfs_.size()));
    if (is_new) bsdfs_.push_back(grey(reflectance));
    return entry->second;
}

Bsdf BsdfReader::read(pugi::xml_node node) {
    if (depth_ == kMaxDepth) file_.fail(node, "materials are nested too deeply");
    ++depth_;
    Bsdf bsdf = read_type(node);
    --depth_;
    return bsdf;
}

Bsdf BsdfReader::read_type(pugi::xml_node node) {
    Properties properties(file_, node);
    const std::string& type = properties.type();
    Bsdf bsdf;
    if (type == "diffuse") {
        read_reflectance(properties, "reflectance", bsdf.reflectance, bsdf.reflectance_texture);
    } else if (type == "twosided") {
        bsdf = read_two_sided(properties);
    } else if (type == "conductor" || type == "roughconductor") {
        bsdf = read_conductor(properties);
    } else if (type == "dielectric" || type == "roughdielectric") {
        bsdf = read_dielectric(properties);
    } else if (type == "plastic") {
        bsdf = read_plastic(properties);
    } else {
        file_.unsupported(node, "this material is not supported" + did_you_mean(type, kTypes) +
                                    "; there are " + join(kTypes));
        bsdf.id = properties.id();
        return bsdf;
    }
    properties.finish();
    bsdf.id = properties.id();
    return bsdf;
}

Bsdf BsdfReader::read_two_sided(Properties& properties) {
    const std::vector<pugi::xml_node> nested = properties.take_objects("bsdf"),
                                      refs = properties.take_objects("ref");
    if (nested.empty() && refs.empty()) file_.fail(properties.node(), "needs a material inside");
    if (nested.size() + refs.size() > 1)
        file_.unsupported(nested.size() > 1 ? nested[1] : refs.back(),
                          "another material for the back is not supported");
    Bsdf bsdf = nested.empty() ? bsdfs_[static_cast<size_t>(find(refs[0]))] : read(nested[0]);
    if (bsdf.type == Bsdf::Type::kDielectric || bsdf.type == Bsdf::Type::kRoughDielectric)
        file_.fail(properties.node(), "a material that lets light through cannot be inside");
    bsdf.two_sided = true;
    return bsdf;
}

void BsdfReader::read_reflectance(Properties& properties, const std::string& name, Rgb& colour,
                                  int& texture) {
    for (const char* tag : {"texture", "ref"})
        for (const pugi::xml_node node : properties.take_objects(tag, name)) {
            if (texture >= 0 || properties.has(name))
                file_.fail(node, quote(name) + " is given twice");
            texture = textures_.find(node);
            if (texture >= 0) colour = {1, 1, 1};
        }
    if (texture < 0)
        colour = read_colour(properties, name, ColourUse::kReflectance, colour);
    else
        properties.accept({name.c_str()});
}

Bsdf BsdfReader::read_conductor(Properties& properties) {
    Bsdf bsdf;
    const bool is_rough = properties.type() == "roughconductor";
    bsdf.type = is_rough ? Bsdf::Type::kRoughConductor : Bsdf::Type::kConductor;
    const pugi::xml_node material_node = properties.peek("material");
    const std::string material = properties.string("material", "none");
    if (material != "none")
        file_.unsupported(material_node,
                          "material " + quote(material) +
                              " needs tables over wavelengths: give eta and k as <rgb>");
    read_reflectance(properties, "specular_reflectance", bsdf.specular_reflectance,
                     bsdf.specular_reflectance_texture);
    bsdf.eta = read_colour(properties, "eta", ColourUse::kIndexOfRefraction, bsdf.eta);
    bsdf.k = read_colour(properties, "k", ColourUse::kIndexOfRefraction, bsdf.k);
    if (is_rough) read_roughness(properties, bsdf);
    return bsdf;
}

void BsdfReader::read_roughness(Properties& properties, Bsdf& bsdf) {
    const pugi::xml_node node =
        properties.peek("distribution") ? properties.peek("distribution") : properties.node();
    std::string distribution = properties.string("distribution", "beckmann");
    std::transform(distribution.begin(), distribution.end(), distribution.begin(),
                   [](unsigned char c) { return std::tolower(c); });
    if (distribution != "ggx")
        file_.unsupported(
            node, "distribution " + quote(distribution) +
                      " is not supported: add <string name=\"distribution\" value=\"ggx\"/>");
    properties.accept(
        {"sample_visible"});  // how Mitsuba draws samples; the picture's mean is the same
    const bool has_one = properties.has("alpha");
    const bool has_u = properties.has("alpha_u"), has_v = properties.has("alpha_v");
    if (has_u != has_v || (has_one && has_u))
        file_.fail(node, "give either alpha or both alpha_u and alpha_v");
    const double alpha = properties.number("alpha", 0.1);
    const double alpha_u = properties.number("alpha_u", alpha),
                 alpha_v = properties.number("alpha_v", alpha);
    for (const double value : {alpha_u, alpha_v})
        if (!(value >= 0) || value > 10) file_.fail(node, "alpha must be in [0, 10]");
    bsdf.alpha_u = static_cast<float>(std::max(alpha_u, kMinAlpha));
    bsdf.alpha_v = static_cast<float>(std::max(alpha_v, kMinAlpha));
}

float BsdfReader::read_ior(Properties& properties, const std::string& name, float fallback) {
    const pugi::xml_node node = properties.peek(name);
    if (!node) {
        properties.accept({name.c_str()});
        return fallback;
    }
    if (std::string_view(node.name()) == "string") {
        std::string material = properties.string(name, "");
        std::transform(material.begin(), material.end(), material.begin(),
                       [](unsigned char c) { return std::tolower(c); });
        const auto found = kIndices.find(material);
        std::vector<std::string> names;
        for (const auto& entry : kIndices) names.push_back(entry.first);
        if (found == kIndices.end())
            file_.fail(node, name + " " + quote(material) + " is not a known material" +
                                 did_you_mean(material, names) + "; there are " + join(names));
        return found->second;
    }
    const double index = properties.number(name, 1);
    if (!(index > 0.01) || index > 100) file_.fail(node, name + " must be in (0.01, 100]");
    return static_cast<float>(index);
}

void BsdfReader::read_indices(Properties& properties, Bsdf& bsdf) {
    bsdf.int_ior = read_ior(properties, "int_ior", bsdf.int_ior);
    bsdf.ext_ior = read_ior(properties, "ext_ior", bsdf.ext_ior);
    if (bsdf.type != Bsdf::Type::kDielectric && bsdf.int_ior == bsdf.ext_ior)
        file_.fail(properties.node(), "int_ior and ext_ior must differ");
}

Bsdf BsdfReader::read_dielectric(Properties& properties) {
    Bsdf bsdf;
    const bool is_rough = properties.type() == "roughdielectric";
    bsdf.type = is_rough ? Bsdf::Type::kRoughDielectric : Bsdf::Type::kDielectric;
    read_indices(properties, bsdf);
    read_reflectance(properties, "specular_reflectance", bsdf.specular_reflectance,
                     bsdf.specular_reflectance_texture);
    read_reflectance(properties, "specular_transmittance", bsdf.specular_transmittance,
                     bsdf.specular_transmittance_texture);
    if (is_rough) read_roughness(properties, bsdf);
    return bsdf;
}

Bsdf BsdfReader::read_plastic(Properties& properties) {
    Bsdf bsdf;
    bsdf.type = Bsdf::Type::kPlastic;
    bsdf.int_ior = kIndices.at("polypropylene");
    read_indices(properties, bsdf);
    read_reflectance(properties, "diffuse_reflectance", bsdf.reflectance, bsdf.reflectance_texture);
    read_reflectance(properties, "specular_reflectance", bsdf.specular_reflectance,
                     bsdf.specular_reflectance_texture);
    bsdf.nonlinear = properties.boolean("nonlinear", false);
    return bsdf;
}

}  // namespace pave
