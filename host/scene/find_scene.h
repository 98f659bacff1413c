// Where a scene's name leads: PAVE's own scenes folders, in order.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace pave {

/// Folders with scenes that exist here: PAVE_SCENE_DIR alone if it is set, else those installed
/// beside the library, else the source tree's.
std::vector<std::filesystem::path> scene_folders();

/// Anything with a slash or ".xml" is a path and returned as it is; a bare name is looked up in
/// scene_folders(). Throws InputError with the names there are.
std::filesystem::path find_scene(const std::string& path_or_name);

}  // namespace pave
