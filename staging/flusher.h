// The background thread between a ring and its sink: checksums first, then the sink, errors kept
// for the next caller.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "staging/ring.h"
#include "staging/sink.h"

namespace pave {

/// One thread, one sink. Every method but start() may be called from any thread.
class Flusher : public std::enable_shared_from_this<Flusher> {
   public:
    using Clock = std::chrono::steady_clock;
    Flusher(std::shared_ptr<Ring> ring, std::unique_ptr<Sink> sink, std::shared_ptr<Trace> trace);
    /// The thread shares ownership of this object, so that one stuck in a dead disk can be left
    /// behind.
    void start();

    void push(Frame frame);  // returns at once
    /// Lets go of the oldest frame whose slot comes free by that, in the sink or in the queue.
    bool drop_oldest();
    /// Returns when everything pushed before went through Sink::flush. Throws the failure, or
    /// RunError on the deadline.
    void flush(std::chrono::milliseconds timeout);
    /// Ends the thread behind everything pushed. Throws as flush does; the thread is left behind if
    /// it is stuck.
    void close(bool finished, std::chrono::milliseconds timeout);

    bool failed() const;
    /// Throws what went wrong in the background, if anything did.
    void check() const;
    const std::string& name() const { return name_; }
    int64_t acknowledged() const { return sink_->acknowledged(); }
    int64_t first_index() const { return sink_->first_index(); }

   private:
    struct Item {
        Frame frame;         // a frame, or ...
        int64_t ticket = 0;  // ... a marker: everything before it must go through flush
        bool close = false, finished = false;
    };
    struct Failure {
        ExitCode code;
        std::string message;
    };
    void run();
    bool handle(Item& item);  // false ends the thread
    void take(Frame& frame);
    void fail(ExitCode code, const std::string& reason, const std::string& doing);
    void wait(int64_t ticket, std::chrono::milliseconds timeout, const char* what);
    void check_locked() const;

    const std::shared_ptr<Ring> ring_;
    const std::unique_ptr<Sink> sink_;
    const std::shared_ptr<Trace> trace_;
    const std::string name_;

    mutable std::mutex mutex_;
    std::condition_variable work_, done_;
    std::deque<Item> queue_;
    int64_t tickets_ = 0, tickets_done_ = 0, items_done_ = 0;
    bool closing_ = false, ended_ = false;
    std::string doing_ = "idle";
    std::optional<Failure> failure_;
    std::thread thread_;
};

}  // namespace pave
