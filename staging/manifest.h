// The manifest of a data set folder: one checksummed JSON line for the header, each block of
// frames, and the closing record.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "staging/files.h"
#include "staging/record.h"

namespace pave {

inline constexpr int kManifestVersion = 1;
inline constexpr const char* kManifestName = "manifest.jsonl";
inline constexpr const char* kTimingsName = "timings.jsonl";
inline constexpr const char* kLockName = ".lock";
/// Of a manifest or its timings: some two million frames.
inline constexpr uint64_t kManifestByteLimit = uint64_t{2} << 30;

/// Frames that became durable together, and the files that hold them. Immutable.
struct Block {
    std::string name;              // of its file or folder, in the data set's folder
    std::vector<FileFacts> files;  // every file of it
    std::vector<FrameRecord> frames;
    size_t line_offset = 0;    // of its line in the manifest, and ...
    std::string check_before;  // ... the checksum of the line before
};

/// A manifest that was read. Frames behind `byte_size` were never acknowledged.
struct Manifest {
    Json header;
    std::string kind;  // "bp" or "exr"
    FrameSchema schema;
    std::vector<Block> blocks;
    bool finished = false;
    size_t byte_size = 0;        // whole lines; a torn last line begins here
    size_t closing_offset = 0;   // where the closing record is, or would come
    std::string closing_before;  // checksum of the line before it
    std::string last_check;

    std::vector<FrameRecord> records() const;
    int64_t frame_count() const;
    int64_t next_index() const;  // behind the last frame's number
};

/// "{...,"check":"XXH3-128"}\n": the checksum covers the text before it and the checksum of the
/// line before.
std::string checked_line(const Json& body, const std::string& check_before,
                         std::string* check = nullptr);
/// The line's JSON, or InputError "WHERE: ...". `line` comes without its newline.
Json parse_checked_line(std::string_view line, const std::string& check_before,
                        const std::string& where, std::string* check = nullptr);

Json header_json(const std::string& kind, const FrameSchema& schema, const Json& options);
Json block_json(const FrameSchema& schema, const Block& block);
Json closing_json(const FrameSchema& schema, const std::vector<FrameRecord>& records);

/// Throws InputError naming path and line for everything but a torn last line.
Manifest read_manifest(const fs::path& root);
/// True if `name` can be a block of `kind`.
bool is_block_name(const std::string& kind, std::string_view name);

/// Compares every file of `block` with the manifest. Throws InputError naming the file that
/// differs.
void verify_block(const fs::path& root, const Block& block);

/// Seconds spent on each frame, kept apart because they differ between identical runs.
std::string timing_line(const FrameMetadata& metadata);
/// Fills seconds_spent of every record. Throws InputError if a line is damaged or a frame's is
/// missing.
void read_timings(const fs::path& root, std::vector<Block>& blocks);

}  // namespace pave
