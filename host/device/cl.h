// The OpenCL side of a pave::Device for the rooms of host/: handles, programs, buffers, slots,
// waits and typed errors.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <CL/opencl.hpp>
#include <chrono>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

#include "pave/device.h"
#include "pave/error.h"

namespace pave {

// ---- Errors ----

/// "CL_OUT_OF_RESOURCES(-5)"; "CL_ERROR(-9999)" for codes that no header names.
std::string cl_code_name(cl_int code);

/// An OpenCL call that failed. what() is one line: "clBuildProgram: CL_BUILD_PROGRAM_FAILURE(-11):
/// path.cl:57: reason; hint".
struct ClError : DeviceError {
    /// `where`: kernel, file:line or buffer concerned; empty parts are left out. An empty hint is
    /// filled in by `code`.
    ClError(std::string_view routine, cl_int code, std::string_view where = {},
            std::string_view reason = {}, std::string_view hint = {}, std::string build_log = {});
    std::string routine;  // "clBuildProgram"
    cl_int code = 0;
    std::string build_log;  // whole compiler output of a failed build, else empty
};

/// Runs `call` and turns a cl::Error into a ClError about `where` (a kernel's or buffer's name).
template <class Call>
decltype(auto) cl_guard(std::string_view where, Call&& call) {
    try {
        return std::forward<Call>(call)();
    } catch (const cl::BuildError& error) {
        throw ClError(error.what(), error.err(), where);
    } catch (const cl::Error& error) {
        throw ClError(error.what(), error.err(), where);
    }
}

// ---- Handles: borrowed references, valid while a copy of the Device lives. Any thread. ----

const cl::Context& context_of(const Device& device);
const cl::Device& device_of(const Device& device);
/// In order, without profiling unless PAVE_PROFILE=1 was set when the device was selected.
const cl::CommandQueue& queue_of(const Device& device);

// ---- Programs ----

/// A number that a program is specialised with; reaches the compiler as -D NAME=NUMBER and as
/// nothing else.
struct DefineValue {
    template <std::integral T>
    DefineValue(T v) : value(static_cast<int64_t>(v)) {}
    DefineValue(float v) : value(v) {}  // written as a hexadecimal literal: exact
    DefineValue(double v) : value(static_cast<float>(v)) {}
    std::variant<int64_t, float> value;
    bool operator==(const DefineValue&) const = default;
};
/// NAME is [A-Z][A-Z0-9_]*, at most 64 characters; anything else is an InternalError.
using Defines = std::map<std::string, DefineValue>;

/// Builds kernels/`file` (with what it includes) for `device`, or loads it from PAVE's kernel
/// cache. Options are the same for every program: -cl-std=CL1.2 plus `defines`; no
/// -cl-fast-relaxed-math, and the source starts with
/// `#pragma OPENCL FP_CONTRACT OFF`, so that a*b+c rounds twice on every device: write fma() where
/// one rounding is meant. Blocking. Any thread. Throws ClError with the first error's file:line and
/// the whole log in build_log.
cl::Program build_program(const Device& device, const std::string& file,
                          const Defines& defines = {});

/// The same over `source` instead of a file of kernels/; `name` is what build logs call it. For
/// tests.
cl::Program build_program_from_source(const Device& device, const std::string& name,
                                      const std::string& source, const Defines& defines = {});

/// Kernel `name` of `program`; throws ClError that lists the kernels there are.
cl::Kernel make_kernel(const cl::Program& program, const std::string& name);

/// The text that build_program compiles for kernels/`file`: includes resolved (each file once),
/// with #line marks.
std::string assemble_source(const std::string& file);

// ---- Launches and waits ----

/// Sets all arguments in order and enqueues; `local` = cl::NullRange lets the driver choose.
/// Non-blocking.
template <class... Args>
cl::Event launch(const Device& device, cl::Kernel& kernel, const cl::NDRange& global,
                 const cl::NDRange& local, const Args&... args);

inline constexpr std::chrono::milliseconds kWaitLimit = std::chrono::minutes(10);

/// Waits until `event` is complete. OpenCL has no wait with a deadline, so this polls with a
/// back-off (first 20 us, then a 32nd of the time waited, at most 2 ms). Throws DeviceError "WHAT
/// did not finish within N s" or, if the command failed, ClError.
void wait(const cl::Event& event, std::string_view what,
          std::chrono::milliseconds limit = kWaitLimit);

/// Flushes the device's queue and waits until all that was enqueued so far is complete.
void finish(const Device& device, std::string_view what,
            std::chrono::milliseconds limit = kWaitLimit);

// ---- Buffers ----

/// An uninitialised buffer; `what` names it in errors. 0 bytes give a buffer of 16 (OpenCL knows no
/// empty buffers). Throws ClError with both sizes when it is above the device's largest allocation.
cl::Buffer make_buffer(const Device& device, size_t byte_size, std::string_view what,
                       cl_mem_flags flags = CL_MEM_READ_WRITE);

/// A read-only buffer with a copy of `bytes`. Blocking.
cl::Buffer make_buffer_of_bytes(const Device& device, std::span<const std::byte> bytes,
                                std::string_view what);
template <class Container>
cl::Buffer make_buffer_of(const Device& device, const Container& items, std::string_view what) {
    return make_buffer_of_bytes(device, std::as_bytes(std::span(items)), what);
}

/// Copies between `buffer` (from byte 0) and host memory; returns when done, after everything
/// enqueued before.
void read_buffer_bytes(const Device& device, const cl::Buffer& buffer, std::span<std::byte> to,
                       std::string_view what);
void write_buffer_bytes(const Device& device, const cl::Buffer& buffer,
                        std::span<const std::byte> from, std::string_view what);
template <class Container>
void read_buffer(const Device& device, const cl::Buffer& buffer, Container& to,
                 std::string_view what) {
    read_buffer_bytes(device, buffer, std::as_writable_bytes(std::span(to)), what);
}
template <class Container>
void write_buffer(const Device& device, const cl::Buffer& buffer, const Container& from,
                  std::string_view what) {
    write_buffer_bytes(device, buffer, std::as_bytes(std::span(from)), what);
}

// ---- Slots ----

/// Device::slot_buffer as a retained cl::Buffer; a null one (buffer() == nullptr) for a frame of
/// another device's memory. A channel lies at schema().channel_byte_offset(i) in it. Kernels write
/// between slot_to_device() and slot_to_host().
cl::Buffer slot_buffer_of(const Device& device, const Frame& frame);

/// Makes what the host wrote into the slot visible to kernels enqueued after it. Non-blocking;
/// nothing to do on CPU devices.
void slot_to_device(const Device& device, const Frame& frame);
/// Makes what kernels wrote visible to the host once finish() or the returned event says so.
/// Non-blocking, never a copy on devices that share the host's memory; elsewhere an asynchronous
/// read into the slot's pinned memory.
cl::Event slot_to_host(const Device& device, const Frame& frame);

// ---- Inline ----

template <class... Args>
cl::Event launch(const Device& device, cl::Kernel& kernel, const cl::NDRange& global,
                 const cl::NDRange& local, const Args&... args) {
    cl::Event event;
    cl_uint index = 0;
    std::string where;
    try {
        where = kernel.getInfo<CL_KERNEL_FUNCTION_NAME>();
        ((kernel.setArg(index, args), ++index), ...);
        queue_of(device).enqueueNDRangeKernel(kernel, cl::NullRange, global, local, nullptr,
                                              &event);
    } catch (const cl::Error& error) {
        if (index < sizeof...(Args)) where += ", argument " + std::to_string(index);
        throw ClError(error.what(), error.err(), where);
    }
    return event;
}

}  // namespace pave
