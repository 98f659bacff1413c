// Durable commits of blocks into a data set folder.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/folder_writer.h"

#include <fcntl.h>

#include <algorithm>
#include <cmath>

namespace pave {
namespace {

/// What a start that was killed early leaves behind is as good as nothing.
bool holds_nothing(const fs::path& root) {
    for (const fs::directory_entry& entry : fs::directory_iterator(root)) {
        const std::string name = entry.path().filename().string();
        if (name != kLockName && !name.starts_with(kTemporaryPrefix)) return false;
    }
    return true;
}

/// Nobody would read a longer one.
void check_room(const fs::path& path, uint64_t byte_size) {
    if (byte_size > kManifestByteLimit)
        throw RunError(path.string() + " would have more than " +
                       std::to_string(kManifestByteLimit) + " bytes: begin another data set");
}

std::string describe(const Json& header) {
    const Json& schema = header["schema"];
    std::string text = header["kind"].get<std::string>() + " " + schema["width"].dump() + "x" +
                       schema["height"].dump() + " with";
    for (const Json& channel : schema["channels"])
        text += " " + channel["name"].get<std::string>() + ":" + channel["planes"].dump();
    for (const auto& [key, value] : header.items())
        if (key != "pave_manifest" && key != "kind" && key != "schema" && key != "check")
            text += ", " + key + " " + value.dump();
    return text;
}

}  // namespace

FolderWriter::FolderWriter(const std::string& path, const std::string& kind,
                           const FrameSchema& schema, const Json& options, bool resume,
                           std::shared_ptr<Trace> trace)
    : root_(fs::absolute(path).lexically_normal()),
      kind_(kind),
      schema_(schema),
      trace_(std::move(trace)) {
    if (!root_.has_filename()) root_ = root_.parent_path();  // "data.bp/"
    try {
        // A folder of somebody else is refused before anything is put into it.
        if (fs::is_directory(root_)) refuse_foreign(resume);
        made_folder_ = make_folder(root_);
        lock_ = File(root_ / kLockName, O_RDWR | O_CREAT);
        if (!lock_.try_lock()) {
            lock_ = File();
            throw RunError(root_.string() +
                           " has another writer at work; wait for it or use another name");
        }
        refuse_foreign(resume);
        const Json header = header_json(kind_, schema_, options);
        fs::exists(root_ / kManifestName) ? start_resumed(header) : start_new(header);
    } catch (const fs::filesystem_error& error) {
        take_back_folder();
        throw RunError("cannot look into " + root_.string() + ": " + error.code().message());
    } catch (const RunError&) {
        take_back_folder();
        throw;
    }
}

/// After a start that failed: the folder goes if it was made for it, unless another writer, which
/// was faster with the lock, has it now.
void FolderWriter::take_back_folder() noexcept {
    std::error_code error;
    if (!made_folder_ || fs::exists(root_ / kManifestName, error) || error) return;
    if (lock_)
        remove_quietly(root_);
    else
        fs::remove(root_, error);  // empty ones only
}

void FolderWriter::refuse_foreign(bool resume) const {
    if (fs::exists(root_ / kManifestName)) {
        if (!resume) throw UsageError(root_.string() + " exists; resume it or use another name");
    } else if (!holds_nothing(root_)) {
        if (resume)
            throw InputError(root_.string() + " holds files but no " + kManifestName +
                             ": not a data set of PAVE; use another name");
        throw UsageError(root_.string() + " exists and is not empty; use another name");
    }
}

void FolderWriter::start_new(const Json& header) {
    remove_leftovers();
    const std::string line = checked_line(header, {}, &manifest_.last_check);
    write_file_whole(root_ / kManifestName, line);
    manifest_.header = header;
    manifest_.kind = kind_;
    manifest_.schema = schema_;
    manifest_.byte_size = manifest_.closing_offset = line.size();
    manifest_.closing_before = manifest_.last_check;
    manifest_file_ = File(root_ / kManifestName, O_WRONLY | O_APPEND);
    timings_file_ = File(root_ / kTimingsName, O_WRONLY | O_APPEND | O_CREAT | O_TRUNC);
    sync_path(root_);
}

void FolderWriter::start_resumed(const Json& header) {
    manifest_ = read_manifest(root_);
    Json found = manifest_.header;
    found.erase("check");
    if (found != header)
        throw UsageError(root_.string() + " cannot be resumed: it is " + describe(found) +
                         ", this stage is " + describe(header));
    for (const Block& block : manifest_.blocks) verify_block(root_, block);
    keep_acknowledged_timings();
    remove_leftovers();
    manifest_file_ = File(root_ / kManifestName, O_WRONLY | O_APPEND);
    manifest_file_.truncate(manifest_.byte_size);
    manifest_file_.sync();
    first_index_ = manifest_.next_index();
    first_count_ = acknowledged_ = manifest_.frame_count();
}

void FolderWriter::remove_leftovers() {
    std::vector<fs::path> leftovers;
    for (const fs::directory_entry& entry : fs::directory_iterator(root_)) {
        const std::string name = entry.path().filename().string();
        const bool is_known = std::any_of(manifest_.blocks.begin(), manifest_.blocks.end(),
                                          [&](const Block& block) { return block.name == name; });
        if (name.starts_with(kTemporaryPrefix) || (is_block_name(kind_, name) && !is_known))
            leftovers.push_back(entry.path());
    }
    for (const fs::path& leftover : leftovers) fs::remove_all(leftover);
}

void FolderWriter::keep_acknowledged_timings() {
    read_timings(root_, manifest_.blocks);
    std::string text;
    for (const Block& block : manifest_.blocks)
        for (const FrameRecord& frame : block.frames) text += timing_line(frame.metadata);
    const fs::path path = root_ / kTimingsName;
    if (!fs::exists(path) || read_file_within(path, kManifestByteLimit) != text)
        write_file_whole(path, text);
    timings_file_ = File(path, O_WRONLY | O_APPEND);
    timings_byte_size_ = text.size();
}

fs::path FolderWriter::temporary(const std::string& name) {
    const std::string temporary_name = kTemporaryPrefix + name;
    if (std::find(temporaries_.begin(), temporaries_.end(), temporary_name) == temporaries_.end())
        temporaries_.push_back(temporary_name);
    remove_quietly(root_ / temporary_name);
    return root_ / temporary_name;
}

std::vector<FileFacts> FolderWriter::sync_block(const std::string& temporary_name,
                                                const std::string& name) {
    const fs::path path = root_ / temporary_name;
    std::vector<FileFacts> files;
    if (!fs::is_directory(path)) {
        sync_path(path);
        files.push_back(file_facts(root_, temporary_name));
        files.back().name = name;
        return files;
    }
    std::vector<std::string> names;
    for (const fs::directory_entry& entry : fs::directory_iterator(path))
        names.push_back(entry.path().filename().string());
    std::sort(names.begin(), names.end());
    for (const std::string& file : names) {
        sync_path(path / file);
        files.push_back(file_facts(path, file));
        files.back().name = name + "/" + file;
    }
    sync_path(path);
    return files;
}

void FolderWriter::append(File& file, uint64_t byte_size, const std::string& text) {
    check_room(file.path(), byte_size + text.size());
    // A line into a file that nobody finds any more would acknowledge what is lost.
    if (!file.is_at_path())
        throw RunError(file.path().string() +
                       " was removed or replaced while it was being written");
    try {
        file.write_all(text);
        file.sync();
    } catch (...) {
        // Half a line would read as unacknowledged; better none at all.
        try {
            file.truncate(byte_size);
        } catch (const RunError&) {
        }
        throw;
    }
}

void FolderWriter::append_timings(const std::vector<FrameRecord>& frames, size_t known) {
    std::string text;
    for (size_t i = known; i < frames.size(); ++i) text += timing_line(frames[i].metadata);
    append(timings_file_, timings_byte_size_, text);
    timings_byte_size_ += text.size();
}

void FolderWriter::reopen_closed() {
    if (!manifest_.finished) return;
    manifest_file_.truncate(manifest_.closing_offset);
    manifest_file_.sync();
    manifest_.finished = false;
    manifest_.byte_size = manifest_.closing_offset;
    manifest_.last_check = manifest_.closing_before;
}

void FolderWriter::commit(const std::string& unfinished, const std::string& name,
                          std::vector<FrameRecord> frames, size_t replaced) {
    const auto begin = Trace::Clock::now();
    const std::string detail = "frames " + std::to_string(frames.front().metadata.index) + " to " +
                               std::to_string(frames.back().metadata.index);
    const std::string temporary_name = kTemporaryPrefix + unfinished;
    Block block{name, sync_block(temporary_name, name), std::move(frames), 0, {}};
    size_t known = 0;
    for (size_t i = 0; i < replaced; ++i)
        known += manifest_.blocks[manifest_.blocks.size() - 1 - i].frames.size();
    const auto fresh = static_cast<int64_t>(block.frames.size() - known);
    append_timings(block.frames, known);
    reopen_closed();
    rename_durable(root_ / temporary_name, root_ / name);
    std::erase(temporaries_, temporary_name);
    try {
        replaced > 0 ? replace_tail(std::move(block), replaced) : append_block(std::move(block));
    } catch (...) {
        remove_unlisted(name);
        throw;
    }
    manifest_.closing_offset = manifest_.byte_size;
    manifest_.closing_before = manifest_.last_check;
    acknowledged_ += fresh;
    if (trace_) trace_->span("fsync", begin, Trace::Clock::now(), detail);
}

void FolderWriter::append_block(Block block) {
    block.line_offset = manifest_.byte_size;
    block.check_before = manifest_.last_check;
    std::string check;
    const std::string line = checked_line(block_json(schema_, block), block.check_before, &check);
    append(manifest_file_, manifest_.byte_size, line);
    manifest_.last_check = check;
    manifest_.byte_size += line.size();
    manifest_.blocks.push_back(std::move(block));
}

void FolderWriter::remove_unlisted(const std::string& name) noexcept {
    try {
        for (const Block& block : read_manifest(root_).blocks)
            if (block.name == name) return;
        remove_quietly(root_ / name);
    } catch (const std::exception&) {
        // An unreadable manifest is no licence to delete.
    }
}

void FolderWriter::replace_tail(Block block, size_t replaced) {
    const auto first = manifest_.blocks.end() - static_cast<std::ptrdiff_t>(replaced);
    block.line_offset = first->line_offset;
    block.check_before = first->check_before;
    std::string text =
        read_file_within(root_ / kManifestName, kManifestByteLimit).substr(0, block.line_offset);
    std::string check;
    text += checked_line(block_json(schema_, block), block.check_before, &check);
    check_room(root_ / kManifestName, text.size());
    write_file_whole(root_ / kManifestName, text);
    manifest_.last_check = check;
    manifest_file_ = File(root_ / kManifestName, O_WRONLY | O_APPEND);
    for (auto old = first; old != manifest_.blocks.end(); ++old) remove_quietly(root_ / old->name);
    manifest_.blocks.erase(first, manifest_.blocks.end());
    manifest_.byte_size = text.size();
    manifest_.blocks.push_back(std::move(block));
}

void FolderWriter::close(bool finished) {
    if (!lock_) return;
    if (finished && !manifest_.finished) {
        const std::string line = checked_line(closing_json(schema_, manifest_.records()),
                                              manifest_.last_check, &manifest_.last_check);
        append(manifest_file_, manifest_.byte_size, line);
        manifest_.finished = true;
    }
    abandon();
}

void FolderWriter::abandon() noexcept {
    for (const std::string& name : temporaries_) remove_quietly(root_ / name);
    temporaries_.clear();
    manifest_file_ = File();
    timings_file_ = File();
    lock_ = File();  // last: from here on another writer may come
}

}  // namespace pave
