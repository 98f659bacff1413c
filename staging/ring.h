// The fixed slots of one arena: who holds which, and the way back to the free list.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "pave/frame.h"

namespace pave {

/// Who a slot waits for.
enum class SlotState : int { kFree, kProducer, kQueued, kSink, kShared };

/// Lives as long as the stage or any of its frames. Any thread.
class Ring : public std::enable_shared_from_this<Ring> {
   public:
    using Clock = std::chrono::steady_clock;
    Ring(ArenaAllocator& allocator, const FrameSchema& schema, int slots);

    /// A free slot with fresh metadata, owned by the producer; an empty frame when there is none.
    Frame try_acquire();
    /// Waits until a slot is free, wake() was called since the last wait ended, or the deadline.
    void wait_for_free(Clock::time_point deadline);
    void wake();

    /// True if `frame` is a slot of this ring in `state`.
    bool is_in(const Frame& frame, SlotState state) const;
    void set_state(const Frame& frame, SlotState state);
    int slots() const { return static_cast<int>(slots_.size()); }
    int free_slots() const;
    /// "2 with the producer, 3 waiting for SINK (frames 4, 5, 6), ..."
    std::string describe(const std::string& sink) const;

   private:
    void give_back(int index);

    mutable std::mutex mutex_;
    std::condition_variable changed_;
    bool woken_ = false;
    std::vector<Slot> slots_;
    std::vector<SlotState> states_;
    std::vector<int> free_;  // a stack: the warmest slot first
};

}  // namespace pave
