// A model without a scene around it: a glTF, GLB or OBJ file, with a camera and light made for it.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>

#include "pave/hash.h"
#include "pave/scene.h"

namespace pave {

/// Whether the file's name ends as a model's does.
bool is_model(const std::filesystem::path& path);

/// The model as a scene (docs/scenes.md says how its materials are mapped). The bytes of the file
/// and of its images go into `hasher`. Throws InputError naming the file.
Scene import_scene(const std::filesystem::path& path, Hasher& hasher);

}  // namespace pave
