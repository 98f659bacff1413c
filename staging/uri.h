// Where frames go to or come from: "scheme:rest", one table of known schemes.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

namespace pave {

struct Uri {
    std::string scheme, rest;
    std::string text() const { return scheme + ":" + rest; }
};

/// Throws UsageError listing the known schemes. Names (mem:) are checked by is_valid_name; paths
/// must not be empty.
Uri parse_uri(const std::string& text);

}  // namespace pave
