// PAVE's own kernel cache: what compilers made, kept under checksums between processes.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/device/cache.h"

#include <sys/stat.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <iterator>

namespace pave {
namespace {

namespace fs = std::filesystem;

constexpr const char* kBinaryName = "program.binary";  // at the top: no driver's file lies there
constexpr std::string_view kSuffix = ".kernel";
constexpr uintmax_t kLargestCache = 256u << 20;  // bytes; the oldest entries go first
constexpr auto kFirstSave = std::chrono::milliseconds(500);
constexpr auto kLongestInterval = std::chrono::seconds(64);

/// The topmost folders of `files`; files at the very top (temporary ones of the driver) have none.
std::set<std::string> roots_of(const std::set<std::string>& files) {
    std::set<std::string> folders;
    for (const std::string& file : files)
        if (const size_t slash = file.rfind('/'); slash != std::string::npos)
            folders.insert(file.substr(0, slash));
    std::set<std::string> roots;
    for (const std::string& folder : folders)
        if (std::none_of(roots.begin(), roots.end(),
                         [&](const std::string& root) { return folder.starts_with(root + "/"); }))
            roots.insert(folder);  // in order: a parent comes before what it holds
    return roots;
}

std::set<std::string> minus(const std::set<std::string>& all,
                            const std::set<std::string>& without) {
    std::set<std::string> rest;
    std::set_difference(all.begin(), all.end(), without.begin(), without.end(),
                        std::inserter(rest, rest.end()));
    return rest;
}

/// For this process alone, so neither atomic nor durable.
bool write_plainly(const fs::path& path, const std::string& bytes) {
    std::error_code error;
    fs::create_directories(path.parent_path(), error);
    std::ofstream file(path, std::ios::binary);
    file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    file.close();
    if (file) return true;
    fs::remove(path, error);  // a driver may stop the program over half a file
    return false;
}

}  // namespace

KernelCache& KernelCache::of_process() {
    static KernelCache cache;
    return cache;
}

KernelCache::KernelCache() : folder_(open_cache_folder()), process_folder_(folder_.path) {
    setenv("POCL_CACHE_DIR", process_folder_.path().c_str(), 1);
}

KernelCache::~KernelCache() {
    try {
        save();
    } catch (const std::exception& error) {
        std::fprintf(stderr, "pave: kernel cache not saved: %s\n", error.what());
    }
}

std::set<std::string> KernelCache::list(const std::string& root) const {
    std::set<std::string> files;
    std::error_code error;
    const fs::path top = process_folder_.path();
    for (fs::recursive_directory_iterator it(top / root, error), end; !error && it != end;
         it.increment(error)) {
        std::error_code ignored;
        if (it->is_regular_file(ignored))
            files.insert(it->path().lexically_relative(top).generic_string());
    }
    return files;
}

std::optional<std::vector<PackedFile>> KernelCache::load(const std::string& key) {
    if (folder_.path.empty()) return std::nullopt;
    const fs::path path = folder_.path / (key + std::string(kSuffix));
    const std::optional<std::string> text = read_file_whole(path);
    if (!text) return std::nullopt;
    auto files = unpack(key, *text);
    std::error_code ignored;
    if (files)
        fs::last_write_time(path, fs::file_time_type::clock::now(), ignored);  // for evict()
    else
        fs::remove(path, ignored);  // damaged: compiled again
    return files;
}

void KernelCache::store(const std::string& key, std::vector<PackedFile> files) {
    if (folder_.path.empty()) return;
    // Another process may have stored work-group sizes that this one did not use.
    if (auto others = load(key))
        for (PackedFile& other : *others)
            if (std::none_of(files.begin(), files.end(),
                             [&](const PackedFile& file) { return file.path == other.path; }))
                files.push_back(std::move(other));
    try_write_file(folder_.path / (key + std::string(kSuffix)), pack(key, files));
    evict();
}

void KernelCache::evict() {
    struct Entry {
        fs::file_time_type used;
        uintmax_t byte_size;
        fs::path path;
    };
    std::vector<Entry> entries;
    uintmax_t total = 0;
    std::error_code error;
    for (fs::directory_iterator it(folder_.path, error), end; !error && it != end;
         it.increment(error)) {
        std::error_code gone;
        if (it->path().filename().string().find(kSuffix) == std::string::npos) continue;
        Entry entry{it->last_write_time(gone), it->file_size(gone), it->path()};
        if (gone) continue;
        total += entry.byte_size;
        entries.push_back(std::move(entry));
    }
    std::sort(entries.begin(), entries.end(),
              [](const Entry& a, const Entry& b) { return a.used < b.used; });
    for (const Entry& entry : entries) {
        if (total <= kLargestCache) break;
        fs::remove(entry.path, error);
        total -= entry.byte_size;
    }
}

void KernelCache::save_locked() {
    for (auto& [key, program] : programs_) {
        std::set<std::string> files;
        for (const std::string& root : program.roots) files.merge(list(root));
        if (std::includes(program.stored.begin(), program.stored.end(), files.begin(), files.end()))
            continue;
        std::vector<PackedFile> packed;
        for (const std::string& file : files)
            if (auto bytes = read_file_whole(process_folder_.path() / file))
                packed.push_back({file, std::move(*bytes)});
        store(key, std::move(packed));
        program.stored = std::move(files);
    }
}

void KernelCache::save() {
    std::lock_guard lock(mutex_);
    save_locked();
}

void KernelCache::save_if_due() {
    std::unique_lock lock(mutex_, std::try_to_lock);
    if (!lock || Clock::now() < due_) return;
    save_locked();
    interval_ = std::min<Clock::duration>(2 * interval_, kLongestInterval);
    due_ = Clock::now() + interval_;
}

KernelCache::Compilation::Compilation(KernelCache& cache, std::string key)
    : cache_(cache), lock_(cache.mutex_), key_(std::move(key)), before_(cache.list("")) {
    if (cache_.programs_.contains(key_)) return;  // the driver still has its files
    const auto files = cache_.load(key_);
    if (!files) return;
    std::set<std::string> restored;
    for (const PackedFile& file : *files) {
        if (file.path == kBinaryName) {
            binary_ = file.bytes;
            continue;
        }
        if (before_.contains(file.path) ||
            write_plainly(cache_.process_folder_.path() / file.path, file.bytes))
            restored.insert(file.path);
    }
    if (!restored.empty()) cache_.programs_[key_] = {roots_of(restored), restored};
}

bool KernelCache::Compilation::end() {
    if (const auto written = minus(cache_.list(""), before_); !written.empty())
        cache_.programs_[key_].roots.merge(roots_of(written));
    cache_.interval_ = kFirstSave;
    cache_.due_ = Clock::now() + kFirstSave;
    return cache_.programs_.contains(key_);
}

void KernelCache::Compilation::keep_binary(std::string bytes) {
    cache_.store(key_, {{kBinaryName, std::move(bytes)}});
}

}  // namespace pave
