// One frame as one multi-layer OpenEXR file that other programs read.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include "pave/frame.h"

namespace pave {

/// Writes `frame` as a scanline EXR (ZIPS, 32-bit float, every channel), whole or absent; a file
/// that is there is replaced. `names` spells the layers as "pave", "oidn" or "cycles"
/// (docs/contract.md). Equal frames give equal bytes: the time spent is not stored. Throws
/// UsageError for another `names`, RunError if the file cannot be written.
void write_exr(const Frame& frame, const std::string& path, const std::string& names = "pave");

/// Reads what write_exr wrote, its bytes checked before OpenEXR sees them. Throws InputError for
/// anything else.
Frame read_exr(const std::string& path, ArenaAllocator& allocator = host_memory());

}  // namespace pave
