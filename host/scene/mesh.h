// Triangle meshes: OBJ and PLY files read as Mitsuba reads them, and what is done to them before
// rendering.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string_view>

#include "host/scene/transform.h"

namespace pave {

/// What can be wrong inside a mesh file; the caller adds the file's name. what() starts with "LINE:
/// " where lines exist.
struct MeshError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// Triangles of a file as they stand there. Polygons become fans from their first vertex. Throws
/// MeshError on everything that is not whole: a cut file, an index out of range, a number that is
/// none, vertices only some of which have normals.
Mesh parse_obj(std::string_view text);
Mesh parse_ply(std::string_view bytes);

struct MeshPlacement {
    Affine world_from_object;
    bool face_normals = false;  // drop the vertices' normals
    bool flip_normals = false;
    bool flip_texcoords = false;  // v becomes 1 - v: image rows count from the top
};
/// Moves `mesh` to its place: positions and unit normals in world space; without normals in the
/// file each vertex gets the angle-weighted mean of its triangles' normals (Thuermer and Wuethrich
/// 1998), as in Mitsuba. Flipping turns winding and normals. Triangles without area are dropped.
/// Throws MeshError if nothing is left or a number is not finite.
void place_mesh(Mesh& mesh, const MeshPlacement& placement);

double mesh_area(const Mesh& mesh);

}  // namespace pave
