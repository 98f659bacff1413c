// Small helpers on text that the scene readers share: numbers, words, the nearest known name.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/text.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <numeric>

namespace pave {
namespace {

constexpr std::string_view kSpaces = " \t\r\n\f\v";

// Levenshtein's distance, one row at a time.
size_t edit_distance(std::string_view a, std::string_view b) {
    std::vector<size_t> row(b.size() + 1);
    std::iota(row.begin(), row.end(), size_t{0});
    for (size_t i = 1; i <= a.size(); ++i) {
        size_t diagonal = row[0];
        row[0] = i;
        for (size_t j = 1; j <= b.size(); ++j) {
            const size_t substituted = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
            diagonal = row[j];
            row[j] = std::min({row[j] + 1, row[j - 1] + 1, substituted});
        }
    }
    return row[b.size()];
}

// from_chars takes no leading plus, Mitsuba's parser does.
std::string_view without_plus(std::string_view text) {
    if (text.size() > 1 && text[0] == '+' && text[1] != '-' && text[1] != '+')
        text.remove_prefix(1);
    return text;
}

}  // namespace

std::string_view trim(std::string_view text) {
    const size_t begin = text.find_first_not_of(kSpaces);
    if (begin == std::string_view::npos) return {};
    return text.substr(begin, text.find_last_not_of(kSpaces) - begin + 1);
}

std::vector<std::string_view> split_words(std::string_view text) {
    std::vector<std::string_view> words;
    const std::string separators = std::string(kSpaces) + ",";
    for (size_t at = text.find_first_not_of(separators); at != std::string_view::npos;) {
        const size_t end = std::min(text.find_first_of(separators, at), text.size());
        words.push_back(text.substr(at, end - at));
        at = text.find_first_not_of(separators, end);
    }
    return words;
}

std::optional<double> parse_number(std::string_view text) {
    text = without_plus(trim(text));
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size()) return {};
    if (!(std::abs(value) <= static_cast<double>(std::numeric_limits<float>::max()))) return {};
    return value;
}

std::optional<int64_t> parse_integer(std::string_view text) {
    text = without_plus(trim(text));
    int64_t value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size()) return {};
    return value;
}

std::string did_you_mean(std::string_view name, const std::vector<std::string>& candidates) {
    constexpr size_t kMaxNameLength = 64;
    size_t best = std::min<size_t>(3, name.size());  // more than two edits is another word
    const std::string* nearest = nullptr;
    if (name.size() <= kMaxNameLength)
        for (const std::string& candidate : candidates)
            if (const size_t distance = edit_distance(name, candidate); distance < best) {
                best = distance;
                nearest = &candidate;
            }
    return nearest == nullptr ? "" : " (did you mean \"" + *nearest + "\"?)";
}

std::string join(const std::vector<std::string>& words) {
    std::string text;
    for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
    return text;
}

std::string quote(std::string_view text) {
    constexpr size_t kMaxLength = 60;
    std::string clean(text.substr(0, kMaxLength));
    for (char& c : clean)
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
    return "\"" + clean + (text.size() > kMaxLength ? "..." : "") + "\"";
}

}  // namespace pave
