// The stage: a ring of frame slots and the sink that a background thread flushes published frames to.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "pave/frame.h"
#include "pave/trace.h"

namespace pave {

enum class QueuePolicy : int { kBlock, kDropOldest, kDropNewest };

struct StageOptions {
    int width = 256, height = 256;
    std::vector<std::string> channels{"color", "albedo", "direct", "normal", "depth"};
    int slots = 8;                                // frames in flight, 1..65536
    QueuePolicy policy = QueuePolicy::kBlock;
    std::chrono::milliseconds timeout{30000};     // of every wait: acquire, flush, close
    bool resume = false;                          // file sinks: go on after the last acknowledged frame
    int frames_per_shard = 16;                    // bp: frames that become durable together
    std::string exr_names = "pave";               // exr: channel spelling, pave | oidn | cycles
    std::shared_ptr<Trace> trace;                 // may be null
    std::vector<Channel> custom_channels;         // if not empty, used instead of `channels`
};

/// URIs: "mem:NAME" (in this process, retained until taken or closed), "bp:PATH", "exr:DIR".
/// acquire and publish are for one producer thread; flush, close and the counters for any thread.
class Stage {
   public:
    /// Memory comes from `allocator` (a Device, or host_memory()). Throws UsageError for a bad URI or options,
    /// RunError if the place cannot be written, InputError if `resume` finds data that is not its own.
    Stage(ArenaAllocator& allocator, const std::string& uri, StageOptions options);
    Stage(const std::string& uri, StageOptions options) : Stage(host_memory(), uri, std::move(options)) {}
    ~Stage();  // close(), errors logged to stderr
    Stage(Stage&&) noexcept;
    Stage& operator=(Stage&&) noexcept;

    const FrameSchema& schema() const;
    /// A free slot, or waits for one as the policy says. Throws RunError on the deadline or an earlier sink failure.
    Frame acquire();
    /// Hands the frame to the background thread and returns at once. Frame numbers must rise.
    void publish(Frame frame);
    /// Returns when everything published before is durable (files) or visible (mem); throws what went wrong in the background.
    void flush();
    /// flush() plus release; files get their closing record. Idempotent.
    void close();

    int64_t first_index() const;   // frames already there when resuming: start rendering here
    int64_t published() const;
    int64_t acknowledged() const;  // durable frames, `first_index` included
    int64_t dropped() const;

   private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace pave
