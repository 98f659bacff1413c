// Whole files in memory and JSON out of them.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "pave/error.h"
#include "staging/json.h"

namespace pave::nn {
namespace {

/// Closes on every way out.
struct Descriptor {
    int fd;
    ~Descriptor() {
        if (fd >= 0) ::close(fd);
    }
};

}  // namespace

std::vector<std::byte> read_file(const std::string& path, size_t byte_limit) {
    // O_NONBLOCK: a pipe in the file's place must not hang the open.
    const Descriptor file{::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK)};
    if (file.fd < 0) throw InputError(path + ": " + std::strerror(errno));
    struct stat status {};
    if (::fstat(file.fd, &status) != 0) throw InputError(path + ": " + std::strerror(errno));
    if (!S_ISREG(status.st_mode)) throw InputError(path + ": not a regular file");
    const size_t byte_size = static_cast<size_t>(status.st_size);
    if (byte_size > byte_limit)
        throw InputError(path + ": " + std::to_string(byte_size) + " bytes, at most " +
                         std::to_string(byte_limit) + " are taken");
    std::vector<std::byte> bytes(byte_size);
    size_t done = 0;
    while (done < byte_size) {
        const ssize_t got = ::read(file.fd, bytes.data() + done, byte_size - done);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) throw InputError(path + ": " + std::strerror(errno));
        if (got == 0) throw InputError(path + ": shrank while being read");
        done += static_cast<size_t>(got);
    }
    return bytes;
}

nlohmann::json parse_json(std::string_view text, const std::string& file) {
    try {
        return parse_shallow_json<nlohmann::json>(text);
    } catch (const InputError& error) {
        throw InputError(file + ": " + error.what());
    } catch (const nlohmann::json::exception& error) {
        std::string reason = error.what();
        for (char& c : reason)
            if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) >= 0x7f)
                c = '?';
        throw InputError(file + ": not valid JSON: " + reason.substr(0, 200));
    }
}

}  // namespace pave::nn
