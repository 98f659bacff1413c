// Threads that share out numbered pieces of work.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/workers.h"

#include <algorithm>

namespace pave {

Workers::Workers(int threads) {
    const int all =
        threads > 0 ? threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
    for (int i = 1; i < all; ++i) threads_.emplace_back([this] { serve(); });
}

Workers::~Workers() {
    {
        std::lock_guard lock(mutex_);
        closing_ = true;
    }
    begin_.notify_all();
    for (std::thread& thread : threads_) thread.join();
}

void Workers::take_pieces(std::unique_lock<std::mutex>& lock) {
    ++at_work_;
    while (next_ < count_) {
        const size_t piece = next_++;
        const auto& work = *work_;
        lock.unlock();
        std::exception_ptr thrown;
        try {
            work(piece);
        } catch (...) {
            thrown = std::current_exception();
        }
        lock.lock();
        if (thrown) {
            if (!thrown_) thrown_ = thrown;
            next_ = count_;
        }
    }
    if (--at_work_ == 0) end_.notify_all();
}

void Workers::serve() {
    std::unique_lock lock(mutex_);
    for (;;) {
        begin_.wait(lock, [&] { return closing_ || next_ < count_; });
        if (closing_) return;
        take_pieces(lock);
    }
}

void Workers::run(size_t count, const std::function<void(size_t)>& work) {
    if (threads_.empty() || count <= 1) {
        for (size_t i = 0; i < count; ++i) work(i);
        return;
    }
    std::unique_lock lock(mutex_);
    work_ = &work;
    next_ = 0;
    count_ = count;
    thrown_ = nullptr;
    begin_.notify_all();
    take_pieces(lock);
    end_.wait(lock, [&] { return at_work_ == 0; });
    next_ = count_ = 0;
    if (thrown_) std::rethrow_exception(thrown_);
}

void run_chunks(Workers& workers, size_t count, size_t grain,
                const std::function<void(size_t, size_t, size_t)>& work) {
    workers.run((count + grain - 1) / grain, [&](size_t piece) {
        work(piece, piece * grain, std::min(count, (piece + 1) * grain));
    });
}

}  // namespace pave
