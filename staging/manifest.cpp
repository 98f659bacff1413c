// Writing and reading of manifest lines.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/manifest.h"

#include <algorithm>
#include <map>

#include "pave/hash.h"

namespace pave {
namespace {

constexpr std::string_view kCheckKey = ",\"check\":\"";
constexpr size_t kHashDigits = 32;
constexpr size_t kCheckSize = kCheckKey.size() + kHashDigits + 2;  // ,"check":"..."}

bool is_hash(std::string_view text) {
    return text.size() == kHashDigits && std::all_of(text.begin(), text.end(), [](char c) {
               return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f');
           });
}

bool is_checked(std::string_view line, const std::string& check_before) {
    if (line.size() <= kCheckSize || !line.ends_with("\"}")) return false;
    const std::string_view body = line.substr(0, line.size() - kCheckSize);
    const std::string_view check = line.substr(body.size() + kCheckKey.size(), kHashDigits);
    return line.substr(body.size(), kCheckKey.size()) == kCheckKey &&
           hash_hex(check_before + std::string(body)) == check;
}

const Json& member(const Json& json, const char* key, const std::string& where) {
    const auto found = json.find(key);
    if (found == json.end()) throw InputError(where + ": '" + key + "' is missing");
    return *found;
}

std::string text_member(const Json& json, const char* key, const std::string& where) {
    const Json& value = member(json, key, where);
    if (!value.is_string()) throw InputError(where + ": '" + key + "' is not a text");
    return value.get<std::string>();
}

/// A file of a block: the block itself, or a plain name in the block's folder. Nothing leads out of
/// it.
bool is_block_file(const Manifest& manifest, const Block& block, const std::string& name) {
    if (manifest.kind == "exr") return name == block.name;
    const std::string folder = block.name + "/";
    return name.starts_with(folder) && is_valid_name(std::string_view(name).substr(folder.size()));
}

Block parse_block(const Json& json, const Manifest& manifest, const std::string& where) {
    Block block;
    block.name = text_member(json, "block", where);
    if (!is_block_name(manifest.kind, block.name))
        throw InputError(where + ": '" + block.name + "' is not a block's name");
    const Json& files = member(json, "files", where);
    const Json& frames = member(json, "frames", where);
    if (!files.is_array() || files.empty() || !frames.is_array() || frames.empty())
        throw InputError(where + ": a block without files or frames");
    for (const Json& file : files) {
        if (!file.is_object()) throw InputError(where + ": a file is not an object");
        FileFacts facts{text_member(file, "name", where), 0, text_member(file, "hash", where)};
        const Json& byte_size = member(file, "bytes", where);
        if (!byte_size.is_number_unsigned() || !is_hash(facts.hash) ||
            !is_block_file(manifest, block, facts.name))
            throw InputError(where + ": file '" + facts.name +
                             "' has no proper name, size or hash");
        facts.byte_size = byte_size.get<uint64_t>();
        block.files.push_back(std::move(facts));
    }
    for (const Json& frame : frames)
        block.frames.push_back(record_from_json(frame, manifest.schema, where));
    return block;
}

void parse_header(const Json& json, Manifest& manifest, const std::string& where) {
    manifest.header = json;
    manifest.kind = text_member(json, "kind", where);
    if (manifest.kind != "bp" && manifest.kind != "exr")
        throw InputError(where + ": unknown kind '" + manifest.kind + "'");
    manifest.schema = schema_from_json(member(json, "schema", where), where);
}

void check_closing(const Json& json, const Manifest& manifest, const std::string& where) {
    if (member(json, "frame_count", where) != manifest.frame_count() ||
        member(json, "content_hash", where) != content_hash(manifest.schema, manifest.records()))
        throw InputError(where + ": the closing record does not match the frames");
}

/// Refuses other versions before anything else of the line is looked at.
void check_version(std::string_view line, const std::string& where) {
    const Json json = parse_json(line);
    if (!json.is_object() || !json.contains("pave_manifest"))
        throw InputError(where + ": not a PAVE manifest");
    if (json["pave_manifest"] != kManifestVersion)
        throw InputError(where + ": format version " + json["pave_manifest"].dump() +
                         " is unknown, this PAVE reads version " +
                         std::to_string(kManifestVersion) + ": use the PAVE that wrote it");
}

}  // namespace

std::vector<FrameRecord> Manifest::records() const {
    std::vector<FrameRecord> all;
    for (const Block& block : blocks)
        all.insert(all.end(), block.frames.begin(), block.frames.end());
    return all;
}

int64_t Manifest::frame_count() const {
    int64_t count = 0;
    for (const Block& block : blocks) count += static_cast<int64_t>(block.frames.size());
    return count;
}

int64_t Manifest::next_index() const {
    return blocks.empty() ? 0 : blocks.back().frames.back().metadata.index + 1;
}

std::string checked_line(const Json& body, const std::string& check_before, std::string* check) {
    std::string line = body.dump();
    line.pop_back();  // the closing brace
    const std::string hash = hash_hex(check_before + line);
    if (check != nullptr) *check = hash;
    return line.append(kCheckKey).append(hash).append("\"}\n");
}

Json parse_checked_line(std::string_view line, const std::string& check_before,
                        const std::string& where, std::string* check) {
    if (!is_checked(line, check_before))
        throw InputError(where + ": checksum mismatch, the line is damaged");
    Json json = parse_json(line);
    if (!json.is_object()) throw InputError(where + ": not a JSON object");
    if (check != nullptr) *check = json["check"].get<std::string>();
    return json;
}

Json header_json(const std::string& kind, const FrameSchema& schema, const Json& options) {
    Json header{{"pave_manifest", kManifestVersion}, {"kind", kind}, {"schema", to_json(schema)}};
    header.update(options);
    return header;
}

Json block_json(const FrameSchema& schema, const Block& block) {
    Json files = Json::array(), frames = Json::array();
    for (const FileFacts& file : block.files)
        files.push_back({{"name", file.name}, {"bytes", file.byte_size}, {"hash", file.hash}});
    for (const FrameRecord& frame : block.frames) frames.push_back(to_json(schema, frame));
    return {{"block", block.name}, {"files", files}, {"frames", frames}};
}

Json closing_json(const FrameSchema& schema, const std::vector<FrameRecord>& records) {
    return {{"closed", true},
            {"frame_count", records.size()},
            {"content_hash", content_hash(schema, records)}};
}

bool is_block_name(const std::string& kind, std::string_view name) {
    const std::string_view prefix = kind == "bp" ? "frames-" : "frame-";
    const std::string_view suffix = kind == "bp" ? ".bp" : ".exr";
    return is_valid_name(name) && name.starts_with(prefix) && name.ends_with(suffix);
}

Manifest read_manifest(const fs::path& root) {
    const fs::path path = root / kManifestName;
    std::error_code error;
    if (!fs::exists(path, error))
        throw InputError(root.string() + " has no " + kManifestName +
                         ": not a data set of PAVE, and foreign data are not read");
    const std::string text = read_file_within(path, kManifestByteLimit);
    Manifest manifest;
    size_t begin = 0;
    int64_t last_index = -1;
    for (int line_number = 1;; ++line_number) {
        const size_t end = text.find('\n', begin);
        const std::string where = path.string() + ":" + std::to_string(line_number);
        if (end == std::string::npos) {
            const std::string_view torn = std::string_view(text).substr(begin);
            if (line_number == 1) throw InputError(where + ": the header line is not whole");
            // A killed writer leaves the beginning of a line; anything else is damage.
            if (!torn.empty() && (manifest.finished || torn.front() != '{' ||
                                  is_checked(torn.substr(0, torn.size() - 1), manifest.last_check)))
                throw InputError(where + ": the line does not end in a newline");
            break;
        }
        const std::string_view line = std::string_view(text).substr(begin, end - begin);
        if (manifest.finished) throw InputError(where + ": a line behind the closing record");
        if (line_number == 1) check_version(line, where);
        const std::string check_before = manifest.last_check;
        const Json json = parse_checked_line(line, check_before, where, &manifest.last_check);
        if (line_number == 1) {
            parse_header(json, manifest, where);
        } else if (json.contains("closed")) {
            check_closing(json, manifest, where);
            manifest.finished = true;
        } else {
            Block block = parse_block(json, manifest, where);
            for (const FrameRecord& frame : block.frames) {
                if (frame.metadata.index <= last_index)
                    throw InputError(where + ": frame numbers do not rise");
                last_index = frame.metadata.index;
            }
            block.line_offset = begin;
            block.check_before = check_before;
            manifest.blocks.push_back(std::move(block));
        }
        begin = manifest.byte_size = end + 1;
        if (!manifest.finished) {
            manifest.closing_offset = begin;
            manifest.closing_before = manifest.last_check;
        }
    }
    return manifest;
}

void verify_block(const fs::path& root, const Block& block) {
    const fs::path folder = root / block.name;
    std::error_code error;
    if (fs::is_symlink(folder, error))
        throw InputError(folder.string() + " is a link: a data set's files are its own");
    for (const FileFacts& expected : block.files) {
        const std::string path = (root / expected.name).string();
        // The size first: hashing what is a thousand times too long would take as much longer.
        const uint64_t byte_size = plain_file_byte_size(path);
        if (byte_size != expected.byte_size)
            throw InputError(path + " has " + std::to_string(byte_size) + " bytes, not " +
                             std::to_string(expected.byte_size) + " as its manifest says");
        if (file_facts(root, expected.name) != expected)
            throw InputError(path + ": checksum mismatch, the file is damaged");
    }
    // A file that the manifest does not know would be read by the library all the same.
    if (!fs::is_directory(folder)) return;
    size_t count = 0;
    for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
         entry.increment(error))
        ++count;
    if (error || count != block.files.size())
        throw InputError(folder.string() + " holds other files than its manifest says");
}

std::string timing_line(const FrameMetadata& metadata) {
    return checked_line({{"index", metadata.index}, {"seconds_spent", metadata.seconds_spent}}, {});
}

void read_timings(const fs::path& root, std::vector<Block>& blocks) {
    if (blocks.empty()) return;
    const fs::path path = root / kTimingsName;
    const std::string text = read_file_within(path, kManifestByteLimit);
    std::map<int64_t, double> seconds;
    size_t begin = 0;
    for (int line_number = 1;; ++line_number) {
        const size_t end = text.find('\n', begin);
        if (end == std::string::npos) break;  // torn: its frames were never acknowledged
        const std::string where = path.string() + ":" + std::to_string(line_number);
        const Json json =
            parse_checked_line(std::string_view(text).substr(begin, end - begin), {}, where);
        if (!member(json, "index", where).is_number_integer())
            throw InputError(where + ": 'index' is not a whole number");
        const Json& spent = member(json, "seconds_spent", where);
        seconds[json["index"].get<int64_t>()] = spent.is_number() ? spent.get<double>() : 0.0;
        begin = end + 1;
    }
    for (Block& block : blocks)
        for (FrameRecord& frame : block.frames) {
            const auto found = seconds.find(frame.metadata.index);
            if (found == seconds.end())
                throw InputError(path.string() + ": the line of frame " +
                                 std::to_string(frame.metadata.index) + " is missing");
            frame.metadata.seconds_spent = found->second;
        }
}

}  // namespace pave
