// Durable file operations over POSIX calls.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/files.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "pave/error.h"
#include "pave/hash.h"

namespace pave {

void throw_errno(const std::string& what, const fs::path& path) {
    const int code = errno;
    throw RunError("cannot " + what + " " + path.string() + ": " + std::strerror(code));
}

File::File(const fs::path& path, int flags) : path_(path) {
    do descriptor_ = ::open(path.c_str(), flags | O_CLOEXEC, 0666);
    while (descriptor_ < 0 && errno == EINTR);
    if (descriptor_ < 0) throw_errno(flags & O_CREAT ? "make" : "open", path);
}

File::~File() {
    if (descriptor_ >= 0) ::close(descriptor_);
}

File::File(File&& other) noexcept
    : path_(std::move(other.path_)), descriptor_(std::exchange(other.descriptor_, -1)) {}

File& File::operator=(File&& other) noexcept {
    if (this != &other) {
        if (descriptor_ >= 0) ::close(descriptor_);
        path_ = std::move(other.path_);
        descriptor_ = std::exchange(other.descriptor_, -1);
    }
    return *this;
}

void File::write_all(std::string_view bytes) {
    while (!bytes.empty()) {
        const ssize_t written = ::write(descriptor_, bytes.data(), bytes.size());
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) throw_errno("write", path_);
        bytes.remove_prefix(static_cast<size_t>(written));
    }
}

void File::sync() {
    // A failed fsync is not tried again: the kernel may have thrown the pages away by then.
    if (::fsync(descriptor_) != 0) throw_errno("sync", path_);
}

void File::truncate(uint64_t byte_size) {
    if (::ftruncate(descriptor_, static_cast<off_t>(byte_size)) != 0)
        throw_errno("truncate", path_);
}

bool File::is_at_path() const {
    struct stat here, there;
    return ::fstat(descriptor_, &here) == 0 && ::stat(path_.c_str(), &there) == 0 &&
           here.st_dev == there.st_dev && here.st_ino == there.st_ino;
}

bool File::try_lock() {
    int result = 0;
    do result = ::flock(descriptor_, LOCK_EX | LOCK_NB);
    while (result != 0 && errno == EINTR);
    if (result != 0 && errno != EWOULDBLOCK) throw_errno("lock", path_);
    return result == 0;
}

void File::close() {
    if (descriptor_ >= 0 && ::close(std::exchange(descriptor_, -1)) != 0 && errno != EINTR)
        throw_errno("close", path_);
}

void sync_path(const fs::path& path) { File(path, O_RDONLY).sync(); }

void rename_durable(const fs::path& from, const fs::path& to) {
    if (::rename(from.c_str(), to.c_str()) != 0) throw_errno("rename to", to);
    sync_path(to.parent_path());
}

bool make_folder(const fs::path& path) {
    if (fs::is_directory(path)) return false;
    if (fs::exists(path)) throw UsageError(path.string() + " exists and is not a folder");
    if (path.has_parent_path() && path.parent_path() != path) make_folder(path.parent_path());
    if (::mkdir(path.c_str(), 0777) != 0) {
        if (errno == EEXIST && fs::is_directory(path)) return false;  // somebody was faster
        throw_errno("make the folder", path);
    }
    sync_path(path.parent_path());
    return true;
}

void write_file_whole(const fs::path& path, std::string_view bytes) {
    const fs::path target = fs::absolute(path);
    const fs::path temporary = target.parent_path() / (kTemporaryPrefix + std::to_string(getpid()) +
                                                       "-" + target.filename().string());
    try {
        File file(temporary, O_WRONLY | O_CREAT | O_TRUNC);
        file.write_all(bytes);
        file.sync();
        file.close();
        rename_durable(temporary, target);
    } catch (...) {
        remove_quietly(temporary);
        throw;
    }
}

std::string read_file_within(const fs::path& path, uint64_t byte_limit) {
    std::error_code error;
    if (!fs::is_regular_file(path, error))
        throw InputError(path.string() + " is missing or not a plain file");
    try {
        File file(path, O_RDONLY | O_NONBLOCK);  // a pipe put in its place must not hang the open
        struct stat status {};
        if (::fstat(file.descriptor(), &status) != 0) throw_errno("look at", path);
        const auto byte_size = static_cast<uint64_t>(status.st_size);
        if (byte_size > byte_limit)
            throw InputError(path.string() + " has " + std::to_string(byte_size) +
                             " bytes, at most " + std::to_string(byte_limit) + " are taken");
        std::string text(byte_size, '\0');
        for (size_t done = 0; done < text.size();) {
            const ssize_t got = ::read(file.descriptor(), text.data() + done, text.size() - done);
            if (got < 0 && errno == EINTR) continue;
            if (got < 0) throw_errno("read", path);
            if (got == 0) text.resize(done);  // a writer took back a line that it could not finish
            done += static_cast<size_t>(got);
        }
        return text;
    } catch (const RunError& failure) {
        throw InputError(failure.what());
    }
}

uint64_t plain_file_byte_size(const fs::path& path) {
    struct stat status {};
    if (::lstat(path.c_str(), &status) != 0 || !S_ISREG(status.st_mode))
        throw InputError(path.string() + " is missing or not a plain file");
    return static_cast<uint64_t>(status.st_size);
}

FileFacts file_facts(const fs::path& root, const std::string& name) {
    const fs::path path = root / name;
    plain_file_byte_size(path);  // no links: a data set's files are its own
    try {
        File file(path, O_RDONLY | O_NOFOLLOW);
        Hasher hasher;
        FileFacts facts{name, 0, {}};
        std::vector<std::byte> buffer(1 << 20);
        for (;;) {
            const ssize_t got = ::read(file.descriptor(), buffer.data(), buffer.size());
            if (got < 0 && errno == EINTR) continue;
            if (got < 0) throw_errno("read", path);
            if (got == 0) break;
            hasher.update({buffer.data(), static_cast<size_t>(got)});
            facts.byte_size += static_cast<uint64_t>(got);
        }
        facts.hash = hasher.hex();
        return facts;
    } catch (const RunError& failure) {
        throw InputError(failure.what());
    }
}

void remove_quietly(const fs::path& path) noexcept {
    std::error_code ignored;
    fs::remove_all(path, ignored);
}

}  // namespace pave
