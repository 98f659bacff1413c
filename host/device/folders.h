// The folders of the kernel cache: who may own them, and the one that lives as long as the
// process; private to host/device.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <optional>
#include <string>

namespace pave {

/// The folder that outlives processes: $PAVE_CACHE_DIR, else $XDG_CACHE_HOME/pave, else
/// $HOME/.cache/pave.
struct CacheFolder {
    std::filesystem::path path;  // empty if none can be had
    std::string note;            // then: why
};

/// Makes the folder if it is missing. A folder is taken only if it is a real one (no link), belongs
/// to this user, lets nobody else in, and cannot be swapped by others (its parent is this user's or
/// root's, and sticky if all may write there).
CacheFolder open_cache_folder();

/// A fresh folder of mode 0700 for this process alone, removed when the object goes (by the process
/// that made it: not by its forks). It holds a lock, so that others can tell whether its process
/// still lives.
class ProcessFolder {
   public:
    /// Inside `cache`/run if that works, else a random name in the system's temporary folder.
    /// Throws DeviceError if neither does.
    explicit ProcessFolder(const std::filesystem::path& cache);
    ~ProcessFolder();
    ProcessFolder(const ProcessFolder&) = delete;
    ProcessFolder& operator=(const ProcessFolder&) = delete;
    const std::filesystem::path& path() const { return path_; }

   private:
    std::filesystem::path path_;
    int lock_ = -1;
    pid_t owner_ = 0;
};

/// Whole or absent: temporary name, fsync, rename. False if it did not work (a cache may miss).
bool try_write_file(const std::filesystem::path& path, std::string_view bytes);
std::optional<std::string> read_file_whole(const std::filesystem::path& path);

}  // namespace pave
