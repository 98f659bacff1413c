// Whole files in memory and JSON out of them, with every failure an InputError that names the file.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace pave::nn {

/// Bytes of the regular file `path`. Throws InputError if it cannot be read or is larger than
/// `byte_limit`; allocates no more than the file is long.
std::vector<std::byte> read_file(const std::string& path, size_t byte_limit);

/// `text` as JSON; InputError "FILE: not valid JSON: reason" otherwise.
nlohmann::json parse_json(std::string_view text, const std::string& file);

}  // namespace pave::nn
