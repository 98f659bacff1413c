// A fixed array of plain values that is not filled before its owner does so; large ones lie on huge
// pages, since trees are walked at random.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdlib>
#include <memory>
#include <new>
#include <span>
#include <type_traits>

namespace pave {

/// `byte_size` bytes, aligned for any vector; a large piece asks for huge pages. Throws
/// std::bad_alloc. Freed by free_block.
void* allocate_block(size_t byte_size);
void free_block(void* block) noexcept;

template <class T>
class Block {
   public:
    static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);
    Block() = default;
    /// The contents are whatever the memory held.
    explicit Block(size_t count)
        : data_(count == 0 ? nullptr : static_cast<T*>(allocate_block(count * sizeof(T)))),
          size_(count) {}

    T* data() { return data_.get(); }
    const T* data() const { return data_.get(); }
    size_t size() const { return size_; }
    bool empty() const { return size_ == 0; }
    T& operator[](size_t i) { return data_.get()[i]; }
    const T& operator[](size_t i) const { return data_.get()[i]; }
    T* begin() { return data(); }
    T* end() { return data() + size_; }
    const T* begin() const { return data(); }
    const T* end() const { return data() + size_; }
    /// Forgets what lies behind the first `count` values.
    void shorten(size_t count) { size_ = count; }

   private:
    struct Free {
        void operator()(T* block) const noexcept { free_block(block); }
    };
    std::unique_ptr<T, Free> data_;
    size_t size_ = 0;
};

}  // namespace pave
