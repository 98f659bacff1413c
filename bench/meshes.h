// The meshes and rays that the bench programs measure with, the same on every machine.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include "pave/rays.h"
#include "pave/scene.h"

namespace pave::bench {

/// A sphere with bumps of several sizes, of at least `triangles` triangles, in the middle of a box
/// [-1, 1]^3 of twelve; one mesh, closed both ways. Its last
/// vertex is a spare one: peers read past their vertices.
Mesh bumpy_sphere_in_box(size_t triangles);

/// A scene of this one mesh.
Scene scene_of(Mesh mesh);

/// Bounces: from random points of the sphere, off its surface, distributed by the cosine.
std::vector<Ray> diffuse_rays(const Mesh& mesh, size_t count, uint32_t seed);
/// From the same points to random points of a lamp under the box's ceiling.
std::vector<Ray> shadow_rays(const Mesh& mesh, size_t count, uint32_t seed);
/// Of a pinhole camera in the box that sees the whole sphere, row by row; `side` squared rays.
std::vector<Ray> primary_rays(size_t side);

}  // namespace pave::bench
