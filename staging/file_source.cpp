// Verified reading of data set folders.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/file_source.h"

namespace pave {

FileSource::FileSource(const std::string& path, const std::string& kind, bool allow_unfinished)
    : root_(fs::absolute(path).lexically_normal()) {
    if (!fs::is_directory(root_))
        throw InputError(root_.string() + " is not there or not a folder");
    manifest_ = read_manifest(root_);
    if (manifest_.kind != kind)
        throw InputError(root_.string() + " is a " + manifest_.kind + ": data set; open it as " +
                         manifest_.kind + ":" + path);
    if (!manifest_.finished && !allow_unfinished)
        throw InputError(root_.string() + " is unfinished, " +
                         std::to_string(manifest_.frame_count()) +
                         " frames are there: resume it, or allow unfinished data");
    read_timings(root_, manifest_.blocks);
    for (size_t block = 0; block < manifest_.blocks.size(); ++block)
        for (size_t step = 0; step < manifest_.blocks[block].frames.size(); ++step)
            places_.push_back({block, step});
}

const FileSource::Place& FileSource::place(int64_t position) const {
    if (position < 0 || position >= frame_count())
        throw UsageError(root_.string() + " has no frame at position " + std::to_string(position) +
                         "; it holds " + std::to_string(frame_count()));
    return places_[static_cast<size_t>(position)];
}

FrameMetadata FileSource::metadata(int64_t position) const {
    const Place at = place(position);
    return manifest_.blocks[at.block].frames[at.step].metadata;
}

Frame FileSource::read(int64_t position, ArenaAllocator& allocator) {
    const Place at = place(position);
    const Block& block = manifest_.blocks[at.block];
    Frame frame;
    try {
        frame = decode(block, at.step, allocator);
    } catch (const InputError&) {
        throw;
    } catch (const std::exception& error) {
        throw InputError((root_ / block.name).string() + " cannot be read: " + error.what());
    }
    const FrameRecord& record = block.frames[at.step];
    const FrameRecord found = make_record(frame);
    for (size_t i = 0; i < found.channel_hashes.size(); ++i)
        if (found.channel_hashes[i] != record.channel_hashes[i])
            throw InputError((root_ / block.name).string() + ": channel '" +
                             schema().channels()[i].name + "' of frame " +
                             std::to_string(record.metadata.index) +
                             " is not what was produced: checksum mismatch");
    frame.metadata() = record.metadata;
    return frame;
}

Frame FileSource::next(std::chrono::milliseconds, ArenaAllocator& allocator) {
    return next_ < frame_count() ? read(next_++, allocator) : Frame();
}

std::string FileSource::content_hash() const {
    return pave::content_hash(schema(), manifest_.records());
}

}  // namespace pave
