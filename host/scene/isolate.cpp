// Work in a forked process whose result comes through a pipe.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/isolate.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <fstream>

namespace pave {
namespace {

using Clock = std::chrono::steady_clock;

/// Address space of this process, which a forked one begins with.
size_t used_byte_size() {
    size_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    return pages * static_cast<size_t>(::sysconf(_SC_PAGESIZE));
}

void limit(__rlimit_resource what, size_t value) {
    rlimit bound{};
    if (::getrlimit(what, &bound) != 0) return;
    bound.rlim_cur = std::min<rlim_t>(bound.rlim_max, value);
    (void)::setrlimit(what, &bound);
}

void write_all(int fd, const char* data, size_t size) {
    while (size > 0) {
        const ssize_t written = ::write(fd, data, size);
        if (written < 0 && errno == EINTR) continue;
        if (written <= 0) ::_exit(1);
        data += written;
        size -= static_cast<size_t>(written);
    }
}

/// First byte of what is sent: R, then the result, or E, then why there is none.
[[noreturn]] void work_and_exit(int fd, const std::function<std::string()>& work,
                                const IsolationLimits& limits, size_t used) {
    for (const int signal : {SIGSEGV, SIGBUS, SIGABRT, SIGFPE, SIGILL, SIGTERM, SIGINT})
        (void)::signal(signal, SIG_DFL);  // no handler of the host program
    limit(RLIMIT_CORE, 0);
    limit(RLIMIT_CPU, static_cast<size_t>(limits.seconds));
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
    limit(RLIMIT_AS, used + limits.memory_byte_size);  // sanitizers reserve terabytes
#else
    (void)used;
#endif
    // What libraries print while they fail is not for the terminal.
    const int nowhere = ::open("/dev/null", O_WRONLY | O_CLOEXEC);
    for (const int stream : {STDOUT_FILENO, STDERR_FILENO}) (void)::dup2(nowhere, stream);
    std::string answer;
    try {
        answer.assign(1, 'R').append(work());
    } catch (const std::bad_alloc&) {
        answer = "Eneeds too much memory";
    } catch (const std::exception& error) {
        answer.assign(1, 'E').append(error.what());
    } catch (...) {
        answer = "Efails for no known reason";
    }
    write_all(fd, answer.data(), answer.size());
    ::_exit(0);
}

/// What comes through the pipe until it is closed. False if that takes or is too much.
bool read_all(int fd, const IsolationLimits& limits, std::string& answer) {
    const Clock::time_point end = Clock::now() + std::chrono::seconds(limits.seconds);
    std::string part(size_t{1} << 20, '\0');
    for (;;) {
        const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - Clock::now());
        if (left.count() <= 0 || answer.size() > limits.result_byte_size) return false;
        pollfd waiting{.fd = fd, .events = POLLIN, .revents = 0};
        const int ready = ::poll(&waiting, 1, static_cast<int>(left.count()));
        if (ready < 0 && errno != EINTR) return false;
        if (ready <= 0) continue;
        const ssize_t got = ::read(fd, part.data(), part.size());
        if (got == 0) return true;
        if (got < 0 && errno != EINTR) return false;
        if (got > 0) answer.append(part.data(), static_cast<size_t>(got));
    }
}

}  // namespace

std::string run_isolated(const std::function<std::string()>& work, const IsolationLimits& limits) {
    int pipe_ends[2];
    if (::pipe2(pipe_ends, O_CLOEXEC) != 0)
        throw IsolationError(std::string("no pipe: ") + std::strerror(errno));
    const size_t used = used_byte_size();
    const pid_t child = ::fork();
    if (child < 0) {
        for (const int end : pipe_ends) ::close(end);
        throw IsolationError(std::string("no process: ") + std::strerror(errno));
    }
    if (child == 0) {
        ::close(pipe_ends[0]);
        work_and_exit(pipe_ends[1], work, limits, used);
    }
    ::close(pipe_ends[1]);
    std::string answer;
    const bool is_whole = read_all(pipe_ends[0], limits, answer);
    ::close(pipe_ends[0]);
    if (!is_whole) (void)::kill(child, SIGKILL);
    int status = 0;
    while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    if (!is_whole) throw IsolationError("takes too long or gives too much");
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0 || answer.empty())
        throw IsolationError("makes its reader crash");
    if (answer[0] == 'E') throw IsolationError(answer.substr(1));
    answer.erase(0, 1);
    return answer;
}

}  // namespace pave
