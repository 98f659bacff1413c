// How the planes of a frame are called inside an EXR file.
// SPDX-License-Identifier: BSD-3-Clause
#include <string_view>

#include "staging/exr.h"

namespace pave {
namespace {

struct Spelling {
    std::string_view channel, suffixes;   // one letter a plane
    std::string_view pave, oidn, cycles;  // layer, "" for the root
};

// Cycles' own DiffDir pass lacks the albedo, which our `direct` contains: it keeps a name of its
// own there.
constexpr Spelling kSpellings[] = {
    {"color", "RGB", "", "", "ViewLayer.Combined"},
    {"albedo", "RGB", "albedo", "albedo", "ViewLayer.Denoising Albedo"},
    {"normal", "XYZ", "normal", "normal", "ViewLayer.Denoising Normal"},
    {"depth", "Z", "depth", "Denoising Depth", "ViewLayer.Depth"},
    {"distance", "Z", "distance", "distance", "ViewLayer.distance"},
    {"direct", "RGB", "direct", "direct", "ViewLayer.direct"},
    {"variance", "RGB", "variance", "variance", "ViewLayer.variance"},
    {"position", "XYZ", "position", "position", "ViewLayer.Position"},
    {"object", "I", "object", "object", "ViewLayer.IndexOB"},
    {"drawn", "RGB", "drawn", "drawn", "ViewLayer.drawn"},
};

}  // namespace

std::vector<std::string> exr_plane_names(const Channel& channel, const std::string& names) {
    if (names != "pave" && names != "oidn" && names != "cycles")
        throw UsageError("unknown EXR spelling '" + names + "'; known are pave, oidn, cycles");
    std::vector<std::string> planes;
    for (const Spelling& spelling : kSpellings) {
        if (spelling.channel != channel.name ||
            static_cast<int>(spelling.suffixes.size()) != channel.planes)
            continue;
        const std::string_view layer = names == "pave"   ? spelling.pave
                                       : names == "oidn" ? spelling.oidn
                                                         : spelling.cycles;
        for (const char suffix : spelling.suffixes)
            planes.push_back((layer.empty() ? "" : std::string(layer) + ".") + suffix);
        // Blender's object index pass ends in X.
        if (names == "cycles" && channel.name == "object") planes.back().back() = 'X';
        return planes;
    }
    for (int plane = 0; plane < channel.planes; ++plane)
        planes.push_back(channel.name + "." + std::to_string(plane));
    return planes;
}

}  // namespace pave
