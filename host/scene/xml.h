// One scene file while it is read: its XML with line numbers, its $parameters, and what to do with
// what PAVE lacks.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <initializer_list>
#include <map>
#include <pugixml.hpp>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "pave/scene.h"

namespace pave {

class SceneFile {
   public:
    /// Parses `text`, the bytes of `path`. Throws InputError for what is not well-formed, has a
    /// DOCTYPE or no <scene>.
    SceneFile(std::filesystem::path path, std::string text, const LoadOptions& options);

    const std::filesystem::path& path() const { return path_; }
    const std::string& text() const { return text_; }
    pugi::xml_node root() const { return document_.document_element(); }

    /// "file:line: node: reason" as InputError.
    [[noreturn]] void fail(pugi::xml_node node, const std::string& reason) const;
    /// Something that Mitsuba knows and PAVE does not: fail(), or a warning if the caller asked to
    /// ignore it.
    void unsupported(pugi::xml_node node, const std::string& reason);
    std::vector<std::string> take_warnings() { return std::move(warnings_); }

    /// Value of an attribute with its $parameters put in; "" if it is absent.
    std::string attribute(pugi::xml_node node, const char* name);
    /// Fails on an attribute outside both lists and on a missing required one.
    void check_attributes(pugi::xml_node node, std::initializer_list<const char*> required,
                          std::initializer_list<const char*> optional = {}) const;
    /// Fails if a node that is a value has elements inside.
    void check_no_children(pugi::xml_node node) const;

    /// `<default name= value=>`: ignored if the caller or an earlier <default> has set it.
    void define_default(pugi::xml_node node);
    /// Throws UsageError for a define of the caller that the file neither declares nor uses.
    void check_defines_used() const;

   private:
    std::string message(pugi::xml_node node, const std::string& reason) const;
    std::string substitute(pugi::xml_node node, std::string value);
    void check_prolog() const;
    size_t line_of(ptrdiff_t offset) const;

    std::filesystem::path path_;
    std::string text_;
    std::vector<size_t> line_starts_;
    pugi::xml_document document_;
    std::map<std::string, std::string> parameters_;
    std::set<std::string> unused_defines_;
    bool ignore_unsupported_ = false;
    std::vector<std::string> warnings_;
};

/// The elements inside one object of the scene, by name; finish() fails on what nobody asked for,
/// so that typos show.
class Properties {
   public:
    Properties(SceneFile& file, pugi::xml_node object);

    SceneFile& file() const { return file_; }
    pugi::xml_node node() const { return object_; }
    const std::string& type() const { return type_; }
    const std::string& id() const { return id_; }

    bool has(const std::string& name) const { return values_.contains(name); }
    /// The element called `name`, or an empty node, without counting as asked for.
    pugi::xml_node peek(const std::string& name) const;
    /// The element called `name`, or an empty node. Counts as asked for, like every getter below.
    pugi::xml_node value(const std::string& name);

    double number(const std::string& name, double fallback);
    int64_t integer(const std::string& name, int64_t fallback);
    bool boolean(const std::string& name, bool fallback);
    std::string string(const std::string& name, const std::string& fallback);
    std::array<double, 3> point(const std::string& name, std::array<double, 3> fallback);
    /// Names that Mitsuba has and that change nothing in PAVE.
    void accept(std::initializer_list<const char*> names);

    /// Takes the nested objects whose tag is `tag` ("bsdf", "film", ..., "ref").
    std::vector<pugi::xml_node> take_objects(const std::string& tag);
    /// Those of them that are called `name`.
    std::vector<pugi::xml_node> take_objects(const std::string& tag, const std::string& name);

    void finish();

   private:
    template <typename Test>
    std::vector<pugi::xml_node> take_if(Test test);
    std::string text(pugi::xml_node node, const char* wanted_tag);

    SceneFile& file_;
    pugi::xml_node object_;
    std::string type_, id_;
    std::map<std::string, pugi::xml_node> values_;
    std::vector<pugi::xml_node> objects_;
    std::vector<std::string> known_;
};

/// True for elements that hold a value (float, rgb, transform, ...), false for objects and unknown
/// ones.
bool is_value_tag(std::string_view tag);
bool is_object_tag(std::string_view tag);

}  // namespace pave
