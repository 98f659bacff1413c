// Time spans of a run in Chrome's trace format: shows what overlapped with what.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <memory>
#include <string>

namespace pave {

/// Collects spans from any thread; write() puts them into a JSON file that chrome://tracing and
/// Perfetto open.
class Trace {
   public:
    using Clock = std::chrono::steady_clock;
    Trace();
    ~Trace();
    /// One span on the calling thread's row. `name` e.g. "render", `detail` e.g. "frame 12".
    void span(const std::string& name, Clock::time_point begin, Clock::time_point end,
              const std::string& detail = {});
    /// Names the calling thread's row.
    void name_thread(const std::string& name);
    /// Whole or absent. Throws RunError if the file cannot be written.
    void write(const std::string& path) const;

   private:
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace pave
