// <emitter type="envmap">: an image of what lies around the scene.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/scene/texture.h"

namespace pave {

/// Fills the scene's environment from the emitter's image, scale and rotation.
void read_environment_map(Properties& emitter, TextureReader& images, Scene& scene);

}  // namespace pave
