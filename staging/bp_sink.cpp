// The bp: sink: frames into shards by their number, shards into the folder when they are full.
// SPDX-License-Identifier: BSD-3-Clause
#include <cinttypes>
#include <cstdio>

#include "staging/bp.h"
#include "staging/folder_writer.h"

namespace pave {
namespace {

/// "frames-00000016.bp", or with the count of its frames if it ended before its boundary: one that
/// a resumed run joins with more frames then begins alike.
std::string shard_name(int64_t first_index, size_t frames, bool is_full) {
    char name[80];
    if (is_full)
        std::snprintf(name, sizeof name, "frames-%08" PRId64 ".bp", first_index);
    else
        std::snprintf(name, sizeof name, "frames-%08" PRId64 "-%zu.bp", first_index, frames);
    return name;
}

class BpSink final : public Sink {
   public:
    BpSink(const std::string& path, const FrameSchema& schema, const StageOptions& options)
        : name_("bp:" + path),
          frames_per_shard_(options.frames_per_shard),
          folder_(path, "bp", schema, {{"frames_per_shard", options.frames_per_shard}},
                  options.resume, options.trace) {
        if (!folder_.blocks().empty() && !is_boundary(folder_.first_index())) find_short_tail();
    }
    ~BpSink() override { abandon(); }

    std::string name() const override { return name_; }
    int64_t first_index() const override { return folder_.first_index(); }
    int64_t first_count() const override { return folder_.first_count(); }
    int64_t acknowledged() const override { return folder_.acknowledged(); }

    void write(const Frame& frame, const FrameRecord& record) override {
        const int64_t index = record.metadata.index;
        if (writer_ && shard_of(index) != shard_of(frames_.front().metadata.index)) seal();
        if (!writer_) begin_shard(index);
        writer_->put(frame);
        frames_.push_back(record);
        if (is_boundary(index + 1)) seal();
    }
    void flush() override {
        if (writer_) seal();
    }
    void close(bool finished) override {
        flush();
        folder_.close(finished);
    }
    void abandon() noexcept override {
        try {
            writer_.reset();
        } catch (const std::exception&) {
            // What ADIOS2 could not write is deleted next.
        }
        frames_.clear();
        folder_.abandon();
    }

   private:
    int64_t shard_of(int64_t index) const { return index / frames_per_shard_; }
    bool is_boundary(int64_t index) const { return index % frames_per_shard_ == 0; }

    /// Shards at the end that a flush or a close ended early: the next frames of the same shard are
    /// put with theirs, so that an interrupted run ends with the same files as an unbroken one.
    void find_short_tail() {
        const int64_t shard = shard_of(folder_.first_index());
        const auto& blocks = folder_.blocks();
        while (short_tail_ < blocks.size()) {
            const Block& block = blocks[blocks.size() - 1 - short_tail_];
            if (shard_of(block.frames.front().metadata.index) != shard) break;
            ++short_tail_;
        }
    }

    void begin_shard(int64_t index) {
        replaced_ = 0;
        if (short_tail_ > 0 && shard_of(index) == shard_of(folder_.first_index()))
            replaced_ = short_tail_;
        short_tail_ = 0;
        writer_ = std::make_unique<BpWriter>(folder_.temporary(kOpenShard), folder_.schema());
        const auto& blocks = folder_.blocks();
        for (size_t i = blocks.size() - replaced_; i < blocks.size(); ++i) replay(blocks[i]);
    }

    /// Puts the frames of a short shard into the open one.
    void replay(const Block& block) {
        BpReader reader(folder_.root(), block, folder_.schema());
        for (size_t step = 0; step < block.frames.size(); ++step) {
            Frame frame = make_frame(folder_.schema());
            reader.get(step, frame);
            frame.metadata() = block.frames[step].metadata;
            if (make_record(frame).channel_hashes != block.frames[step].channel_hashes)
                throw InputError(block.name + ": the pixels are not those that were written");
            writer_->put(frame);
            frames_.push_back(block.frames[step]);
        }
    }

    void seal() {
        const bool is_full = is_boundary(frames_.back().metadata.index + 1);
        writer_->close();
        writer_.reset();
        const std::string name =
            shard_name(frames_.front().metadata.index, frames_.size(), is_full);
        folder_.commit(kOpenShard, name, std::exchange(frames_, {}), replaced_);
    }

    static constexpr const char* kOpenShard = "shard";
    const std::string name_;
    const int64_t frames_per_shard_;
    FolderWriter folder_;
    std::unique_ptr<BpWriter> writer_;
    std::vector<FrameRecord> frames_;  // of the open shard
    size_t short_tail_ = 0, replaced_ = 0;
};

}  // namespace

std::unique_ptr<Sink> make_bp_sink(const std::string& path, const FrameSchema& schema,
                                   const StageOptions& options) {
    return std::make_unique<BpSink>(path, schema, options);
}

}  // namespace pave
