// Sinks that misbehave on purpose.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <vector>

#include "staging/sink.h"

namespace pave::test {

/// What a TestSink does and what it saw; shared with the test, which outlives the stage.
struct SinkControl {
    std::mutex mutex;
    std::condition_variable changed;
    bool is_stuck = false;  // write() does not return while this is set
    int64_t fail_at = -1;   // write() of this frame throws
    int delay_ms = 0;       // write() takes this long
    std::vector<FrameRecord> seen;
    int flushes = 0, closes = 0, abandons = 0;
    bool finished = false, destroyed = false;

    void set_stuck(bool stuck);
    /// Waits (10 s at most) until the sink is gone.
    bool wait_until_destroyed();
    /// Waits (10 s at most) until `count` frames went in or are stuck in write().
    bool wait_for_entries(int count);
    int entries = 0;
    std::vector<int64_t> indices();
};

class TestSink final : public Sink {
   public:
    explicit TestSink(std::shared_ptr<SinkControl> control) : control_(std::move(control)) {}
    ~TestSink() override;
    std::string name() const override { return "test:sink"; }
    void write(const Frame& frame, const FrameRecord& record) override;
    void flush() override;
    void close(bool finished) override;
    void abandon() noexcept override;
    int64_t acknowledged() const override { return acknowledged_; }

   private:
    const std::shared_ptr<SinkControl> control_;
    std::atomic<int64_t> acknowledged_{0};
};

}  // namespace pave::test
