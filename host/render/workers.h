// Threads that share out numbered pieces of work, all cores of the process by default.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace pave {

/// The calling thread is one of the workers. One run at a time.
class Workers {
   public:
    /// 0 threads: as many as the process may use.
    explicit Workers(int threads = 0);
    ~Workers();
    Workers(const Workers&) = delete;
    Workers& operator=(const Workers&) = delete;

    /// Calls work(i) once for every i in [0, count), in any order on any thread, and returns when
    /// all are done. The first exception is rethrown; pieces that have not begun are then left out.
    void run(size_t count, const std::function<void(size_t)>& work);

   private:
    void take_pieces(std::unique_lock<std::mutex>& lock);
    void serve();

    std::mutex mutex_;
    std::condition_variable begin_, end_;
    const std::function<void(size_t)>* work_ = nullptr;
    size_t next_ = 0, count_ = 0, at_work_ = 0;
    bool closing_ = false;
    std::exception_ptr thrown_;
    std::vector<std::thread> threads_;
};

/// Pieces of `grain` items over `count` items: work(piece, first, last).
void run_chunks(Workers& workers, size_t count, size_t grain,
                const std::function<void(size_t, size_t, size_t)>& work);

}  // namespace pave
