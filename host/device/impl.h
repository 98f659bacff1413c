// What a pave::Device holds; private to host/device.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <map>
#include <mutex>
#include <string>

#include "host/device/cl.h"

namespace pave {

/// How the host sees what kernels wrote into a slot; decided by a probe, see arena.cpp.
enum class SlotAccess : int {
    kUnknown,
    kShared,  // one address: nothing to do
    kMapped,  // one memory, but caches need a map and an unmap
    kTwin     // discrete: a device buffer beside pinned host memory
};

class Device::Impl {
   public:
    Impl(cl::Context context, cl::Device device, cl::CommandQueue queue, DeviceProfile profile)
        : context_(std::move(context)),
          device_(std::move(device)),
          queue_(std::move(queue)),
          profile_(std::move(profile)) {}
    /// Probes once; any thread.
    SlotAccess slot_access();

    cl::Context context_;
    cl::Device device_;
    cl::CommandQueue queue_;
    DeviceProfile profile_;
    std::mutex programs_mutex_;
    std::map<std::string, cl::Program>
        programs_;  // by key of the kernel cache: built once a context

   private:
    std::once_flag probed_;
    SlotAccess slot_access_ = SlotAccess::kUnknown;
};

/// Everything that OpenCL says of `device`; `id` as list() numbers it. Throws UsageError for a bad
/// PAVE_LANES.
DeviceProfile query_profile(const cl::Device& device, std::string id);

}  // namespace pave
