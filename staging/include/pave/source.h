// Reading frames back, whatever the sink was: one interface for every URI.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "pave/frame.h"

namespace pave {

/// Frames of "mem:NAME", "bp:PATH" or "exr:DIR". File sources check every byte against the manifest
/// before a library parses it. A file source sees what was acknowledged when it was opened. A mem:
/// source sees every frame that was published, not dropped and not yet taken; positions count from
/// the oldest of them, so next() shifts them for all sources of the name. A mem: store lives while
/// its stage or a source does.
class Source {
   public:
    /// Throws UsageError for a bad URI or a name that no stage has, InputError for broken, foreign
    /// or unfinished data (unfinished files are taken with `allow_unfinished`; mem: always is).
    static std::unique_ptr<Source> open(const std::string& uri, bool allow_unfinished = false);
    virtual ~Source() = default;

    virtual const FrameSchema& schema() const = 0;
    virtual int64_t frame_count() const = 0;
    virtual bool finished() const = 0;  // the writer closed it
    /// Metadata alone, without reading pixels.
    virtual FrameMetadata metadata(int64_t position) const = 0;
    /// Frame `position` in 0..frame_count()-1. mem: shares the slot itself; files: read into memory
    /// of `allocator`. Throws InputError naming the file if a checksum does not match. One thread
    /// at a time per source.
    virtual Frame read(int64_t position, ArenaAllocator& allocator = host_memory()) = 0;
    /// Every frame, in order; of mem: those of one moment, whoever takes or adds some meanwhile.
    virtual std::vector<Frame> read_all(ArenaAllocator& allocator = host_memory());
    /// The oldest frame not yet given by next(), in order, whatever the sink: mem: takes it out of
    /// the store, so that its slot is free again when the caller lets go; waits for one while the
    /// stage is open and throws PeerError after `timeout`. An empty frame when there will be no
    /// more.
    virtual Frame next(std::chrono::milliseconds timeout,
                       ArenaAllocator& allocator = host_memory()) = 0;
    /// XXH3-128 hex over all frames' pixels and metadata but the time spent: equal for equal data
    /// sets in any sink.
    virtual std::string content_hash() const = 0;
};

}  // namespace pave
