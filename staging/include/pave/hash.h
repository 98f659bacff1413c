// The one hash of PAVE, XXH3-128: of blocks, scenes, kernels and weights. It finds damage; it is
// no defence against forgery.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <string_view>

namespace pave {

/// XXH3-128 as 32 lower-case hex digits, in the canonical (big-endian) order that `xxhsum -H2`
/// prints.
std::string hash_hex(std::span<const std::byte> bytes);
std::string hash_hex(std::string_view text);

/// The same over data that come in pieces.
class Hasher {
   public:
    Hasher();
    ~Hasher();
    Hasher(const Hasher&) = delete;
    Hasher& operator=(const Hasher&) = delete;
    void update(std::span<const std::byte> bytes);
    void update(std::string_view text);
    /// Of everything so far; more may follow.
    std::string hex() const;

   private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace pave
