// The writing side of a data set folder: lock, resume, and the order that makes frames durable.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "pave/trace.h"
#include "staging/files.h"
#include "staging/manifest.h"

namespace pave {

/// A folder that PAVE owns, with one writer at a time. Order of every commit: data files synced,
/// renamed, their folder synced, then the manifest line synced, then acknowledged.
class FolderWriter {
   public:
    /// Throws as Stage's constructor. `options` is what must be equal to go on: it becomes part of
    /// the header.
    FolderWriter(const std::string& path, const std::string& kind, const FrameSchema& schema,
                 const Json& options, bool resume, std::shared_ptr<Trace> trace);

    const fs::path& root() const { return root_; }
    const FrameSchema& schema() const { return schema_; }
    int64_t first_index() const { return first_index_; }
    int64_t first_count() const { return first_count_; }
    int64_t acknowledged() const { return acknowledged_; }  // any thread
    const std::vector<Block>& blocks() const { return manifest_.blocks; }

    /// Path for an unfinished file or folder, free of leftovers.
    fs::path temporary(const std::string& unfinished);
    /// Makes that file or folder the block `name` with `frames`. The last `replaced` blocks go:
    /// their frames are in it.
    void commit(const std::string& unfinished, const std::string& name,
                std::vector<FrameRecord> frames, size_t replaced = 0);
    /// Writes the closing record if `finished`, then lets go of the folder.
    void close(bool finished);
    /// Lets go of the folder and of unfinished files.
    void abandon() noexcept;

   private:
    void take_back_folder() noexcept;
    void refuse_foreign(bool resume) const;
    void start_new(const Json& header);
    void start_resumed(const Json& header);
    void remove_leftovers();
    void keep_acknowledged_timings();
    std::vector<FileFacts> sync_block(const std::string& temporary_name, const std::string& name);
    void append(File& file, uint64_t byte_size, const std::string& text);
    void append_timings(const std::vector<FrameRecord>& frames, size_t known);
    void reopen_closed();
    void append_block(Block block);
    void remove_unlisted(const std::string& name) noexcept;
    void replace_tail(Block block, size_t replaced);

    fs::path root_;
    const std::string kind_;
    const FrameSchema schema_;
    const std::shared_ptr<Trace> trace_;
    bool made_folder_ = false;
    File lock_, manifest_file_, timings_file_;
    uint64_t timings_byte_size_ = 0;
    Manifest manifest_;
    int64_t first_index_ = 0, first_count_ = 0;
    std::atomic<int64_t> acknowledged_{0};
    std::vector<std::string> temporaries_;
};

}  // namespace pave
