// Typed errors of every PAVE room and the exit code each one ends a program with.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <stdexcept>
#include <string>

namespace pave {

/// Exit codes of every PAVE program. Also listed in docs/errors.md and python/pave/errors.py.
enum class ExitCode : int { kDone = 0, kRun = 1, kUsage = 2, kInput = 3, kDevice = 4, kPeer = 5 };

/// Base of all PAVE errors. what() is one line: what went wrong, where, and how to mend it.
class Error : public std::runtime_error {
   public:
    Error(ExitCode code, const std::string& message) : std::runtime_error(message), code_(code) {}
    ExitCode exit_code() const noexcept { return code_; }

   private:
    ExitCode code_;
};

/// A run that could not go on: disk full, background write failed, limit reached.
struct RunError : Error {
    explicit RunError(const std::string& message) : Error(ExitCode::kRun, message) {}
};
/// The caller asked for something that cannot be: unknown option, size 0, wrong channel name.
struct UsageError : Error {
    explicit UsageError(const std::string& message) : Error(ExitCode::kUsage, message) {}
};
/// A file or its data are broken: parse error with file and line, checksum mismatch.
struct InputError : Error {
    explicit InputError(const std::string& message) : Error(ExitCode::kInput, message) {}
};
/// The OpenCL environment is missing or refused: no platform, unknown device, build failure.
struct DeviceError : Error {
    explicit DeviceError(const std::string& message) : Error(ExitCode::kDevice, message) {}
};
/// Another process of a stream is late, dead or not the one expected.
struct PeerError : Error {
    explicit PeerError(const std::string& message) : Error(ExitCode::kPeer, message) {}
};
/// A broken promise inside PAVE: please report it.
struct InternalError : Error {
    explicit InternalError(const std::string& message)
        : Error(ExitCode::kRun, "internal error, please report: " + message) {}
};

}  // namespace pave
