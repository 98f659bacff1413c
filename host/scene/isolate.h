// Work on data that nobody vouches for, by libraries with open faults, in a process of its own.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <stdexcept>
#include <string>

namespace pave {

/// Why isolated work gave nothing: its own error, a crash, or a limit that it met.
struct IsolationError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

struct IsolationLimits {
    size_t memory_byte_size = size_t{4} << 30;  // beyond what the process has already
    int seconds = 120;
    size_t result_byte_size = size_t{6} << 30;
};

/// What `work` returns, computed in a forked process: if it crashes, hangs or takes too much
/// memory, this process only learns that. `work` must not touch OpenCL, Python or threads. Throws
/// IsolationError, with the message of what `work` threw.
std::string run_isolated(const std::function<std::string()>& work,
                         const IsolationLimits& limits = {});

}  // namespace pave
