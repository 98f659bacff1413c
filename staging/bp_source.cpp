// The bp: source: shards opened on first touch, the last few kept open.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <deque>

#include "staging/bp.h"
#include "staging/file_source.h"

namespace pave {
namespace {

constexpr size_t kOpenShards = 64;  // each holds a file descriptor or two

class BpSource final : public FileSource {
   public:
    BpSource(const std::string& path, bool allow_unfinished)
        : FileSource(path, "bp", allow_unfinished) {}

   private:
    struct OpenShard {
        const Block* block;
        std::unique_ptr<BpReader> reader;
    };
    Frame decode(const Block& block, size_t step, ArenaAllocator& allocator) override {
        auto found = std::find_if(open_.begin(), open_.end(),
                                  [&](const OpenShard& shard) { return shard.block == &block; });
        if (found == open_.end()) {
            check_room(block);
            if (open_.size() == kOpenShards) open_.pop_front();
            auto reader = std::make_unique<BpReader>(root(), block, schema());
            open_.push_back({&block, std::move(reader)});
            found = std::prev(open_.end());
        }
        Frame frame = make_frame(schema(), allocator);
        found->reader->get(step, frame);
        return frame;
    }

    /// BP5 does not compress: files smaller than their pixels are a lie, told before memory is
    /// taken.
    void check_room(const Block& block) const {
        uint64_t byte_size = 0, frame_byte_size = 0;
        for (const FileFacts& file : block.files) byte_size += file.byte_size;
        for (size_t i = 0; i < schema().channels().size(); ++i)
            frame_byte_size += schema().channel_byte_size(static_cast<int>(i));
        if (byte_size / block.frames.size() < frame_byte_size)
            throw InputError((root() / block.name).string() +
                             ": the files are too small for their frames");
    }

    std::deque<OpenShard> open_;  // oldest first
};

}  // namespace

std::unique_ptr<Source> open_bp_source(const std::string& path, bool allow_unfinished) {
    return std::make_unique<BpSource>(path, allow_unfinished);
}

}  // namespace pave
