// Files that are whole or absent: descriptors, durable writes, renames, locks and hashes, with
// errors that name the path.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace pave {

namespace fs = std::filesystem;

/// An open file descriptor, closed at the end of its life.
class File {
   public:
    File() = default;
    /// Throws RunError "cannot open PATH: reason". `flags` as for open(2); O_CLOEXEC is added.
    File(const fs::path& path, int flags);
    ~File();
    File(File&& other) noexcept;
    File& operator=(File&& other) noexcept;
    explicit operator bool() const { return descriptor_ >= 0; }

    const fs::path& path() const { return path_; }
    int descriptor() const { return descriptor_; }
    void write_all(std::string_view bytes);  // all of them, or RunError
    void sync();                             // to the disk, or RunError
    void truncate(uint64_t byte_size);
    bool is_at_path() const;  // the path still leads to this very file
    bool try_lock();          // advisory, exclusive, gone with the last descriptor or its process
    void close();             // throws what closing reports; the destructor does not

   private:
    fs::path path_;
    int descriptor_ = -1;
};

/// RunError "cannot DO PATH: strerror(errno)".
[[noreturn]] void throw_errno(const std::string& what, const fs::path& path);

void sync_path(const fs::path& path);  // a file's or a folder's fsync
/// Renames inside one folder, then makes the folder durable.
void rename_durable(const fs::path& from, const fs::path& to);
/// Makes `path` and its missing parents, durable. True if it was not there.
bool make_folder(const fs::path& path);
/// Writes beside `path`, syncs, renames over it: readers see the old or the new file, never half of
/// one.
void write_file_whole(const fs::path& path, std::string_view bytes);
/// The whole text of a plain file, as long as it is when it is opened. Throws InputError naming the
/// path if it cannot be read or has more than `byte_limit` bytes.
std::string read_file_within(const fs::path& path, uint64_t byte_limit);
/// Throws InputError if `path` is not a plain file itself: a link to one is none.
uint64_t plain_file_byte_size(const fs::path& path);

struct FileFacts {
    std::string name;  // relative to the data set's folder, '/' between its parts
    uint64_t byte_size = 0;
    std::string hash;

    bool operator==(const FileFacts&) const = default;
};
/// Size and XXH3-128 of root / name. Throws InputError if it is not a plain file or cannot be read.
FileFacts file_facts(const fs::path& root, const std::string& name);

/// Removes a file or folder; what cannot be removed stays.
void remove_quietly(const fs::path& path) noexcept;

/// Every unfinished file's or folder's name begins so.
inline constexpr const char* kTemporaryPrefix = ".tmp-";

}  // namespace pave
