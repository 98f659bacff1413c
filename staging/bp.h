// ADIOS2 BP5: shards of frames that any ADIOS2 tool reads, and the bp: sink and source over them.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string>

#include "pave/source.h"
#include "staging/manifest.h"
#include "staging/sink.h"

namespace pave {

/// Writes one BP5 folder, one step a frame. A frame's memory is free again when put() returns.
class BpWriter {
   public:
    BpWriter(const fs::path& path, const FrameSchema& schema);
    ~BpWriter();
    BpWriter(const BpWriter&) = delete;
    BpWriter& operator=(const BpWriter&) = delete;
    void put(const Frame& frame);
    void close();  // complete, but not yet synced

   private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

/// Reads one shard of the data set at `root`.
class BpReader {
   public:
    /// Compares the bytes of `block` with the manifest before ADIOS2 sees them. Throws InputError
    /// if they differ, or are not its frames as steps of `schema`.
    BpReader(const fs::path& root, const Block& block, const FrameSchema& schema);
    ~BpReader();
    BpReader(const BpReader&) = delete;
    BpReader& operator=(const BpReader&) = delete;
    void get(size_t step, Frame& frame);  // pixels only

   private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

std::unique_ptr<Sink> make_bp_sink(const std::string& path, const FrameSchema& schema,
                                   const StageOptions& options);
std::unique_ptr<Source> open_bp_source(const std::string& path, bool allow_unfinished);

}  // namespace pave
