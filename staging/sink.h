// The interface between a stage and a place that frames go to. The stage's background thread is
// its only caller, unless said.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "pave/frame.h"
#include "pave/stage.h"
#include "staging/record.h"

namespace pave {

class Sink {
   public:
    virtual ~Sink() = default;
    /// The URI, for messages. Any thread.
    virtual std::string name() const = 0;
    /// Frame number to go on with, and frames already there, when the sink was opened. Any thread.
    virtual int64_t first_index() const { return 0; }
    virtual int64_t first_count() const { return 0; }

    /// Takes one frame. What it throws ends the sink: it is not called again but for its
    /// destructor.
    virtual void write(const Frame& frame, const FrameRecord& record) = 0;
    /// Everything written becomes durable (files) or visible (streams).
    virtual void flush() = 0;
    /// flush() and, if `finished`, the closing record.
    virtual void close(bool finished) = 0;
    /// After a failure: lets go of locks and unfinished files; acknowledged frames stay.
    virtual void abandon() noexcept {}
    /// Frames durable or visible so far, first_count() included. Any thread.
    virtual int64_t acknowledged() const = 0;

    /// Policy drop-oldest: lets go of the oldest frame that nobody else holds, if the sink retains
    /// any. Any thread.
    virtual bool drop_oldest() { return false; }
};

/// Makes the sink of `uri`. Throws UsageError, InputError or RunError as Stage's constructor says.
std::unique_ptr<Sink> make_sink(const std::string& uri, const FrameSchema& schema,
                                const StageOptions& options);

}  // namespace pave
