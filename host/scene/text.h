// Small helpers on text that the scene readers share: numbers, words, the nearest known name.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace pave {

std::string_view trim(std::string_view text);
/// Words between spaces, tabs, newlines and commas, as Mitsuba splits "0.2, 0.3 0.4".
std::vector<std::string_view> split_words(std::string_view text);

/// The whole of `text` as a finite number that float32 can hold; locale-independent. Nothing for
/// "nan", "inf", "2x", "1e99".
std::optional<double> parse_number(std::string_view text);
std::optional<int64_t> parse_integer(std::string_view text);

/// ` (did you mean "..."?)` with the candidate that is at most two edits away, else "".
std::string did_you_mean(std::string_view name, const std::vector<std::string>& candidates);
/// "a, b, c"
std::string join(const std::vector<std::string>& words);
/// `text` between double quotes, cut after 60 characters, control characters replaced: safe in a
/// one-line message.
std::string quote(std::string_view text);

}  // namespace pave
