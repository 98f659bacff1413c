// Memory of blocks: ordinary allocations, with advice to the system where huge pages can help.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/block.h"

#include <sys/mman.h>

namespace pave {

void* allocate_block(size_t byte_size) {
    constexpr size_t kHugePage = size_t{2} << 20, kLine = 128;
    const size_t alignment = byte_size >= 2 * kHugePage ? kHugePage : kLine;
    const size_t rounded = (byte_size + alignment - 1) / alignment * alignment;
    void* block = rounded < byte_size ? nullptr : std::aligned_alloc(alignment, rounded);
    if (block == nullptr) throw std::bad_alloc();
#ifdef MADV_HUGEPAGE
    // Advice only: systems without huge pages give small ones.
    if (alignment == kHugePage) (void)madvise(block, rounded, MADV_HUGEPAGE);
#endif
    return block;
}

void free_block(void* block) noexcept { std::free(block); }

}  // namespace pave
