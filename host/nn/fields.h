// A JSON object read key by key: every key must have the right type, and none may be left over.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <set>
#include <string>

namespace pave::nn {

/// `text` fit for a one-line message: printable and short.
std::string shown(const std::string& text);

/// Reader of one object; `place` ("generator.json: node 'enc0'") starts every error.
class Fields {
   public:
    /// Throws InputError if `object` is no JSON object.
    Fields(const nlohmann::json& object, std::string place);

    bool has(const std::string& key) const;
    /// Each throws InputError "PLACE: KEY: reason" if the key is missing, of another type or out of
    /// range.
    const nlohmann::json& any(const std::string& key);
    const nlohmann::json& array(const std::string& key, size_t max_size);
    std::string text(const std::string& key);
    /// A name as pave::is_valid_name has it.
    std::string name(const std::string& key);
    int integer(const std::string& key, int low, int high);
    float number(const std::string& key, double low, double high);
    /// Throws if the object has a key that nobody asked for.
    void end() const;

    [[noreturn]] void fail(const std::string& reason) const;

   private:
    const nlohmann::json& object_;
    std::string place_;
    std::set<std::string> read_;
};

}  // namespace pave::nn
