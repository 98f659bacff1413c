// JSON from outside, before anything else touches it.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "pave/error.h"

namespace pave {

/// Levels of nesting that are taken; what PAVE writes has 6 at most.
inline constexpr int kDeepestJson = 32;

/// `text` as a nlohmann::json or ordered_json. Copies and dumps of those recurse, so a line of
/// brackets would overflow the stack: deeper text is an InputError. Throws JsonType::exception for
/// text that is not JSON.
template <typename JsonType>
JsonType parse_shallow_json(std::string_view text) {
    return JsonType::parse(text, [](int depth, typename JsonType::parse_event_t, JsonType&) {
        if (depth > kDeepestJson)
            throw InputError("nests deeper than " + std::to_string(kDeepestJson) + " levels");
        return true;
    });
}

}  // namespace pave
