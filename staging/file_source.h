// Reading a data set folder: manifest first, bytes verified before a library sees them, pixels
// verified after.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <vector>

#include "pave/source.h"
#include "staging/manifest.h"

namespace pave {

/// What bp: and exr: have in common. The subclass turns a block into pixels.
class FileSource : public Source {
   public:
    FileSource(const std::string& path, const std::string& kind, bool allow_unfinished);

    const FrameSchema& schema() const override { return manifest_.schema; }
    int64_t frame_count() const override { return static_cast<int64_t>(places_.size()); }
    bool finished() const override { return manifest_.finished; }
    FrameMetadata metadata(int64_t position) const override;
    Frame read(int64_t position, ArenaAllocator& allocator) override;
    Frame next(std::chrono::milliseconds timeout, ArenaAllocator& allocator) override;
    std::string content_hash() const override;

   protected:
    /// Pixels of frame `step` of `block`. Calls verify_block() before a library opens a file of it.
    /// Throws anything.
    virtual Frame decode(const Block& block, size_t step, ArenaAllocator& allocator) = 0;
    const fs::path& root() const { return root_; }
    const Manifest& manifest() const { return manifest_; }

   private:
    struct Place {
        size_t block, step;
    };
    const Place& place(int64_t position) const;

    fs::path root_;
    Manifest manifest_;
    std::vector<Place> places_;
    int64_t next_ = 0;
};

}  // namespace pave
