// The stage's background thread.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/flusher.h"

#include <pthread.h>

#include <csignal>
#include <utility>

namespace pave {
namespace {

/// A thread that gets no signals: SIGTERM and SIGINT are for the program's own threads.
template <typename Body>
std::thread start_without_signals(Body body) {
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    try {
        std::thread thread(std::move(body));
        pthread_sigmask(SIG_SETMASK, &before, nullptr);
        return thread;
    } catch (const std::exception& error) {
        pthread_sigmask(SIG_SETMASK, &before, nullptr);
        throw RunError(std::string("cannot start the background thread: ") + error.what());
    }
}

}  // namespace

Flusher::Flusher(std::shared_ptr<Ring> ring, std::unique_ptr<Sink> sink,
                 std::shared_ptr<Trace> trace)
    : ring_(std::move(ring)),
      sink_(std::move(sink)),
      trace_(std::move(trace)),
      name_(sink_->name()) {}

void Flusher::start() {
    thread_ = start_without_signals([self = shared_from_this()] { self->run(); });
}

void Flusher::push(Frame frame) {
    const std::lock_guard lock(mutex_);
    queue_.push_back({std::move(frame)});
    work_.notify_one();
}

bool Flusher::drop_oldest() {
    if (sink_->drop_oldest()) return true;
    Frame dropped;  // its slot goes back after the lock is gone
    const std::lock_guard lock(mutex_);
    for (auto item = queue_.begin(); item != queue_.end(); ++item) {
        if (!item->frame || item->frame.slot().use_count() != 1) continue;
        dropped = std::move(item->frame);
        queue_.erase(item);
        return true;
    }
    return false;
}

void Flusher::flush(std::chrono::milliseconds timeout) {
    int64_t ticket = 0;
    {
        const std::lock_guard lock(mutex_);
        check_locked();
        if (closing_) throw UsageError("the stage of " + name_ + " is closed");
        ticket = ++tickets_;
        queue_.push_back({{}, ticket});
        work_.notify_one();
    }
    wait(ticket, timeout, "flush");
}

void Flusher::close(bool finished, std::chrono::milliseconds timeout) {
    int64_t ticket = 0;
    {
        const std::lock_guard lock(mutex_);
        closing_ = true;
        ticket = ++tickets_;
        queue_.push_back({{}, ticket, true, finished});
        work_.notify_one();
    }
    // The thread joins in the destructor's stead: once it ended, or never if it is stuck.
    struct Joiner {
        Flusher& flusher;
        ~Joiner() {
            bool ended = false;
            {
                const std::lock_guard lock(flusher.mutex_);
                ended = flusher.ended_;
            }
            if (!flusher.thread_.joinable()) return;
            ended ? flusher.thread_.join() : flusher.thread_.detach();
        }
    } joiner{*this};
    wait(ticket, timeout, "close");
}

void Flusher::wait(int64_t ticket, std::chrono::milliseconds timeout, const char* what) {
    std::unique_lock lock(mutex_);
    // The deadline is one without progress: a long queue on a slow disk is no failure.
    for (int64_t seen = -1; seen != items_done_ && tickets_done_ < ticket;) {
        seen = items_done_;
        done_.wait_until(lock, Clock::now() + timeout,
                         [&] { return tickets_done_ >= ticket || items_done_ != seen; });
    }
    check_locked();
    if (tickets_done_ >= ticket) return;
    throw RunError(std::string(what) + " of " + name_ + " made no progress in " +
                   std::to_string(timeout.count()) + " ms: " + doing_ + ", " +
                   std::to_string(queue_.size()) +
                   " entries wait behind it; look at the disk or raise the time-out");
}

bool Flusher::failed() const {
    const std::lock_guard lock(mutex_);
    return failure_.has_value();
}

void Flusher::check() const {
    const std::lock_guard lock(mutex_);
    check_locked();
}

void Flusher::check_locked() const {
    if (!failure_) return;
    switch (failure_->code) {
        case ExitCode::kUsage:
            throw UsageError(failure_->message);
        case ExitCode::kInput:
            throw InputError(failure_->message);
        case ExitCode::kPeer:
            throw PeerError(failure_->message);
        default:
            throw RunError(failure_->message);
    }
}

void Flusher::run() {
    pthread_setname_np(pthread_self(), "pave-flusher");
    if (trace_) trace_->name_thread("flusher " + name_);
    for (bool more = true; more;) {
        Item item;
        {
            std::unique_lock lock(mutex_);
            work_.wait(lock, [&] { return !queue_.empty(); });
            item = std::move(queue_.front());
            queue_.pop_front();
            doing_ = item.frame ? "frame " + std::to_string(item.frame.metadata().index) +
                                      " is being written"
                                : std::string("files are being made durable");
        }
        more = handle(item);
        const int64_t ticket = item.ticket;
        item = {};  // the slot goes back before anybody is told
        {
            const std::lock_guard lock(mutex_);
            doing_ = "idle";
            ++items_done_;
            if (ticket > 0) tickets_done_ = ticket;
            if (!more) ended_ = true;
            done_.notify_all();
        }
        ring_->wake();
    }
}

bool Flusher::handle(Item& item) {
    const bool sink_is_usable = !failed();
    const std::string doing =
        item.frame ? "frame " + std::to_string(item.frame.metadata().index) + ": " : std::string();
    try {
        if (!sink_is_usable) {
            // Frames behind a failure only let go of their slots.
        } else if (item.frame) {
            take(item.frame);
        } else if (item.close) {
            sink_->close(item.finished);
        } else {
            sink_->flush();
        }
    } catch (const Error& error) {
        fail(error.exit_code(), error.what(), doing);
    } catch (const std::exception& error) {
        fail(ExitCode::kRun, error.what(), doing);
    } catch (...) {
        fail(ExitCode::kRun, "unknown error", doing);
    }
    return !item.close;
}

void Flusher::take(Frame& frame) {
    ring_->set_state(frame, SlotState::kSink);
    const std::string detail = "frame " + std::to_string(frame.metadata().index);
    const auto begin = Clock::now();
    const FrameRecord record = make_record(frame);
    const auto hashed = Clock::now();
    if (trace_) trace_->span("checksum", begin, hashed, detail);
    sink_->write(frame, record);
    if (trace_) trace_->span("write", hashed, Clock::now(), detail);
    ring_->set_state(frame, SlotState::kShared);
}

void Flusher::fail(ExitCode code, const std::string& reason, const std::string& doing) {
    sink_->abandon();
    const std::lock_guard lock(mutex_);
    failure_ = {code, name_ + ": " + doing + reason};
}

}  // namespace pave
