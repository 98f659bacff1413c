// Frames with known pixels, data sets of them, and folders that clean up after themselves.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "pave/source.h"
#include "pave/stage.h"

namespace pave::test {

namespace fs = std::filesystem;

/// A fresh folder, removed at the end of its life.
class TempFolder {
   public:
    TempFolder();
    ~TempFolder();
    TempFolder(const TempFolder&) = delete;
    TempFolder& operator=(const TempFolder&) = delete;
    fs::path operator/(const std::string& name) const { return path_ / name; }
    const fs::path& path() const { return path_; }

   private:
    fs::path path_;
};

/// Options of a small stage: 16x8, color 3, normal 3 and depth 1, four frames a shard.
StageOptions small_options();
/// The value of plane `plane` of `channel`, pixel (x, y), of frame `index`: signed, not round, +inf
/// now and then in depth.
float pixel_value(int64_t index, size_t channel, int plane, int x, int y);
/// Pixels and every metadata field from the index alone, but for seconds_spent.
void fill(Frame& frame, int64_t index);
/// "" if `frame` is exactly fill(index), else what differs.
std::string difference(const Frame& frame, int64_t index);
/// Publishes frames first..last-1.
void publish_frames(Stage& stage, int64_t first, int64_t last);
/// A whole data set of `count` frames at `uri`, closed.
void write_data_set(const std::string& uri, int64_t count, StageOptions options = small_options());
/// "" if `uri` opens and holds exactly frames 0..count-1.
std::string check_data_set(const std::string& uri, int64_t count, bool allow_unfinished = false);

std::string read_text(const fs::path& path);
void write_text(const fs::path& path, const std::string& text);
/// Plain files below `folder`, sorted, relative.
std::vector<std::string> list_files(const fs::path& folder);

}  // namespace pave::test
