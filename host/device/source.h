// Assembly of kernel sources and the one hash; private to host/device.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <string>
#include <string_view>

namespace pave {

/// Every file of kernels/ by name; written by cmake/embed_kernels.cmake.
const std::map<std::string, std::string_view>& embedded_kernels();

struct SourcePlace {
    std::string file;
    int line = 0;
};

/// Where line `line` (from 1) of an assembled text came from, for drivers whose logs do not heed
/// #line.
SourcePlace place_of_line(const std::string& assembled, int line);
/// True if `assembled` holds (a part of) `file`.
bool has_file(const std::string& assembled, const std::string& file);

/// `text` with its includes resolved and #line marks, under `name`.
std::string assemble_text(const std::string& name, const std::string& text);

/// XXH3-128 as 32 hex digits.
std::string xxh3_hex(std::string_view bytes);

}  // namespace pave
