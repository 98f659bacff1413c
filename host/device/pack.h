// The file format of a kernel cache entry: named files under one checksum; private to host/device.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace pave {

struct PackedFile {
    std::string path;  // relative, '/' between parts, no "." or ".." part
    std::string bytes;
};

/// Layout, little-endian: magic "PAVEKC1\n", key (32 hex digits), XXH3-128 of the payload (32 hex
/// digits), payload; the payload is a row of (uint32 path size, uint64 byte size, path, bytes).
std::string pack(const std::string& key, const std::vector<PackedFile>& files);

/// The files, or nothing if the text is not a whole, unchanged entry of `key`.
std::optional<std::vector<PackedFile>> unpack(const std::string& key, std::string_view text);

}  // namespace pave
