// One scene file while it is read: its XML with line numbers, its $parameters, and what to do with
// what PAVE lacks.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/xml.h"

#include <algorithm>
#include <cctype>
#include <cstring>

#include "host/scene/text.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr size_t kMaxElements = size_t{1} << 22;  // pugixml needs about 70 bytes for each

bool is_name_character(char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_'; }

// What a message calls a node: `bsdf "diffuse"`, `rgb "reflectance"`, `scene`.
std::string describe(pugi::xml_node node) {
    std::string name = node.attribute("type").value();
    if (name.empty()) name = node.attribute("name").value();
    if (name.empty()) name = node.attribute("id").value();
    const std::string tag = node.type() == pugi::node_element ? node.name() : "text";
    return name.empty() ? tag : tag + " " + quote(name);
}

}  // namespace

SceneFile::SceneFile(std::filesystem::path path, std::string text, const LoadOptions& options)
    : path_(std::move(path)),
      text_(std::move(text)),
      ignore_unsupported_(options.ignore_unsupported) {
    line_starts_.push_back(0);
    for (size_t i = 0; i < text_.size(); ++i)
        if (text_[i] == '\n') line_starts_.push_back(i + 1);
    for (const auto& [name, value] : options.defines) {
        parameters_[name] = value;
        unused_defines_.insert(name);
    }
    if (static_cast<size_t>(std::count(text_.begin(), text_.end(), '<')) > kMaxElements)
        throw InputError(path_.string() + ": more than " + std::to_string(kMaxElements) +
                         " elements");
    // pugixml expands no entities but the five of XML and reads no external file. Doctypes are kept
    // to be refused.
    const pugi::xml_parse_result result = document_.load_buffer(
        text_.data(), text_.size(), pugi::parse_default | pugi::parse_doctype, pugi::encoding_utf8);
    if (!result)
        throw InputError(path_.string() + ":" + std::to_string(line_of(result.offset)) +
                         ": xml: " + result.description());
    check_prolog();
}

void SceneFile::check_prolog() const {
    for (const pugi::xml_node node : document_.children())
        if (node.type() == pugi::node_doctype)
            throw InputError(path_.string() +
                             ":1: xml: a DOCTYPE is not allowed in a scene; remove it");
    if (text_.find("<!ENTITY") != std::string::npos)
        throw InputError(path_.string() + ": xml: entity declarations are not allowed in a scene");
    const pugi::xml_node scene = root();
    if (std::strcmp(scene.name(), "scene") != 0)
        fail(scene, "the outermost element must be <scene version=\"3.0.0\">");
    if (scene.next_sibling()) fail(scene.next_sibling(), "a file holds one <scene>");
    check_attributes(scene, {"version"});
    const std::string_view version = scene.attribute("version").value();
    if (version.empty() || (version[0] != '2' && version[0] != '3') ||
        (version.size() > 1 && version[1] != '.'))
        fail(scene, "version " + quote(version) + " is not one of 2.x and 3.x");
}

size_t SceneFile::line_of(ptrdiff_t offset) const {
    const auto next = std::upper_bound(line_starts_.begin(), line_starts_.end(),
                                       static_cast<size_t>(std::max<ptrdiff_t>(offset, 0)));
    return static_cast<size_t>(next - line_starts_.begin());
}

std::string SceneFile::message(pugi::xml_node node, const std::string& reason) const {
    return path_.string() + ":" + std::to_string(line_of(node.offset_debug())) + ": " +
           describe(node) + ": " + reason;
}

void SceneFile::fail(pugi::xml_node node, const std::string& reason) const {
    throw InputError(message(node, reason));
}

void SceneFile::unsupported(pugi::xml_node node, const std::string& reason) {
    if (!ignore_unsupported_) fail(node, reason);
    warnings_.push_back(message(node, reason) + "; ignored");
}

// Longest name first, as Mitsuba does, so that $light does not eat the head of $light_scale.
std::string SceneFile::substitute(pugi::xml_node node, std::string value) {
    std::string result;
    for (size_t at = 0; at < value.size();) {
        const bool escaped = value[at] == '\\' && at + 1 < value.size() && value[at + 1] == '$';
        if (escaped || value[at] != '$') {
            result += value[escaped ? at + 1 : at];
            at += escaped ? 2 : 1;
            continue;
        }
        const std::map<std::string, std::string>::value_type* longest = nullptr;
        for (const auto& parameter : parameters_)
            if (value.compare(at + 1, parameter.first.size(), parameter.first) == 0 &&
                (longest == nullptr || parameter.first.size() > longest->first.size()))
                longest = &parameter;
        if (longest == nullptr) {
            size_t end = at + 1;
            while (end < value.size() && is_name_character(value[end])) ++end;
            std::vector<std::string> names;
            for (const auto& parameter : parameters_) names.push_back(parameter.first);
            const std::string name = value.substr(at + 1, end - at - 1);
            fail(node, "undefined parameter " + quote("$" + name) + did_you_mean(name, names));
        }
        result += longest->second;
        unused_defines_.erase(longest->first);
        at += 1 + longest->first.size();
    }
    return result;
}

std::string SceneFile::attribute(pugi::xml_node node, const char* name) {
    std::string value = node.attribute(name).value();
    return value.find('$') == std::string::npos ? value : substitute(node, std::move(value));
}

void SceneFile::check_attributes(pugi::xml_node node, std::initializer_list<const char*> required,
                                 std::initializer_list<const char*> optional) const {
    std::vector<std::string> names(required.begin(), required.end());
    names.insert(names.end(), optional.begin(), optional.end());
    for (const pugi::xml_attribute attribute : node.attributes()) {
        const std::string name = attribute.name();
        if (std::find(names.begin(), names.end(), name) == names.end())
            fail(node, "unexpected attribute " + quote(name) + did_you_mean(name, names));
        if (node.attribute(name.c_str()) != attribute)
            fail(node, "attribute " + quote(name) + " is given twice");
    }
    for (const char* name : required)
        if (!node.attribute(name)) fail(node, "attribute " + quote(name) + " is missing");
}

void SceneFile::check_no_children(pugi::xml_node node) const {
    if (node.first_child())
        fail(node.first_child(), "nothing may stand inside <" + std::string(node.name()) + ">");
}

void SceneFile::define_default(pugi::xml_node node) {
    check_attributes(node, {"name", "value"});
    check_no_children(node);
    const std::string name = attribute(node, "name");
    if (name.empty() || !std::all_of(name.begin(), name.end(), is_name_character))
        fail(node, "name must be made of letters, digits and _");
    parameters_.emplace(name, attribute(node, "value"));
    unused_defines_.erase(name);
}

void SceneFile::check_defines_used() const {
    if (unused_defines_.empty()) return;
    std::vector<std::string> names;
    for (const auto& parameter : parameters_)
        if (!unused_defines_.contains(parameter.first)) names.push_back(parameter.first);
    const std::string& unused = *unused_defines_.begin();
    throw UsageError(path_.string() + " has no parameter " + quote("$" + unused) +
                     did_you_mean(unused, names) +
                     (names.empty() ? "; it has none" : "; it has " + join(names)));
}

}  // namespace pave
