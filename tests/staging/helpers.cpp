// Helpers of the staging tests.
// SPDX-License-Identifier: BSD-3-Clause
#include "tests/staging/helpers.h"

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <limits>
#include <sstream>

namespace pave::test {

TempFolder::TempFolder() {
    std::string name = (fs::temp_directory_path() / "pave-test-XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw std::runtime_error("mkdtemp failed: " + name);
    path_ = name;
}
TempFolder::~TempFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
}

StageOptions small_options() {
    StageOptions options;
    options.width = 16;
    options.height = 8;
    options.channels = {"color", "normal", "depth"};
    options.slots = 4;
    options.frames_per_shard = 4;
    return options;
}

float pixel_value(int64_t index, size_t channel, int plane, int x, int y) {
    uint64_t key = static_cast<uint64_t>(index) * 1000003 + channel * 10007 +
                   static_cast<uint64_t>(plane) * 101 + static_cast<uint64_t>(y) * 65537 +
                   static_cast<uint64_t>(x);
    key = (key ^ (key >> 31)) * 0x9E3779B97F4A7C15ull;
    key ^= key >> 29;
    if (channel == 2 && key % 16 == 0) return std::numeric_limits<float>::infinity();
    return static_cast<float>(static_cast<int64_t>(key >> 24 & 0xFFFFFF) - 0x800000) * 0x1.234p-21f;
}

namespace {

template <typename Visit>
void for_each_pixel(const FrameSchema& schema, Visit visit) {
    for (size_t c = 0; c < schema.channels().size(); ++c) {
        size_t i = 0;
        for (int plane = 0; plane < schema.channels()[c].planes; ++plane)
            for (int y = 0; y < schema.height(); ++y)
                for (int x = 0; x < schema.width(); ++x) visit(c, i++, plane, x, y);
    }
}

FrameMetadata metadata_of(int64_t index) {
    FrameMetadata m;
    m.index = index;
    for (size_t i = 0; i < 16; ++i)
        m.view.world_from_camera[i] = 0.1f * static_cast<float>(i) - static_cast<float>(index) / 3;
    m.view.fov_x_degrees = 39.3077f;
    m.spp = 64 + static_cast<int>(index);
    m.max_depth = 50;
    m.rr_depth = static_cast<int>(index % 4);  // 0 too: it is stored by being left out
    m.seed = 0xFFFFFFFFFFFFFFF0ull - static_cast<uint64_t>(index);
    m.scene = "cornell " + std::string(static_cast<size_t>(index % 9), 'x');
    m.scene_hash = "0123456789abcdef0123456789abcdef";
    m.device = "a device \"with quotes\", \xC3\xA4";
    m.driver = "3.1";
    m.kernel_hash = "fedcba9876543210fedcba9876543210";
    m.program_version = "0.1.0";
    m.program_commit = "abc123";
    m.weights_version = index % 2 == 0 ? "" : "v1";
    return m;
}

bool same_identity(const FrameMetadata& a, const FrameMetadata& b) {
    return a.index == b.index && a.view == b.view && a.spp == b.spp && a.max_depth == b.max_depth &&
           a.rr_depth == b.rr_depth && a.seed == b.seed && a.scene == b.scene &&
           a.scene_hash == b.scene_hash && a.device == b.device && a.driver == b.driver &&
           a.kernel_hash == b.kernel_hash && a.program_version == b.program_version &&
           a.program_commit == b.program_commit && a.weights_version == b.weights_version;
}

}  // namespace

void fill(Frame& frame, int64_t index) {
    const FrameSchema& schema = frame.schema();
    for_each_pixel(schema, [&](size_t c, size_t i, int plane, int x, int y) {
        frame.channel(schema.channels()[c].name)[i] = pixel_value(index, c, plane, x, y);
    });
    frame.metadata() = metadata_of(index);
}

std::string difference(const Frame& frame, int64_t index) {
    const std::string where = "frame " + std::to_string(index);
    if (!frame) return where + " is empty";
    if (!same_identity(frame.metadata(), metadata_of(index))) return where + ": metadata differ";
    std::string text;
    const FrameSchema& schema = frame.schema();
    for_each_pixel(schema, [&](size_t c, size_t i, int plane, int x, int y) {
        if (text.empty() &&
            frame.channel(schema.channels()[c].name)[i] != pixel_value(index, c, plane, x, y))
            text = where + ": channel " + schema.channels()[c].name + " differs at " +
                   std::to_string(i);
    });
    return text;
}

void publish_frames(Stage& stage, int64_t first, int64_t last) {
    for (int64_t index = first; index < last; ++index) {
        Frame frame = stage.acquire();
        fill(frame, index);
        frame.metadata().seconds_spent = 0.25 * static_cast<double>(index);
        stage.publish(std::move(frame));
    }
}

void write_data_set(const std::string& uri, int64_t count, StageOptions options) {
    Stage stage(uri, std::move(options));
    publish_frames(stage, stage.first_index(), count);
    stage.close();
}

std::string check_data_set(const std::string& uri, int64_t count, bool allow_unfinished) {
    const auto source = Source::open(uri, allow_unfinished);
    if (source->frame_count() != count)
        return uri + " holds " + std::to_string(source->frame_count()) + " frames, not " +
               std::to_string(count);
    for (int64_t position = 0; position < count; ++position) {
        const std::string text = difference(source->read(position), position);
        if (!text.empty()) return uri + ": " + text;
        if (source->metadata(position).seconds_spent != 0.25 * static_cast<double>(position))
            return uri + ": seconds_spent of frame " + std::to_string(position) + " differ";
    }
    return {};
}

std::string read_text(const fs::path& path) {
    std::ifstream file(path, std::ios::binary);
    std::ostringstream text;
    text << file.rdbuf();
    return text.str();
}

void write_text(const fs::path& path, const std::string& text) {
    std::ofstream(path, std::ios::binary) << text;
}

std::vector<std::string> list_files(const fs::path& folder) {
    std::vector<std::string> names;
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder))
        if (entry.is_regular_file()) names.push_back(fs::relative(entry.path(), folder).string());
    std::sort(names.begin(), names.end());
    return names;
}

}  // namespace pave::test
