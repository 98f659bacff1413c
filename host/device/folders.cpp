// The folders of the kernel cache: who may own them, and the one that lives as long as the process.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/device/folders.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <utility>

#include "pave/error.h"

namespace pave {
namespace {

namespace fs = std::filesystem;

constexpr const char* kLockName = "lock";
constexpr std::string_view kPrefix = "pave-kernels-";
constexpr std::string_view kNewPrefix = "pave-kernels-new-";
constexpr time_t kNewFolderSeconds = 3600;

class FileDescriptor {
   public:
    explicit FileDescriptor(int fd) : fd_(fd) {}
    ~FileDescriptor() {
        if (fd_ >= 0) close(fd_);
    }
    FileDescriptor(const FileDescriptor&) = delete;
    FileDescriptor& operator=(const FileDescriptor&) = delete;
    int get() const { return fd_; }
    int release() { return std::exchange(fd_, -1); }

   private:
    int fd_;
};

fs::path wanted_folder() {
    const auto variable = [](const char* name) {
        const char* text = std::getenv(name);
        return std::string(text == nullptr ? "" : text);
    };
    if (const std::string own = variable("PAVE_CACHE_DIR"); !own.empty()) return fs::absolute(own);
    // The XDG base directory specification: a relative path there is to be ignored.
    if (const fs::path xdg = variable("XDG_CACHE_HOME"); xdg.is_absolute()) return xdg / "pave";
    if (const fs::path home = variable("HOME"); home.is_absolute()) return home / ".cache" / "pave";
    return {};
}

/// Why `path` cannot be trusted, or "".
std::string fault_of(const fs::path& path) {
    struct stat info {};
    if (lstat(path.c_str(), &info) != 0) return std::strerror(errno);
    if (S_ISLNK(info.st_mode)) return "is a symbolic link";
    if (!S_ISDIR(info.st_mode)) return "is not a folder";
    if (info.st_uid != geteuid()) return "belongs to another user";
    if ((info.st_mode & 077) != 0) return "is open to others (chmod 700)";
    if (access(path.c_str(), W_OK | X_OK) != 0) return "is not writable";
    if (stat(path.parent_path().c_str(), &info) != 0) return std::strerror(errno);
    if (info.st_uid != geteuid() && info.st_uid != 0) return "lies in another user's folder";
    if ((info.st_mode & S_IWOTH) != 0 && (info.st_mode & S_ISVTX) == 0)
        return "lies in a folder that everybody can change";
    return "";
}

bool can_hold_code(const fs::path& path) {
    struct statvfs info {};
    return statvfs(path.c_str(), &info) == 0 && (info.f_flag & ST_NOEXEC) == 0;
}

int make_lock(const fs::path& folder) {
    FileDescriptor lock(open((folder / kLockName).c_str(),
                             O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600));
    if (lock.get() < 0 || flock(lock.get(), LOCK_EX | LOCK_NB) != 0) return -1;
    return lock.release();
}

/// Removes what dead processes of this user left in `parent`, and nothing that PAVE did not make.
void sweep(const fs::path& parent) {
    std::error_code error;
    for (fs::directory_iterator it(parent, error), end; !error && it != end; it.increment(error)) {
        const fs::path& folder = it->path();
        struct stat info {};
        if (!folder.filename().string().starts_with(kPrefix) || lstat(folder.c_str(), &info) != 0 ||
            !S_ISDIR(info.st_mode) || info.st_uid != geteuid())
            continue;
        FileDescriptor lock(open((folder / kLockName).c_str(), O_RDWR | O_CLOEXEC | O_NOFOLLOW));
        if (folder.filename().string().starts_with(kNewPrefix)) {
            // Being made this moment, or its maker died then.
            if (std::time(nullptr) - info.st_mtime < kNewFolderSeconds) continue;
            unlink((folder / kLockName).c_str());
            rmdir(folder.c_str());
        } else if (lock.get() >= 0 && flock(lock.get(), LOCK_EX | LOCK_NB) == 0) {
            std::error_code ignored;
            fs::remove_all(folder, ignored);
        }
    }
}

/// A new locked folder of this process in `parent`; false if there can be none.
bool make_process_folder(const fs::path& parent, fs::path& path, int& lock) {
    sweep(parent);
    std::string name = (parent / kNewPrefix).string() + "XXXXXX";
    if (mkdtemp(name.data()) == nullptr) return false;  // mode 0700
    const fs::path made = name;
    // It gets its lasting name once it is locked, so that nobody sweeps it half made.
    lock = make_lock(made);
    const std::string random = made.filename().string().substr(kNewPrefix.size());
    path = parent / (std::string(kPrefix) + std::to_string(getpid()) + "-" + random);
    std::error_code error;
    if (lock >= 0) fs::rename(made, path, error);
    if (lock >= 0 && !error) return true;
    if (lock >= 0) close(std::exchange(lock, -1));
    fs::remove_all(made, error);
    return false;
}

}  // namespace

CacheFolder open_cache_folder() {
    const char* off = std::getenv("PAVE_NO_CACHE");
    if (off != nullptr && std::string_view(off) == "1")
        return {{}, "switched off by PAVE_NO_CACHE"};
    fs::path path = wanted_folder();
    if (path.empty()) return {{}, "none of PAVE_CACHE_DIR, XDG_CACHE_HOME and HOME is set"};
    if (path.filename().empty()) path = path.parent_path();  // "folder/": lstat would follow a link
    std::error_code error;
    fs::create_directories(path.parent_path(), error);
    if (mkdir(path.c_str(), 0700) != 0 && errno != EEXIST)
        return {{}, path.string() + ": " + std::strerror(errno)};
    if (const std::string fault = fault_of(path); !fault.empty())
        return {{}, path.string() + " " + fault};
    return {path, ""};
}

ProcessFolder::ProcessFolder(const fs::path& cache) : owner_(getpid()) {
    if (!cache.empty() && can_hold_code(cache)) {
        const fs::path run = cache / "run";
        mkdir(run.c_str(), 0700);
        if (fault_of(run).empty() && make_process_folder(run, path_, lock_)) return;
    }
    std::error_code error;
    const fs::path temporary = fs::temp_directory_path(error);
    if (!error && make_process_folder(temporary, path_, lock_)) return;
    throw DeviceError("no folder for compiled kernels: neither the cache folder nor " +
                      temporary.string() + " can be written; set PAVE_CACHE_DIR or TMPDIR");
}

ProcessFolder::~ProcessFolder() {
    if (getpid() == owner_) {
        std::error_code error;
        fs::remove_all(path_, error);  // what stays is swept by a later process
    }
    if (lock_ >= 0) close(lock_);
}

bool try_write_file(const fs::path& path, std::string_view bytes) {
    std::string temporary = path.string() + ".XXXXXX";
    FileDescriptor file(mkostemp(temporary.data(), O_CLOEXEC));  // mode 0600
    if (file.get() < 0) return false;
    bool good = true;
    while (good && !bytes.empty()) {
        const ssize_t written = write(file.get(), bytes.data(), bytes.size());
        if (written < 0 && errno == EINTR) continue;
        good = written > 0;
        if (good) bytes.remove_prefix(static_cast<size_t>(written));
    }
    good = good && fsync(file.get()) == 0 && rename(temporary.c_str(), path.c_str()) == 0;
    if (!good) unlink(temporary.c_str());
    return good;
}

std::optional<std::string> read_file_whole(const fs::path& path) {
    FileDescriptor file(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
    struct stat info {};
    if (file.get() < 0 || fstat(file.get(), &info) != 0 || !S_ISREG(info.st_mode))
        return std::nullopt;
    std::string bytes(static_cast<size_t>(info.st_size), '\0');
    size_t done = 0;
    while (done < bytes.size()) {
        const ssize_t got = read(file.get(), bytes.data() + done, bytes.size() - done);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) return std::nullopt;
        done += static_cast<size_t>(got);
    }
    return bytes;
}

}  // namespace pave
