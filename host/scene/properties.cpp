// The elements inside one object of the scene, by name, each read by its type; leftovers are typos.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>

#include "host/scene/text.h"
#include "host/scene/xml.h"

namespace pave {
namespace {

const std::vector<std::string> kValueTags{"float",    "integer", "boolean", "string",   "rgb",
                                          "spectrum", "point",   "vector",  "transform"};
const std::vector<std::string> kObjectTags{"bsdf",  "emitter", "film",    "integrator", "medium",
                                           "phase", "ref",     "rfilter", "sampler",    "sensor",
                                           "shape", "texture", "volume",  "field"};

bool contains(const std::vector<std::string>& names, std::string_view name) {
    return std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace

bool is_value_tag(std::string_view tag) { return contains(kValueTags, tag); }
bool is_object_tag(std::string_view tag) { return contains(kObjectTags, tag); }

Properties::Properties(SceneFile& file, pugi::xml_node object) : file_(file), object_(object) {
    file.check_attributes(object, {"type"}, {"id", "name"});
    type_ = file.attribute(object, "type");
    id_ = file.attribute(object, "id");
    for (const pugi::xml_node child : object.children()) {
        if (child.type() == pugi::node_comment || child.type() == pugi::node_pi) continue;
        if (child.type() != pugi::node_element)
            file.fail(child, "stray text " + quote(trim(child.value())));
        const std::string tag = child.name();
        // <spectrum type="..."> is a texture in Mitsuba's eyes.
        if (is_value_tag(tag) && !child.attribute("type")) {
            const std::string name = file.attribute(child, "name");
            if (name.empty()) file.fail(child, "attribute \"name\" is missing");
            if (!values_.emplace(name, child).second)
                file.fail(child, quote(name) + " is given twice");
        } else if (is_object_tag(tag) || tag == "spectrum") {
            objects_.push_back(child);
        } else {
            std::vector<std::string> tags = kValueTags;
            tags.insert(tags.end(), kObjectTags.begin(), kObjectTags.end());
            file.unsupported(child,
                             "element <" + tag + "> is not known here" + did_you_mean(tag, tags));
        }
    }
}

pugi::xml_node Properties::peek(const std::string& name) const {
    const auto found = values_.find(name);
    return found == values_.end() ? pugi::xml_node() : found->second;
}

pugi::xml_node Properties::value(const std::string& name) {
    if (!contains(known_, name)) known_.push_back(name);
    const auto found = values_.find(name);
    if (found == values_.end()) return {};
    const pugi::xml_node node = found->second;
    values_.erase(found);
    return node;
}

std::string Properties::text(pugi::xml_node node, const char* wanted_tag) {
    if (std::string_view(node.name()) != wanted_tag)
        file_.fail(node, "must be a <" + std::string(wanted_tag) + ">");
    file_.check_attributes(node, {"name", "value"});
    file_.check_no_children(node);
    return file_.attribute(node, "value");
}

double Properties::number(const std::string& name, double fallback) {
    const pugi::xml_node node = value(name);
    if (!node) return fallback;
    const bool is_integer = std::string_view(node.name()) == "integer";
    const std::string words = text(node, is_integer ? "integer" : "float");
    const std::optional<double> number = parse_number(words);
    if (!number) file_.fail(node, quote(words) + " is not a finite number");
    return *number;
}

int64_t Properties::integer(const std::string& name, int64_t fallback) {
    const pugi::xml_node node = value(name);
    if (!node) return fallback;
    const std::string words = text(node, "integer");
    const std::optional<int64_t> number = parse_integer(words);
    if (!number) file_.fail(node, quote(words) + " is not an integer");
    return *number;
}

bool Properties::boolean(const std::string& name, bool fallback) {
    const pugi::xml_node node = value(name);
    if (!node) return fallback;
    std::string words = text(node, "boolean");
    std::transform(words.begin(), words.end(), words.begin(),
                   [](unsigned char c) { return std::tolower(c); });
    if (words != "true" && words != "false")
        file_.fail(node, quote(words) + " is neither true nor false");
    return words == "true";
}

std::string Properties::string(const std::string& name, const std::string& fallback) {
    const pugi::xml_node node = value(name);
    return node ? text(node, "string") : fallback;
}

std::array<double, 3> Properties::point(const std::string& name, std::array<double, 3> fallback) {
    const pugi::xml_node node = value(name);
    if (!node) return fallback;
    const std::string_view tag = node.name();
    if (tag != "point" && tag != "vector") file_.fail(node, "must be a <point>");
    file_.check_no_children(node);
    std::string words = file_.attribute(node, "value");
    if (node.attribute("value")) {
        file_.check_attributes(node, {"name", "value"});
    } else {
        file_.check_attributes(node, {"name", "x", "y", "z"});
        for (const char* axis : {"x", "y", "z"}) words += file_.attribute(node, axis) + " ";
    }
    const std::vector<std::string_view> parts = split_words(words);
    if (parts.size() != 3 && parts.size() != 1) file_.fail(node, "needs three numbers");
    std::array<double, 3> result{};
    for (size_t i = 0; i < 3; ++i) {
        const std::optional<double> number = parse_number(parts[parts.size() == 1 ? 0 : i]);
        if (!number) file_.fail(node, quote(words) + " is not three finite numbers");
        result[i] = *number;
    }
    return result;
}

void Properties::accept(std::initializer_list<const char*> names) {
    for (const char* name : names) value(name);
}

std::vector<pugi::xml_node> Properties::take_objects(const std::string& tag) {
    return take_if([&](pugi::xml_node object) { return tag == object.name(); });
}

std::vector<pugi::xml_node> Properties::take_objects(const std::string& tag,
                                                     const std::string& name) {
    return take_if([&](pugi::xml_node object) {
        return tag == object.name() && file_.attribute(object, "name") == name;
    });
}

template <typename Test>
std::vector<pugi::xml_node> Properties::take_if(Test test) {
    std::vector<pugi::xml_node> taken;
    for (auto it = objects_.begin(); it != objects_.end();) {
        if (test(*it)) {
            taken.push_back(*it);
            it = objects_.erase(it);
        } else {
            ++it;
        }
    }
    return taken;
}

void Properties::finish() {
    for (const auto& [name, node] : values_)
        file_.unsupported(node, "not a property of " + std::string(object_.name()) + " " +
                                    quote(type_) + " in PAVE" + did_you_mean(name, known_) +
                                    (known_.empty() ? "" : "; it has " + join(known_)));
    for (const pugi::xml_node node : objects_)
        file_.unsupported(node,
                          "has no place in " + std::string(object_.name()) + " " + quote(type_));
    values_.clear();
    objects_.clear();
}

}  // namespace pave
