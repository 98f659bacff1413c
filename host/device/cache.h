// PAVE's own kernel cache: what compilers made, kept under checksums between processes. See
// docs/kernel-cache.md.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "host/device/folders.h"
#include "host/device/pack.h"

namespace pave {

/// There is one a process, because the drivers' settings are the process's (environment). Any
/// thread.
class KernelCache {
   public:
    /// Opens it at the first call, which has to come before the process's first OpenCL call: it
    /// points the drivers' own cache (POCL_CACHE_DIR) into a fresh private folder, whatever it
    /// pointed to before.
    static KernelCache& of_process();

    KernelCache();
    ~KernelCache();
    KernelCache(const KernelCache&) = delete;
    KernelCache& operator=(const KernelCache&) = delete;

    /// Brackets the compilation of one program: restores what the driver had written for `key` into
    /// the process's folder, and on end() takes note of where the driver writes for it now.
    /// Compilations of a process exclude each other: do not nest them.
    class Compilation {
       public:
        Compilation(KernelCache& cache, std::string key);
        /// A program binary, for drivers that keep no files.
        const std::optional<std::string>& binary() const { return binary_; }
        /// True if the driver left files, so that a binary is not needed.
        bool end();
        void keep_binary(std::string bytes);

       private:
        KernelCache& cache_;
        std::lock_guard<std::mutex> lock_;
        std::string key_;
        std::optional<std::string> binary_;
        std::set<std::string> before_;
    };

    /// Stores what the drivers wrote since: kernels are compiled again at their first launch with a
    /// new work-group size.
    void save();
    /// save(), but only now and then: half a second after a compilation, and then at doubling
    /// intervals.
    void save_if_due();

    const CacheFolder& folder() const { return folder_; }

   private:
    struct Program {
        std::set<std::string> roots;  // folders, relative to the process's, that the driver writes
                                      // to for this program
        std::set<std::string> stored;
    };
    using Clock = std::chrono::steady_clock;

    std::set<std::string> list(const std::string& root) const;
    void save_locked();
    void store(const std::string& key, std::vector<PackedFile> files);
    std::optional<std::vector<PackedFile>> load(const std::string& key);
    void evict();

    CacheFolder folder_;
    ProcessFolder process_folder_;
    std::mutex mutex_;
    std::map<std::string, Program> programs_;
    Clock::time_point due_ = Clock::time_point::max();
    Clock::duration interval_{};
};

}  // namespace pave
