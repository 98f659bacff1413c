// Page-aligned zero-filled host memory between two guard pages; private to host/device.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

namespace pave {

/// Memory comes from the system as it is touched. The pages before and after it cannot be touched
/// at all, so that a kernel on a CPU device that runs over the end of a ring stops there instead of
/// changing other data.
class HostPages {
   public:
    HostPages() = default;
    /// Throws DeviceError when the memory cannot be had.
    explicit HostPages(size_t byte_size);
    ~HostPages();
    HostPages(const HostPages&) = delete;
    HostPages& operator=(const HostPages&) = delete;
    std::byte* data() { return data_; }

   private:
    void* mapping_ = nullptr;
    size_t mapping_byte_size_ = 0;
    std::byte* data_ = nullptr;
};

}  // namespace pave
