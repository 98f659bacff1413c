// Where a scene's name leads: PAVE's own scenes folders, in order.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/find_scene.h"

#include <dlfcn.h>

#include <cstdlib>
#include <set>

#include "host/scene/import_scene.h"
#include "host/scene/text.h"
#include "pave/error.h"
#include "pave/frame.h"

namespace pave {
namespace fs = std::filesystem;
namespace {

// Folder of the library or program that this function is in; empty if the loader does not say.
fs::path library_folder() {
    Dl_info info{};
    if (dladdr(reinterpret_cast<const void*>(&library_folder), &info) == 0 ||
        info.dli_fname == nullptr)
        return {};
    std::error_code error;
    const fs::path path = fs::canonical(info.dli_fname, error);
    return error ? fs::path() : path.parent_path();
}

}  // namespace

std::vector<fs::path> scene_folders() {
    if (const char* folder = std::getenv("PAVE_SCENE_DIR"); folder != nullptr && *folder != '\0')
        return {folder};
    std::vector<fs::path> folders;
    if (const fs::path library = library_folder(); !library.empty())
        folders = {library / ".." / "share" / "pave" / "scenes", library / "scenes",
                   library / ".." / "scenes"};
    folders.emplace_back(PAVE_SOURCE_SCENES);
    std::error_code error;
    std::erase_if(folders,
                  [&](const fs::path& folder) { return !fs::is_directory(folder, error); });
    return folders;
}

fs::path find_scene(const std::string& path_or_name) {
    if (path_or_name.find('/') != std::string::npos || path_or_name.ends_with(".xml") ||
        is_model(path_or_name))
        return path_or_name;
    if (!is_valid_name(path_or_name))
        throw InputError("scene " + quote(path_or_name) +
                         " is neither a name nor a path ending in .xml");
    const std::vector<fs::path> folders = scene_folders();
    std::set<std::string> names;
    std::error_code error;
    for (const fs::path& folder : folders) {
        const fs::path path = folder / (path_or_name + ".xml");
        if (fs::is_regular_file(path, error)) return path.lexically_normal();
        for (const fs::directory_entry& entry : fs::directory_iterator(folder, error))
            if (entry.path().extension() == ".xml") names.insert(entry.path().stem().string());
    }
    const std::vector<std::string> known(names.begin(), names.end());
    throw InputError(
        "no scene is called " + quote(path_or_name) + did_you_mean(path_or_name, known) +
        (known.empty() ? "; set PAVE_SCENE_DIR to the folder with PAVE's scenes"
                       : "; there are " + join(known) + ", or give the path of an .xml file"));
}

}  // namespace pave
