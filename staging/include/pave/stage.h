// The stage: a ring of frame slots and the sink that a background thread flushes published frames
// to.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "pave/frame.h"
#include "pave/trace.h"

namespace pave {

class Sink;

/// What happens when the sink is slower than the producer.
/// kBlock: acquire waits for a slot until the time-out. kDropOldest: acquire lets go of the oldest
/// published frame that nobody else holds. kDropNewest: publish lets go of its frame if no slot
/// would be left for the next one.
enum class QueuePolicy : int { kBlock, kDropOldest, kDropNewest };

struct StageOptions {
    int width = 256, height = 256;
    std::vector<std::string> channels{"color", "albedo", "direct", "normal", "depth"};
    int slots = 8;  // frames in flight, 1..65536; the drop policies need 2
    QueuePolicy policy = QueuePolicy::kBlock;
    std::chrono::milliseconds timeout{30000};  // of acquire; of flush, close: without progress
    bool resume = false;                     // file sinks: go on after the last acknowledged frame
    int frames_per_shard = 16;               // bp: frames that become durable together
    std::string exr_names = "pave";          // exr: channel spelling, pave | oidn | cycles
    std::shared_ptr<Trace> trace{};          // may be null
    std::vector<Channel> custom_channels{};  // if not empty, used instead of `channels`
};

/// URIs: "mem:NAME" (in this process; each frame keeps its slot until a Source takes it), "mem:"
/// (nobody reads it: a frame is let go once it is checksummed), "bp:PATH", "exr:DIR". acquire and
/// publish are for one producer thread; flush, close and the counters for any thread.
class Stage {
   public:
    /// Memory comes from `allocator` (a Device, or host_memory()), which is only used here. Throws
    /// UsageError for a bad URI or options, a place that exists already, or a resumed one of
    /// another schema; RunError if the place cannot be written or another writer has it; InputError
    /// if `resume` finds data that are broken.
    Stage(ArenaAllocator& allocator, const std::string& uri, StageOptions options);
    Stage(const std::string& uri, StageOptions options)
        : Stage(host_memory(), uri, std::move(options)) {}
    /// A sink of the caller's own (staging/sink.h).
    Stage(ArenaAllocator& allocator, std::unique_ptr<Sink> sink, StageOptions options);
    /// close(), or abandon() while an exception unwinds the stack; errors are logged to stderr.
    ~Stage();
    Stage(Stage&&) noexcept;
    Stage& operator=(Stage&&) noexcept;

    const FrameSchema& schema() const;
    /// A free slot, or waits for one as the policy says; its metadata are fresh, but for the next
    /// frame number. Its pixels are those of an earlier frame. Throws RunError on the deadline,
    /// naming who holds the slots, or the failure of the sink.
    Frame acquire();
    /// Hands the frame to the background thread and returns at once. From here on nobody may write
    /// to it. Throws UsageError if it is not an acquired frame of this stage, or its number
    /// (metadata().index) is not above the last one. False if drop-newest let go of the frame: who
    /// still holds it keeps a slot that the next acquire may need.
    bool publish(Frame frame);
    /// Returns when everything published before is durable (files) or visible (mem); throws what
    /// went wrong in the background.
    void flush();
    /// flush() plus release; files get their closing record. Idempotent.
    void close();
    /// close() without the closing record: what was published is kept, and the data set stays open
    /// for `resume`.
    void abandon();

    /// Number of the first frame to make: behind the last one there when resuming.
    int64_t first_index() const;
    int64_t published() const;  // by this stage, dropped ones included
    /// Frames durable (files) or visible (mem), those found when resuming included, without those
    /// that drop-oldest let go of.
    int64_t acknowledged() const;
    int64_t dropped() const;

   private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace pave
