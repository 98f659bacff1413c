// Camera, film, sampler and integrator of the scene file.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/scene/xml.h"

namespace pave {

/// Fills view, width, height and spp.
void read_sensor(SceneFile& file, pugi::xml_node node, Scene& scene);
/// What max_depth -1 means.
inline constexpr int kEndlessDepth = std::numeric_limits<int>::max();

/// Fills max_depth and rr_depth.
void read_integrator(SceneFile& file, pugi::xml_node node, Scene& scene);

}  // namespace pave
