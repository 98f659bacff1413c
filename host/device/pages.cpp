// Page-aligned zero-filled host memory between two guard pages.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/device/pages.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>

#include "pave/error.h"
#include "pave/frame.h"

namespace pave {

HostPages::HostPages(size_t byte_size) {
    const size_t guard = std::max(kChannelAlignment, static_cast<size_t>(sysconf(_SC_PAGESIZE)));
    const size_t used = (byte_size + guard - 1) / guard * guard;
    void* mapping = used < byte_size ? MAP_FAILED
                                     : mmap(nullptr, used + 2 * guard, PROT_NONE,
                                            MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (mapping != MAP_FAILED &&
        mprotect(static_cast<std::byte*>(mapping) + guard, used, PROT_READ | PROT_WRITE) != 0) {
        munmap(mapping, used + 2 * guard);
        mapping = MAP_FAILED;
    }
    if (mapping == MAP_FAILED)
        throw DeviceError("cannot allocate " + std::to_string(byte_size) + " bytes for the ring: " +
                          std::strerror(errno) + "; use fewer slots or smaller frames");
    mapping_ = mapping;
    mapping_byte_size_ = used + 2 * guard;
    data_ = static_cast<std::byte*>(mapping) + guard;
}

HostPages::~HostPages() {
    if (mapping_ != nullptr) munmap(mapping_, mapping_byte_size_);
}

}  // namespace pave
