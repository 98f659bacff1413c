// Assembly of kernel sources and the one hash; private to host/device.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <string_view>

namespace pave {

/// `text` with its includes resolved and #line marks, under `name`.
std::string assemble_text(const std::string& name, const std::string& text);

/// XXH3-128 as 32 hex digits.
std::string xxh3_hex(std::string_view bytes);

}  // namespace pave
