// Boxes around what a scene file puts into the world.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/scene/transform.h"

namespace pave {

/// A box that grows around what is included.
struct Bounds {
    Double3 low, high;  // low beyond high: empty
    Bounds();
    bool empty() const { return low[0] > high[0]; }
    void include(const Double3& point);
    /// Those of the mesh's vertices that triangles have.
    void include(const Mesh& mesh);
    /// An affine map's image of the box, or of the ellipsoid (`is_round`), of these half-extents
    /// around `center`.
    void include_image(const Affine& map, const Double3& center, const Double3& half,
                       bool is_round = false);
    /// The map's image of another box that is not empty.
    void include_image(const Affine& map, const Bounds& box);
    /// Whether all coordinates are small enough that squares and cubes stay finite in float32.
    bool in_range() const;
};

/// Makes them the scene's.
void set_bounds(Scene& scene, const Bounds& bounds);

}  // namespace pave
