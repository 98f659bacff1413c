// The file format of a kernel cache entry: named files under one checksum.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/device/pack.h"

#include <cstdint>
#include <cstring>

#include "host/device/source.h"

namespace pave {
namespace {

constexpr std::string_view kMagic = "PAVEKC1\n";
constexpr size_t kHashSize = 32;
constexpr size_t kHeaderSize = kMagic.size() + 2 * kHashSize;

/// Refuses whatever could lead out of the folder that the files are written to.
bool is_safe_path(std::string_view path) {
    if (path.empty() || path.size() > 1024 || path.front() == '/' || path.back() == '/')
        return false;
    while (!path.empty()) {
        const size_t slash = path.find('/');
        const std::string_view part = path.substr(0, slash);
        if (part.empty() || part == "." || part == ".." || part.find('\0') != part.npos)
            return false;
        path = slash == path.npos ? std::string_view{} : path.substr(slash + 1);
    }
    return true;
}

template <class T>
void put(std::string& out, T value) {
    for (size_t i = 0; i < sizeof(T); ++i) out += static_cast<char>((value >> (8 * i)) & 0xff);
}

template <class T>
T take(std::string_view& text) {
    T value = 0;
    for (size_t i = 0; i < sizeof(T); ++i)
        value |= static_cast<T>(static_cast<unsigned char>(text[i])) << (8 * i);
    text.remove_prefix(sizeof(T));
    return value;
}

}  // namespace

std::string pack(const std::string& key, const std::vector<PackedFile>& files) {
    std::string payload;
    for (const PackedFile& file : files) {
        put(payload, static_cast<uint32_t>(file.path.size()));
        put(payload, static_cast<uint64_t>(file.bytes.size()));
        payload += file.path + file.bytes;
    }
    return std::string(kMagic) + key + xxh3_hex(payload) + payload;
}

std::optional<std::vector<PackedFile>> unpack(const std::string& key, std::string_view text) {
    if (text.size() < kHeaderSize || text.substr(0, kMagic.size()) != kMagic) return std::nullopt;
    if (text.substr(kMagic.size(), kHashSize) != key) return std::nullopt;
    const std::string_view hash = text.substr(kMagic.size() + kHashSize, kHashSize);
    std::string_view payload = text.substr(kHeaderSize);
    if (xxh3_hex(payload) != hash) return std::nullopt;
    std::vector<PackedFile> files;
    while (!payload.empty()) {
        if (payload.size() < sizeof(uint32_t) + sizeof(uint64_t)) return std::nullopt;
        const size_t path_size = take<uint32_t>(payload);
        const uint64_t byte_size = take<uint64_t>(payload);
        if (path_size > payload.size() || byte_size > payload.size() - path_size)
            return std::nullopt;
        PackedFile file{std::string(payload.substr(0, path_size)),
                        std::string(payload.substr(path_size, byte_size))};
        if (!is_safe_path(file.path)) return std::nullopt;
        payload.remove_prefix(path_size + byte_size);
        files.push_back(std::move(file));
    }
    return files;
}

}  // namespace pave
