// One OpenCL device and what it says of itself: selection, profile, queue, kernel programs, pinned
// arenas.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "pave/frame.h"

namespace pave {

/// Facts queried from OpenCL; every choice of a fast path is made from these, never from a vendor's
/// name.
struct DeviceProfile {
    std::string id;  // "platform:device", what Device::select takes
    std::string platform, name, vendor, driver, opencl_version;
    bool is_cpu = false, is_gpu = false;
    bool host_unified_memory = false;  // host and device share memory: a slot is never copied
    int compute_units = 0;
    int native_float_width = 1;
    int lane_width =
        1;  // lanes of kernels/lanes.h: 16 or 8 on CPUs, 1 on GPUs; PAVE_LANES forces it
    size_t max_work_group_size = 0;
    size_t global_byte_size = 0, max_alloc_byte_size = 0;
    size_t cache_byte_size = 0;  // of global memory; a CPU's last level
};

/// Where compiled kernels are kept between processes (docs/kernel-cache.md).
struct KernelCacheInfo {
    std::string folder;  // empty if there is none; nothing is kept then
    std::string note;    // then: why, e.g. "/home/ada/.cache/pave is open to others (chmod 700)"
};

/// A counted handle on a device with its context and in-order queue. Copies share it. Any thread.
class Device : public ArenaAllocator {
   public:
    /// `spec`: "" (PAVE_DEVICE, else the first GPU, else the first CPU), "cpu", "gpu", "P:D" as
    /// list() numbers them, or a part of the platform's or device's name in any case, e.g. "pocl".
    /// Throws DeviceError that lists what there is.
    static Device select(std::string_view spec = {});
    /// Devices of every platform that loads. Throws DeviceError, with the package to install, if
    /// there is no platform.
    static std::vector<DeviceProfile> list();
    /// A device over somebody else's OpenCL objects (cl_context, cl_device_id, cl_command_queue);
    /// each is retained. With `queue` null a queue is made. Throws DeviceError if they do not
    /// belong together.
    static Device from_handles(void* context, void* device_id, void* queue);

    const DeviceProfile& profile() const;
    void* context_handle()
        const;  // cl_context, cl_device_id, cl_command_queue: borrowed while a copy of this lives
    void* device_handle() const;
    void* queue_handle() const;

    /// Pinned, zero-filled memory that this device's kernels and the host both use.
    std::unique_ptr<Arena> allocate_arena(size_t slot_byte_size, int slots) override;
    /// cl_mem of `frame`'s slot, borrowed while the frame's arena lives; null if the frame's arena
    /// is not of this device's context. On devices that share the host's memory it lies over the
    /// slot's very bytes; on discrete ones it is the slot's twin in device memory, and the slot is
    /// the pinned memory that PAVE reads the twin into.
    void* slot_buffer(const Frame& frame) const;

    /// XXH3-128 hex of all kernel sources: the library's own, or those in PAVE_KERNEL_DIR.
    static std::string kernel_hash();
    /// Opens the kernel cache and points the drivers' own caches into it. select(), list() and
    /// from_handles() do so by themselves; call it earlier in programs that make OpenCL calls of
    /// their own before them. Throws DeviceError if not even a temporary folder can be made.
    static KernelCacheInfo kernel_cache();

    class Impl;
    Impl& impl() const { return *impl_; }

   private:
    explicit Device(std::shared_ptr<Impl> impl);
    std::shared_ptr<Impl> impl_;
};

}  // namespace pave
