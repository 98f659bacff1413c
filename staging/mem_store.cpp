// The process-wide table of mem: stores, and what a store does with its frames.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/mem_store.h"

#include <condition_variable>
#include <deque>
#include <map>
#include <mutex>

namespace pave {
namespace {

/// Frames of one stage in order, each a reference to the stage's very slot. Held by the stage and
/// its sources; the table only knows it weakly, so it disappears with the last of them.
class MemStore {
   public:
    struct Entry {
        Frame frame;
        FrameRecord record;
    };
    MemStore(std::string name, FrameSchema schema)
        : name_(std::move(name)), schema_(std::move(schema)) {}

    void put(const Frame& frame, const FrameRecord& record) {
        const std::lock_guard lock(mutex_);
        ++visible_;
        if (!name_.empty()) entries_.push_back({frame, record});
        changed_.notify_all();
    }
    void finish(bool finished) {
        const std::lock_guard lock(mutex_);
        ended_ = true;
        finished_ = finished;
        changed_.notify_all();
    }
    bool drop_oldest() {
        Entry dropped;  // its slot goes back after the lock is gone
        const std::lock_guard lock(mutex_);
        for (auto entry = entries_.begin(); entry != entries_.end(); ++entry) {
            if (entry->frame.slot().use_count() != 1) continue;
            dropped = std::move(*entry);
            entries_.erase(entry);
            --visible_;  // a frame is acknowledged or dropped, not both
            return true;
        }
        return false;
    }
    Frame take(std::chrono::milliseconds timeout) {
        std::unique_lock lock(mutex_);
        const auto deadline = std::chrono::steady_clock::now() + timeout;
        if (!changed_.wait_until(lock, deadline, [&] { return !entries_.empty() || ended_; }))
            throw PeerError("mem:" + name_ + ": no frame within " +
                            std::to_string(timeout.count()) +
                            " ms; its stage is open and has shown " + std::to_string(visible_));
        if (entries_.empty()) return {};
        Frame frame = std::move(entries_.front().frame);
        entries_.pop_front();
        return frame;
    }
    Entry at(int64_t position) const {
        const std::lock_guard lock(mutex_);
        if (position < 0 || position >= static_cast<int64_t>(entries_.size()))
            throw UsageError("mem:" + name_ + " has no frame at position " +
                             std::to_string(position) + "; it holds " +
                             std::to_string(entries_.size()) + " now");
        return entries_[static_cast<size_t>(position)];
    }
    std::vector<Frame> frames() const {
        const std::lock_guard lock(mutex_);
        std::vector<Frame> frames;
        for (const Entry& entry : entries_) frames.push_back(entry.frame);
        return frames;
    }
    std::vector<FrameRecord> records() const {
        const std::lock_guard lock(mutex_);
        std::vector<FrameRecord> records;
        for (const Entry& entry : entries_) records.push_back(entry.record);
        return records;
    }
    int64_t size() const {
        const std::lock_guard lock(mutex_);
        return static_cast<int64_t>(entries_.size());
    }
    int64_t visible() const {
        const std::lock_guard lock(mutex_);
        return visible_;
    }
    bool ended() const {
        const std::lock_guard lock(mutex_);
        return ended_;
    }
    bool finished() const {
        const std::lock_guard lock(mutex_);
        return finished_;
    }
    const std::string& name() const { return name_; }
    const FrameSchema& schema() const { return schema_; }

   private:
    const std::string name_;
    const FrameSchema schema_;
    mutable std::mutex mutex_;
    std::condition_variable changed_;
    std::deque<Entry> entries_;
    int64_t visible_ = 0;
    bool ended_ = false, finished_ = false;
};

/// The one table of the process: a name in a URI has to lead somewhere without an object at hand.
struct MemTable {
    std::mutex mutex;
    std::map<std::string, std::weak_ptr<MemStore>> stores;
};
MemTable& mem_table() {
    static MemTable table;
    return table;
}

class MemSink final : public Sink {
   public:
    explicit MemSink(std::shared_ptr<MemStore> store) : store_(std::move(store)) {}
    ~MemSink() override { store_->finish(store_->finished()); }
    std::string name() const override { return "mem:" + store_->name(); }
    void write(const Frame& frame, const FrameRecord& record) override {
        store_->put(frame, record);
    }
    void flush() override {}
    void close(bool finished) override { store_->finish(finished); }
    void abandon() noexcept override { store_->finish(false); }
    int64_t acknowledged() const override { return store_->visible(); }
    bool drop_oldest() override { return store_->drop_oldest(); }

   private:
    const std::shared_ptr<MemStore> store_;
};

class MemSource final : public Source {
   public:
    explicit MemSource(std::shared_ptr<MemStore> store) : store_(std::move(store)) {}
    const FrameSchema& schema() const override { return store_->schema(); }
    int64_t frame_count() const override { return store_->size(); }
    bool finished() const override { return store_->finished(); }
    FrameMetadata metadata(int64_t position) const override {
        return store_->at(position).record.metadata;
    }
    Frame read(int64_t position, ArenaAllocator&) override { return store_->at(position).frame; }
    std::vector<Frame> read_all(ArenaAllocator&) override { return store_->frames(); }
    Frame next(std::chrono::milliseconds timeout, ArenaAllocator&) override {
        return store_->take(timeout);
    }
    std::string content_hash() const override {
        return pave::content_hash(store_->schema(), store_->records());
    }

   private:
    const std::shared_ptr<MemStore> store_;
};

}  // namespace

std::unique_ptr<Sink> make_mem_sink(const std::string& name, const FrameSchema& schema) {
    auto store = std::make_shared<MemStore>(name, schema);
    if (!name.empty()) {
        MemTable& table = mem_table();
        const std::lock_guard lock(table.mutex);
        std::erase_if(table.stores, [](const auto& entry) { return entry.second.expired(); });
        auto& known = table.stores[name];
        if (const auto other = known.lock(); other && !other->ended())
            throw UsageError("mem:" + name + " has a stage already; close it or use another name");
        known = store;
    }
    return std::make_unique<MemSink>(std::move(store));
}

std::unique_ptr<Source> open_mem_source(const std::string& name) {
    if (name.empty()) throw UsageError("mem: without a name cannot be read; write mem:NAME");
    MemTable& table = mem_table();
    const std::lock_guard lock(table.mutex);
    const auto found = table.stores.find(name);
    auto store = found == table.stores.end() ? nullptr : found->second.lock();
    if (!store)
        throw UsageError("there is no mem:" + name +
                         " in this process; make its stage first and keep it");
    return std::make_unique<MemSource>(std::move(store));
}

}  // namespace pave
