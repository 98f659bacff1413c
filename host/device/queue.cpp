// Buffers, transfers and waits with a deadline.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <thread>

#include "host/device/cache.h"
#include "host/device/cl.h"

namespace pave {

void wait(const cl::Event& event, std::string_view what, std::chrono::milliseconds limit) {
    using Clock = std::chrono::steady_clock;
    constexpr std::chrono::nanoseconds kShortest = std::chrono::microseconds(20);
    constexpr std::chrono::nanoseconds kLongest = std::chrono::milliseconds(2);
    const Clock::time_point begin = Clock::now();
    cl_guard(what,
             [&] {  // a command that is not flushed may never start; user events have no queue
                 const cl::CommandQueue queue = event.getInfo<CL_EVENT_COMMAND_QUEUE>();
                 if (queue() != nullptr) queue.flush();
             });
    for (;;) {
        const cl_int status =
            cl_guard(what, [&] { return event.getInfo<CL_EVENT_COMMAND_EXECUTION_STATUS>(); });
        if (status == CL_COMPLETE) {
            KernelCache::of_process().save_if_due();
            return;
        }
        if (status < 0) throw ClError("command", status, what);
        const std::chrono::nanoseconds waited = Clock::now() - begin;
        if (waited >= limit)
            throw DeviceError(std::string(what) + " did not finish within " +
                              std::to_string(limit.count() / 1000.0).substr(0, 6) +
                              " s; use a smaller frame or tile, or check the device's driver");
        std::this_thread::sleep_for(std::clamp(waited / 32, kShortest, kLongest));
    }
}

void finish(const Device& device, std::string_view what, std::chrono::milliseconds limit) {
    cl::Event event;
    cl_guard(what, [&] { queue_of(device).enqueueMarkerWithWaitList(nullptr, &event); });
    wait(event, what, limit);
}

cl::Buffer make_buffer(const Device& device, size_t byte_size, std::string_view what,
                       cl_mem_flags flags) {
    constexpr size_t kSmallest = 16;
    const size_t largest = device.profile().max_alloc_byte_size;
    if (byte_size > largest)
        throw ClError("clCreateBuffer", CL_INVALID_BUFFER_SIZE, what,
                      std::to_string(byte_size) + " bytes, " + device.profile().name +
                          " allocates " + std::to_string(largest) + " at most",
                      "use a smaller frame or scene");
    return cl_guard(what, [&] {
        return cl::Buffer(context_of(device), flags, std::max(byte_size, kSmallest));
    });
}

cl::Buffer make_buffer_of_bytes(const Device& device, std::span<const std::byte> bytes,
                                std::string_view what) {
    cl::Buffer buffer = make_buffer(device, bytes.size(), what, CL_MEM_READ_ONLY);
    write_buffer_bytes(device, buffer, bytes, what);
    return buffer;
}

void read_buffer_bytes(const Device& device, const cl::Buffer& buffer, std::span<std::byte> to,
                       std::string_view what) {
    if (to.empty()) return;
    cl::Event event;
    cl_guard(what, [&] {
        queue_of(device).enqueueReadBuffer(buffer, CL_FALSE, 0, to.size(), to.data(), nullptr,
                                           &event);
    });
    wait(event, what);
}

void write_buffer_bytes(const Device& device, const cl::Buffer& buffer,
                        std::span<const std::byte> from, std::string_view what) {
    if (from.empty()) return;
    cl::Event event;
    cl_guard(what, [&] {
        queue_of(device).enqueueWriteBuffer(buffer, CL_FALSE, 0, from.size(), from.data(), nullptr,
                                            &event);
    });
    wait(event, what);
}

}  // namespace pave
