// The exr: sink and source: a folder with one EXR file a frame.
// SPDX-License-Identifier: BSD-3-Clause
#include <cinttypes>
#include <cstdio>

#include "staging/exr.h"
#include "staging/file_source.h"
#include "staging/folder_writer.h"

namespace pave {
namespace {

class ExrSink final : public Sink {
   public:
    ExrSink(const std::string& path, const FrameSchema& schema, const StageOptions& options)
        : name_("exr:" + path),
          names_(options.exr_names),
          folder_(path, "exr", schema, {{"exr_names", options.exr_names}}, options.resume,
                  options.trace) {}

    std::string name() const override { return name_; }
    int64_t first_index() const override { return folder_.first_index(); }
    int64_t first_count() const override { return folder_.first_count(); }
    int64_t acknowledged() const override { return folder_.acknowledged(); }

    void write(const Frame& frame, const FrameRecord& record) override {
        char name[40];
        std::snprintf(name, sizeof name, "frame-%08" PRId64 ".exr", record.metadata.index);
        write_exr_file(frame, record, names_, folder_.temporary(name));
        folder_.commit(name, name, {record});
    }
    void flush() override {}  // every write was durable
    void close(bool finished) override { folder_.close(finished); }
    void abandon() noexcept override { folder_.abandon(); }

   private:
    const std::string name_, names_;
    FolderWriter folder_;
};

class ExrSource final : public FileSource {
   public:
    ExrSource(const std::string& path, bool allow_unfinished)
        : FileSource(path, "exr", allow_unfinished) {}

   private:
    Frame decode(const Block& block, size_t, ArenaAllocator& allocator) override {
        verify_block(root(), block);
        return read_exr_file(root() / block.name, &schema(), allocator);
    }
};

}  // namespace

std::unique_ptr<Sink> make_exr_sink(const std::string& path, const FrameSchema& schema,
                                    const StageOptions& options) {
    for (const Channel& channel : schema.channels()) exr_plane_names(channel, options.exr_names);
    return std::make_unique<ExrSink>(path, schema, options);
}

std::unique_ptr<Source> open_exr_source(const std::string& path, bool allow_unfinished) {
    return std::make_unique<ExrSource>(path, allow_unfinished);
}

}  // namespace pave
