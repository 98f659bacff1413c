// Slow, failing and stuck sinks.
// SPDX-License-Identifier: BSD-3-Clause
#include "tests/staging/test_sinks.h"

#include <thread>

namespace pave::test {

constexpr std::chrono::seconds kPatience(10);

void SinkControl::set_stuck(bool stuck) {
    const std::lock_guard lock(mutex);
    is_stuck = stuck;
    changed.notify_all();
}

bool SinkControl::wait_until_destroyed() {
    std::unique_lock lock(mutex);
    return changed.wait_for(lock, kPatience, [&] { return destroyed; });
}

bool SinkControl::wait_for_entries(int count) {
    std::unique_lock lock(mutex);
    return changed.wait_for(lock, kPatience, [&] { return entries >= count; });
}

std::vector<int64_t> SinkControl::indices() {
    const std::lock_guard lock(mutex);
    std::vector<int64_t> all;
    for (const FrameRecord& record : seen) all.push_back(record.metadata.index);
    return all;
}

TestSink::~TestSink() {
    const std::lock_guard lock(control_->mutex);
    control_->destroyed = true;
    control_->changed.notify_all();
}

void TestSink::write(const Frame&, const FrameRecord& record) {
    std::unique_lock lock(control_->mutex);
    ++control_->entries;
    control_->changed.notify_all();
    control_->changed.wait(lock, [&] { return !control_->is_stuck; });
    const int delay_ms = control_->delay_ms;
    if (record.metadata.index == control_->fail_at) throw std::runtime_error("the disk is on fire");
    control_->seen.push_back(record);
    lock.unlock();
    std::this_thread::sleep_for(std::chrono::milliseconds(delay_ms));
    ++acknowledged_;
}

void TestSink::flush() {
    const std::lock_guard lock(control_->mutex);
    ++control_->flushes;
}

void TestSink::close(bool finished) {
    const std::lock_guard lock(control_->mutex);
    ++control_->closes;
    control_->finished = finished;
}

void TestSink::abandon() noexcept {
    const std::lock_guard lock(control_->mutex);
    ++control_->abandons;
}

}  // namespace pave::test
