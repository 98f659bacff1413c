// The stage: acquire and publish on the producer's side, policies, and the errors of the
// background thread.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/stage.h"

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <exception>
#include <utility>

#include "staging/flusher.h"
#include "staging/ring.h"
#include "staging/sink.h"
#include "staging/uri.h"

namespace pave {
namespace {

using Clock = std::chrono::steady_clock;

// A reader that lets go of a frame that the sink retains frees no slot, so nobody is woken, but
// drop-oldest may take the frame from then on: acquire looks again this often.
constexpr std::chrono::milliseconds kDropInterval(20);

FrameSchema make_schema(const StageOptions& options) {
    return options.custom_channels.empty()
               ? FrameSchema::of_known(options.width, options.height, options.channels)
               : FrameSchema(options.width, options.height, options.custom_channels);
}

StageOptions checked(StageOptions options) {
    const int least = options.policy == QueuePolicy::kBlock ? 1 : 2;
    if (options.slots < least || options.slots > 65536)
        throw UsageError("slots must be " + std::to_string(least) +
                         " to 65536 with this policy, not " + std::to_string(options.slots));
    if (options.timeout.count() < 0 || options.timeout > std::chrono::hours(24 * 365))
        throw UsageError("the time-out must be 0 ms to a year");
    if (options.frames_per_shard < 1 || options.frames_per_shard > 1'000'000)
        throw UsageError("frames_per_shard must be 1 to 1000000, not " +
                         std::to_string(options.frames_per_shard));
    const size_t slot_byte_size = make_schema(options).slot_byte_size();
    size_t byte_size = 0;
    if (__builtin_mul_overflow(slot_byte_size, static_cast<size_t>(options.slots), &byte_size) ||
        byte_size > size_t{1} << 46)
        throw UsageError(std::to_string(options.slots) + " slots of " +
                         std::to_string(slot_byte_size) + " bytes are more than any memory");
    return options;
}

}  // namespace

class Stage::Impl {
   public:
    Impl(ArenaAllocator& allocator, StageOptions options)
        : options_(checked(std::move(options))),
          schema_(make_schema(options_)),
          ring_(std::make_shared<Ring>(allocator, schema_, options_.slots)) {}

    void start(std::unique_ptr<Sink> sink) {
        first_index_ = next_index_ = sink->first_index();
        flusher_ = std::make_shared<Flusher>(ring_, std::move(sink), options_.trace);
        flusher_->start();
    }

    Frame acquire() {
        check_open();
        const auto begin = Clock::now();
        const auto deadline = begin + options_.timeout;
        for (;;) {
            const auto now = Clock::now();
            flusher_->check();
            if (Frame frame = ring_->try_acquire()) {
                frame.metadata().index = next_index_;
                if (options_.trace)
                    options_.trace->span("acquire-wait", begin, Clock::now(),
                                         "frame " + std::to_string(next_index_));
                return frame;
            }
            const bool drops = options_.policy == QueuePolicy::kDropOldest;
            if (drops && flusher_->drop_oldest()) {
                ++dropped_;
                continue;
            }
            if (now >= deadline) throw_no_slot();
            ring_->wait_for_free(drops ? std::min(deadline, now + kDropInterval) : deadline);
        }
    }

    bool publish(Frame frame) {
        check_open();
        const auto begin = Clock::now();
        if (!ring_->is_in(frame, SlotState::kProducer))
            throw UsageError("publish takes a frame that this stage's acquire() gave, once");
        const int64_t index = frame.metadata().index;
        if (index < next_index_)
            throw UsageError("frame number " + std::to_string(index) +
                             " is not above the last one, " + std::to_string(next_index_ - 1));
        check_metadata(frame.metadata());
        next_index_ = index + 1;
        ++published_;
        if (options_.policy == QueuePolicy::kDropNewest && ring_->free_slots() == 0) {
            ring_->set_state(frame, SlotState::kShared);
            ++dropped_;
            return false;
        }
        ring_->set_state(frame, SlotState::kQueued);
        flusher_->push(std::move(frame));
        if (options_.trace)
            options_.trace->span("publish", begin, Clock::now(), "frame " + std::to_string(index));
        return true;
    }

    void flush() {
        check_open();
        flusher_->flush(options_.timeout);
    }

    void close(bool finished) {
        if (closed_.exchange(true)) return;
        if (flusher_) flusher_->close(finished, options_.timeout);
    }

    const FrameSchema& schema() const { return schema_; }
    int64_t first_index() const { return first_index_; }
    int64_t published() const { return published_; }
    int64_t acknowledged() const { return flusher_->acknowledged(); }
    int64_t dropped() const { return dropped_; }
    const StageOptions& options() const { return options_; }
    const int exceptions_at_start = std::uncaught_exceptions();

   private:
    void check_open() const {
        if (closed_) throw UsageError("the stage of " + flusher_->name() + " is closed");
    }
    [[noreturn]] void throw_no_slot() const {
        throw RunError("no free slot for " + flusher_->name() + " within " +
                       std::to_string(options_.timeout.count()) +
                       " ms: " + ring_->describe(flusher_->name()) +
                       "; let go of frames, use more slots or a drop policy");
    }

    const StageOptions options_;
    const FrameSchema schema_;
    const std::shared_ptr<Ring> ring_;
    std::shared_ptr<Flusher> flusher_;
    int64_t first_index_ = 0, next_index_ = 0;
    std::atomic<int64_t> published_{0}, dropped_{0};
    std::atomic<bool> closed_{false};
};

Stage::Stage(ArenaAllocator& allocator, const std::string& uri, StageOptions options) {
    parse_uri(uri);  // a bad one is refused before memory is taken
    impl_ = std::make_unique<Impl>(allocator, std::move(options));
    impl_->start(make_sink(uri, impl_->schema(), impl_->options()));
}

Stage::Stage(ArenaAllocator& allocator, std::unique_ptr<Sink> sink, StageOptions options)
    : impl_(std::make_unique<Impl>(allocator, std::move(options))) {
    impl_->start(std::move(sink));
}

Stage::~Stage() {
    if (!impl_) return;
    try {
        impl_->close(std::uncaught_exceptions() <= impl_->exceptions_at_start);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "pave: %s\n", error.what());
    }
}

Stage::Stage(Stage&&) noexcept = default;
Stage& Stage::operator=(Stage&& other) noexcept {
    if (this != &other) {
        const Stage closing(std::move(*this));  // its destructor closes and logs
        impl_ = std::move(other.impl_);
    }
    return *this;
}

const FrameSchema& Stage::schema() const { return impl_->schema(); }
Frame Stage::acquire() { return impl_->acquire(); }
bool Stage::publish(Frame frame) { return impl_->publish(std::move(frame)); }
void Stage::flush() { impl_->flush(); }
void Stage::close() { impl_->close(true); }
void Stage::abandon() { impl_->close(false); }
int64_t Stage::first_index() const { return impl_->first_index(); }
int64_t Stage::published() const { return impl_->published(); }
int64_t Stage::acknowledged() const { return impl_->acknowledged(); }
int64_t Stage::dropped() const { return impl_->dropped(); }

}  // namespace pave
