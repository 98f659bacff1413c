// A JSON object read key by key.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/fields.h"

#include <cmath>
#include <utility>

#include "pave/error.h"
#include "pave/frame.h"

namespace pave::nn {
std::string shown(const std::string& text) {
    std::string result = text.substr(0, 64);
    for (char& c : result)
        if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) >= 0x7f) c = '?';
    return result;
}

Fields::Fields(const nlohmann::json& object, std::string place)
    : object_(object), place_(std::move(place)) {
    if (!object.is_object()) fail("must be a JSON object");
}

void Fields::fail(const std::string& reason) const { throw InputError(place_ + ": " + reason); }

bool Fields::has(const std::string& key) const { return object_.contains(key); }

const nlohmann::json& Fields::any(const std::string& key) {
    read_.insert(key);
    const auto found = object_.find(key);
    if (found == object_.end()) fail(key + " is missing");
    return *found;
}

const nlohmann::json& Fields::array(const std::string& key, size_t max_size) {
    const nlohmann::json& value = any(key);
    if (!value.is_array()) fail(key + " must be a list");
    if (value.size() > max_size)
        fail(key + " has " + std::to_string(value.size()) + " items, at most " +
             std::to_string(max_size) + " are taken");
    return value;
}

std::string Fields::text(const std::string& key) {
    const nlohmann::json& value = any(key);
    if (!value.is_string()) fail(key + " must be a string");
    return value.get<std::string>();
}

std::string Fields::name(const std::string& key) {
    std::string value = text(key);
    if (!is_valid_name(value)) fail(key + " '" + shown(value) + "' is no valid name");
    return value;
}

int Fields::integer(const std::string& key, int low, int high) {
    const nlohmann::json& value = any(key);
    // Compared as the type that was parsed: get<int>() would wrap.
    const bool fits = value.is_number_unsigned()
                          ? std::in_range<int>(value.get<uint64_t>()) && value.get<int>() >= low &&
                                value.get<int>() <= high
                          : value.is_number_integer() && value.get<int64_t>() >= low &&
                                value.get<int64_t>() <= high;
    if (!fits)
        fail(key + " must be a whole number from " + std::to_string(low) + " to " +
             std::to_string(high));
    return value.get<int>();
}

float Fields::number(const std::string& key, double low, double high) {
    const nlohmann::json& value = any(key);
    if (!value.is_number()) fail(key + " must be a number");
    const double result = value.get<double>();
    if (!std::isfinite(result) || result < low || result > high) fail(key + " is out of range");
    return static_cast<float>(result);
}

void Fields::end() const {
    for (const auto& [key, value] : object_.items())
        if (!read_.contains(key)) fail("unknown key '" + shown(key) + "'");
}

}  // namespace pave::nn
