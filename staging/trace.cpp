// Collects spans and writes Chrome's trace format.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/trace.h"

#include <atomic>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <vector>

#include "staging/files.h"

namespace pave {
namespace {

/// Unlike std::thread::id never used again after the thread's end.
int this_thread_number() {
    static std::atomic<int> next{0};
    thread_local const int number = next++;
    return number;
}

}  // namespace

class Trace::Impl {
   public:
    struct Span {
        std::string name, detail;
        Clock::time_point begin, end;
        int row;
    };
    /// Rows are numbered as threads first speak. The lock is held.
    int row() {
        const auto [found, is_new] =
            rows_.emplace(this_thread_number(), static_cast<int>(names_.size()));
        if (is_new) names_.push_back("thread " + std::to_string(names_.size()));
        return found->second;
    }

    const Clock::time_point start_ = Clock::now();
    mutable std::mutex mutex_;
    std::map<int, int> rows_;
    std::vector<std::string> names_;
    std::vector<Span> spans_;
};

Trace::Trace() : impl_(std::make_unique<Impl>()) {}
Trace::~Trace() = default;

void Trace::span(const std::string& name, Clock::time_point begin, Clock::time_point end,
                 const std::string& detail) {
    const std::lock_guard lock(impl_->mutex_);
    impl_->spans_.push_back({name, detail, begin, end, impl_->row()});
}

void Trace::name_thread(const std::string& name) {
    const std::lock_guard lock(impl_->mutex_);
    const int row = impl_->row();
    impl_->names_[static_cast<size_t>(row)] = name;
}

void Trace::write(const std::string& path) const {
    using Json = nlohmann::ordered_json;
    Json events = Json::array();
    {
        const std::lock_guard lock(impl_->mutex_);
        const auto micros = [&](Clock::time_point t) {
            return std::chrono::duration<double, std::micro>(t - impl_->start_).count();
        };
        for (size_t row = 0; row < impl_->names_.size(); ++row)
            events.push_back({{"name", "thread_name"},
                              {"ph", "M"},
                              {"pid", 1},
                              {"tid", row},
                              {"args", {{"name", impl_->names_[row]}}}});
        for (const Impl::Span& span : impl_->spans_) {
            Json event{{"name", span.name},
                       {"cat", "pave"},
                       {"ph", "X"},
                       {"pid", 1},
                       {"tid", span.row},
                       {"ts", micros(span.begin)},
                       {"dur", micros(span.end) - micros(span.begin)}};
            if (!span.detail.empty()) event["args"] = {{"detail", span.detail}};
            events.push_back(std::move(event));
        }
    }
    const Json trace{{"displayTimeUnit", "ms"}, {"traceEvents", std::move(events)}};
    write_file_whole(path, trace.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n");
}

}  // namespace pave
