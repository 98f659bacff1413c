// OpenEXR: spelling of layers, frames to and from files, and the exr: sink and source over them.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "pave/source.h"
#include "staging/files.h"
#include "staging/sink.h"

namespace pave {

/// EXR channel name of every plane of `channel` ("albedo.R", ...). Throws UsageError listing the
/// spellings there are.
std::vector<std::string> exr_plane_names(const Channel& channel, const std::string& names);

/// Writes a new file at `path` that ends with a checksum of its own; not yet synced.
void write_exr_file(const Frame& frame, const FrameRecord& record, const std::string& names,
                    const fs::path& path);
/// Pixels and record of a file, checked against its own checksum first. With `expected` the file
/// must be of that schema.
Frame read_exr_file(const fs::path& path, const FrameSchema* expected, ArenaAllocator& allocator);

std::unique_ptr<Sink> make_exr_sink(const std::string& path, const FrameSchema& schema,
                                    const StageOptions& options);
std::unique_ptr<Source> open_exr_source(const std::string& path, bool allow_unfinished);

}  // namespace pave
